"""Rates of the desired cable forces, and of the carriers' positions, above a load that turns."""

import numpy as np
import pytest
from helpers import GAINS, INERTIA, SHAPES, difference
from numpy.polynomial import Polynomial
from pydrake.common.eigen_geometry import Quaternion

from drake_nonstop.mechanics.carrier import carrier_positions
from drake_nonstop.mechanics.grasp import cable_forces_and_rates, forces_along, grasp_matrix
from drake_nonstop.mechanics.internal_force import even_phases, hamiltonian_cycle, internal_force
from drake_nonstop.mechanics.load_motion import LoadMotion
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.wrench import wrench_and_rate

LOAD = RigidLoad(mass=1.3, inertia=INERTIA, drag=0.7, angular_drag=0.2, gravity=9.81)
WIND = np.array([3.0, -2.0, 0.5])  # m/s
PARAMETERS = np.array([1.7, 0.9])
AXIS = np.array([0.6, -0.48, 0.64])
TILT = np.array([0.9, 0.3, -0.2, 0.245])
ANGLE = Polynomial([0.3, 0.5, 0.2, 0.15])
WAYS = [
    Polynomial(way)
    for way in ([0.1, 0.3, -0.4, 0.3, 0.2], [0.2, -0.2, 0.1, -0.5, 0.1], [0, 0.4, 0.2, 0.2, -0.3])
]


def motion_at(time):
    """A reference with a constant snap and a constant angular jerk, about an axis, and these."""
    angle, *turns = [ANGLE.deriv(k)(time) if k else ANGLE(time) for k in range(4)]
    rates = [np.array([way.deriv(k)(time) if k else way(time) for way in WAYS]) for k in range(5)]
    about_axis = Quaternion(np.array([np.cos(angle / 2), *np.sin(angle / 2) * AXIS]))
    turned = about_axis.multiply(Quaternion(TILT / np.linalg.norm(TILT)))
    spin, spin_rate, angular_jerk = (turn * AXIS for turn in turns)
    reference = [turned.wxyz(), rates[0], spin, rates[1], spin_rate, rates[2], rates[3]]
    return np.concatenate(reference), np.concatenate([angular_jerk, rates[4]])


class Orbits:
    """Carriers above a load on its reference, at constant ξ and A."""

    def __init__(self, shape, compliance):
        attachments = SHAPES[shape]
        grasp = np.linalg.pinv(grasp_matrix(attachments))
        self.maps = {"pseudo_inverse": grasp, "basis": hamiltonian_cycle(attachments)}
        self.cables = {"rest_length": 0.8, "compliance": compliance, "attachments": attachments}
        self.phases = even_phases(len(attachments))
        self.offset = self.maps["basis"] @ np.linspace(0.3, -0.2, len(attachments))

    def internal(self, time):
        phase = np.array([PARAMETERS[0] * time])
        return internal_force(PARAMETERS, phase, phases=self.phases)

    def forces(self, time):
        """Those of the wrench controller, which has no error: the load is on its reference."""
        reference, _ = motion_at(time)
        wrenches = wrench_and_rate(
            LOAD, reference[:13], reference, np.zeros(6), WIND, **GAINS, feedforward=1.0
        )
        internal = np.concatenate(self.internal(time)[:2])
        offset = {"offset": self.offset}
        return cable_forces_and_rates(reference, *wrenches, internal, **self.maps, **offset)[0]

    def series(self, time):
        """The load's motion, and the forces in L."""
        motion = LoadMotion.along(*motion_at(time))
        rates = difference(self.forces, time)
        higher = np.concatenate(self.internal(time)[2:])
        forces = self.forces(time), rates, higher, WIND
        return motion, forces_along(LOAD, motion, *forces, **self.maps)

    def force_rates(self, time):
        motion, forces = self.series(time)
        return (forces @ motion.axes).rates

    def motion(self, time):
        return carrier_positions(*self.series(time), **self.cables).rates


@pytest.mark.parametrize("shape", ["regular-3", "irregular-4", "spatial-7"])
@pytest.mark.parametrize("compliance", [0.0, 0.02])
def test_each_rate_is_the_difference_of_the_one_below(shape, compliance):
    """Of the cable forces and of the carriers' positions; `motion_at` has all rates of the load."""
    orbits = Orbits(shape, compliance)
    for rates in (orbits.force_rates, orbits.motion):
        for time in (-0.4, 0.7):
            for order in (1, 2, 3):
                expected = difference(lambda t, k=order, f=rates: f(t)[k - 1], time)
                size = np.max(np.abs(expected))
                np.testing.assert_allclose(rates(time)[order], expected, rtol=0, atol=3e-9 * size)
