"""Poses where directions are parallel, opposite or undefined."""

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from drake_nonstop.view.bodies import attitudes, cylinder_poses, tube


def test_degenerate_poses():
    up = np.array([0.0, 0.0, 1.0])
    directions = np.array([up, -up, [1e-9, 0.0, -1.0], [1, 0, 0], [0, -1, 0]])
    poses, lengths = cylinder_poses(np.zeros((5, 3)), 60 * directions)
    for pose, length, direction in zip(poses, lengths, directions, strict=True):
        end = RigidTransform(pose) @ np.array([0, 0, length / 2])  # raises where it is no rotation
        np.testing.assert_allclose(end, 60 * direction, atol=1e-6)
    poses, lengths = cylinder_poses(up[None], up[None])
    assert lengths[0] > 0
    RigidTransform(poses[0])
    for heading in (up, np.array([1.0, 0, 0])):
        for tops in (heading, -heading, np.array([2e-6, 0, 60.0])):
            attitude = RotationMatrix(attitudes(heading[None], up=tops[None])[0])
            np.testing.assert_allclose(attitude.matrix()[:, 0], heading, atol=1e-9)


def test_a_tube_encloses_its_path(rng):
    path = np.cumsum(rng.normal(size=(6, 3)), axis=0)
    vertices, faces = tube(path, 0.1)
    bars = vertices.T.reshape(5, 2, 4, 3)
    ends = np.stack([path[:-1], path[1:]], axis=1)
    np.testing.assert_allclose(np.linalg.norm(bars - ends[:, :, None], axis=-1), 0.1)
    np.testing.assert_allclose(bars.mean(axis=2), ends, atol=1e-12)
    a, b, c = vertices.T[faces]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    np.testing.assert_allclose(area, 4 * np.sqrt(2) * 0.1 * length)
    assert np.isfinite(tube(path[:1], 0.1)[0]).all()
