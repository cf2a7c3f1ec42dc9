"""Estimates of a load's state: carried on in time, and corrected by a measurement."""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rotation import (
    norm,
    quaternion_conjugate,
    quaternion_product,
    rotate_quaternion,
)
from drake_nonstop.mechanics.signals import LoadState


def predicted_state(state: NDArray, elapsed: float | NDArray) -> NDArray:
    """The state (13,) after a time in s, with constant velocities in W."""
    quaternion, position, angular_velocity, velocity = LoadState.view(state)
    return np.concatenate(
        [
            rotate_quaternion(quaternion, elapsed * angular_velocity),
            position + elapsed * velocity,
            angular_velocity,
            velocity,
        ]
    )


def corrected_state(
    state: NDArray, measured: NDArray, rotation_gain: NDArray, translation_gain: NDArray
) -> NDArray:
    """An estimate (13,) after a measurement (13,) of the state.

    With gains K (2, 2) of [pose; rate], in units of 1, s and 1/s, x⁺ = x + K (y − x). The error of
    the attitude is that of a multiplicative filter, a rotation in W by
    [[sin φ]] = vee(R_y Rᵀ − R R_yᵀ)/2, φ for small angles, and q⁺ = exp(K …) ⊗ q. Lefferts, Markley
    and Shuster, "Kalman filtering for spacecraft attitude estimation", 1982.
    """
    quaternion, position, angular_velocity, velocity = LoadState.view(state)
    seen = LoadState.view(measured)
    unit = quaternion / norm(quaternion)
    turn = quaternion_product(seen.quaternion / norm(seen.quaternion), quaternion_conjugate(unit))
    rotation = 2 * turn[:1] * turn[1:]  # the same for ±q, and smooth
    turning = seen.angular_velocity - angular_velocity
    shift, speeding = seen.position - position, seen.velocity - velocity
    of_rotation, of_translation = rotation_gain.tolist(), translation_gain.tolist()
    return np.concatenate(
        [
            rotate_quaternion(unit, of_rotation[0][0] * rotation + of_rotation[0][1] * turning),
            position + of_translation[0][0] * shift + of_translation[0][1] * speeding,
            angular_velocity + of_rotation[1][0] * rotation + of_rotation[1][1] * turning,
            velocity + of_translation[1][0] * shift + of_translation[1][1] * speeding,
        ]
    )
