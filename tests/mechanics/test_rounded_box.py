"""Distances of segments from spheres, boxes and the ground, held against Drake's geometry."""

import numpy as np
import pytest
from pydrake.geometry import (
    Box,
    Capsule,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    HalfSpace,
    ProximityProperties,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix

from drake_nonstop.mechanics.rounded_box import nearest_to
from drake_nonstop.scenario.obstacles import BoxConfig, GroundConfig, SphereConfig
from drake_nonstop.view.bodies import cylinder_poses

THIN = 1e-3  # m, radius of a capsule that stands for a segment


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


def query_of(shape, pose, segments=()):
    """Drake's query object for a shape, the shape, and thin capsules in place of the segments."""
    graph = SceneGraph()
    source = graph.RegisterSource("test")

    def add(frame, shape, pose, name):
        instance = GeometryInstance(pose, shape, name)
        geometry = graph.RegisterGeometry(source, frame, instance)
        graph.AssignRole(source, geometry, ProximityProperties())
        return geometry

    solid = add(graph.world_frame_id(), shape, pose, "obstacle")
    frames, capsules = FramePoseVector(), []
    for k, segment in enumerate(segments):
        (place,), (length,) = cylinder_poses(*segment[:, None])
        frame = graph.RegisterFrame(source, GeometryFrame(f"{k}"))
        capsules.append(add(frame, Capsule(THIN, length), RigidTransform(), f"segment {k}"))
        rotation = RotationMatrix.ProjectToRotationMatrix(place[:3, :3])
        frames.set_value(frame, RigidTransform(rotation, place[:3, 3]))
    context = graph.CreateDefaultContext()
    graph.get_source_pose_port(source).FixValue(context, frames)
    query = graph.get_query_output_port().Eval(context)
    return query, solid, capsules, (graph, context)  # which it needs


@pytest.mark.parametrize("kind", [SphereConfig, BoxConfig])
def test_distances_are_those_of_drakes_capsules(kind):
    rng = np.random.default_rng(4)
    for _ in range(4):
        obstacle, shape, pose = drawn(kind, rng)
        segments = drawn_segments(rng, 60)
        query, solid, capsules, _ = query_of(shape, pose, segments)
        expected = THIN + np.array(
            [query.ComputeSignedDistancePairClosestPoints(solid, c).distance for c in capsules]
        )
        found = nearest_to(obstacle.shape(), segments)[0]
        apart = expected > 2 * THIN
        assert apart.sum() > 20
        assert np.all(found[~apart] < 2 * THIN)
        # Drake's iteration may end a little too far.
        assert np.all(found[apart] <= expected[apart] + 2e-6)
        np.testing.assert_allclose(found[apart], expected[apart], atol=1e-3)


@pytest.mark.parametrize("kind", [SphereConfig, BoxConfig, GroundConfig])
def test_no_point_of_a_segment_is_nearer_by_drakes_distances_of_points(kind):
    rng = np.random.default_rng(5)
    for _ in range(4):
        obstacle, shape, pose = drawn(kind, rng)
        segments = drawn_segments(rng, 60)
        query, *_ = query_of(shape, pose)
        distances, nearest_points, gradients = nearest_to(obstacle.shape(), segments)
        shares = np.linspace(0, 1, 101)[:, None]
        for k, (start, end) in enumerate(segments):
            points = [nearest_points[k], *(start + shares * (end - start))]
            nearest, *others = (query.ComputeSignedDistanceToPoint(p)[0] for p in points)
            assert nearest.distance == pytest.approx(distances[k], abs=1e-9)
            least = min(other.distance for other in others)
            assert nearest.distance <= least + 1e-9
            if nearest.distance > 1e-9:
                np.testing.assert_allclose(nearest.grad_W, gradients[k], atol=1e-6)
