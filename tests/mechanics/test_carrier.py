import numpy as np
import pytest
from helpers import regular

from drake_nonstop.mechanics.carrier import (
    carrier_motion,
)
from drake_nonstop.mechanics.grasp import cable_forces_and_rates, grasp_matrix
from drake_nonstop.mechanics.internal_force import (
    even_phases,
    hamiltonian_cycle,
    internal_force,
)

LENGTH = 0.8
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
