"""Rotations: quaternions, roll-pitch-yaw angles, and the vector algebra that they need."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def cross(a: NDArray, b: NDArray) -> NDArray:
    """The vector product a × b over the last axis, for any scalar type.

    Arguments are (..., 3) and broadcast; the result is (..., 3). `np.cross` takes no
    symbols, and is about ten times slower on arrays this small.
    """
    ax, ay, az = components(a)
    bx, by, bz = components(b)
    return np.concatenate([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def components(a: NDArray) -> list[NDArray]:
    """The entries along the last axis, each still an array with a last axis of length 1.

    A bare entry of an object array is not an array, and NumPy's functions may fail on it.
    """
    return [a[..., i : i + 1] for i in range(a.shape[-1])]


def absolute(a: NDArray) -> NDArray:
    """|a| of each entry, for any scalar type.

    `np.abs` fails on the symbols of CasADi below 3.8, and `np.fabs` on pydrake's types.
    """
    if a.dtype == object and not hasattr(a.flat[0], "fabs"):
        return np.abs(a)
    return np.fabs(a)


def clipped(a: NDArray, limit: float | NDArray) -> NDArray:
    """The entries within ± the limit, for any scalar type."""
    return (absolute(a + limit) - absolute(a - limit)) / 2


def skew(a: NDArray) -> NDArray:
    """S(a) (..., 3, 3) of a (..., 3): the matrices with S(a) b = a × b."""
    return cross(a[..., None, :], np.eye(3)).swapaxes(-1, -2)


def vee(matrix: NDArray) -> NDArray:
    """The (3,) vector a of a skew-symmetric (3, 3) matrix S(a): the inverse of `skew`."""
    return np.concatenate([matrix[2, 1:2], matrix[0, 2:3], matrix[1, 0:1]])


def norm(a: NDArray) -> NDArray:
    """Euclidean norm over the last axis, kept as an axis of length 1: (..., 1)."""
    return np.sqrt((a * a).sum(axis=-1, keepdims=True))


def rotation_matrix(quaternion: NDArray) -> NDArray:
    """R (..., 3, 3) of a quaternion (..., 4), w x y z, which need not have unit norm.

    Dividing by the squared norm keeps R a rotation while an integrator lets the norm
    drift by rounding.
    """
    w, x, y, z = components(quaternion)
    s = 2 / (quaternion * quaternion).sum(axis=-1, keepdims=True)
    return np.concatenate(
        [
            *[1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
            *[s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
            *[s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
        ],
        axis=-1,
    ).reshape(*quaternion.shape[:-1], 3, 3)


def quaternion_product(a: NDArray, b: NDArray) -> NDArray:
    """The product a ⊗ b (..., 4) of quaternions w x y z, (..., 4) each, that broadcast."""
    a_scalar, a_vector = a[..., :1], a[..., 1:]
    b_scalar, b_vector = b[..., :1], b[..., 1:]
    return np.concatenate(
        [
            a_scalar * b_scalar - (a_vector * b_vector).sum(axis=-1, keepdims=True),
            a_scalar * b_vector + b_scalar * a_vector + cross(a_vector, b_vector),
        ],
        axis=-1,
    )


def quaternion_conjugate(quaternion: NDArray) -> NDArray:
    """The quaternion (..., 4), w x y z, of the inverse rotation, of the same norm."""
    return np.concatenate([quaternion[..., :1], -quaternion[..., 1:]], axis=-1)


def rotation_vector(quaternion: NDArray) -> NDArray:
    """The rotation vector (..., 3), rad, of quaternions (..., 4), w x y z, of any norm.

    Its norm is at most π. From q_1 to q_2 it is that of q_2 ⊗ q̄_1 in W, and that of q̄_1 ⊗ q_2 in
    the rotated frame. For floats only, since its sign depends on a comparison.
    """
    scalar, vector = quaternion[..., :1], quaternion[..., 1:]
    sine = norm(vector)
    angle = 2 * np.arctan2(sine, np.fabs(scalar))
    factor = np.where(sine > 0, angle / np.maximum(sine, 1e-300), 2.0)
    return np.where(scalar < 0, -vector, vector) * factor


def quaternion_rate(quaternion: NDArray, angular_velocity: NDArray) -> NDArray:
    """q̇ (..., 4) = ½ (0, ω) ⊗ q, with the angular velocity (..., 3) in the world frame."""
    scalar = 0 * angular_velocity[..., :1]
    return quaternion_product(np.concatenate([scalar, angular_velocity], axis=-1), quaternion) / 2


def rotate_quaternion(quaternion: NDArray, rotation: NDArray) -> NDArray:
    """The quaternion (..., 4) after one more rotation, by a rotation vector (..., 3) in W, rad."""
    angle = np.sqrt((rotation * rotation).sum(axis=-1, keepdims=True) + 1e-300)
    turn = [np.cos(angle / 2), rotation * (np.sin(angle / 2) / angle)]
    return quaternion_product(np.concatenate(turn, axis=-1), quaternion)


def roll_pitch_yaw_to_quaternion(roll_pitch_yaw: NDArray) -> NDArray:
    """The quaternion (..., 4) of R = R_z(yaw) R_y(pitch) R_x(roll), angles (..., 3) in rad."""
    half = roll_pitch_yaw / 2
    cr, cp, cy = components(np.cos(half))
    sr, sp, sy = components(np.sin(half))
    return np.concatenate(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


def angular_velocity_of(roll_pitch_yaw: Any) -> Any:
    """The series of the angular velocity (3,), in W, of a series of roll-pitch-yaw angles, rad.

    Roll's axis turns with yaw and pitch, and pitch's with yaw.
    """
    roll, pitch, yaw = components(roll_pitch_yaw.rate())
    (_, cp, cy), (_, sp, sy) = (components(f(roll_pitch_yaw)) for f in (np.cos, np.sin))
    level = cp * roll
    return np.concatenate([cy * level - sy * pitch, sy * level + cy * pitch, yaw - sp * roll])
