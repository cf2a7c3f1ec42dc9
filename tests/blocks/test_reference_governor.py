"""A trajectory that is slowed down where no ξ and A keep the speed bound with it."""

import numpy as np
import pytest
from helpers import (
    difference,
    nightly_beyond,
    output,
    rates_by_differences,
    rotation,
    sizes_of_ports,
)

from drake_nonstop import (
    Model,
    carrier_speeds,
    compute_metrics,
    load_scenario,
    make_nonstop,
    simulate,
)
from drake_nonstop.mechanics.signals import CarrierStates, LoadReference

# A line with ξ and A that do not change, and a bound that their orbit keeps at rest only.
FAST_LINE = [
    "simulation_duration=6",
    "load_trajectory.start_time=1",
    "load_trajectory.move_time=2",
    "load_trajectory.velocity=[0.5, 0, 0]",
    "optimization_layer.speed_bound=0.25",
]
GOVERNED = "reference_governor={change_time: 0.5}"
START, DURATION, BOUND = 3.0, 24.0, 0.3
ANY_ORBIT = [
    f"simulation_duration={DURATION}",
    # Neither the load nor its motion has a plane of symmetry.
    "system.attachments=[[0.8, 0.5, 0.0], [-0.4, 0.8, 0.0], [-0.8, -0.3, 0.0], [0.3, -0.9, 0.0]]",
    f"optimization_layer=!NlpLayer {{speed_bound: {BOUND}, tightening: 0, "
    "frequency_bounds: [0.1, 2.0], amplitude_bounds: [0.9, 1.2]}",
]

WAYS = [
    "!RestToRest {displacement: [0.5, 0, 0], roll_pitch_yaw: [0.6, 0.9, 2], move_time: 3}",
    "!ConstantVelocityMove {velocity: [0.6, 0.2, 0.3], move_time: 3, blend: c4}",
]
AMPLITUDES = np.linspace(0.9, 1.2, 5)  # N, within the bounds above


def trajectory_of(name, *changes):
    """The block of the trajectory in a loop, its preview, and the loop's model."""
    scenario = load_scenario(name, changes)
    block = make_nonstop(scenario, at_equilibrium=False).GetSubsystemByName("load_trajectory")
    port = block.GetOutputPort("reference_preview")
    model = Model(scenario.system, scenario.pattern, 0.0)
    return block, port.Eval(block.CreateDefaultContext()), model


@pytest.mark.slow
def test_its_signals_are_those_of_the_delayed_motion_with_its_rates():
    _, preview, model = trajectory_of("line_without_optimization", *FAST_LINE)
    block, ahead, _ = trajectory_of("line_without_optimization", *FAST_LINE, GOVERNED)
    sizes = {"reference": 22, "reference_higher_rates": 6, "reference_delay": 1}
    assert sizes_of_ports(block) == sizes | {"reference_preview": None}
    context, clone = block.CreateDefaultContext(), block.Clone()
    again = clone.GetOutputPort("reference_preview").Eval(clone.CreateDefaultContext())
    times = [0.0, 1.33, 2.12, 3.37, 30.0]  # between the knots of the delay
    for time in times:
        context.SetTime(time)
        reference, higher, (delay,) = (output(block, context, name) for name in sizes)
        np.testing.assert_array_equal(ahead(time), reference)
        np.testing.assert_array_equal(again(time), reference)
        np.testing.assert_array_equal(reference[:7], preview(time - delay)[:7])
        expected = rates_by_differences(ahead, time)
        np.testing.assert_allclose([*reference[7:], *higher], expected, rtol=0, atol=1e-5)
    np.testing.assert_array_equal(ahead.at(times), [ahead(time) for time in times])
    assert delay > 0.5
    times = np.linspace(0, 6, 61)
    slowest = [slowest_on_best_orbit(model, p, times, [1.2]).min() for p in (preview, ahead)]
    assert slowest[0] < 0.9 * 0.25 < 0.25 < slowest[1]


@pytest.mark.slow
def test_a_governed_flight_keeps_the_bound_and_arrives_late():
    run = simulate(load_scenario("line_without_optimization", [*FAST_LINE, GOVERNED]))
    velocities = CarrierStates.view(run.steps["carrier_state"]).velocities
    assert np.min(np.linalg.norm(velocities, axis=-1)) > 0.25
    delays = run.signal("reference_delay")[:, 0]
    shown = compute_metrics(run)["load"]["reference_delay_max_s"]
    assert shown == np.max(delays) == delays[-1] > 0.5
    assert run.signal("load_state")[-1, 4] == pytest.approx(1.0, abs=1e-3)
    largest = np.max(np.linalg.norm(run.signal("tracking_error")[:, 3:6], axis=1))
    assert largest < 4e-5  # without the reference's higher rates 6e-5


def slowest_on_best_orbit(model, preview, times, amplitudes=AMPLITUDES):
    """The speed of the slowest carrier at any phase, at ξ = 2 and the best of A at each time."""
    phases, load = np.linspace(0, 2 * np.pi, 32, endpoint=False), model.load

    def wrench(time):
        now = LoadReference.view(preview(time))
        R, omega = rotation(now.quaternion), now.angular_velocity
        J = R @ load.inertia @ R.T
        force = load.mass * (now.acceleration + load.gravity * np.eye(3)[2])
        torque = J @ now.angular_acceleration + np.cross(omega, J @ omega)
        return np.concatenate([torque, force + load.drag * now.velocity])

    def slowest(time, A):
        motion = preview(time), wrench(time), difference(wrench, time)
        return carrier_speeds(model, *motion, 2.0, A, phases).min()

    return np.array([max(slowest(time, A) for A in amplitudes) for time in times])


@pytest.mark.slow
@pytest.mark.parametrize("way", nightly_beyond(1, "flights", WAYS))
def test_an_infeasible_motion_is_slowed_just_as_far_as_its_orbits_need(way):
    changes = [*ANY_ORBIT, f"load_trajectory={way}", f"load_trajectory.start_time={START}"]
    _, preview, model = trajectory_of("quintic", *changes)
    block, ahead, _ = trajectory_of("quintic", *changes, "reference_governor={}")
    times = np.linspace(0, DURATION, 61)
    (delays,) = block.precomputed_inputs(["reference_delay"], times)
    stretched = ahead.at(times)
    assert slowest_on_best_orbit(model, preview, times).min() < 0.8 * BOUND
    speeds = slowest_on_best_orbit(model, ahead, times)
    assert BOUND < speeds.min() < 1.1 * BOUND
    slows_down = np.gradient(delays[:, 0], times) > 0.1
    assert np.median(speeds[slows_down]) < 1.4 * BOUND
    # Until it slows down it is the given motion, to the bit; at the end it is there, late.
    before = times < START - 2.5
    np.testing.assert_array_equal(stretched[before], preview.at(times[before]))
    assert np.min(delays) == 0
    assert np.max(delays) > 1.0
    assert delays[-1] == pytest.approx(np.max(delays), abs=1e-12)
    np.testing.assert_allclose(stretched[-1, 4:7], preview(1e3)[4:7], atol=1e-9)
