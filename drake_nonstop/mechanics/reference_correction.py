"""References of carriers that are moved and turned against the load's measured error."""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rotation import cross, quaternion_product, rotation_matrix
from drake_nonstop.mechanics.signals import LoadReference

CORRECTION_SIZE = 6  # [rotation; shift], rad, in L, and m, in W
_LEVEL, _UPRIGHT = np.array([1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])


def corrected_reference(
    reference: NDArray, correction: NDArray, correction_rate: NDArray
) -> NDArray:
    """The reference (22,) that a formation hangs on: turned about the vertical, and shifted.

    The correction (6,) is a rotation, whose last entry is the turn, and a shift, in W; its rate
    has those of both.
    """
    desired = LoadReference.view(reference)
    turn = _yaw(correction)
    axes, yaw_rate = rotation_matrix(turn).T, _UPRIGHT * correction_rate[:3]
    return np.concatenate(
        [
            quaternion_product(turn, desired.quaternion),
            desired.position + correction[3:],
            desired.angular_velocity @ axes + yaw_rate,
            desired.velocity + correction_rate[3:],
            desired.angular_acceleration @ axes,
            desired.acceleration,
            desired.jerk,
        ]
    )


def corrected_forces(
    forces: NDArray, rates: NDArray, correction: NDArray, correction_rate: NDArray
) -> tuple[NDArray, NDArray]:
    """Cable forces (n, 3), in W, that are turned with the formation, of the same sum; their rates.

    What turning takes from their sum is shared by all.
    """
    axes = rotation_matrix(_yaw(correction)).T

    def turned(vectors: NDArray, turning: NDArray | float = 0.0) -> NDArray:
        found: NDArray = vectors @ axes + turning
        return found + (vectors - found).sum(axis=0) / len(vectors)

    found = turned(forces)
    return found, turned(rates, cross(_UPRIGHT * correction_rate[:3], found))


def corrected_attachments(attachments: NDArray, correction: NDArray) -> NDArray:
    """Where cables end (n, 3), m, in L, that tilt a load by a correction (6,)."""
    turn = np.concatenate([np.ones(1), _LEVEL * correction[:3] / 2])
    found: NDArray = attachments @ rotation_matrix(turn).T
    return found


def _yaw(correction: NDArray) -> NDArray:
    """The quaternion (4,), of any norm, of a correction's turn about the vertical."""
    return np.concatenate([np.ones(1), _UPRIGHT * correction[:3] / 2])
