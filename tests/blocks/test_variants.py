"""What sets the interchangeable controllers, generators and carriers apart."""

import dataclasses

import numpy as np
import pytest
from helpers import Motion, difference, fix, model, output, regular

from drake_nonstop.blocks.carrier_controller import (
    CarrierPid,
    CarrierPidConfig,
    FeedforwardCarrierPid,
    FeedforwardCarrierPidConfig,
    TunedCarrierPid,
    TunedCarrierPidConfig,
    TunedFeedforwardCarrierPid,
    TunedFeedforwardCarrierPidConfig,
)
from drake_nonstop.blocks.carrier_dynamics import IdealCarriers
from drake_nonstop.blocks.carrier_trajectory import (
    CarrierTrajectory,
    InextensibleCarrierTrajectory,
    MeasuredCarrierTrajectory,
)
from drake_nonstop.blocks.wrench_controller import (
    GeometricPd,
    GeometricPdConfig,
    PaperWrenchController,
    PaperWrenchControllerConfig,
    TunedWrenchController,
    TunedWrenchControllerConfig,
    WrenchController,
    WrenchControllerConfig,
)
from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.mechanics.grasp import cable_forces_and_rates
from drake_nonstop.mechanics.internal_force import internal_force
from drake_nonstop.validation import ScenarioError


def outputs(block, state=None, time=0.0, **inputs):
    context = block.CreateDefaultContext()
    context.SetTime(time)
    if state is not None:
        context.SetContinuousState(state)
    fix(block, context, **inputs)
    return {
        block.get_output_port(i).get_name(): output(
            block, context, block.get_output_port(i).get_name()
        )
        for i in range(block.num_output_ports())
    }


LOAD = {"measured_load_state": Motion(3).state(0.3), "reference": Motion(4).reference(0.3)}
INTEGRALS = np.array([0.1, -0.2, 0.3, 0.2, 0.1, -0.1])


def test_pd_is_the_controller_without_integrals_and_feedforward():
    none = WrenchControllerConfig(
        position_integral_gain=0.0, orientation_integral_gain=0.0, feedforward=0.0
    )
    expected = outputs(WrenchController(model(), none), **LOAD)
    block = GeometricPd(model())
    assert block.CreateDefaultContext().num_continuous_states() == 0
    for name, value in outputs(block, **LOAD).items():
        np.testing.assert_array_equal(value, expected[name], err_msg=name)


def test_printed_sign_turns_the_damping_of_the_rotation_around():
    printed = outputs(PaperWrenchController(model()), INTEGRALS, **LOAD)["wrench"]
    mended = WrenchControllerConfig(feedforward=0.0)
    damped = outputs(WrenchController(model(), mended), INTEGRALS, **LOAD)["wrench"]
    undamped = dataclasses.replace(mended, angular_velocity_gain=0.0)
    without = outputs(WrenchController(model(), undamped), INTEGRALS, **LOAD)["wrench"]
    np.testing.assert_allclose(printed - without, without - damped, rtol=0, atol=1e-14)
    assert np.linalg.norm((without - damped)[:3]) > 1e-3


def test_tuned_gains_are_the_plain_ones_of_that_mass_and_inertia():
    body = model(load_mass=3.0, load_drag=0.5, load_inertia=(0.02 * np.eye(3)).tolist())
    tuned = TunedWrenchControllerConfig(
        position_frequency=2.0,
        position_damping=0.7,
        position_integral_rate=0.0,
        orientation_frequency=5.0,
        orientation_damping=0.6,
        orientation_integral_rate=0.3,
    )
    plain = WrenchControllerConfig(
        position_gain=3.0 * 4.0,
        velocity_gain=3.0 * 2 * 0.7 * 2.0 - 0.5,
        position_integral_gain=0.0,
        orientation_gain=0.02 * (25.0 + 6.0 * 0.3),
        angular_velocity_gain=0.02 * (6.0 + 0.3),
        orientation_integral_gain=0.02 * 25.0 * 0.3,
    )
    expected = outputs(WrenchController(body, plain), INTEGRALS, **LOAD)
    for name, value in outputs(TunedWrenchController(body, tuned), INTEGRALS, **LOAD).items():
        np.testing.assert_allclose(value, expected[name], rtol=1e-12, atol=1e-12, err_msg=name)


def test_tuned_rotation_answers_alike_about_all_axes():
    """An error of the orientation alone is turned back along itself, whatever the inertia."""
    config = TunedWrenchControllerConfig(orientation_frequency=4.0, orientation_integral_rate=0.0)
    body = model()
    turned = np.array([1.0, 1e-4, -2e-4, 1.5e-4, *np.zeros(9)])
    still = np.array([1.0, *np.zeros(21)])
    torque = outputs(
        TunedWrenchController(body, config),
        np.zeros(6),
        measured_load_state=turned,
        reference=still,
    )["wrench"][:3]
    acceleration = np.linalg.solve(body.load.inertia, torque)
    np.testing.assert_allclose(acceleration, -16.0 * 2 * turned[1:4], rtol=1e-3)


@pytest.mark.parametrize(
    ("make", "config", "message"),
    [
        (GeometricPd, GeometricPdConfig(position_gain=-1.0), r"position_gain = -1\.0"),
        (
            PaperWrenchController,
            PaperWrenchControllerConfig(velocity_gain=np.nan),
            "velocity_gain = nan",
        ),
        (
            TunedWrenchController,
            TunedWrenchControllerConfig(position_frequency=0.0),
            r"position_frequency = 0\.0: .*greater than zero",
        ),
        (
            TunedWrenchController,
            TunedWrenchControllerConfig(position_damping=0.1, position_integral_rate=0.0),
            r"position_damping = 0\.1: the load's drag alone damps more",
        ),
        (CarrierPid, CarrierPidConfig(integral_gain=-1.0), r"integral_gain = -1\.0"),
        (TunedCarrierPid, TunedCarrierPidConfig(frequency=0.0), r"frequency = 0\.0"),
        (
            TunedFeedforwardCarrierPid,
            TunedFeedforwardCarrierPidConfig(damping=-0.1),
            r"damping = -0\.1",
        ),
        (
            FeedforwardCarrierPid,
            FeedforwardCarrierPidConfig(position_gain=np.inf),
            "position_gain = inf",
        ),
    ],
)
def test_parameters_out_of_range_are_named(make, config, message):
    with pytest.raises(ScenarioError, match=message):
        make(model(), config)


@pytest.mark.parametrize("n", [3, 4])
def test_default_tuned_gains_of_the_papers_carriers_are_those_of_the_pid(rng, n):
    inputs = {"carrier_reference": rng.normal(size=6 * n), "carrier_state": rng.normal(size=6 * n)}
    tuned = outputs(TunedCarrierPid(model(n)), **inputs)["carrier_forces"]
    plain = outputs(CarrierPid(model(n)), **inputs)["carrier_forces"]
    np.testing.assert_allclose(tuned, plain, rtol=1e-13)
    heavy = outputs(TunedCarrierPid(model(n, carrier_mass=6.0)), **inputs)["carrier_forces"]
    np.testing.assert_allclose(heavy, 60 * plain, rtol=1e-13)


def orbit(body, time, frequency=2.0, amplitude=1.2):
    """The signals of carriers that turn above a load at rest, at a time."""
    phase = np.array([frequency * time])
    still = np.array([1.0, *np.zeros(21)])
    parameters = np.array([frequency, amplitude])
    internal = np.concatenate(internal_force(parameters, phase, phases=body.pattern.phases))
    forces, rates = cable_forces_and_rates(
        still[:13],
        np.array([0, 0, 0, 0, 0, 9.81]),
        np.zeros(6),
        internal,
        pseudo_inverse=body.pseudo_inverse,
        basis=body.pattern.basis,
        offset=body.pattern.offset,
    )
    motion = carrier_motion(
        still,
        forces,
        rates,
        attachments=body.attachments,
        rest_length=body.cable_length,
        compliance=body.cable_compliance,
    )
    return {
        "carrier_reference": np.concatenate([part.ravel() for part in motion]),
        "reference": still,
        "desired_cable_forces": forces.ravel(),
        "desired_cable_force_rates": rates.ravel(),
        "internal_force": internal,
        "parameters": parameters,
    }


@pytest.mark.parametrize("make", [FeedforwardCarrierPid, TunedFeedforwardCarrierPid])
def test_feedforward_is_the_mass_times_the_acceleration_of_the_orbit(make):
    body = model(4, carrier_mass=0.3)
    signals = orbit(body, 0.4)
    forces = outputs(make(body), carrier_state=signals["carrier_reference"], **signals)
    acceleration = difference(lambda t: orbit(body, t)["carrier_reference"][12:], 0.4)
    np.testing.assert_allclose(forces["carrier_forces"], 0.3 * acceleration, rtol=0, atol=1e-9)
    assert np.linalg.norm(acceleration) > 1


def test_ideal_carriers_are_where_they_should_be(rng):
    values = rng.normal(size=24)
    state = outputs(IdealCarriers(model()), carrier_reference=values)["carrier_state"]
    np.testing.assert_array_equal(state, values)


def carried(block, pose):
    pulls = {"desired_cable_forces": np.tile([0.3, -0.2, 2.5], 4)}
    return outputs(block, **pose, **pulls, desired_cable_force_rates=np.full(12, 0.1))[
        "carrier_reference"
    ]


def test_inextensible_cables_are_as_long_as_they_are_unstretched():
    pose = {"reference": LOAD["reference"]}
    stiff = carried(CarrierTrajectory(model(cable_stiffness=np.inf)), pose)
    np.testing.assert_array_equal(carried(InextensibleCarrierTrajectory(model()), pose), stiff)
    assert np.linalg.norm(carried(CarrierTrajectory(model()), pose) - stiff) > 1e-3


def test_measured_pose_carries_the_cables():
    state = LOAD["measured_load_state"]
    measured = carried(MeasuredCarrierTrajectory(model()), {"measured_load_state": state})
    same = carried(CarrierTrajectory(model()), {"reference": np.concatenate([state, np.zeros(9)])})
    np.testing.assert_array_equal(measured, same)
    ends = measured[:12].reshape(4, 3) - state[4:7]
    assert np.all(np.linalg.norm(ends, axis=1) < np.linalg.norm(regular(4), axis=1).max() + 0.81)
