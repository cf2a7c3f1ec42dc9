"""Carriers that feel their cables, unlike cables, a sensor that errs, and wind."""

import numpy as np
import pytest
from helpers import fix, model, output
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import VectorLogSink
from scipy.spatial.transform import Rotation

from drake_nonstop.blocks.cables import Cables, IndividualCables, IndividualCablesConfig
from drake_nonstop.blocks.carrier_controller import LoadedCarrierPid
from drake_nonstop.blocks.carrier_dynamics import (
    LoadedCarrierDynamics,
    LoadedCarrierDynamicsConfig,
)
from drake_nonstop.blocks.load_disturbance import Wind, WindConfig
from drake_nonstop.blocks.load_feedback import NoisyFeedback, NoisyFeedbackConfig
from drake_nonstop.blocks.load_plant import LoadPlant, MultibodyLoadPlant
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.simulation.metrics import compute_metrics
from drake_nonstop.simulation.simulate import simulate
from drake_nonstop.validation import ScenarioError

LOADED = ["carrier_dynamics=!LoadedCarrierDynamics {}", "carrier_controller=!LoadedCarrierPid {}"]


def state(n=4, height=0.85):
    """A level load at the origin, and carriers `height` above its attachments: taut cables."""
    load = np.array([1.0, *[0.0] * 12])
    points = model(n).attachments + np.array([0.0, 0.0, height])
    return load, np.concatenate([points.ravel(), np.zeros(3 * n)])


def acceleration(block, **inputs):
    context = block.CreateDefaultContext()
    fix(block, context, **inputs)
    return block.EvalTimeDerivatives(context).CopyToVector()[12:].reshape(4, 3)


def test_carriers_feel_weight_cable_and_their_limit():
    free = LoadedCarrierDynamics(model())
    mass, gravity = model().carrier_mass, model().gravity
    forces = np.arange(12.0)
    cables = np.linspace(-1, 1, 12)
    expected = (forces - cables).reshape(4, 3) / mass - [0, 0, gravity]
    np.testing.assert_allclose(
        acceleration(free, carrier_forces=forces, cable_forces=cables), expected
    )
    limited = LoadedCarrierDynamics(model(), LoadedCarrierDynamicsConfig(max_force=5.0))
    got = acceleration(limited, carrier_forces=forces, cable_forces=np.zeros(12))
    applied = mass * (got + np.array([0, 0, gravity]))
    sizes = np.linalg.norm(forces.reshape(4, 3), axis=1)
    np.testing.assert_allclose(np.linalg.norm(applied, axis=1), np.minimum(sizes, 5.0))
    np.testing.assert_allclose(np.cross(applied, forces.reshape(4, 3)), 0, atol=1e-12)


def test_their_controller_carries_weight_and_cable():
    block = LoadedCarrierPid(model())
    context = block.CreateDefaultContext()
    still = np.arange(24.0)
    pull = np.linspace(-1, 1, 12)
    fix(block, context, carrier_reference=still, carrier_state=still, desired_cable_forces=pull)
    weight = [0, 0, model().carrier_mass * model().gravity]
    np.testing.assert_allclose(
        output(block, context, "carrier_forces").reshape(4, 3), pull.reshape(4, 3) + weight
    )


@pytest.mark.parametrize("mass", [0.9, 1.0, 1.1])
def test_with_the_cables_reaction_and_a_wrong_mass_the_bound_holds(mass):
    run = simulate(load_scenario("quintic", [*LOADED, f"simulated.load_mass={mass}"]))
    metrics = compute_metrics(run)
    assert metrics["carriers"]["time_below_bound_s"] == 0
    assert metrics["load"]["position_error_final_m"] <= 1.2e-3
    assert metrics["optimizer"]["relaxed"] + metrics["optimizer"]["held"] == 0


def test_carriers_too_weak_for_the_load_let_it_down():
    settings = [*LOADED, "carrier_dynamics.max_force=3.0", "duration=2"]
    run = simulate(load_scenario("quintic", settings))
    assert run.signal("load_state")[-1, 6] < -0.1


def test_alike_cables_are_the_plain_ones_and_unlike_ones_are_not():
    load, carriers = state()
    plain, alike = Cables(model()), IndividualCables(model())
    config = IndividualCablesConfig(stiffness=[100.0, 200.0, 400.0, 800.0])
    unlike = IndividualCables(model(), config)
    results = []
    for block in (plain, alike, unlike):
        context = block.CreateDefaultContext()
        fix(block, context, load_state=load, carrier_state=carriers)
        results.append(output(block, context, "tensions"))
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_allclose(results[2], 0.05 * np.array(config.stiffness))
    short = IndividualCables(model(), IndividualCablesConfig(rest_length=[0.8, 0.86, 0.8, 0.84]))
    context = short.CreateDefaultContext()
    fix(short, context, load_state=load, carrier_state=carriers)
    np.testing.assert_allclose(output(short, context, "tensions"), [25, 0, 25, 5], atol=1e-9)


def test_a_cable_that_goes_slack_and_taut_does_not_chatter():
    """One cable 3 % too long: it is slack part of each turn, and the tension has no jumps."""
    settings = ["cables=!IndividualCables {rest_length: [0.8, 0.8, 0.8, 0.83]}", "duration=4"]
    run = simulate(load_scenario("quintic", settings))
    fine = simulate(load_scenario("quintic", [*settings, "simulator.max_step_size=0.001"]))
    switches = []
    for each in (run, fine):
        slack = each.steps["tensions"][each.steps["time"] > 1.0, 3] <= 0
        assert 0.05 < slack.mean() < 0.95
        switches.append(np.count_nonzero(np.diff(slack)))
    # What chatters does so at every step: five times as often with steps of a fifth.
    assert switches[1] < 1.5 * switches[0]


@pytest.mark.parametrize(
    ("field", "value"),
    [("stiffness", [1.0, 2.0]), ("damping", [-1.0] * 4), ("rest_length", [0.0] * 4)],
)
def test_bad_cables(field, value):
    with pytest.raises(ScenarioError, match=f"^cables\\.{field} = "):
        IndividualCables(model(), IndividualCablesConfig(**{field: value}))


def measured(config, times, states):
    """What the feedback shows at some times of a run in which the state is (time, …)."""
    block = NoisyFeedback(model(4, 0.01), config)
    context = block.CreateDefaultContext()
    results = []
    for time, value in zip(times, states, strict=True):
        context.SetTime(time)
        fix(block, context, load_state=value)
        results.append(output(block, context, "measured_load_state").copy())
    return np.array(results)


def test_noise_has_the_deviations_that_were_asked_for_and_repeats():
    config = NoisyFeedbackConfig(
        position_noise=0.1, orientation_noise=0.02, velocity_noise=0.3, angular_velocity_noise=0.4
    )
    times = 0.01 * np.arange(2000) + 0.003
    still = np.tile(state()[0], (2000, 1))
    noisy = measured(config, times, still)
    np.testing.assert_array_equal(noisy, measured(config, times, still))
    turns = Rotation.from_quat(noisy[:, [1, 2, 3, 0]]).as_rotvec()
    for values, deviation in (
        (turns, 0.02),
        (noisy[:, 4:7], 0.1),
        (noisy[:, 7:10], 0.4),
        (noisy[:, 10:], 0.3),
    ):
        np.testing.assert_allclose(values.std(axis=0), deviation, rtol=0.1)
        assert np.abs(values.mean(axis=0)).max() < 0.1 * deviation
    # Held between samples, other for another seed.
    np.testing.assert_array_equal(noisy[:5], measured(config, times[:5] + 0.004, still[:5]))
    config.seed = 1
    assert not np.array_equal(noisy[0], measured(config, times[:1], still[:1])[0])


def test_a_delayed_state_is_that_of_so_many_samples_ago():
    """In the loop: what the controllers hold is what the load was N periods before."""
    for periods in (1, 3):
        setting = f"load_feedback=!NoisyFeedback {{delay: {0.01 * periods}}}"
        run = simulate(load_scenario("quintic", [setting, "duration=1"]))
        held, load = run.signal("held_measured_load_state"), run.signal("load_state")
        # The signals at a sample's instant hold what was taken at the one before.
        for k in (20, 57, 99):
            np.testing.assert_allclose(held[k], load[k - 1 - periods], rtol=0, atol=1e-9)
            assert np.abs(held[k] - load[k - periods]).max() > 1e-9


@pytest.mark.parametrize(
    ("field", "value"),
    [("delay", 0.015), ("delay", -0.01), ("position_noise", -1.0), ("period", 0.0), ("seed", -1)],
)
def test_bad_feedback(field, value):
    with pytest.raises(ScenarioError, match=f"^load_feedback\\.{field} = "):
        NoisyFeedback(model(), NoisyFeedbackConfig(**{field: value}))


def winds(config, times):
    block = Wind(model(), config)
    context = block.CreateDefaultContext()
    results = []
    for time in times:
        context.SetTime(time)
        results.append(output(block, context, "disturbance_wrench").copy())
    return np.array(results)


def test_wind_is_constant_but_for_its_gust():
    config = WindConfig(force=[1, 2, 3], torque=[4, 5, 6], start_time=0.5)
    calm, windy = winds(config, [0.4, 0.6])
    np.testing.assert_array_equal(calm, 0)
    np.testing.assert_array_equal(windy, [4, 5, 6, 1, 2, 3])


def test_a_gust_has_its_deviation_and_correlation_time():
    config = WindConfig(gust_force=0.5, gust_time=0.4, seed=3)
    times = np.arange(0, 400, 0.05)
    forces = winds(config, times)[:, 3:]
    np.testing.assert_allclose(forces.std(axis=0), 0.5, rtol=0.1)
    assert np.abs(forces.mean(axis=0)).max() < 0.05
    lag = round(0.4 / 0.05)
    correlation = (forces[lag:] * forces[:-lag]).mean(axis=0) / forces.var(axis=0)
    np.testing.assert_allclose(correlation, np.exp(-1), atol=0.15)
    assert np.abs(np.corrcoef(forces.T) - np.eye(3)).max() < 0.1
    np.testing.assert_array_equal(forces[:9], winds(config, times[:9])[:, 3:])
    config.seed = 4
    assert np.abs(forces[:9] - winds(config, times[:9])[:, 3:]).max() > 0.01


@pytest.mark.parametrize(
    ("field", "value"),
    [("force", [1.0]), ("gust_force", -1.0), ("gust_time", 0.0), ("seed", 0.5)],
)
def test_bad_wind(field, value):
    with pytest.raises(ScenarioError, match=f"^load_disturbance\\.{field} = "):
        Wind(model(), WindConfig(**{field: value}))


def test_angular_drag_brings_a_spinning_load_to_rest():
    for plant in (LoadPlant, MultibodyLoadPlant):
        block = plant(model(load_angular_drag=0.02, load_inertia=np.diag([0.01] * 3).tolist()))
        builder = DiagramBuilder()
        builder.AddSystem(block)
        sink = builder.AddSystem(VectorLogSink(13))
        builder.Connect(block.GetOutputPort("load_state"), sink.get_input_port())
        diagram = builder.Build()
        simulator = Simulator(diagram)
        context = block.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        fix(block, context, cable_forces=np.zeros(12), disturbance_wrench=np.zeros(6))
        context.SetContinuousState([1, *[0.0] * 6, 0, 0, 3.0, 0, 0, 0])
        simulator.AdvanceTo(0.5)
        spin = context.get_continuous_state_vector().CopyToVector()[9]
        assert spin == pytest.approx(3 * np.exp(-0.5 * 0.02 / 0.01), rel=1e-3)
