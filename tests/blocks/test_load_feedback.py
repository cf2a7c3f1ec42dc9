"""The load feedback: exact, open loop, and with noise and delay."""

import numpy as np
import pytest
from helpers import Motion, fix, model, output
from pydrake.systems.analysis import Simulator
from scipy.spatial.transform import Rotation

from drake_nonstop.blocks.load_feedback import (
    DesiredStateFeedback,
    EstimatedFeedback,
    EstimatedFeedbackConfig,
    IdealFeedback,
    NoisyFeedback,
    NoisyFeedbackConfig,
    steady_state_gain,
)
from drake_nonstop.mechanics.signals import LoadState
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.systems.documentation import own_config_class
from drake_nonstop.validation import ScenarioError


def test_ideal_feedback_passes_the_state_on():
    block = IdealFeedback(model())
    context = block.CreateDefaultContext()
    state = Motion(50).state(0.1)
    fix(block, context, load_state=state)
    np.testing.assert_array_equal(output(block, context, "measured_load_state"), state)


def test_desired_state_feedback_passes_the_reference_on():
    block = DesiredStateFeedback(model())
    context = block.CreateDefaultContext()
    reference = Motion(50).reference(0.1)
    fix(block, context, reference=reference)
    np.testing.assert_array_equal(output(block, context, "measured_load_state"), reference[:13])


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
    still = np.tile(np.array([1.0, *np.zeros(12)]), (2000, 1))
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
        short = ["simulation_duration=0.3", "optimization_layer=ConstantParameters"]
        run = simulate(load_scenario("quintic", [setting, *short]))
        held, load = run.signal("held_measured_load_state"), run.signal("load_state")
        # The signals at a sample's instant hold what was taken at the one before.
        for k in (10, 17, 29):
            np.testing.assert_allclose(held[k], load[k - 1 - periods], rtol=0, atol=1e-9)
            assert np.abs(held[k] - load[k - periods]).max() > 1e-9


@pytest.mark.parametrize(
    ("field", "value"),
    [("delay", 0.015), ("delay", -0.01), ("position_noise", -1.0), ("period", 0.0), ("seed", -1)],
)
def test_bad_feedback(field, value):
    with pytest.raises(ScenarioError, match=f"^load_feedback\\.{field} = "):
        NoisyFeedback(model(), NoisyFeedbackConfig(**{field: value}))


@pytest.mark.parametrize("index", [0.01, 0.3, 4.0])
def test_gains_are_those_of_the_alpha_beta_filter_where_only_the_pose_is_known(index):
    """Kalata's relation of gains and tracking index, for continuous white acceleration.

    beta^2/(1 - alpha) = index^2 and alpha = sqrt(2 beta + beta^2/12) - beta/2: Bar-Shalom, Li and
    Kirubarajan, "Estimation with Applications to Tracking and Navigation", section 6.5.3.
    """
    noise, period = 0.02, 0.05
    gain = steady_state_gain(noise, 1e9, index * noise / period**2, period)
    alpha, beta = gain[0, 0], period * gain[1, 0]
    assert beta**2 / (1 - alpha) == pytest.approx(index**2)
    assert alpha == pytest.approx(np.sqrt(2 * beta + beta**2 / 12) - beta / 2)


def test_an_exact_rate_leaves_a_filter_of_the_pose_alone():
    """What a rate at both ends of a period leaves unknown of the way is q T^3/12."""
    noise, period, acceleration = 0.01, 0.02, 40.0
    gain = steady_state_gain(noise, 0.0, acceleration, period)
    k = gain[0, 0]
    assert k**2 / (1 - k) == pytest.approx((acceleration * period**2 / noise) ** 2 / 12)
    np.testing.assert_allclose(gain, [[k, (1 - k) * period / 2], [0, 1]], atol=1e-14)
    np.testing.assert_allclose(steady_state_gain(0, 0, 1, 0.01), np.eye(2), atol=1e-14)
    np.testing.assert_allclose(steady_state_gain(0, 0.1, 1, 0.01)[0], [1, 0], atol=1e-14)


def estimated(config, states):
    """What the filter shows at its samples, of these states (k, 13) at each of them."""
    block = EstimatedFeedback(model(4, 0.01), config)
    context = block.CreateDefaultContext()
    fix(block, context, load_state=states[0])
    simulator = Simulator(block, context)
    shown = [output(block, context, "measured_load_state").copy()]
    simulator.Initialize()
    for k, state in enumerate(states[1:], 1):
        simulator.AdvanceTo((k - 1e-8) * config.period)  # its update is still to come
        fix(block, context, load_state=state)
        shown.append(output(block, context, "measured_load_state").copy())
    return np.array(shown)


@pytest.mark.nightly("studies")
def test_errors_of_a_long_record_have_the_deviations_of_the_riccati_equation():
    config = EstimatedFeedbackConfig(
        position_noise=0.01,
        orientation_noise=0.02,
        velocity_noise=0.05,
        angular_velocity_noise=0.1,
        believed_velocity_noise=0.05,
        believed_angular_velocity_noise=0.1,
        process_acceleration=20.0,
        process_angular_acceleration=30.0,
    )
    T, count = config.period, 2000
    process = np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    factor = np.linalg.cholesky(process)
    generator = np.random.default_rng(5)
    states = np.zeros((count, 13))
    states[0, 0], attitude = 1.0, Rotation.identity()
    for k in range(1, count):
        before, now = states[k - 1], states[k]
        moved, sped = factor @ generator.standard_normal((2, 6))
        now[7:10] = before[7:10] + 30.0 * T * sped[:3]
        now[10:13] = before[10:13] + 20.0 * T * sped[3:]
        attitude = Rotation.from_rotvec(T * before[7:10] + 30.0 * T**2 * moved[:3]) * attitude
        now[:4] = attitude.as_quat()[[3, 0, 1, 2]]
        now[4:7] = before[4:7] + T * before[10:13] + 20.0 * T**2 * moved[3:]
    shown = estimated(config, states)[100:]
    states = states[100:]
    turned = Rotation.from_quat(shown[:, [1, 2, 3, 0]]) * (
        Rotation.from_quat(states[:, [1, 2, 3, 0]]).inv()
    )
    errors = shown - states
    for pose, rate, noises, acceleration in (
        (errors[:, 4:7], errors[:, 10:], (0.01, 0.05), 20.0),
        (turned.as_rotvec(), errors[:, 7:10], (0.02, 0.1), 30.0),
    ):
        gain = steady_state_gain(*noises, acceleration, T)
        spread = gain @ np.diag(np.square(noises))  # P+ = K R
        expected = np.sqrt(np.diag(spread))
        measured = np.sqrt([np.mean(pose**2), np.mean(rate**2)])
        np.testing.assert_allclose(measured, expected, rtol=0.05)


def test_an_exact_measurement_is_passed_on_and_a_record_repeats():
    states = np.array([Motion(50).state(0.1 + 0.01 * k) for k in range(20)])
    exact = EstimatedFeedbackConfig(believed_position_noise=0, believed_orientation_noise=0)
    shown = estimated(exact, states)
    rotations = [Rotation.from_quat(s[:, [1, 2, 3, 0]]).as_matrix() for s in (shown, states)]
    np.testing.assert_allclose(rotations[0], rotations[1], atol=1e-6)
    np.testing.assert_allclose(shown[:, 4:], states[:, 4:], atol=1e-12)
    noisy = EstimatedFeedbackConfig(position_noise=0.01, orientation_noise=0.02, delay=0.02)
    np.testing.assert_array_equal(estimated(noisy, states), estimated(noisy, states))
    np.testing.assert_array_equal(estimated(noisy, states)[0], states[0])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("delay", 0.015),
        ("believed_position_noise", -1.0),
        ("process_acceleration", 0.0),
        ("process_angular_acceleration", -1.0),
    ],
)
def test_bad_estimated_feedback(field, value):
    with pytest.raises(ScenarioError, match=f"^load_feedback\\.{field} = "):
        EstimatedFeedback(model(), EstimatedFeedbackConfig(**{field: value}))


@pytest.mark.parametrize("block", [NoisyFeedback, EstimatedFeedback])
def test_an_attitude_that_is_not_measured_is_the_reference_s(block):
    state, reference, shown = Motion(50).state(0.1), Motion(51).reference(0.1), []
    for measures_attitude in (True, False):
        feedback = block(
            model(),
            own_config_class(block)(
                position_noise=0.1, orientation_noise=0.1, measures_attitude=measures_attitude
            ),
        )
        context = feedback.CreateDefaultContext()
        context.SetTime(0.1)
        fix(feedback, context, load_state=state)
        if not measures_attitude:
            fix(feedback, context, reference=reference)
        shown.append(LoadState.view(output(feedback, context, "measured_load_state").copy()))
    measured, desired = shown[0], LoadState.view(reference)
    expected = (desired.quaternion, measured.position, desired.angular_velocity, measured.velocity)
    for found, value in zip(shown[1], expected, strict=True):
        np.testing.assert_array_equal(found, value)
    is_measured = feedback.describe_response().is_measured
    np.testing.assert_array_equal(is_measured, np.repeat([0, 1, 0, 1], 3))
