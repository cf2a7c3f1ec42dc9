"""States that are found through an output port, against closed forms, Drake and drawn systems."""

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import LeafSystem

from drake_nonstop.systems.port_state import PortState, set_state_values, state_values


class Shown(LeafSystem):
    """A state x, continuous and discrete, with ẋ = v, or x + h v each period; the port shows f(x).

    `extra` is a second discrete state, with a sample time of its own, that the port does not show.
    """

    def __init__(self, function, size, velocity, continuous=0, period=0.1, offset=0.0, extra=0.0):
        super().__init__()
        self.velocity, self.period = velocity, period
        self.count = continuous
        if continuous:
            self.DeclareContinuousState(continuous)
        if size > continuous:
            self.group = self.DeclareDiscreteState(size - continuous)
            self.DeclarePeriodicUnrestrictedUpdateEvent(period, offset, self.update)
        if extra:
            self.clock = self.DeclareDiscreteState(1)
            self.DeclarePeriodicDiscreteUpdateEvent(extra, 0.0, self.tick)

        def calc(context, output):
            output.SetFromVector(function(state_values(context)[:size]))

        self.DeclareVectorOutputPort("shown", len(function(np.zeros(size))), calc)

    def DoCalcTimeDerivatives(self, context, derivatives):  # noqa: N802
        derivatives.get_mutable_vector().SetFromVector(self.velocity[: self.count])

    def update(self, context, state):
        values = state.get_mutable_discrete_state().get_mutable_vector(self.group)
        value = context.get_discrete_state(self.group).value()
        values.SetFromVector(value + self.period * self.velocity[self.count :])

    def tick(self, context, state):
        value = context.get_discrete_state(self.clock).value() + 1
        state.get_mutable_vector(self.clock).SetFromVector(value)


def port_state(system):
    return PortState(system, system.get_output_port()), system.CreateDefaultContext()


@pytest.mark.parametrize("continuous", [0, 5, 13])
@pytest.mark.parametrize("seed", range(4))
def test_a_drawn_affine_map_of_the_state_is_inverted(seed, continuous):
    generator = np.random.default_rng(seed)
    matrix, offset = generator.normal(size=(13, 13)), generator.normal(size=13)
    system = Shown(lambda x: matrix @ x + offset, 13, np.zeros(13), continuous)
    shown, context = port_state(system)
    for value in 10 * generator.normal(size=(3, 13)):
        shown.show(context, value)
        expected = np.linalg.solve(matrix, value - offset)
        np.testing.assert_allclose(state_values(context), expected, rtol=0, atol=1e-8)


def test_a_state_that_is_not_shown_stays():
    generator = np.random.default_rng(5)
    matrix = np.hstack([generator.normal(size=(4, 4)), np.zeros((4, 3))])
    shown, context = port_state(Shown(lambda x: matrix @ x, 7, np.zeros(7), continuous=5))
    set_state_values(context, np.arange(7.0))
    shown.show(context, np.ones(4))
    np.testing.assert_allclose(matrix @ state_values(context), 1, atol=1e-12)
    np.testing.assert_array_equal(state_values(context)[4:], [4, 5, 6])


@pytest.mark.parametrize("time_step", [0.0, 0.01])
def test_a_multibody_plant_has_its_positions_first(time_step):
    """Drake's own setters are the other source."""
    plant = MultibodyPlant(time_step)
    inertia = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
    bodies = [plant.AddRigidBody(f"body_{k}", inertia) for k in range(3)]
    plant.Finalize()
    context, expected = plant.CreateDefaultContext(), plant.CreateDefaultContext()
    generator = np.random.default_rng(6)
    for body in bodies:
        pose = generator.normal(size=7)
        pose[:4] /= np.linalg.norm(pose[:4])
        plant.SetFreeBodyPose(expected, body, RigidTransform(Quaternion(pose[:4]), pose[4:]))
    plant.SetVelocities(expected, generator.normal(size=18))
    PortState(plant, plant.get_state_output_port()).show(
        context, plant.get_state_output_port().Eval(expected)
    )
    for get in (plant.GetPositions, plant.GetVelocities):
        np.testing.assert_allclose(get(context), get(expected), rtol=0, atol=1e-12)


@pytest.mark.parametrize("angles", np.random.default_rng(7).uniform(-1.2, 1.2, (4, 3)).tolist())
def test_angles_are_found_that_show_a_quaternion(angles):
    system = Shown(lambda x: RollPitchYaw(x).ToQuaternion().wxyz(), 3, np.zeros(3), continuous=3)
    shown, context = port_state(system)
    shown.show(context, RollPitchYaw(angles).ToQuaternion().wxyz())
    np.testing.assert_allclose(state_values(context), angles, rtol=0, atol=1e-9)


def test_a_value_that_cannot_be_shown_leaves_one_that_is_close():
    shown, context = port_state(Shown(lambda x: np.clip(x, -1, 1), 3, np.zeros(3), continuous=3))
    shown.show(context, np.array([0.5, 2.0, -0.5]))
    np.testing.assert_allclose(np.clip(state_values(context), -1, 1), [0.5, 1.0, -0.5], atol=0.6)


@pytest.mark.parametrize(
    "kind",
    [
        {"continuous": 6},
        {"period": 0.1},
        {"period": 0.02, "offset": 0.02},
        {"period": 0.05, "extra": 0.01},
        {"period": 0.02, "offset": 0.005, "extra": 0.07},
    ],
)
def test_the_rate_is_that_of_the_state_mapped_through_the_port(kind):
    generator = np.random.default_rng(8)
    matrix, velocity = generator.normal(size=(6, 6)), generator.normal(size=6)
    shown, context = port_state(Shown(lambda x: matrix @ x, 6, velocity, **kind))
    before = state_values(context)
    np.testing.assert_allclose(shown.rate(context), matrix @ velocity, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(state_values(context), before)
