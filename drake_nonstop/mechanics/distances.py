"""Distances of carriers, cables and obstacles, at instants and over time."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_AT_ONCE = 4096  # steps that are looked at together: this bounds the memory
_STRIDE = 8  # steps between those whose distances tell which others may be less
_PARTS, _REFINEMENTS = 8, 4  # of the time about the nearest step, in search of a least distance


def segment_distances(a: NDArray, b: NDArray, c: NDArray, d: NDArray) -> NDArray:
    """Distances (…) between the segments from a to b and from c to d, (…, 3) each.

    The nearest points of the two lines are clamped to the segments, one after the other
    (C. Ericson, Real-Time Collision Detection, section 5.1.9).
    """
    u, v, w = b - a, d - c, a - c
    uu, vv, uv = (u * u).sum(axis=-1), (v * v).sum(axis=-1), (u * v).sum(axis=-1)
    uw, vw = (u * w).sum(axis=-1), (v * w).sum(axis=-1)
    tiny = np.finfo(float).tiny
    determinant = uu * vv - uv * uv
    parallel = determinant <= 1e-12 * uu * vv
    on_first = np.where(parallel, 0.0, uv * vw - vv * uw) / np.where(parallel, 1.0, determinant)
    on_first = on_first.clip(0, 1)
    on_second = ((uv * on_first + vw) / (vv + tiny)).clip(0, 1)
    on_first = ((uv * on_second - uw) / (uu + tiny)).clip(0, 1)
    return np.linalg.norm(w + on_first[..., None] * u - on_second[..., None] * v, axis=-1)


def least_length(vectors: NDArray) -> float:
    """The least length of vectors (k, …, 3), each of which changes linearly to the next."""
    starts, changes = vectors[:-1], np.diff(vectors, axis=0)
    squares = (changes * changes).sum(axis=-1)
    shares = -(starts * changes).sum(axis=-1) / np.where(squares > 0, squares, 1.0)
    nearest = starts + shares.clip(0, 1)[..., None] * changes
    return float(np.min(np.linalg.norm(np.concatenate([vectors, nearest]), axis=-1)))


class Nearest(NamedTuple):
    """Where each of m groups of segments is nearest over time."""

    distances: NDArray  # (m,), m
    steps: NDArray  # (m,), when that is, with a fraction between two steps
    inside: NDArray  # (m,), the first step with a distance below zero; inf: there is none


def nearest_over_time(
    distance: Callable[[NDArray], NDArray], segments: NDArray, groups: NDArray
) -> Nearest:
    """Returns the least distances of groups of segments over k steps.

    They are sampled: at every eighth step, at the others where a bound by the speed of the ends
    allows a distance that is less than the least known one or inside, and finely about the
    nearest step of each group. Between two steps the ends are taken to move along straight lines.

    Args:
        distance: that of each of j groups of b segments (j, b, 2, 3), m.
        segments: the ends (k, s, 2, 3) of all segments at each step, m.
        groups: the numbers (m, b) of the segments in each group.
    """
    count = len(groups)
    least = Nearest(np.full(count, np.inf), np.zeros(count), np.full(count, np.inf))
    for start in range(0, max(1, len(segments) - 1), _AT_ONCE):
        some = segments[start : start + _AT_ONCE + 1]
        found = _nearest(distance, some, groups)
        is_less = found.distances < least.distances
        least = Nearest(
            np.where(is_less, found.distances, least.distances),
            np.where(is_less, start + found.steps, least.steps),
            np.minimum(least.inside, start + found.inside),
        )
    return least


def _nearest(distance: Callable[[NDArray], NDArray], segments: NDArray, groups: NDArray) -> Nearest:
    last, every = len(segments) - 1, np.arange(len(groups))
    marks = np.append(np.arange(0, last, _STRIDE), last)
    found = np.full((last + 1, len(groups)), np.inf)
    found[marks] = distance(
        segments[marks][:, groups].reshape(-1, *groups.shape[1:], 2, 3)
    ).reshape(len(marks), -1)
    if last > 0:
        moved = np.linalg.norm(np.diff(segments, axis=0), axis=-1).max(axis=-1)
        ways = np.add.reduceat(moved, marks[:-1])[:, groups].sum(axis=-1)
        bounds = (found[marks[:-1]] + found[marks[1:]] - ways) / 2
        block, group = np.nonzero(bounds <= np.maximum(found.min(axis=0), 0.0))
        steps = np.minimum(marks[block] + np.arange(1, _STRIDE)[:, None], last).ravel()
        group = np.tile(group, _STRIDE - 1)
        found[steps, group] = distance(segments[steps[:, None], groups[group]])
    nearest = found.argmin(axis=0).astype(float)
    least, width, parts = found.min(axis=0), 1.0, np.arange(-_PARTS, _PARTS + 1)[:, None] / _PARTS
    for _ in range(_REFINEMENTS):
        times = (nearest + width * parts).clip(0, last)
        before = np.minimum(times.astype(int), max(0, last - 1))
        share = (times - before)[..., None, None, None]
        ends = [segments[np.minimum(at, last)[..., None], groups] for at in (before, before + 1)]
        between = (1 - share) * ends[0] + share * ends[1]
        values = distance(between.reshape(-1, *between.shape[2:])).reshape(times.shape)
        best = values.argmin(axis=0)
        is_less = values[best, every] < least
        least = np.where(is_less, values[best, every], least)
        nearest, width = np.where(is_less, times[best, every], nearest), width / _PARTS
    is_inside = found < 0
    inside = np.where(is_inside.any(axis=0), is_inside.argmax(axis=0), np.inf)
    return Nearest(least, nearest, inside)
