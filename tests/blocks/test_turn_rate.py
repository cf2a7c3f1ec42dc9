"""The rate of a load that turns with its aircraft, against closed forms and a dense scan."""

import functools
import math

import numpy as np
import pytest

from drake_nonstop.blocks.turn_rate_optimizer import TurnRateOptimizerConfig, TurnRateSolver
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.model.pattern import ConstantSpreadConfig
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.planning.diagnostics import Outcome

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


NO_LIMITS = dict.fromkeys(["max_lift_share", "max_bank", "max_thrust_share"], math.inf)
LOAD = np.eye(22)[0], np.array([0, 0, 0, 0, 0, 98.1]), np.zeros(6)


def solver(phases=16, **settings):
    """Of a rate that may be 0.1 to 2 rad/s at once."""
    config = TurnRateOptimizerConfig(
        **{"tightening": 0.0, "orbit_points": phases, "max_frequency_rate": 1e3, **NO_LIMITS}
        | settings
    )
    return TurnRateSolver(turning_model(), config)


def solved(solver, speed_bound, last=0.4, wind=(0.0, 0.0, 0.0)):
    return solver.solve(speed_bound, last, *LOAD, np.array(wind))


@pytest.mark.parametrize("wind", [0.0, 3.0])
def test_the_rate_is_the_least_at_which_the_slowest_phase_has_the_bound(wind):
    """ξ R − w = ε at the phase that flies with the wind."""
    answer = solved(solver(), 24.0, wind=(wind, 0.0, 0.0))
    assert answer.outcome == Outcome.SOLVED
    assert answer.rate == pytest.approx((24.0 + wind) / RADIUS, rel=1e-6)
    assert answer.slowest_speed == pytest.approx(24.0, rel=1e-6)
    again = solved(solver(), 24.0, answer.rate, wind=(wind, 0, 0))
    assert again.outcome == Outcome.KEPT


def test_the_bank_limits_the_rate_by_its_closed_form():
    """tan φ = [V²/gR − μ tan ϑ]/(1 + μ), with μ the load's mass over that of all aircraft."""
    ratio, most = 10.0 / 24.0, 0.3
    slope = SPREAD / SHARE
    square = 9.81 / RADIUS * ((1 + ratio) * math.tan(most) + ratio * slope)
    answer = solved(solver(max_bank=most), 10.0, 0.9)
    assert answer.outcome == Outcome.SOLVED
    assert answer.rate == pytest.approx(math.sqrt(square), rel=1e-6)


def test_what_is_found_is_the_nearest_of_a_dense_scan(rng):
    limited = solver(8, max_lift_share=0.8, max_bank=0.7, max_thrust_share=0.9)
    rates = np.geomspace(0.1, 2.0, 800)
    outcomes = set()
    for _ in range(10):
        bound, last = rng.uniform(8, 22), rng.uniform(0.15, 1.5)
        wind = rng.normal(size=3) * [3, 3, 0]
        answer = solved(limited, bound, last, wind)
        margins = limited.margins(bound, rates, (*LOAD, wind))[0].min(axis=0)
        feasible = rates[margins >= 0]
        outcomes.add(answer.outcome)
        if answer.outcome in (Outcome.KEPT, Outcome.SOLVED):
            assert limited.margins(bound, np.array([answer.rate]), (*LOAD, wind))[0].min() >= -1e-6
            if len(feasible):
                best = np.min(np.abs(feasible - last))
                assert abs(answer.rate - last) <= best + 1e-9
        else:
            assert len(feasible) == 0
            assert answer.missed
    assert {Outcome.SOLVED, Outcome.RELAXED} <= outcomes


def test_the_airspeed_comes_before_the_other_limits():
    answer = solved(solver(max_bank=0.2), 25.0)
    assert answer.outcome == Outcome.RELAXED
    assert answer.slowest_speed >= 25.0
    assert answer.missed == ["bank"]


def test_the_anchor_leads_back_as_far_as_the_bound_allows():
    far = solved(solver(anchor_weight=1.0), 10.0, 0.6)
    assert far.rate == pytest.approx(0.5)
    held = solved(solver(anchor_weight=9.0), 24.0, 0.6)
    assert held.rate == pytest.approx(24.0 / RADIUS, rel=1e-6)
