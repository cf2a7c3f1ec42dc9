"""Poses of the scene's objects: of bodies, cylinders between two points, and carriers."""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rotation import cross

SMALL = 1e-6  # m, m/s: a shorter vector has no direction


def stack_poses(rotations: NDArray, positions: NDArray) -> NDArray:
    """Poses (k, 4, 4) of rotation matrices (k, 3, 3), or one for all, and positions (k, 3)."""
    poses = np.zeros((len(positions), 4, 4))
    poses[:, :3, :3] = rotations
    poses[:, :3, 3] = positions
    poses[:, 3, 3] = 1.0
    return poses


def cylinder_poses(starts: NDArray, ends: NDArray) -> tuple[NDArray, NDArray]:
    """Poses (k, 4, 4) of cylinders (along z) between points (k, 3) in m, and lengths (k,) in m.

    A length is never below `SMALL`.
    """
    axes = unit_vectors(ends - starts, otherwise=np.array([0.0, 0.0, 1.0]))
    lengths = np.maximum(np.sqrt(((ends - starts) ** 2).sum(axis=1)), SMALL)
    sides = _perpendiculars(axes)
    rotations = np.stack([sides, cross(axes, sides), axes], axis=2)
    return stack_poses(rotations, (starts + ends) / 2), lengths


def attitudes(headings: NDArray, up: NDArray) -> NDArray:
    """Rotation matrices (k, 3, 3) with x along unit vectors `headings` and z towards `up`."""
    across = up - (up * headings).sum(axis=1, keepdims=True) * headings
    tops = unit_vectors(across, otherwise=_perpendiculars(headings))
    return np.stack([headings, cross(tops, headings), tops], axis=2)


def aircraft_attitudes(air_velocities: NDArray, bank: NDArray, angle_of_attack: NDArray) -> NDArray:
    """Rotation matrices (k, 3, 3) of aircraft in coordinated flight: nose, left wing, top.

    Args:
        air_velocities: (k, 3), m/s, to the air. One without a direction flies along x of W.
        bank: (k,), rad, of the lift about the air velocity, to the right.
        angle_of_attack: (k,), rad, of the nose above the air velocity.
    """
    ahead = unit_vectors(air_velocities, otherwise=np.array([1.0, 0.0, 0.0]))
    level = attitudes(ahead, up=np.broadcast_to([0.0, 0.0, 1.0], ahead.shape))
    left, above = level[..., 1], level[..., 2]
    lift = np.cos(bank)[:, None] * above - np.sin(bank)[:, None] * left
    pitch = angle_of_attack[:, None]
    nose = np.cos(pitch) * ahead + np.sin(pitch) * lift
    return attitudes(nose, up=np.cos(pitch) * lift - np.sin(pitch) * ahead)


def unit_vectors(vectors: NDArray, *, otherwise: NDArray) -> NDArray:
    """Unit vectors (k, 3) along `vectors`, or `otherwise` where these are not above `SMALL`."""
    lengths = np.sqrt((vectors**2).sum(axis=1, keepdims=True))
    return np.where(lengths > SMALL, vectors / np.maximum(lengths, SMALL), otherwise)


def _perpendiculars(axes: NDArray) -> NDArray:
    """A unit vector perpendicular to each of some unit vectors (k, 3)."""
    others = np.where(np.abs(axes[:, :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    return unit_vectors(cross(others, axes), otherwise=others)
