from dataclasses import replace

import numpy as np
import pytest
from helpers import INERTIA, SHAPES, Motion, rotation
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import RotationalInertia, SpatialInertia

from drake_nonstop.mechanics.load_motion import LoadMotion, torque_and_force
from drake_nonstop.mechanics.rigid_load import (
    RigidLoad,
    load_acceleration,
    load_state_rate,
)
from drake_nonstop.mechanics.signals import LoadState
from drake_nonstop.mechanics.taylor import Taylor

MASS, DRAG, GRAVITY = 1.3, 0.7, 9.7
LOAD = RigidLoad(mass=MASS, inertia=INERTIA, drag=DRAG, gravity=GRAVITY)


@pytest.fixture(scope="module")
def plant():
    """A free body with the load's mass and inertia."""
    plant = MultibodyPlant(time_step=0.0)
    moments = RotationalInertia(*np.diag(INERTIA), *INERTIA[[0, 0, 1], [1, 2, 2]])
    plant.AddRigidBody("load", SpatialInertia.MakeFromCentralInertia(MASS, np.zeros(3), moments))
    plant.mutable_gravity_field().set_gravity_vector([0, 0, -GRAVITY])
    plant.Finalize()
    return plant


def external_force(plant, point, torque, force):
    applied = ExternallyAppliedSpatialForce()
    applied.body_index = plant.GetBodyByName("load").index()
    applied.p_BoBq_B = point
    applied.F_Bq_W = SpatialForce(torque, force)
    return applied


@pytest.mark.parametrize("shape", ["irregular-3", "regular-4", "spatial-6"])
@pytest.mark.parametrize("time", [0.0, 1.3, 2.9])
def test_load_moves_as_a_free_body_of_multibody_plant(plant, rng, shape, time):
    attachments = SHAPES[shape]
    state = Motion(5).state(time)
    forces, disturbance = rng.normal(size=attachments.shape), rng.normal(size=6)
    context = plant.CreateDefaultContext()
    plant.SetPositionsAndVelocities(context, state)
    applied = [
        external_force(plant, point, np.zeros(3), force)
        for point, force in zip(attachments, forces, strict=True)
    ]
    applied.append(external_force(plant, np.zeros(3), np.zeros(3), -DRAG * state[10:13]))
    applied.append(external_force(plant, np.zeros(3), disturbance[:3], disturbance[3:]))
    plant.get_applied_spatial_force_input_port().FixValue(context, applied)
    expected = plant.EvalTimeDerivatives(context).CopyToVector()
    rate = load_state_rate(LOAD, state, forces.ravel(), disturbance, attachments=attachments)
    np.testing.assert_allclose(rate, expected, rtol=0, atol=1e-9)


def test_the_wrench_of_a_motion_moves_the_load_so(rng):
    load, wind, wrench = replace(LOAD, angular_drag=0.2), rng.normal(size=3), rng.normal(size=6)
    quaternion, position, spin, velocity = LoadState.view(Motion(3).state(0.4))
    state = np.concatenate([quaternion, position, 3 * spin, velocity])
    angular, translational = load_acceleration(load, state, wrench, wind)
    in_time = Taylor.of_rates(position, velocity, translational), Taylor([3 * spin, angular])
    torque, force = torque_and_force(load, LoadMotion.of(quaternion, *in_time), wind)
    made = [rotation(quaternion) @ torque.rates[0], force.rates[0]]
    np.testing.assert_allclose(np.concatenate(made), wrench, atol=1e-12)
