"""The rate of a load that turns with its aircraft, against closed forms and a dense scan."""

import functools
import math

import numpy as np
import pytest
from helpers import fix, output, outputs, rates_by_differences

from drake_nonstop import AircraftParameters, Diagnostics, Model, SystemParameters
from drake_nonstop.blocks.load_trajectory import PlannedTurn, PlannedTurnConfig
from drake_nonstop.blocks.turn_rate_optimizer import TurnRateOptimizer, TurnRateOptimizerConfig
from drake_nonstop.mechanics.aircraft import flight_needs, needed_force, thrust_limits
from drake_nonstop.model.pattern import ConstantSpreadConfig

CORNERS = [[1.5, 0.0, 0.0], [0.0, 1.5, 0.0], [-1.5, 0.0, 0.0], [0.0, -1.5, 0.0]]
SPREAD, LENGTH, SHARE = 30.0, 60.0, 10.0 * 9.81 / 4
RADIUS = 1.5 + LENGTH * SPREAD / math.hypot(SPREAD, SHARE)  # of the level circles
LIMITS = ["max_lift_share", "max_bank", "max_thrust_share"]
AT_ONCE = {"tightening": 0.0, "max_frequency_rate": 1e3} | dict.fromkeys(LIMITS, math.inf)


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


def solved(speed_bound, last=0.4, wind=(0.0, 0.0, 0.0), **fields):
    """The rate after an update, its diagnostics, and the names of the limits that it misses.

    It may be 0.1 to 2 rad/s at once.
    """
    config = TurnRateOptimizerConfig(speed_bound=speed_bound, **AT_ONCE | fields)
    block = TurnRateOptimizer(turning_model(), config)
    context, weight = block.CreateDefaultContext(), 98.1 * np.eye(6)[5]
    fix(block, context, reference=np.eye(22)[0], wrench=weight, wrench_rate=np.zeros(6))
    fix(block, context, wind_estimate=np.array(wind))
    states = block.states(context) | {"parameters": [last, 0.0]}
    context.SetDiscreteState(block.flat(states))
    context.SetDiscreteState(block.answer(context))
    missed = output(block, context, "missed_limits")
    entries = block.signal_layouts["missed_limits"].entries("", len(missed))
    names = [entry.name.strip(".") for entry, count in zip(entries, missed, strict=True) if count]
    told = Diagnostics.view(output(block, context, "diagnostics"))
    return output(block, context, "parameters")[0], told, names


@pytest.mark.parametrize("wind", [0.0, 3.0])
def test_the_rate_is_the_least_at_which_the_slowest_phase_has_the_bound(wind):
    """ξ R − w = ε at the phase that flies with the wind."""
    rate, told, _ = solved(24.0, wind=(wind, 0.0, 0.0))
    assert told.solved == 1
    assert rate == pytest.approx((24.0 + wind) / RADIUS, rel=1e-6)
    assert told.speed_margin == pytest.approx(0, abs=2e-5)
    assert solved(24.0, rate, wind=(wind, 0, 0))[1].kept == 1


def least_margins(bound, rates, wind, most):
    """The least of all margins at each rate, of four aircraft on their circle, at 8 phases."""
    aircraft, margins = turning_model().aircraft, []
    angles = 2 * np.pi * np.arange(8) / 8  # those of the corners are among them
    out = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1)
    on = np.stack([-np.sin(angles), np.cos(angles), 0 * angles], axis=-1)
    for rate in rates:
        pull = SPREAD * out + [0, 0, SHARE]
        force = needed_force(aircraft, -(rate**2) * RADIUS * out, pull)
        needs = flight_needs(aircraft, force, rate * RADIUS * on - wind)
        least, highest = thrust_limits(aircraft, needs.airspeed)
        middle, half = (highest + least) / 2, (highest - least) / 2
        shares = needs.lift / aircraft.max_lift, abs(needs.bank), abs(needs.thrust - middle) / half
        of_limits = (1 - share / limit for share, limit in zip(shares, most, strict=True))
        margins.append(np.min([needs.airspeed / bound - 1, *of_limits]))
    return np.array(margins)


@pytest.mark.slow
def test_what_is_found_is_the_nearest_of_a_dense_scan_of_first_principles(rng):
    most, rates, outcomes = (0.8, 0.7, 0.9), np.geomspace(0.1, 2.0, 800), set()
    fields = {"orbit_points": 8} | dict(zip(LIMITS, most, strict=True))
    for _ in range(10):
        bound, last = rng.uniform(8, 22), rng.uniform(0.15, 1.5)
        wind = rng.normal(size=3) * [3, 3, 0]
        rate, told, missed = solved(bound, last, wind, **fields)
        feasible = rates[least_margins(bound, rates, wind, most) >= 0]
        outcomes.add(int(told.outcome))
        if told.kept + told.solved:
            assert least_margins(bound, [rate], wind, most) >= -1e-6
            if len(feasible):
                assert abs(rate - last) <= np.min(np.abs(feasible - last)) + 1e-9
        else:
            assert len(feasible) == 0
            assert missed
    assert {2, 3} <= outcomes  # solved, relaxed


def test_the_airspeed_comes_before_the_other_limits():
    _, told, missed = solved(25.0, max_bank=0.2)
    assert told.relaxed == 1
    assert told.speed_margin >= 0
    assert missed == ["bank"]


def test_the_anchor_leads_back_as_far_as_the_bound_allows():
    assert solved(10.0, 0.6, anchor_weight=1.0)[0] == pytest.approx(0.5)
    held, *_ = solved(24.0, 0.6, anchor_weight=9.0)
    assert held == pytest.approx(24.0 / RADIUS, rel=1e-6)


def test_the_planned_turn_has_the_rates_of_its_pose_of_a_phase_with_constant_jerk():
    config = PlannedTurnConfig(displacement=[3.0, 1.0, 0.0], move_time=4.0)
    block = PlannedTurn(turning_model(), config)

    def shown(time, name="reference"):
        angle, rate = 0.4 * time + 0.05 * time**2 + 0.2 * time**3 / 6, 0.4 + 0.1 * time
        rates = [rate + 0.1 * time**2, 0.0, 0.1 + 0.2 * time, 0.0, 0.2, 0.0, 0.0]
        return outputs(block, time=time, planned=np.array([angle, *rates]))[name]

    now, expected = shown(1.3), rates_by_differences(shown, 1.3)
    assert 2 * np.arctan2(now[3], now[0]) == pytest.approx(0.52 + 0.0845 + 0.2 * 1.3**3 / 6)
    found = [*now[7:], *shown(1.3, "reference_higher_rates")]
    np.testing.assert_allclose(found, expected, atol=1e-8)
