"""The carrier trajectories, on the desired and on the measured pose."""

import math

import numpy as np
import pytest
from helpers import Motion, fix, model, output, outputs, regular

from drake_nonstop.blocks.carrier_trajectory import (
    CarrierTrajectory,
    InextensibleCarrierTrajectory,
    MeasuredCarrierTrajectory,
)
from drake_nonstop.mechanics.carrier import carrier_motion

counts = pytest.mark.parametrize("n", [3, 4, 6])


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


def generator_inputs(rng, n):
    return {
        "reference": Motion(61).reference(0.3),
        "desired_cable_forces": rng.uniform(0.5, 2.0, 3 * n),
        "desired_cable_force_rates": rng.normal(size=3 * n),
    }


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


SIGNALS = {"measured_load_state": Motion(3).state(0.3), "reference": Motion(4).reference(0.3)}


def carried(block, pose):
    pulls = {"desired_cable_forces": np.tile([0.3, -0.2, 2.5], 4)}
    return outputs(block, **pose, **pulls, desired_cable_force_rates=np.full(12, 0.1))[
        "carrier_reference"
    ]


def test_inextensible_cables_are_as_long_as_they_are_unstretched():
    pose = {"reference": SIGNALS["reference"]}
    stiff = carried(CarrierTrajectory(model(cable_stiffness=np.inf)), pose)
    np.testing.assert_array_equal(carried(InextensibleCarrierTrajectory(model()), pose), stiff)
    assert np.linalg.norm(carried(CarrierTrajectory(model()), pose) - stiff) > 1e-3


def test_measured_pose_carries_the_cables():
    state = SIGNALS["measured_load_state"]
    measured = carried(MeasuredCarrierTrajectory(model()), {"measured_load_state": state})
    same = carried(CarrierTrajectory(model()), {"reference": np.concatenate([state, np.zeros(9)])})
    np.testing.assert_array_equal(measured, same)
    ends = measured[:12].reshape(4, 3) - state[4:7]
    assert np.all(np.linalg.norm(ends, axis=1) < np.linalg.norm(regular(4), axis=1).max() + 0.81)
