"""Rotations: quaternions, roll-pitch-yaw angles and the vector products."""

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

    A bare entry of an object array is no array, and NumPy may not know what to do with it.
    """
    return [a[..., i : i + 1] for i in range(a.shape[-1])]


def skew(a: NDArray) -> NDArray:
    """S(a), the (3, 3) matrix with S(a) b = a × b."""
    return cross(a, np.eye(3)).T


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


def quaternion_rate(quaternion: NDArray, angular_velocity: NDArray) -> NDArray:
    """q̇ (4,) = ½ (0, ω) ⊗ q, with the angular velocity (3,) in the world frame."""
    scalar, vector = quaternion[:1], quaternion[1:]
    return (
        np.concatenate(
            [
                -(angular_velocity * vector).sum(keepdims=True),
                scalar * angular_velocity + cross(angular_velocity, vector),
            ]
        )
        / 2
    )


def rotate_quaternion(quaternion: NDArray, rotation: NDArray) -> NDArray:
    """The quaternion (4,) of an attitude that is turned by a rotation vector (3,) in W."""
    angle = np.sqrt((rotation * rotation).sum(keepdims=True) + 1e-300)
    scalar, vector = np.cos(angle / 2), rotation * (np.sin(angle / 2) / angle)
    q, p = quaternion[:1], quaternion[1:]
    return np.concatenate(
        [scalar * q - (vector * p).sum(keepdims=True), scalar * p + q * vector + cross(vector, p)]
    )


def roll_pitch_yaw_to_quaternion(roll_pitch_yaw: NDArray) -> NDArray:
    """The quaternion (4,) of R = R_z(yaw) R_y(pitch) R_x(roll), angles (3,) in rad."""
    half = roll_pitch_yaw / 2
    cr, cp, cy = components(np.cos(half))
    sr, sp, sy = components(np.sin(half))
    return np.concatenate(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def angular_motion(
    roll_pitch_yaw: NDArray, rate: NDArray, acceleration: NDArray
) -> tuple[NDArray, NDArray]:
    """Angular velocity and acceleration (3,), in W, of moving roll-pitch-yaw angles.

    ω = E ṙpy, whose columns are the axes about which roll, pitch and yaw turn, and
    ω̇ = E r̈py + Ė ṙpy. Own derivation.
    """
    _, cp, cy = components(np.cos(roll_pitch_yaw))
    _, sp, sy = components(np.sin(roll_pitch_yaw))
    roll_rate, pitch_rate, yaw_rate = components(rate)
    zero, one = 0 * cp, 0 * cp + 1
    roll_axis = np.concatenate([cy * cp, sy * cp, -sp])
    pitch_axis = np.concatenate([-sy, cy, zero])
    yaw_axis = np.concatenate([zero, zero, one])
    roll_axis_rate = np.concatenate(
        [
            -sy * cp * yaw_rate - cy * sp * pitch_rate,
            cy * cp * yaw_rate - sy * sp * pitch_rate,
            -cp * pitch_rate,
        ]
    )
    pitch_axis_rate = np.concatenate([-cy * yaw_rate, -sy * yaw_rate, zero])
    axes = np.stack([roll_axis, pitch_axis, yaw_axis], axis=1)
    return axes @ rate, (
        axes @ acceleration + roll_axis_rate * roll_rate + pitch_axis_rate * pitch_rate
    )
