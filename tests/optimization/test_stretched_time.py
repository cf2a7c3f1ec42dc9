"""Times along a path that pass more slowly where ξ and A would not keep the bound."""

import functools

import numpy as np
import pytest
from helpers import difference, model, resting_orbits

from drake_nonstop.analysis.aircraft_margins import margins_at_rest
from drake_nonstop.blocks.load_trajectory import (
    ConstantVelocityMove,
    ConstantVelocityMoveConfig,
    RestToRest,
    RestToRestConfig,
)
from drake_nonstop.mechanics.reference_preview import ReferencePreview
from drake_nonstop.mechanics.wind import MeanWind
from drake_nonstop.model.system import Model
from drake_nonstop.optimization import stretched_time
from drake_nonstop.optimization.horizon_config import HorizonConfig
from drake_nonstop.optimization.problem_config import LimitsConfig
from drake_nonstop.optimization.stretched_time import (
    OrbitFeasibility,
    PathDelay,
    still_air,
    stretching,
)
from drake_nonstop.scenario.loading import load_scenario

START, MOVE = 3.0, 3.0  # s, of the line
DURATION = 24.0  # s


def line(speed=0.7):
    block = ConstantVelocityMove(
        model(),
        ConstantVelocityMoveConfig(
            velocity=[speed, 0.0, 0.0], start_time=START, move_time=MOVE, blend="c4"
        ),
    )
    return block.GetOutputPort("reference_preview").Eval(block.CreateDefaultContext())


def limits(bound, highest=2.0):
    return LimitsConfig(
        speed_bound=bound, frequency_bounds=[0.1, highest], amplitude_bounds=[0.1, 1.2]
    )


def found(bound, preview=None, **changes):
    duration = changes.pop("duration", DURATION)
    settings = {
        "least_rate": 0.1,
        "largest_rate": 1.2,
        "change_time": 1.0,
        "can_plan": False,
        "config": HorizonConfig(),
        "name": lambda: "here",
    }
    return stretching(model(), limits(bound), preview or line(), duration, **settings | changes)


def test_rates_of_a_delay_are_its_differences_and_it_stays_at_its_end():
    rates = np.zeros(30)
    rates[3:27] = np.random.default_rng(1).uniform(-0.2, 0.8, 24)
    delay = PathDelay(0.25, rates)

    def at(time):
        return delay.at(np.array([time]))[0]

    for time in (0.3, 2.111, 5.1):
        slope = difference(at, time, 1e-3)
        np.testing.assert_allclose(at(time)[1:], slope[:4], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(at(0.0)[:4], 0)
    np.testing.assert_array_equal(at(-1.0), 0)
    assert delay.end_time == pytest.approx(27 * 0.25)
    np.testing.assert_allclose(at(50.0), [0.25 * rates.sum(), 0, 0, 0, 0], rtol=0, atol=1e-12)


def test_a_load_at_rest_is_feasible_up_to_the_speed_of_its_slowest_orbit():
    """For ξ and A that cannot change; the orbit's speeds are those of positions, differenced."""
    system, xi, A = model(), 2.0, 1.2
    times = np.linspace(0, 2 * np.pi / xi, 16, endpoint=False)
    parameters, still = np.array([xi, A]), np.zeros(3)
    orbits = resting_orbits(system, np.eye(7)[0], times, parameters, load_wind=still)
    slowest = float(np.min(np.linalg.norm(orbits.velocities, axis=-1)))
    rest = np.eye(22)[:1]
    for factor, expected in ((0.995, True), (1.005, False)):
        fixed = LimitsConfig(
            speed_bound=factor * slowest,
            tightening=0.0,
            frequency_bounds=[xi, xi],
            amplitude_bounds=[A, A],
        )
        config = HorizonConfig(horizon=6.0, knot_spacing=0.4)
        feasibility = OrbitFeasibility(system, fixed, config, lambda: "rest")
        assert feasibility.holds(rest).tolist() == [expected]


def test_a_motion_that_is_feasible_is_left_alone():
    assert found(0.1, line(0.2)).delay is None
    assert found(0.0).delay is None  # without a bound


def test_an_infeasible_motion_is_slowed_just_as_far_as_its_orbits_need():
    preview, result = line(), found(0.3)
    assert result.delay is not None
    assert len(result.too_fast) == len(result.not_at_rest) == 0
    times = np.linspace(0, DURATION, 801)
    delays = result.delay.at(times)
    rates = 1 - delays[:, 1]
    assert 0.1 < np.min(rates) < 0.9
    assert np.max(rates) <= 1.2 + 1e-12
    assert np.min(delays[:, 0]) == 0
    # Every stretched instant is feasible, and hardly so where the load is at its fastest.
    config = HorizonConfig(horizon=6.0, knot_spacing=0.4)
    stretched = result.delay.stretched(preview, times)
    assert OrbitFeasibility(model(), limits(0.3), config, lambda: "here").holds(stretched).all()
    tighter = OrbitFeasibility(model(), limits(0.35), config, lambda: "here")
    assert not tighter.holds(stretched).all()
    # Until it slows down it is the given motion, to the bit; at the end it is on time again.
    before = times < START - 2.5
    np.testing.assert_array_equal(stretched[before], preview.at(times[before]))
    assert np.max(delays[:, 0]) > 1.0
    assert delays[-1, 0] < 0.2 * np.max(delays[:, 0])
    np.testing.assert_allclose(stretched[-1, 4:7], preview(1e3)[4:7], atol=1e-9)


def test_the_rate_is_above_1_only_to_catch_up():
    late = found(0.3, largest_rate=1.0)
    delays = late.delay.at(np.linspace(0, DURATION, 241))
    assert np.min(delays[:, 1]) > -1e-12
    assert delays[-1, 0] == np.max(delays[:, 0])


def test_what_no_rate_helps_is_told_and_not_slowed():
    result = found(3.0)
    assert result.delay is None
    assert len(result.not_at_rest) == 241


def test_instants_that_are_infeasible_after_the_last_round_are_told(monkeypatch):
    assert len(found(0.5).too_fast) == 0
    monkeypatch.setattr(stretched_time, "_MOST_ROUNDS", 0)
    told = found(0.5).too_fast
    assert len(told) > 0
    assert np.all((told > START - 1) & (told < START + MOVE + 1))


def test_what_the_least_rate_does_not_help_is_told():
    result = found(0.3, least_rate=0.9)
    assert np.all((result.too_fast > START - 1) & (result.too_fast < START + MOVE + 1))
    assert len(result.too_fast) > 10
    assert np.min(1 - result.delay.at(np.linspace(0, DURATION, 241))[:, 1]) == pytest.approx(0.9)


def test_a_motion_that_plans_find_a_way_through_is_left_alone(monkeypatch):
    """Where not every phase is fast enough, those that come may be."""
    asked = []

    def planned(*arguments):
        asked.append(arguments)
        return True

    monkeypatch.setattr("drake_nonstop.optimization.stretched_time._is_planned", planned)
    assert found(0.3, can_plan=True).delay is None
    assert len(asked) == 1
    assert found(0.1, line(0.2), can_plan=True).delay is None
    assert len(asked) == 1


def test_plans_that_need_slack_are_no_way_through():
    slow = ReferencePreview(line().reference)  # which tells one instant after the other
    assert found(0.45, slow, can_plan=True, duration=6.0).delay is not None


AT_REST = np.eye(22)[0]
NOMINAL = np.array([0.595, 1.0])  # rad/s, N, of the aircraft
FIXED = {"frequency_bounds": [0.595] * 2, "amplitude_bounds": [1.0] * 2}


@functools.cache
def aircraft_model():
    scenario = load_scenario("aircraft_rest")
    return Model(scenario.system, scenario.pattern, scenario.control_period)


def of_aircraft(**limits):
    return LimitsConfig(
        **{"frequency": NOMINAL[0], "amplitude": NOMINAL[1], "tightening": 0.0} | limits
    )


def aircraft_hold(winds, references=None, **limits):
    """Whether aircraft keep limits in winds (k, 3), above a load that rests if not said."""
    config = of_aircraft(**limits)
    feasibility = OrbitFeasibility(aircraft_model(), config, HorizonConfig(), lambda: "aircraft")
    references = np.tile(AT_REST, (len(winds), 1)) if references is None else references
    return feasibility.holds(references, np.array(winds)).tolist()


def needs(wind):
    return margins_at_rest(aircraft_model(), AT_REST, NOMINAL, wind=MeanWind(np.array(wind))).needs


def test_limits_of_aircraft_are_kept_up_to_what_the_orbit_in_the_wind_needs():
    """Against margins that are evaluated at 720 phases of positions' exact derivatives."""
    wind = [1.5, -1.0, 0.0]
    need = needs(wind)
    slowest, bank = need.airspeed.min(), np.abs(need.bank).max()
    for limit, expected in (
        ({"speed_bound": 0.99 * slowest}, True),
        ({"speed_bound": 1.02 * slowest}, False),
        ({"max_bank": 1.005 * bank}, True),
        ({"max_bank": 0.97 * bank}, False),
    ):
        assert aircraft_hold([wind], **{"speed_bound": 0.0} | limit, **FIXED) == [expected], limit


def test_velocity_and_wind_count_by_their_difference():
    rng = np.random.default_rng(3)
    winds, velocities = (rng.uniform(-3, 3, (12, 3)) * [1, 1, 0] for _ in range(2))
    moving = np.tile(AT_REST, (12, 1))
    moving[:, 10:13] = velocities
    limits = {"speed_bound": 11.0, "max_bank": 0.65}
    at_rest = aircraft_hold(winds, **limits, **FIXED)
    assert aircraft_hold(winds + velocities, moving, **limits, **FIXED) == at_rest
    assert len(set(at_rest)) == 2


def test_other_parameters_near_by_count_where_the_first_ones_do_not_fly():
    limits = {"speed_bound": 11.0, "max_lift_share": 0.8, "max_bank": 0.75}
    winds = [[3.0, 0.0, 0.0], [12.0, 0.0, 0.0]]
    assert aircraft_hold(winds, **limits, **FIXED) == [False, False]
    assert aircraft_hold(winds, **limits) == [True, False]  # within the default bounds


def transfer():
    config = RestToRestConfig(displacement=[20.0, 0.0, 0.0], start_time=2.0, move_time=30.0)
    block = RestToRest(aircraft_model(), config)
    return block.GetOutputPort("reference_preview").Eval(block.CreateDefaultContext())


def test_a_load_is_slowed_to_the_largest_velocity_through_the_air_that_aircraft_keep_the_bound_at():
    bound = 11.0  # m/s
    low, high = 0.0, 6.0  # m/s, of wind that a load at rest is flown in
    for _ in range(12):
        middle = (low + high) / 2
        is_kept = needs([-middle, 0.0, 0.0]).airspeed.min() > 1.02 * bound  # as a reserve asks for
        low, high = (middle, high) if is_kept else (low, middle)
    largest, duration = low, 60.0

    def slowed(winds):
        return stretching(
            aircraft_model(),
            of_aircraft(speed_bound=bound, **FIXED),
            transfer(),
            duration,
            least_rate=0.1,
            largest_rate=1.0,
            change_time=8.0,
            can_plan=False,
            config=HorizonConfig(),
            name=lambda: "transfer",
            winds=winds,
        )

    def steady(times, references):
        return np.tile([-1.7, 0.0, 0.0], (len(times), 1))

    def rising(times, references):
        return np.outer(np.clip(times / 20, 0, 1), [-2.0, 0.0, 0.0])

    assert 2.0 < largest < 1.7 + 1.875 * 20 / 30  # the fastest through the air
    assert slowed(still_air).delay is None
    assert slowed(lambda times, references: -steady(times, references)).delay is None
    times = np.linspace(0, duration, 301)
    for winds in (steady, rising):
        found = slowed(winds)
        assert len(found.too_fast) == len(found.not_at_rest) == 0
        stretched = found.delay.stretched(transfer(), times)
        through_air = stretched[:, 10] - winds(times, stretched)[:, 0]
        assert 0.8 * largest < np.max(through_air) < 1.05 * largest  # it accelerates, too
        assert found.delay.at(times)[-1, 0] > 1.0
