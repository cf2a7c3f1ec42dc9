"""How far carriers and cables are apart."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.model.system import SystemParameters
from drake_nonstop.scenario.schema import Scenario

_MOST_DISTANCES = 2**13  # between two of many, at once: this bounds the memory
_PARTS, _REFINEMENTS = 8, 4  # of an interval between two steps, in search of a least distance


class Spacing(ABC):
    """How close carriers and cables of a motion come, a run's or a planned one.

    Attributes:
        scenario: whose limits the motion is held against.
    """

    scenario: Scenario

    @property
    @abstractmethod
    def system(self) -> SystemParameters:
        """The load, cables and carriers that move."""

    @property
    @abstractmethod
    def carrier_positions(self) -> NDArray:
        """At each step (k, n, 3), in W, m."""

    @property
    @abstractmethod
    def attachment_positions(self) -> NDArray:
        """Where the cables are attached to the load at each step (k, n, 3), in W, m."""

    @property
    def reach(self) -> float:
        """The distance of a carrier from the load, as `RunLimits` has it, m."""
        radii = np.linalg.norm(self.system.attachments, axis=1)
        return float(np.max(radii)) + self.system.cable_length

    @cached_property
    def carrier_separation(self) -> float:
        """The least distance of two carriers, m, also between two steps."""
        return least_carrier_distance(self.carrier_positions)

    @cached_property
    def cable_separations(self) -> NDArray:
        """The least distance of each two cables (pairs,), m, also between two steps."""
        return least_cable_distances(self.attachment_positions, self.carrier_positions)

    @cached_property
    def closest_cables_for_attachments(self) -> tuple[float, float]:
        """The two cables that come closest for where they are attached, m.

        Their least distance and the distance of their attachments, beyond which no two cables
        can be apart. Cables that are attached at one point are left out.
        """
        attachments = np.array(self.system.attachments)
        apart = np.array([np.linalg.norm(a - b) for a, b in combinations(attachments, 2)])
        shares = np.divide(
            self.cable_separations, apart, out=np.full(len(apart), np.inf), where=apart > 0
        )
        closest = np.argmin(shares)
        return float(self.cable_separations[closest]), float(apart[closest])


def closest_carriers(positions: NDArray) -> NDArray:
    """The distance (k,) of the closest two of carriers at `positions` (k, n, 3), m."""
    return _least_of_pairs(_distances, positions)


def closest_cables(ends: NDArray, carriers: NDArray) -> NDArray:
    """The distance (k,) of the closest two straight cables from `ends` to `carriers`, m.

    Both (k, n, 3).
    """
    return _least_of_pairs(segment_distances, ends, carriers)


def least_length(vectors: NDArray) -> float:
    """The least length of vectors (k, …, 3), each of which changes linearly to the next."""
    starts, changes = vectors[:-1], np.diff(vectors, axis=0)
    squares = (changes * changes).sum(axis=-1)
    shares = -(starts * changes).sum(axis=-1) / np.where(squares > 0, squares, 1.0)
    nearest = starts + shares.clip(0, 1)[..., None] * changes
    return float(np.min(np.linalg.norm(np.concatenate([vectors, nearest]), axis=-1)))


def least_carrier_distance(positions: NDArray) -> float:
    """The least distance of any two carriers, m, at any time.

    Args:
        positions: at each step (k, n, 3), m; between two steps they move along straight lines.
    """
    return min(least_length(one - others) for _, _, (one,), (others,) in _pairs(positions))


def least_cable_distances(ends: NDArray, carriers: NDArray) -> NDArray:
    """The least distance (pairs,) of each two straight cables, m, at any time.

    The pairs are in the order of `itertools.combinations`.

    Args:
        ends: of the cables at the load at each step (k, n, 3), m; between two steps they move
            along straight lines.
        carriers: their other ends (k, n, 3), m, which do likewise.
    """
    count = ends.shape[1]
    least = np.full((count, count), np.inf)
    for _, i, (a, b), (c, d) in _pairs(ends, carriers):
        row = least[i, i + 1 :]
        row[:] = _least_segment_distances(a, b, c, d, row)
    return np.array([least[pair] for pair in combinations(range(count), 2)])


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
    gap = w + on_first[..., None] * u - on_second[..., None] * v
    return np.linalg.norm(gap, axis=-1)


def _distances(a: NDArray, b: NDArray) -> NDArray:
    return np.linalg.norm(a - b, axis=-1)


def _pairs(*points: NDArray) -> Iterator[tuple[int, int, list[NDArray], list[NDArray]]]:
    """The points (k, n, 3) of one (s, 1, 3) and of all that follow (s, m, 3), some steps at a time.

    With the first step and the number of the one. The last step of some is the first of the next.
    """
    steps, count = points[0].shape[:2]
    at_once = max(2, _MOST_DISTANCES // count)
    for start in range(0, max(1, steps - 1), at_once - 1):
        some = slice(start, start + at_once)
        parts = [_laid_apart(part[some]) for part in points]
        for i in range(count - 1):
            one = [part[:, i : i + 1] for part in parts]
            yield start, i, one, [part[:, i + 1 :] for part in parts]


def _laid_apart(vectors: NDArray) -> NDArray:
    """The same vectors (…, 3) with their components apart in memory: several times faster."""
    return np.moveaxis(np.moveaxis(vectors, -1, 0).copy(), 0, -1)


def _least_of_pairs(distances: Callable[..., NDArray], *points: NDArray) -> NDArray:
    """The least distance (k,) of any two of n, each with some `points` (k, n, 3)."""
    least = np.full(len(points[0]), np.inf)
    for start, _, one, others in _pairs(*points):
        found = distances(*one, *others).min(axis=1)
        some = least[start : start + len(found)]
        np.minimum(some, found, out=some)
    return least


def _least_segment_distances(
    a: NDArray, b: NDArray, c: NDArray, d: NDArray, known: NDArray
) -> NDArray:
    """The least distances (m,) of the segment from a to b (k, 1, 3) and m from c to d (k, m, 3).

    Each end changes linearly from step to step; `known` (m,) are distances that were reached.
    """
    distances = segment_distances(a, b, c, d)
    least = np.minimum(known, distances.min(axis=0))
    if len(a) < 2:
        return least
    travel = _largest_step(a, b) + _largest_step(c, d)
    interval, pair = np.nonzero((distances[:-1] + distances[1:] - travel) / 2 < least)
    if len(interval) == 0:
        return least
    one = np.stack([a, b])[:, :, 0]
    other = np.stack([c, d])
    starts = np.concatenate([one[:, interval], other[:, interval, pair]])
    ends = np.concatenate([one[:, interval + 1], other[:, interval + 1, pair]])
    starts, changes = _laid_apart(starts), _laid_apart(ends - starts)
    low, width = np.zeros(len(interval)), 1.0
    for _ in range(_REFINEMENTS):  # about the nearest of some instants in each interval
        shares = (low + width * np.linspace(0, 1, _PARTS + 1)[:, None]).clip(0, 1)
        between = starts[:, None] + shares[..., None] * changes[:, None]
        found = segment_distances(*between)
        np.minimum.at(least, pair, found.min(axis=0))
        nearest = np.take_along_axis(shares, np.argmin(found, axis=0)[None], axis=0)[0]
        low, width = nearest - width / _PARTS, 2 * width / _PARTS
    return least


def _largest_step(a: NDArray, b: NDArray) -> NDArray:
    """How far the farther-moving end of segments (k, m, 3) moves in each step (k - 1, m)."""
    return np.maximum(*(np.linalg.norm(np.diff(end, axis=0), axis=-1) for end in (a, b)))
