"""The load feedback: exact, open loop, and with noise and delay."""

import numpy as np
import pytest
from helpers import Motion, fix, model, nightly_beyond, output, outputs
from pydrake.systems.analysis import Simulator
from scipy.linalg import solve_discrete_are
from scipy.spatial.transform import Rotation

from drake_nonstop import load_scenario, simulate
from drake_nonstop.blocks.load_feedback import (
    FilteredFeedback,
    FilteredFeedbackConfig,
    NoisyFeedback,
    NoisyFeedbackConfig,
)
from drake_nonstop.mechanics.load_estimate import (
    corrected_error,
    error_of,
    predicted_error,
    state_with_error,
)
from drake_nonstop.mechanics.signals import LoadState


def test_noise_has_the_deviations_that_were_asked_for_and_repeats():
    names = ("orientation", "position", "angular_velocity", "velocity")
    deviations = np.array([0.02, 0.1, 0.4, 0.3])
    fields = {f"{name}_noise": size for name, size in zip(names, deviations, strict=True)}
    times = 0.01 * np.arange(2000) + 0.003

    def measured(times, seed=0):
        """What the feedback shows at some times of a load at rest."""
        block = NoisyFeedback(model(4, 0.01), NoisyFeedbackConfig(**fields, seed=seed))
        still = np.eye(13)[0]
        return np.array(
            [outputs(block, time=t, load_state=still)["measured_load_state"] for t in times]
        )

    noisy = measured(times)
    turns = Rotation.from_quat(noisy[:, [1, 2, 3, 0]]).as_rotvec()
    found = np.stack([turns, noisy[:, 4:7], noisy[:, 7:10], noisy[:, 10:]])
    np.testing.assert_allclose(found.std(axis=1), np.outer(deviations, np.ones(3)), rtol=0.1)
    assert np.all(np.abs(found.mean(axis=1)) < 0.1 * deviations[:, None])
    # Held between samples, other for another seed.
    np.testing.assert_array_equal(noisy[:5], measured(times[:5] + 0.004))
    assert not np.array_equal(noisy[:1], measured(times[:1], seed=1))


@pytest.mark.slow
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


@pytest.mark.parametrize("noises", [(0.01, 0.05), (0.002, 1.0), (0.05, 0.3)])
def test_covariances_settle_at_the_solution_of_the_riccati_equation(noises):
    """Of a double integrator that white accelerations drive, by SciPy's solver."""
    T, density = 0.02, 0.3
    A = np.array([[1.0, T], [0.0, 1.0]])
    Q = density * np.array([[T**3 / 3, T**2 / 2], [T**2 / 2, T]])
    R = np.diag(np.square(noises))
    before = solve_discrete_are(A.T, np.eye(2), Q, R)
    after = before - before @ np.linalg.solve(before + R, before)
    error, covariance, both = np.ones(12), np.tile([1.0, 0.0, 1.0], 2), np.full(2, density)
    for _ in range(3000):
        error, covariance = predicted_error(error, covariance, np.array([T]), both)
        error, covariance = corrected_error(
            error, covariance, 0 * error, np.tile(np.diag(R), (2, 1))
        )
    for found in covariance.reshape(2, 3):
        np.testing.assert_allclose(found, after[[0, 0, 1], [0, 1, 1]], rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(error, 0, atol=1e-9)


def filtered(config, states, references):
    """Signals of the filter at its samples, of these states and references at each of them."""
    block = FilteredFeedback(model(4, 0.01), config)
    context = block.CreateDefaultContext()
    fix(block, context, load_state=states[0], reference=references[0])
    simulator = Simulator(block, context)
    simulator.Initialize()
    shown = []
    for k, (state, reference) in enumerate(zip(states, references, strict=True)):
        simulator.AdvanceTo(max(0.0, (k - 1e-8) * config.period))  # its update is still to come
        fix(block, context, load_state=state, reference=reference)
        names = ("measured_load_state", "measured_load_covariance")
        shown.append(np.concatenate([output(block, context, name) for name in names]))
    return np.split(np.array(shown), [13], axis=1)


def wandering(count, config):
    """Errors (count, 12) of the motion that the filter believes in, from zero on."""
    T, generator = config.period, np.random.default_rng(5)
    factor = np.linalg.cholesky(np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]]))
    size = np.repeat([config.process_angular_acceleration, config.process_acceleration], 3)
    errors = np.zeros((count, 12))
    for k in range(1, count):
        moved, sped = size * (factor @ generator.standard_normal((2, 6)))
        errors[k, 6:] = errors[k - 1, 6:] + T * sped
        errors[k, :6] = errors[k - 1, :6] + T * errors[k - 1, 6:] + T**2 * moved
    return errors


@pytest.mark.slow
@pytest.mark.parametrize("delay", nightly_beyond(1, "studies", [0.05, 0.0]))
def test_errors_of_a_long_record_have_the_covariance_that_is_told(delay):
    """Beside a reference that moves, with measurements that are late, and rates that are noisy."""
    noises = {"position": 0.01, "orientation": 0.002, "velocity": 0.05, "angular_velocity": 0.02}
    config = FilteredFeedbackConfig(
        **{f"{name}_noise": value for name, value in noises.items()},
        **{f"believed_{name}_noise": value for name, value in noises.items()},
        process_acceleration=2.0,
        process_angular_acceleration=0.05,
        measures_attitude=True,
        delay=delay,
    )
    count = 1500
    references = np.array([Motion(50).reference(0.1 + 0.01 * k) for k in range(count)])
    errors = wandering(count, config)
    states = [state_with_error(e, r[:13]) for e, r in zip(errors, references, strict=True)]
    shown, covariances = filtered(config, states, references)
    np.testing.assert_allclose(shown[0], states[0], atol=1e-12)
    off = np.array([error_of(a, b) for a, b in zip(shown, states, strict=True)])[200:]
    for k, entry in enumerate((0, 2, 3, 5)):
        axes = slice(*((0, 3), (6, 9), (3, 6), (9, 12))[k])
        told = np.sqrt(covariances[-1, entry])
        assert np.sqrt(np.mean(off[:, axes] ** 2)) == pytest.approx(told, rel=0.15)


def test_a_late_measurement_of_a_load_beside_its_moving_reference_is_exact():
    references = np.array([Motion(50).reference(0.1 + 0.01 * k) for k in range(40)])
    off = np.concatenate([[0.01, 0.02, -0.03, 0.1, 0.2, -0.3], np.zeros(6)])
    states = [state_with_error(off, reference[:13]) for reference in references]
    shown, _ = filtered(
        FilteredFeedbackConfig(delay=0.2, measures_attitude=True), states, references
    )
    np.testing.assert_allclose(shown, states, atol=1e-9)


@pytest.mark.parametrize(
    ("kind", "config"),
    [(NoisyFeedback, NoisyFeedbackConfig), (FilteredFeedback, FilteredFeedbackConfig)],
)
def test_an_attitude_that_is_not_measured_is_the_reference_s(kind, config):
    inputs = {"load_state": Motion(50).state(0.1), "reference": Motion(51).reference(0.1)}
    shown, noises = [], {"position_noise": 0.1, "orientation_noise": 0.1}
    for measures_attitude in (True, False):
        block = kind(model(), config(measures_attitude=measures_attitude, **noises))
        given = {name: value for name, value in inputs.items() if block.HasInputPort(name)}
        found = outputs(block, time=0.1, **given)
        shown.append(LoadState.view(found["measured_load_state"]))
    measured, desired = shown[0], LoadState.view(inputs["reference"])
    expected = (desired.quaternion, measured.position, desired.angular_velocity, measured.velocity)
    for found, value in zip(shown[1], expected, strict=True):
        np.testing.assert_array_equal(found, value)
    np.testing.assert_array_equal(block.describe_response().is_measured, np.repeat([0, 1, 0, 1], 3))
