"""The exact orbits above a load that rests or turns steadily."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers import INERTIA, SHAPES, regular, resting_orbits

from drake_nonstop.mechanics.grasp import grasp_matrix
from drake_nonstop.mechanics.internal_force import even_phases, hamiltonian_cycle, spread
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.model.pattern import InternalForcePattern

LOAD = RigidLoad(mass=1.3, inertia=INERTIA, drag=0.7, angular_drag=0.2, gravity=9.81)
YAW_RATE = 0.8
WIND = np.array([0.9, -0.4, 0.2])
COMPLIANCE = 0.01
POSE = np.array([0.9, 0.3, -0.2, 0.4, 1.0, -2.0, 3.0])


def orbits(attachments, times, *, load=LOAD, pose=POSE, wind=WIND, **others):
    cables = {
        "basis": hamiltonian_cycle(attachments),
        "phases": even_phases(len(attachments)),
        "offset": 2.0 * spread(attachments),
    }
    made = SimpleNamespace(
        load=load,
        attachments=attachments,
        pseudo_inverse=np.linalg.pinv(grasp_matrix(attachments)),
        cable_length=2.0,
        cable_compliance=COMPLIANCE,
        pattern=InternalForcePattern(**(cables | others)),
    )
    parameters = np.array([1.7, 1.2])
    return resting_orbits(made, pose, times, parameters, yaw_rate=YAW_RATE, load_wind=wind)


@pytest.mark.parametrize("name", ["regular-4", "irregular-3", "spatial-5"])
def test_velocities_and_accelerations_are_the_rates_of_positions(name, rng):
    step = 2e-4
    times = rng.uniform(0, 20, 12)
    found = orbits(SHAPES[name], times)
    earlier, later = (orbits(SHAPES[name], times + shift) for shift in (-step, step))
    for rate, shown in (("velocities", "positions"), ("accelerations", "velocities")):
        difference = (getattr(later, shown) - getattr(earlier, shown)) / (2 * step)
        np.testing.assert_allclose(getattr(found, rate), difference, rtol=1e-5, atol=2e-5)


def test_the_cables_hold_the_turning_load_in_the_wind():
    """Newton and Euler in W: the load does not accelerate, and turns about the vertical."""
    times = np.linspace(0, 7, 9)
    found = orbits(SHAPES["spatial-5"], times)
    np.testing.assert_allclose(
        found.cable_forces.sum(axis=1),
        np.tile([0, 0, 1.3 * 9.81] - 0.7 * WIND, (9, 1)),
        atol=1e-12,
    )
    omega = np.array([0, 0, YAW_RATE])
    levers = found.cable_ends - POSE[4:]
    torques = np.cross(levers, found.cable_forces).sum(axis=1)
    for time, torque in zip(times, torques, strict=True):
        c, s = np.cos(YAW_RATE * time), np.sin(YAW_RATE * time)
        R_WL = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ rotation_matrix(POSE[:4])
        inertia = R_WL @ INERTIA @ R_WL.T
        wanted = np.cross(omega, inertia @ omega) + 0.2 * omega
        np.testing.assert_allclose(torque, wanted, atol=1e-12)


def test_cables_are_stretched_along_their_forces():
    found = orbits(SHAPES["irregular-4"], np.linspace(0, 3, 5))
    tensions = np.linalg.norm(found.cable_forces, axis=-1, keepdims=True)
    np.testing.assert_allclose(
        found.positions - found.cable_ends,
        (2.0 + COMPLIANCE * tensions) * found.cable_forces / tensions,
        atol=1e-12,
    )


def test_above_a_turning_load_constant_forces_are_level_circles():
    """Of the radius R = b + L sin(theta), with tan(theta) = C / f0, at the load's rate."""
    outward, share = 3.0, 1.3 * 9.81 / 4
    found = orbits(
        regular(4),
        np.linspace(0, 5, 6),
        load=RigidLoad(mass=1.3, inertia=0.01 * np.eye(3), drag=0.7, gravity=9.81),
        pose=np.array([1.0, 0, 0, 0, 0, 0, 0]),
        wind=np.zeros(3),
        basis=np.zeros((12, 0)),
        phases=np.zeros(0),
        offset=outward * spread(regular(4)),
    )
    tension = np.hypot(outward, share)
    length = 2.0 + COMPLIANCE * tension
    radius = 0.75 + length * outward / tension
    np.testing.assert_allclose(found.positions[..., 2], length * share / tension)
    for vectors, size in (
        (found.positions[..., :2], radius),
        (found.velocities, YAW_RATE * radius),
        (found.accelerations, YAW_RATE**2 * radius),
    ):
        np.testing.assert_allclose(np.linalg.norm(vectors, axis=-1), size)
