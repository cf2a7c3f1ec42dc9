import numpy as np
import pytest
from helpers import SHAPES, Motion, regular, rotation

from drake_nonstop.mechanics.carrier import (
    carrier_motion,
    double_integrator_rate,
    pid_forces,
)
from drake_nonstop.mechanics.grasp import cable_forces_and_rates, grasp_matrix
from drake_nonstop.mechanics.internal_force import (
    even_phases,
    hamiltonian_cycle,
    internal_force,
)

LENGTH = 0.8
UP = np.array([0.0, 0.0, 2.5])
STILL = np.array([1.0, *np.zeros(12)])


def orbits(n, amplitude, frequency, angles, compliance=0.0, load_state=STILL, weight=9.81):
    """Tensions (n,) and velocities (n, 3) over a level polygon, for each phase angle."""
    attachments = regular(n)
    for angle in angles:
        internal = internal_force(
            np.array([frequency, amplitude]), np.array([angle]), phases=even_phases(n)
        )
        forces, rates = cable_forces_and_rates(
            load_state,
            np.array([0, 0, 0, 0, 0, weight]),
            np.zeros(6),
            np.concatenate(internal[:2]),
            pseudo_inverse=np.linalg.pinv(grasp_matrix(attachments)),
            basis=hamiltonian_cycle(attachments),
            offset=np.zeros(3 * n),
        )
        _, velocities = carrier_motion(
            load_state,
            forces,
            rates,
            attachments=attachments,
            rest_length=LENGTH,
            compliance=compliance,
        )
        yield np.linalg.norm(forces, axis=1), velocities


ANGLES = np.linspace(0, 2 * np.pi, 25)


@pytest.mark.parametrize("compliance", [0.0, 1 / 500])
@pytest.mark.parametrize(("amplitude", "frequency"), [(1.2, 2.0), (3.0, 0.7)])
def test_speed_over_a_still_square_in_closed_form(amplitude, frequency, compliance):
    tension = np.hypot(amplitude, 9.81 / 4)
    speed = frequency * amplitude * (LENGTH + compliance * tension) / tension
    for tensions, velocities in orbits(4, amplitude, frequency, ANGLES, compliance):
        np.testing.assert_allclose(tensions, tension, rtol=1e-13)
        np.testing.assert_allclose(np.linalg.norm(velocities, axis=1), speed, rtol=1e-13)


@pytest.mark.parametrize("n", range(3, 10))
def test_speed_is_constant_over_still_regular_polygons(n):
    speeds = [np.linalg.norm(v, axis=1) for _, v in orbits(n, 1.2, 2.0, ANGLES)]
    np.testing.assert_allclose(speeds, speeds[0][0], rtol=1e-12)
    assert speeds[0][0] > 0.1


def test_load_velocity_adds_to_the_carriers():
    moving = np.array([1.0, *np.zeros(9), 0.3, -0.2, 0.1])
    pairs = zip(
        orbits(4, 1.2, 2.0, ANGLES), orbits(4, 1.2, 2.0, ANGLES, load_state=moving), strict=True
    )
    for (_, still), (_, carried) in pairs:
        np.testing.assert_allclose(carried - still, [[0.3, -0.2, 0.1]] * 4, rtol=0, atol=1e-14)


def moving_cables(shape, compliance):
    """The carriers' positions and velocities (n, 3) at a time, on smooth motions of all."""
    attachments = SHAPES[shape]
    load, pulls = Motion(9), [Motion(30 + i) for i in range(len(attachments))]

    def motion(t):
        return carrier_motion(
            load.reference(t),
            np.array([pull.state(t)[4:7] + UP for pull in pulls]),
            np.array([pull.state(t)[10:13] for pull in pulls]),
            attachments=attachments,
            rest_length=LENGTH,
            compliance=compliance,
        )

    return load, pulls, attachments, motion


@pytest.mark.parametrize("compliance", [0.0, 0.2])
def test_carriers_stand_a_stretched_cable_length_along_their_forces(compliance):
    load, pulls, attachments, motion = moving_cables("spatial-5", compliance)
    time = 0.7
    state = load.state(time)
    cables = motion(time)[0] - state[4:7] - attachments @ rotation(state[:4]).T
    forces = np.array([pull.state(time)[4:7] + UP for pull in pulls])
    tensions = np.linalg.norm(forces, axis=1)
    np.testing.assert_allclose(
        cables, (LENGTH / tensions + compliance)[:, None] * forces, rtol=0, atol=1e-14
    )


def test_pid_forces_in_closed_form():
    forces = pid_forces(
        np.array([0.5, 0, -1, 3, 0, -1]),
        np.array([0.1, 0.2, -0.3]),
        position_gain=10.0,
        velocity_gain=2.0,
        integral_gain=5.0,
    )
    np.testing.assert_allclose(forces, [5 + 6 + 0.5, 1, -10 - 2 - 1.5], rtol=1e-15)


def test_double_integrator_rate_in_closed_form():
    state = np.array([9.0, 9, 9, 9, 9, 9, 1, 2, 3, 4, 5, 6])
    rate = double_integrator_rate(state, np.array([2.0, 4, 6, -2, -4, -6]), mass=0.5)
    np.testing.assert_array_equal(rate, [1, 2, 3, 4, 5, 6, 4, 8, 12, -4, -8, -12])
