"""The load feedback: exact, open loop, and with noise and delay."""

import numpy as np
import pytest
from helpers import Motion, fix, model, output
from scipy.spatial.transform import Rotation

from drake_nonstop.blocks.load_feedback import (
    DesiredStateFeedback,
    IdealFeedback,
    NoisyFeedback,
    NoisyFeedbackConfig,
)
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.simulation.simulate import simulate
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
        run = simulate(load_scenario("quintic", [setting, "simulation_duration=1"]))
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
