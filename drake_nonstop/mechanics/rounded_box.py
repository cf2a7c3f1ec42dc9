"""Signed distances of segments from a rounded box: a sphere, a box, or all below a plane."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_ROUNDING = 1e-12  # of a segment's length and place, by which its ends may be misplaced


class RoundedBox(NamedTuple):
    """All points within a radius of a box; one without size is a sphere's centre."""

    position: NDArray  # (3,), of the box's frame O, in W, m
    rotation: NDArray  # R_WO (3, 3)
    lower: NDArray  # (3,), of the box, in O, m; may be -inf
    upper: NDArray  # (3,), likewise; may be inf
    radius: float = 0.0  # m


class Nearest(NamedTuple):
    """How near segments are to an obstacle."""

    distances: NDArray  # (…), m; negative inside
    points: NDArray  # (…, 3), the nearest of each segment, in W, m
    normals: NDArray  # (…, 3), gradients of the distance there, in W; zero inside


def nearest_to(box: RoundedBox, segments: NDArray) -> Nearest:
    """How near segments (…, 2, 3), in W, m, come to a rounded box.

    The squared distance from the box along a segment is convex and made of parabolas, which meet
    where the segment crosses planes of the box's faces: its slope is linear from one of these to
    the next, and zero at the nearest point. Of a segment that goes through the box it is the middle
    of what is inside, at least half as deep as the deepest.
    """
    starts = (segments[..., 0, :] - box.position) @ box.rotation
    ways = (segments[..., 1, :] - segments[..., 0, :]) @ box.rotation
    lower, upper = box.lower, box.upper
    lengths, far = np.linalg.norm(ways, axis=-1), np.linalg.norm(starts, axis=-1)
    rounding = (_ROUNDING * lengths * (lengths + far))[..., None]

    def slopes(shares: NDArray) -> NDArray:
        at = starts[..., None, :] + shares[..., None] * ways[..., None, :]
        beyond = np.maximum(at - upper, 0) - np.maximum(lower - at, 0)
        slope = (beyond * ways[..., None, :]).sum(axis=-1)
        return np.where(np.abs(slope) > rounding, slope, 0.0)

    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = np.concatenate([(lower - starts) / ways, (upper - starts) / ways], axis=-1)
    crossings = np.nan_to_num(crossings, nan=0.0).clip(0, 1)
    slope = slopes(crossings)
    bounds = np.stack(
        [
            np.where(slope <= 0, crossings, 0.0).max(axis=-1),
            np.where(slope >= 0, crossings, 1.0).min(axis=-1),
        ],
        axis=-1,
    )
    slope = slopes(bounds)
    rise = slope[..., 1] - slope[..., 0]
    share = np.where(rise == 0, 0.5, -slope[..., 0] / np.where(rise == 0, 1.0, rise))
    share = bounds[..., 0] + share.clip(0, 1) * (bounds[..., 1] - bounds[..., 0])
    points = starts + share[..., None] * ways
    gaps = np.maximum(points - upper, lower - points)  # negative between two faces
    beyond = np.maximum(points - upper, 0) - np.maximum(lower - points, 0)
    outside = np.linalg.norm(beyond, axis=-1)
    normals = beyond / np.where(outside == 0, 1.0, outside)[..., None]
    return Nearest(
        distances=np.where(outside > 0, outside, gaps.max(axis=-1)) - box.radius,
        points=points @ box.rotation.T + box.position,
        normals=normals @ box.rotation.T,
    )
