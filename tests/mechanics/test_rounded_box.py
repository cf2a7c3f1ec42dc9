"""Distances of segments from spheres, boxes and the ground, held against Drake's geometry."""

import itertools

import numpy as np
import pytest
from pydrake.geometry import (
    Box,
    FramePoseVector,
    GeometryInstance,
    HalfSpace,
    ProximityProperties,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from drake_nonstop.mechanics.rounded_box import RoundedBox, nearest_to, outline_in
from drake_nonstop.scenario.obstacles import BoxConfig, GroundConfig, SphereConfig


def drawn(kind, rng):
    """An obstacle, and Drake's shape with its pose."""
    place = rng.uniform(-2, 2, 3)
    if kind is SphereConfig:
        radius = rng.uniform(0.1, 2)
        return SphereConfig(position=place, radius=radius), Sphere(radius), RigidTransform(place)
    if kind is GroundConfig:
        height = rng.uniform(-2, 2)
        return GroundConfig(height=height), HalfSpace(), RigidTransform([0, 0, height])
    size, angles = rng.uniform(0.1, 4, 3), rng.uniform(-np.pi, np.pi, 3)
    obstacle = BoxConfig(position=place, roll_pitch_yaw=angles, size=size)
    rotation = RotationMatrix(obstacle.shape().rotation)
    return obstacle, Box(*size), RigidTransform(rotation, place)


def drawn_segments(rng, count):
    middles = rng.uniform(-3, 3, (count, 1, 3))
    segments = middles + rng.normal(size=(count, 2, 3)) * rng.choice([0.1, 1, 5], (count, 1, 1))
    segments[:10, 1, :2] = segments[:10, 0, :2]  # some along an axis, some without a length
    segments[5:10, 1] = segments[5:10, 0]
    return segments


def query_of(shape, pose):
    """Drake's query object for a shape."""
    graph = SceneGraph()
    source = graph.RegisterSource("test")
    instance = GeometryInstance(pose, shape, "obstacle")
    geometry = graph.RegisterGeometry(source, graph.world_frame_id(), instance)
    graph.AssignRole(source, geometry, ProximityProperties())
    context = graph.CreateDefaultContext()
    graph.get_source_pose_port(source).FixValue(context, FramePoseVector())
    return graph.get_query_output_port().Eval(context), (graph, context)  # which it needs


@pytest.mark.parametrize("kind", [SphereConfig, BoxConfig, GroundConfig])
def test_no_point_of_a_segment_is_nearer_by_drakes_distances_of_points(kind):
    rng = np.random.default_rng(5)
    for _ in range(4):
        obstacle, shape, pose = drawn(kind, rng)
        segments = drawn_segments(rng, 60)
        query, _ = query_of(shape, pose)
        distances, nearest_points, gradients = nearest_to(obstacle.shape(), segments)
        shares = np.linspace(0, 1, 101)[:, None]
        for k, (start, end) in enumerate(segments):
            points = [nearest_points[k], *(start + shares * (end - start))]
            ways = [np.linalg.norm(nearest_points[k] - point) for point in (start, end)]
            assert sum(ways) == pytest.approx(np.linalg.norm(end - start), abs=1e-9)  # it is on it
            nearest, *others = (query.ComputeSignedDistanceToPoint(p)[0] for p in points)
            assert nearest.distance == pytest.approx(distances[k], abs=1e-9)
            assert nearest.distance <= min(other.distance for other in others) + 1e-9
            if nearest.distance > 1e-9:
                np.testing.assert_allclose(nearest.grad_W, gradients[k], atol=1e-6)


def test_an_outline_has_the_farthest_point_of_each_direction():
    view = RotationMatrix(RollPitchYaw([0.3, 0.2, 0.1])).matrix()[:2]
    turn = RotationMatrix(RollPitchYaw([1.0, -0.5, 2.0])).matrix()
    box = RoundedBox(np.array([1.0, 2.0, 3.0]), np.array([0.5, 1.0, 2.0]), turn, 0.3)
    corners = np.array([*itertools.product(*np.stack([-box.half, box.half], axis=1))])
    angles = 2 * np.pi * np.arange(12) / 12
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    farthest = (ways @ view @ (corners @ turn.T + box.position).T).max(axis=1) + box.radius
    np.testing.assert_allclose((outline_in(box, view, 12) * ways).sum(axis=1), farthest)
