"""Signed distances of segments from a rounded box: a sphere, a box, or all below a plane."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_HALVINGS = 26  # of a segment, in search of its nearest point


class RoundedBox(NamedTuple):
    """All points within a radius of a box; one without size is a sphere's centre."""

    position: NDArray  # (3,), of the box's centre, the origin of its frame O, in W, m
    half: NDArray  # (3,), half of its size, m; may be inf
    rotation: NDArray = np.eye(3)  # R_WO (3, 3)
    radius: float = 0.0  # m


def nearest_to(box: RoundedBox, segments: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """The signed distance (…), m, of the nearest or deepest point (…, 3) of segments (…, 2, 3).

    Then that point, and the distance's gradient there; all in W, m. A convex obstacle's signed
    distance is convex: along a segment its slope changes its sign once, which is found by halving.
    """
    starts = (segments[..., 0, :] - box.position) @ box.rotation
    ways = (segments[..., 1, :] - segments[..., 0, :]) @ box.rotation
    slopes = [(_distances(box, at)[1] * ways).sum(axis=-1) for at in (starts, starts + ways)]
    shares, part = np.where(slopes[0] >= 0, 0.0, 1.0), 0.5
    is_between = (slopes[0] < 0) & (slopes[1] > 0)
    inner, way, share = starts[is_between], ways[is_between], np.full((is_between.sum(), 1), 0.5)
    for _ in range(_HALVINGS if len(share) else 0):
        _, gradients = _distances(box, inner + share * way)
        part /= 2
        share -= part * np.sign((gradients * way).sum(axis=-1, keepdims=True))
    shares[is_between] = share[:, 0]
    points = starts + shares[..., None] * ways
    distances, gradients = _distances(box, points)
    return distances, points @ box.rotation.T + box.position, gradients @ box.rotation.T


def outline_in(box: RoundedBox, view: NDArray, count: int = 180) -> NDArray:
    """The outline (count, 2), m, in a parallel view with the page's directions (2, 3), unit ones.

    Of each direction on the page it has the farthest point.
    """
    angles = 2 * np.pi * np.arange(count) / count
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1) @ view
    farthest = np.copysign(box.half, ways @ box.rotation) @ box.rotation.T + box.radius * ways
    outline: NDArray = (box.position + farthest) @ view.T
    return outline


def _distances(box: RoundedBox, points: NDArray) -> tuple[NDArray, NDArray]:
    """Signed distances (…), m, of points (…, 3) in O, and their gradients; inside to a face."""
    gaps = np.abs(points) - box.half
    beyond, deepest = gaps.clip(0), gaps.max(axis=-1, keepdims=True)
    outside = np.sqrt((beyond * beyond).sum(axis=-1, keepdims=True))
    is_outside = outside > 0
    directions = np.where(is_outside, beyond / np.where(is_outside, outside, 1), gaps == deepest)
    distances = np.where(is_outside, outside, deepest)[..., 0] - box.radius
    return distances, np.copysign(directions, points)
