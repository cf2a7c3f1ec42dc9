"""Cables, and the blocks that steer and move the carriers, each alone."""

import math

import numpy as np
import pytest
from helpers import Motion, fix, model, output, regular
from pydrake.systems.analysis import Simulator

from drake_nonstop.blocks.cables import Cables
from drake_nonstop.blocks.carrier_controller import CarrierPid, CarrierPidConfig
from drake_nonstop.blocks.carrier_dynamics import CarrierDynamics, LoadedCarrierDynamics
from drake_nonstop.blocks.carrier_trajectory import CarrierTrajectory
from drake_nonstop.mechanics.cable import cable_forces_and_tensions
from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import ScenarioError

counts = pytest.mark.parametrize("n", [3, 4, 6])


@counts
def test_cables_pull_on_the_load(rng, n):
    block = Cables(model(n))
    context = block.CreateDefaultContext()
    state = Motion(60).state(0.3)
    carriers = rng.uniform(-0.3, 0.3, 6 * n) + np.concatenate([[0, 0, 1.3] * n, np.zeros(3 * n)])
    fix(block, context, load_state=state, carrier_state=carriers)
    forces, tensions = cable_forces_and_tensions(
        state, carriers, attachments=regular(n), rest_length=0.8, stiffness=500.0, damping=0.1
    )
    np.testing.assert_allclose(output(block, context, "cable_forces"), forces.ravel(), rtol=1e-12)
    np.testing.assert_allclose(output(block, context, "tensions"), tensions, rtol=1e-12)
    assert np.min(tensions) > 1


def test_resting_carriers_straight_above_hold_a_load_by_stretched_cables():
    block = Cables(model(4))
    context = block.CreateDefaultContext()
    above = regular(4) + np.array([0, 0, 0.8 + 0.005])
    fix(
        block,
        context,
        load_state=np.array([1.0, *np.zeros(12)]),
        carrier_state=np.concatenate([above.ravel(), np.zeros(12)]),
    )
    np.testing.assert_allclose(output(block, context, "tensions"), 2.5, rtol=1e-12)
    np.testing.assert_allclose(
        output(block, context, "cable_forces"), [0, 0, 2.5] * 4, rtol=0, atol=1e-12
    )


def test_simulated_cables_need_a_finite_stiffness():
    with pytest.raises(ScenarioError, match=r"simulated\.cable_stiffness = inf: simulated cables"):
        Cables(model(cable_stiffness=math.inf))


def generator_inputs(rng, n):
    return {
        "reference": Motion(61).reference(0.3),
        "desired_cable_forces": rng.uniform(0.5, 2.0, 3 * n),
        "desired_cable_force_rates": rng.normal(size=3 * n),
    }


def expected_motion(inputs, n, compliance):
    reference, forces, rates = inputs.values()
    return carrier_motion(
        reference,
        forces.reshape(n, 3),
        rates.reshape(n, 3),
        attachments=regular(n),
        rest_length=0.8,
        compliance=compliance,
    )


@counts
@pytest.mark.parametrize(("stiffness", "compliance"), [(500.0, 1 / 500), (math.inf, 0.0)])
def test_carrier_trajectory_stands_on_the_desired_load_pose(rng, n, stiffness, compliance):
    block = CarrierTrajectory(model(n, cable_stiffness=stiffness))
    context = block.CreateDefaultContext()
    inputs = generator_inputs(rng, n)
    fix(block, context, **inputs)
    expected = np.ravel(expected_motion(inputs, n, compliance))
    np.testing.assert_allclose(
        output(block, context, "carrier_reference"), expected, rtol=1e-12, atol=1e-13
    )


def test_sampled_carrier_trajectory_goes_on_along_its_velocity(rng):
    block = CarrierTrajectory(model(4, 0.01))
    context = block.CreateDefaultContext()
    inputs = generator_inputs(rng, 4)
    positions, velocities = expected_motion(inputs, 4, 1 / 500)
    fix(block, context, **inputs, sample_time=np.array([2.0]))
    for time in (2.0, 2.004, 2.01):
        context.SetTime(time)
        expected = np.ravel([positions + (time - 2.0) * velocities, velocities])
        np.testing.assert_allclose(
            output(block, context, "carrier_reference"), expected, rtol=1e-12, atol=1e-13
        )


@counts
def test_carrier_pid_in_closed_form(rng, n):
    gains = {"position_gain": 900.0, "velocity_gain": 7.0, "integral_gain": 11.0}
    block = CarrierPid(model(n), CarrierPidConfig(**gains))
    context = block.CreateDefaultContext()
    reference, state = rng.normal(size=(2, 6 * n))
    integral = rng.normal(size=3 * n)
    fix(block, context, carrier_reference=reference, carrier_state=state)
    context.SetContinuousState(integral)
    error = reference - state
    expected = 900 * error[: 3 * n] + 7 * error[3 * n :] + 11 * integral
    np.testing.assert_allclose(
        output(block, context, "carrier_forces"), expected, rtol=1e-12, atol=1e-10
    )
    np.testing.assert_allclose(
        block.EvalTimeDerivatives(context).CopyToVector(), error[: 3 * n], rtol=0, atol=1e-15
    )


def test_carrier_pid_without_integral_gain_has_no_state(rng):
    block = CarrierPid(model())
    context = block.CreateDefaultContext()
    assert context.num_continuous_states() == 0
    reference, state = rng.normal(size=(2, 24))
    fix(block, context, carrier_reference=reference, carrier_state=state)
    error = reference - state
    np.testing.assert_allclose(
        output(block, context, "carrier_forces"), 1000 * error[:12] + 10 * error[12:], rtol=1e-12
    )
    assert block.EvalTimeDerivatives(context).size() == 0


@pytest.mark.parametrize("gain", ["position_gain", "velocity_gain", "integral_gain"])
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf, False, None])
def test_bad_gain_of_the_carrier_controller_is_named(gain, value):
    with pytest.raises(ScenarioError, match=f"carrier_controller.{gain} = {value}: give"):
        CarrierPid(model(), CarrierPidConfig(**{gain: value}))


@counts
def test_carriers_are_double_integrators(rng, n):
    block = CarrierDynamics(model(n, carrier_mass=0.25))
    context = block.CreateDefaultContext()
    state, forces = rng.normal(size=6 * n), rng.normal(size=3 * n)
    context.SetContinuousState(state)
    fix(block, context, carrier_forces=forces)
    rate = block.EvalTimeDerivatives(context)
    np.testing.assert_allclose(
        rate.CopyToVector(), [*state[3 * n :], *(4 * forces)], rtol=0, atol=1e-15
    )
    np.testing.assert_array_equal(output(block, context, "carrier_state"), state)


def test_pushed_carrier_moves_on_a_parabola():
    block = CarrierDynamics(model(3, carrier_mass=0.1))
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    fix(block, context, carrier_forces=np.arange(9.0))
    simulator.AdvanceTo(0.5)
    expected = np.concatenate([np.arange(9) / 0.1 * 0.5**2 / 2, np.arange(9) / 0.1 * 0.5])
    np.testing.assert_allclose(output(block, context, "carrier_state"), expected, rtol=1e-9)


def test_carrier_that_gets_no_number_is_named():
    block = LoadedCarrierDynamics(model())
    block.set_name("carrier_dynamics")
    context = block.CreateDefaultContext()
    fix(block, context, carrier_forces=np.full(12, np.inf), cable_forces=np.zeros(12))
    with pytest.raises(NotFiniteError, match="carrier_dynamics"):
        block.EvalTimeDerivatives(context)


def test_cable_of_no_length_is_named():
    block = Cables(model())
    block.set_name("cables")
    context = block.CreateDefaultContext()
    carriers = np.concatenate([regular(4).ravel(), np.zeros(12)])
    fix(block, context, load_state=np.array([1.0, *np.zeros(12)]), carrier_state=carriers)
    with pytest.raises(NotFiniteError, match="cables"):
        block.GetOutputPort("tensions").Eval(context)
