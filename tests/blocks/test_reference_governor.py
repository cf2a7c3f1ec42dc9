"""A trajectory that is slowed down where no ξ and A keep the speed bound with it."""

import numpy as np
import pytest
from helpers import difference, model, output, resting_orbits

from drake_nonstop import (
    compute_metrics,
    load_scenario,
    simulate,
)
from drake_nonstop.blocks.load_trajectory import (
    ConstantVelocityMove,
    ConstantVelocityMoveConfig,
    RestToRest,
    RestToRestConfig,
)
from drake_nonstop.blocks.reference_governor import (
    PathDelay,
    ReferenceGovernor,
    ReferenceGovernorConfig,
    delay_of,
    orbits_hold,
)
from drake_nonstop.mechanics.signals import CarrierStates
from drake_nonstop.planning.problem_config import LimitsConfig
from drake_nonstop.systems.wiring import output_sizes

# A line with ξ and A that do not change, and a bound that their orbit keeps at rest only.
FAST_LINE = [
    "simulation_duration=6",
    "load_trajectory.start_time=1",
    "load_trajectory.move_time=2",
    "load_trajectory.velocity=[0.5, 0, 0]",
    "optimization_layer.speed_bound=0.25",
]
GOVERNED = "reference_governor={change_time: 0.5}"


def governor():
    rates = np.zeros(20)
    rates[4:14] = 0.4
    block = RestToRest(model(), RestToRestConfig(displacement=[1, 2, 3], roll_pitch_yaw=[0, 0, 1]))
    preview = block.GetOutputPort("reference_preview").Eval(block.CreateDefaultContext())
    return ReferenceGovernor(preview, PathDelay(0.5, rates)), preview


@pytest.fixture(scope="module")
def flights():
    """Of the fast line, without a governor and with one."""
    scenarios = [
        load_scenario("line_without_optimization", [*FAST_LINE, *o]) for o in ([], [GOVERNED])
    ]
    return [simulate(scenario) for scenario in scenarios]


def test_its_signals_are_those_of_the_delayed_motion():
    block, preview = governor()
    assert output_sizes(block) == {
        "reference": 22,
        "reference_higher_rates": 6,
        "reference_preview": None,
        "reference_delay": 1,
    }
    context = block.CreateDefaultContext()
    ahead = block.GetOutputPort("reference_preview").Eval(context)
    clone = block.Clone()
    again = clone.GetOutputPort("reference_preview").Eval(clone.CreateDefaultContext())
    np.testing.assert_array_equal(again(3.3), ahead(3.3))
    times = [0.0, 2.0, 4.3, 30.0]
    for time in times:
        context.SetTime(time)
        reference, (delay,) = (output(block, context, n) for n in ("reference", "reference_delay"))
        np.testing.assert_array_equal(ahead(time), reference)
        np.testing.assert_array_equal(reference[:7], preview(time - delay)[:7])
    np.testing.assert_array_equal(ahead.at(times), [ahead(time) for time in times])
    assert delay == pytest.approx(0.5 * 10 * 0.4)


def test_its_higher_rates_are_differences():
    block, _ = governor()
    context = block.CreateDefaultContext()
    ahead = block.GetOutputPort("reference_preview").Eval(context)
    for time in (2.1, 4.3, 6.8, 30.0):  # between the knots of the delay
        context.SetTime(time)
        rates, now = difference(ahead, time, 1e-3), ahead(time)
        below = [rates[part] for part in (slice(4, 7), slice(10, 13), slice(16, 19))]
        np.testing.assert_allclose(
            now[[10, 11, 12, *range(16, 22)]], np.concatenate(below), atol=1e-5
        )
        expected = np.concatenate([rates[13:16], rates[19:22]])
        found = output(block, context, "reference_higher_rates")
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)


@pytest.mark.slow
def test_a_bound_that_is_missed_at_full_speed_is_kept_and_the_load_arrives_late(flights):
    without, governed = flights
    slowest = [
        np.min(np.linalg.norm(CarrierStates.view(run.steps["carrier_state"]).velocities, axis=-1))
        for run in flights
    ]
    assert slowest[0] < 0.9 * 0.25
    assert slowest[1] > 0.25
    figures = [compute_metrics(run) for run in flights]
    assert figures[0]["carriers"]["time_below_bound_s"] > 0.05
    assert figures[1]["carriers"]["time_below_bound_s"] == 0
    assert figures[0]["load"]["reference_delay_max_s"] is None
    delays = governed.signal("reference_delay")[:, 0]
    assert figures[1]["load"]["reference_delay_max_s"] == np.max(delays) > 0.5
    assert delays[-1] == np.max(delays)
    for run in flights:  # 1 m away
        assert run.signal("load_state")[-1, 4] == pytest.approx(1.0, abs=1e-3)
    middle = np.searchsorted(governed.time, 3.0)
    assert governed.signal("load_state")[middle, 4] < without.signal("load_state")[middle, 4] - 0.1
    largest = np.max(np.linalg.norm(governed.signal("tracking_error")[:, 3:6], axis=1))
    assert largest < 4e-5  # without the reference's higher rates 6e-5


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
    """The delay of the line for a bound in m/s."""
    settings = {"least_rate": 0.1, "change_time": 1.0} | changes
    config = ReferenceGovernorConfig(**settings)
    return delay_of(model(), limits(bound), preview or line(), DURATION, config)


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
        assert orbits_hold(system, fixed, rest).tolist() == [expected]


def test_an_infeasible_motion_is_slowed_just_as_far_as_its_orbits_need():
    preview, delay = line(), found(0.3)
    times = np.linspace(0, DURATION, 801)
    delays = delay.at(times)
    rates = 1 - delays[:, 1]
    assert 0.1 < np.min(rates) < 0.9
    assert np.max(rates) <= 1 + 1e-12
    assert np.min(delays[:, 0]) == 0
    # Every stretched instant is feasible, and hardly so where the load is at its fastest.
    stretched = delay.stretched(preview).at(times)
    assert orbits_hold(model(), limits(0.3), stretched).all()
    assert not orbits_hold(model(), limits(0.35), stretched).all()
    # Until it slows down it is the given motion, to the bit; at the end it is there, late.
    before = times < START - 2.5
    np.testing.assert_array_equal(stretched[before], preview.at(times[before]))
    assert np.max(delays[:, 0]) > 1.0
    assert delays[-1, 0] == pytest.approx(np.max(delays[:, 0]), abs=1e-12)
    np.testing.assert_allclose(stretched[-1, 4:7], preview(1e3)[4:7], atol=1e-9)
