"""Second and third rates of the desired cable forces, and the carriers' jerk that follows."""

from itertools import pairwise

import numpy as np
import pytest
from helpers import GAINS, INERTIA, SHAPES, difference
from pydrake.common.eigen_geometry import Quaternion

from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.mechanics.grasp import (
    cable_forces_and_rates,
    grasp_matrix,
    second_and_third_force_rates,
)
from drake_nonstop.mechanics.internal_force import (
    even_phases,
    hamiltonian_cycle,
    internal_force,
)
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.wrench import wrench_and_rate

LOAD = RigidLoad(mass=1.3, inertia=INERTIA, drag=0.7, angular_drag=0.2, gravity=9.81)
WIND = np.array([3.0, -2.0, 0.5])  # m/s
PARAMETERS = np.array([1.7, 0.9])
AXIS = np.array([0.6, -0.48, 0.64])
TILT = np.array([0.9, 0.3, -0.2, 0.245])


def reference(time):
    """A motion without snap and angular jerk: a cubic, and a turn that speeds up about an axis."""
    angle, rate, second_rate = 0.3 + 0.5 * time + 0.2 * time**2, 0.5 + 0.4 * time, 0.4
    about_axis = Quaternion(np.array([np.cos(angle / 2), *np.sin(angle / 2) * AXIS]))
    turn = about_axis.multiply(Quaternion(TILT / np.linalg.norm(TILT)))
    powers = np.array([[1, time, time**2, time**3]] * 3)
    powers = [powers, 0 * powers, 0 * powers, 0 * powers]
    powers[1][:, 1:] = [1, 2 * time, 3 * time**2]
    powers[2][:, 2:] = [2, 6 * time]
    powers[3][:, 3:] = 6
    numbers = np.array([[0.1, 0.3, -0.4, 0.3], [0.2, -0.2, 0.1, -0.5], [0, 0.4, 0.2, 0.2]])
    position, velocity, acceleration, jerk = ((numbers * power).sum(axis=1) for power in powers)
    return np.concatenate(
        [
            *(turn.wxyz(), position, rate * AXIS, velocity),
            *(second_rate * AXIS, acceleration, jerk),
        ]
    )


class Orbits:
    """Carriers above a load on its reference, at constant ξ and A."""

    def __init__(self, shape, compliance=0.02):
        self.attachments = SHAPES[shape]
        self.pseudo_inverse = np.linalg.pinv(grasp_matrix(self.attachments))
        self.basis = hamiltonian_cycle(self.attachments)
        self.cables = {
            "attachments": self.attachments,
            "rest_length": 0.8,
            "compliance": compliance,
        }

    def internal_force(self, time):
        phase = np.array([PARAMETERS[0] * time])
        rates = internal_force(PARAMETERS, phase, phases=even_phases(len(self.attachments)))
        return np.concatenate(rates[:2]), np.concatenate(rates[2:])

    def forces(self, time):
        """f and ḟ, both exact: the load is on its reference."""
        wanted = reference(time)
        state = wanted[:13]
        wrenches = wrench_and_rate(LOAD, state, wanted, np.zeros(6), WIND, **GAINS, feedforward=1.0)
        return cable_forces_and_rates(
            state,
            *wrenches,
            self.internal_force(time)[0],
            pseudo_inverse=self.pseudo_inverse,
            basis=self.basis,
            offset=self.basis @ np.linspace(0.3, -0.2, len(self.attachments)),
        )

    def higher_rates(self, time):
        return second_and_third_force_rates(
            LOAD,
            reference(time),
            *self.forces(time),
            self.internal_force(time)[1],
            WIND,
            pseudo_inverse=self.pseudo_inverse,
            basis=self.basis,
        )

    def velocity(self, time):
        return carrier_motion(reference(time), *self.forces(time), **self.cables)[1]

    def acceleration(self, time):
        return self.motion(time)[2]

    def jerk(self, time):
        return self.motion(time)[3]

    def motion(self, time):
        forces = *self.forces(time), *self.higher_rates(time)
        return carrier_motion(reference(time), *forces, **self.cables)


shapes = pytest.mark.parametrize("shape", ["regular-3", "irregular-4", "spatial-7"])


@shapes
def test_the_rates_are_differences_of_those_below_them(shape):
    orbits = Orbits(shape)
    for time in (-0.4, 0.7):
        second, third = orbits.higher_rates(time)
        expected = difference(lambda t: orbits.forces(t)[1], time)
        np.testing.assert_allclose(second, expected, rtol=0, atol=1e-9)
        expected = difference(lambda t: orbits.higher_rates(t)[0], time)
        np.testing.assert_allclose(third, expected, rtol=0, atol=1e-9)


@shapes
@pytest.mark.parametrize("compliance", [0.0, 0.02])
def test_accelerations_and_jerks_are_differences_of_velocities(shape, compliance):
    orbits = Orbits(shape, compliance)
    for time in (-0.4, 0.7):
        expected = difference(orbits.velocity, time)
        np.testing.assert_allclose(orbits.acceleration(time), expected, rtol=0, atol=1e-8)
        expected = difference(orbits.acceleration, time)
        np.testing.assert_allclose(orbits.jerk(time), expected, rtol=0, atol=1e-8)


def test_the_reference_of_these_tests_is_a_motion_without_snap_and_angular_jerk():
    parts = [slice(4, 7), slice(10, 13), slice(16, 19), slice(19, 22)]
    for lower, upper in pairwise(parts):
        rate = difference(lambda t, lower=lower: reference(t)[lower], 0.5)
        np.testing.assert_allclose(reference(0.5)[upper], rate, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(reference(0.5)[[19, 20, 21, 13]], reference(1)[[19, 20, 21, 13]])
    np.testing.assert_allclose(
        difference(lambda t: reference(t)[7:10], 0.5), reference(0.5)[13:16], rtol=0, atol=1e-10
    )
