"""The rate of a load that turns with its aircraft, against closed forms and a dense scan."""

import functools
import math

import numpy as np
import pytest

from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.model.pattern import ConstantSpreadConfig
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.optimization.constraints import Constraints
from drake_nonstop.optimization.diagnostics import Outcome
from drake_nonstop.optimization.problem_config import LimitsConfig
from drake_nonstop.optimization.turn_rate import TurnRateSolver, TurnUpdate

CORNERS = [[1.5, 0.0, 0.0], [0.0, 1.5, 0.0], [-1.5, 0.0, 0.0], [0.0, -1.5, 0.0]]
SPREAD, LENGTH, SHARE = 30.0, 60.0, 10.0 * 9.81 / 4
RADIUS = 1.5 + LENGTH * SPREAD / math.hypot(SPREAD, SHARE)  # of the level circles


@functools.cache
def turning_model():
    system = SystemParameters(
        load_mass=10.0,
        load_inertia=[[5.6, 0.0, 0.0], [0.0, 5.6, 0.0], [0.0, 0.0, 11.2]],
        load_drag=0.0,
        attachments=CORNERS,
        cable_length=LENGTH,
        cable_stiffness=math.inf,
        aircraft=AircraftParameters(model="rascal_110"),
    )
    return Model(system, ConstantSpreadConfig(spread=SPREAD))


def solver(phases=16, **limits):
    config = LimitsConfig(tightening=0.0, **limits)
    return TurnRateSolver(turning_model(), Constraints(config), phases)


def update(speed_bound, previous=0.4, wind=(0.0, 0.0, 0.0), **others):
    values = {"nominal": 0.4, "anchor_weight": 0.0, "low": 0.1, "high": 2.0} | others
    return TurnUpdate(
        previous=previous,
        motion=np.eye(22)[0],
        wrench=np.array([0, 0, 0, 0, 0, 98.1]),
        wrench_rate=np.zeros(6),
        wind=np.array(wind),
        speed_bound=speed_bound,
        **values,
    )


@pytest.mark.parametrize("wind", [0.0, 3.0])
def test_the_rate_is_the_least_at_which_the_slowest_phase_has_the_bound(wind):
    """ξ R − w = ε at the phase that flies with the wind."""
    answer = solver().solve(update(24.0, wind=(wind, 0.0, 0.0)))
    assert answer.outcome == Outcome.SOLVED
    assert answer.rate == pytest.approx((24.0 + wind) / RADIUS, rel=1e-6)
    assert answer.slowest_speed == pytest.approx(24.0, rel=1e-6)
    assert solver().solve(update(24.0, previous=answer.rate, wind=(wind, 0, 0))).outcome == (
        Outcome.KEPT
    )


def test_the_bank_limits_the_rate_by_its_closed_form():
    """tan φ = [V²/gR − μ tan ϑ]/(1 + μ), with μ the load's mass over that of all aircraft."""
    ratio, most = 10.0 / 24.0, 0.3
    slope = SPREAD / SHARE
    square = 9.81 / RADIUS * ((1 + ratio) * math.tan(most) + ratio * slope)
    answer = solver(max_bank=most).solve(update(10.0, previous=0.9))
    assert answer.outcome == Outcome.SOLVED
    assert answer.rate == pytest.approx(math.sqrt(square), rel=1e-6)


def test_what_is_found_is_the_nearest_of_a_dense_scan(rng):
    limited = solver(8, max_lift_share=0.8, max_bank=0.7, max_thrust_share=0.9)
    rates = np.geomspace(0.1, 2.0, 800)
    outcomes = set()
    for _ in range(10):
        given = update(
            rng.uniform(8, 22), rng.uniform(0.15, 1.5), wind=rng.normal(size=3) * [3, 3, 0]
        )
        answer = limited.solve(given)
        margins = limited.margins(given, rates)[0].min(axis=0)
        feasible = rates[margins >= 0]
        outcomes.add(answer.outcome)
        if answer.outcome in (Outcome.KEPT, Outcome.SOLVED):
            assert limited.margins(given, np.array([answer.rate]))[0].min() >= -1e-6
            if len(feasible):
                best = np.min(np.abs(feasible - given.previous))
                assert abs(answer.rate - given.previous) <= best + 1e-9
        else:
            assert len(feasible) == 0
            assert answer.missed
    assert {Outcome.SOLVED, Outcome.RELAXED} <= outcomes


def test_the_airspeed_comes_before_the_other_limits():
    answer = solver(max_bank=0.2).solve(update(25.0))
    assert answer.outcome == Outcome.RELAXED
    assert answer.slowest_speed >= 25.0
    assert answer.missed == ["bank"]


def test_the_anchor_leads_back_as_far_as_the_bound_allows():
    far = solver().solve(update(10.0, previous=0.6, anchor_weight=1.0))
    assert far.rate == pytest.approx(0.5)
    held = solver().solve(update(24.0, previous=0.6, anchor_weight=9.0))
    assert held.rate == pytest.approx(24.0 / RADIUS, rel=1e-6)
