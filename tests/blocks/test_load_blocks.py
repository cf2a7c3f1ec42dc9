"""Load plant, load feedback, disturbance and wrench controller, each alone."""

import numpy as np
import pytest
from helpers import INERTIA, Motion, fix, model, output, regular
from pydrake.systems.analysis import Simulator

from drake_nonstop.blocks.load_disturbance import NoDisturbance
from drake_nonstop.blocks.load_feedback import DesiredStateFeedback, IdealFeedback
from drake_nonstop.blocks.load_plant import LoadPlant
from drake_nonstop.blocks.wrench_controller import WrenchController, WrenchControllerConfig
from drake_nonstop.mechanics.rigid_load import RigidLoad, load_state_rate
from drake_nonstop.mechanics.wrench import tracking_error, wrench_and_rate
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import ScenarioError

LOAD = RigidLoad(mass=1.0, inertia=INERTIA, drag=0.7, gravity=9.81)


@pytest.mark.parametrize("n", [3, 4, 6])
def test_load_plant_integrates_newton_euler(rng, n):
    block = LoadPlant(model(n))
    context = block.CreateDefaultContext()
    state, forces, wrench = Motion(50).state(0.3), rng.normal(size=3 * n), rng.normal(size=6)
    context.SetContinuousState(state)
    fix(block, context, cable_forces=forces, disturbance_wrench=wrench)
    expected = load_state_rate(LOAD, state, forces, wrench, attachments=regular(n))
    rate = block.EvalTimeDerivatives(context).CopyToVector()
    np.testing.assert_allclose(rate, expected, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(output(block, context, "load_state"), state)


def test_load_plant_starts_at_rest_at_the_origin():
    block = LoadPlant(model())
    state = output(block, block.CreateDefaultContext(), "load_state")
    np.testing.assert_array_equal(state, [1, *[0] * 12])


def test_falling_load_in_closed_form():
    block = LoadPlant(model(load_drag=0.7))
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    fix(block, context, cable_forces=np.zeros(12), disturbance_wrench=np.zeros(6))
    simulator.get_mutable_integrator().set_target_accuracy(1e-10)
    simulator.AdvanceTo(2.0)
    velocity = -9.81 / 0.7 * (1 - np.exp(-0.7 * 2.0))  # m = 1 kg
    expected = [1, 0, 0, 0, 0, 0, -(9.81 * 2.0 + velocity) / 0.7, 0, 0, 0, 0, 0, velocity]
    np.testing.assert_allclose(output(block, context, "load_state"), expected, rtol=0, atol=1e-7)


def test_load_plant_that_gets_no_number_is_named():
    block = LoadPlant(model())
    block.set_name("load_plant")
    context = block.CreateDefaultContext()
    forces = np.zeros(12)
    forces[4] = np.nan
    fix(block, context, cable_forces=forces, disturbance_wrench=np.zeros(6))
    with pytest.raises(NotFiniteError, match="load_plant"):
        block.EvalTimeDerivatives(context)


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


def test_no_disturbance_is_no_wrench():
    block = NoDisturbance(model())
    wrench = output(block, block.CreateDefaultContext(), "disturbance_wrench")
    np.testing.assert_array_equal(wrench, np.zeros(6))


GAINS = {
    "position_gain": 7.0,
    "velocity_gain": 3.0,
    "position_integral_gain": 1.1,
    "orientation_gain": 0.6,
    "angular_velocity_gain": 0.07,
    "orientation_integral_gain": 0.2,
    "feedforward": 0.5,
}


@pytest.mark.parametrize("period", [0.0, 0.01])
def test_wrench_controller_gives_wrench_rate_and_error(rng, period):
    block = WrenchController(model(4, period), WrenchControllerConfig(**GAINS))
    context = block.CreateDefaultContext()
    state, reference = Motion(51).state(0.3), Motion(52).reference(0.3)
    integrals = rng.normal(size=6)
    if period:
        context.SetDiscreteState(integrals)
    else:
        context.SetContinuousState(integrals)
    fix(block, context, measured_load_state=state, reference=reference)
    wrench, rate = wrench_and_rate(LOAD, state, reference, integrals, **GAINS)
    error = tracking_error(state, reference)
    for name, expected in (("wrench", wrench), ("wrench_rate", rate), ("tracking_error", error)):
        np.testing.assert_allclose(
            output(block, context, name), expected, rtol=1e-12, atol=1e-12, err_msg=name
        )


def test_integrals_of_a_continuous_controller_have_the_error_as_their_rate():
    block = WrenchController(model())
    context = block.CreateDefaultContext()
    state, reference = Motion(51).state(0.3), Motion(52).reference(0.3)
    fix(block, context, measured_load_state=state, reference=reference)
    np.testing.assert_array_equal(context.get_continuous_state_vector().CopyToVector(), 0)
    np.testing.assert_allclose(
        block.EvalTimeDerivatives(context).CopyToVector(),
        tracking_error(state, reference)[:6],
        rtol=0,
        atol=1e-14,
    )


def test_integrals_of_a_sampled_controller_step_once_a_period():
    block = WrenchController(model(4, 0.02))
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    state, reference = Motion(51).state(0.3), Motion(52).reference(0.3)
    fix(block, context, measured_load_state=state, reference=reference)
    simulator.Initialize()
    error = tracking_error(state, reference)[:6]
    for time, steps in ((0.0, 0), (0.01, 0), (0.03, 1), (0.05, 2)):
        simulator.AdvanceTo(time)
        integrals = context.get_discrete_state_vector().value()
        np.testing.assert_allclose(integrals, steps * 0.02 * error, rtol=0, atol=1e-15)


@pytest.mark.parametrize("gain", GAINS)
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf, True, "1"])
def test_bad_gain_of_the_wrench_controller_is_named(gain, value):
    with pytest.raises(ScenarioError, match=f"wrench_controller.{gain} = {value}: give"):
        WrenchController(model(), WrenchControllerConfig(**{gain: value}))
