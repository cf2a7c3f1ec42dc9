"""How far carriers and cables are apart."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from functools import cached_property
from itertools import combinations
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.obstacle_distances import Approach, closest_approach
from drake_nonstop.model.system import SystemParameters
from drake_nonstop.scenario.schema import Scenario

_MOST_DISTANCES = 2**13  # between two of many, at once: this bounds the memory
_PARTS, _REFINEMENTS = 8, 4  # of an interval between two steps, in search of a least distance
_STRIDE = 8  # steps between those whose distances tell which others may be less
_FIRST, _MOST = 64, 2**11  # intervals that are looked at before others are left out
_ROUNDING = 1e-13  # m, by which an interval has to be closer to be searched


class Spacing(ABC):
    """How close carriers and cables of a motion come, a run's or a planned one.

    Attributes:
        scenario: whose limits the motion is held against.
        time: of the steps (k,), s; between two of them all move along straight lines.
        load_positions: of the load's centre of mass at each step (k, 3), in W, m.
    """

    scenario: Scenario
    time: NDArray
    load_positions: NDArray

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
    def cable_points(self) -> NDArray:
        """Points that cables are straight between, from the load on, (points, k, n, 3), in W, m."""
        return np.stack([self.attachment_positions, self.carrier_positions])

    @cached_property
    def approaches(self) -> list[Approach]:
        """How near load, cables and carriers come to each obstacle, the worst first.

        The load is the frame between its attachments and its centre of mass.
        """
        if not self.scenario.obstacles:
            return []
        corners = np.concatenate([self.attachment_positions, self.load_positions[:, None]], axis=1)
        edges = corners[:, np.transpose(np.triu_indices(corners.shape[1], 1))]
        cables = np.stack([self.cable_points[:-1], self.cable_points[1:]], axis=-2)
        carriers = np.stack(2 * [self.carrier_positions], axis=-2)
        moved = {"load": edges[:, None], "cable": np.moveaxis(cables, 0, 2)}
        found = [
            closest_approach(kind, bodies, self.time, obstacle.name, obstacle.shape())
            for obstacle in self.scenario.obstacles
            for kind, bodies in (moved | {"carrier": carriers[:, :, None]}).items()
        ]
        return sorted(found, key=attrgetter("order"))

    def obstacle_distance(self, kind: str = "") -> float | None:
        """The least distance from an obstacle, of bodies of a kind, m; None: there are none."""
        return min((a.distance for a in self.approaches if kind in ("", a.kind)), default=None)

    @property
    def reach(self) -> float:
        """The distance of a carrier from the load, as `RunLimits` has it, m."""
        radii = np.linalg.norm(self.system.attachments, axis=1)
        return float(np.max(radii)) + float(np.max(self.system.cable_length))

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
    return closest_cables(positions, positions)  # of no length


def closest_cables(ends: NDArray, carriers: NDArray) -> NDArray:
    """The distance (k,) of the closest two straight cables from `ends` to `carriers`, m.

    Both (k, n, 3).
    """
    least = np.empty(len(ends))
    for start, one, other in _pairs(ends, carriers):
        found = segment_distances(*one, *other).min(axis=1)
        least[start : start + len(found)] = found
    return least


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
    return min(least_length(one - other) for _, (one,), (other,) in _pairs(positions))


def least_cable_distances(ends: NDArray, carriers: NDArray) -> NDArray:
    """The least distance (pairs,) of each two straight cables, m, at any time.

    The pairs are in the order of `itertools.combinations`.

    Args:
        ends: of the cables at the load at each step (k, n, 3), m; between two steps they move
            along straight lines.
        carriers: their other ends (k, n, 3), m, which do likewise.
    """
    pairs = np.array(np.triu_indices(ends.shape[1], 1))
    least = np.full(pairs.shape[1], np.inf)
    at_once = _STRIDE * max(2, _MOST_DISTANCES // max(1, len(least)))
    for start in range(0, max(1, len(ends) - 1), at_once):
        some = slice(start, start + at_once + 1)
        parts = [part[some].transpose(2, 0, 1) for part in (ends, carriers)]
        _lower_to_distances(least, _CablePairs(np.stack(parts, axis=1), pairs))
    return least


def segment_distances(a: NDArray, b: NDArray, c: NDArray, d: NDArray) -> NDArray:
    """Distances (…) between the segments from a to b and from c to d, (…, 3) each.

    The nearest points of the two lines are clamped to the segments, one after the other
    (C. Ericson, Real-Time Collision Detection, section 5.1.9).
    """
    return np.linalg.norm(_gaps(b - a, d - c, a - c), axis=-1)


def _gaps(u: NDArray, v: NDArray, w: NDArray) -> NDArray:
    """The shortest ways (…, 3) to segments along u from others along v, which begin w before."""
    uu, vv, uv = (u * u).sum(axis=-1), (v * v).sum(axis=-1), (u * v).sum(axis=-1)
    uw, vw = (u * w).sum(axis=-1), (v * w).sum(axis=-1)
    tiny = np.finfo(float).tiny
    determinant = uu * vv - uv * uv
    parallel = determinant <= 1e-12 * uu * vv
    on_first = np.where(parallel, 0.0, uv * vw - vv * uw) / np.where(parallel, 1.0, determinant)
    on_first = on_first.clip(0, 1)
    on_second = ((uv * on_first + vw) / (vv + tiny)).clip(0, 1)
    on_first = ((uv * on_second - uw) / (uu + tiny)).clip(0, 1)
    return w + on_first[..., None] * u - on_second[..., None] * v


def _pairs(*points: NDArray) -> Iterator[tuple[int, list[NDArray], list[NDArray]]]:
    """The points (k, n, 3) of the first and of the second of each pair, some steps at a time.

    With the first step. The last step of some is the first of the next.
    """
    steps, count = points[0].shape[:2]
    first, second = np.triu_indices(count, 1)
    at_once = max(2, _MOST_DISTANCES // max(1, len(first)))
    for start in range(0, max(1, steps - 1), at_once - 1):
        parts = [part[start : start + at_once].transpose(2, 0, 1) for part in points]
        one, other = (
            [part[..., which].transpose(1, 2, 0) for part in parts] for which in (first, second)
        )
        yield start, one, other


def laid_apart(vectors: NDArray) -> NDArray:
    """The same vectors (…, 3) with their components apart in memory: several times faster."""
    return np.moveaxis(np.moveaxis(vectors, -1, 0).copy(), 0, -1)


class _CablePairs(NamedTuple):
    """Pairs of straight cables that move."""

    components: NDArray  # (3, 2, k, n), of both ends of each cable at each step, m
    pairs: NDArray  # (2, m), the numbers of the first and the second cables

    def at(self, step: NDArray, pair: NDArray) -> list[NDArray]:
        """The ends a, b of the first and c, d of the second cable, of a pair at a step (…, 3)."""
        *parts, steps, count = self.components.shape
        points = self.components.reshape(*parts, steps * count)
        ends = [points.take(count * step + cable[pair], axis=-1) for cable in self.pairs]
        return [np.moveaxis(end, 0, -1) for both in ends for end in both.swapaxes(0, 1)]


def _lower_to_distances(least: NDArray, cables: _CablePairs) -> None:
    """Lowers `least` (m,) to the least distances of pairs of cables.

    No point of a cable moves farther than the farther-moving of its ends: that bounds a distance
    between every eighth step. Between two steps the ends move along straight lines: the gap between
    two cables along any one direction, which is at most their distance, is least at a step.
    """
    last = cables.components.shape[2] - 1
    marks = np.append(np.arange(0, last, _STRIDE), last)
    block, pair = np.indices((len(marks), len(least)))
    distances = segment_distances(*cables.at(marks[block], pair))
    np.minimum(least, distances.min(axis=0), out=least)
    if last == 0:
        return
    steps = np.linalg.norm(np.diff(cables.components, axis=2), axis=0).max(axis=0)
    ways = np.add.reduceat(steps, marks[:-1])[:, cables.pairs].sum(axis=1)
    bounds = (distances[:-1] + distances[1:] - ways) / 2
    pairs, begins = pair[:-1].ravel(), marks[block[:-1]].ravel()
    for chosen in _lowest_first(bounds.ravel(), pairs, least):
        step = np.minimum(begins[chosen] + np.arange(_STRIDE + 1)[:, None], last)
        bounds = _lower_to_steps(least, cables.at(step, pairs[chosen]), pairs[chosen])
        step, pair = step[:-1].ravel(), np.tile(pairs[chosen], _STRIDE)
        for closest in _lowest_first(bounds.ravel(), pair, least):
            between = np.minimum([step[closest], step[closest] + 1], last)
            _lower_between(least, cables.at(between, pair[closest]), pair[closest])


def _lowest_first(bounds: NDArray, pairs: NDArray, least: NDArray) -> Iterator[NDArray]:
    """The places of bounds below `least` of their pairs, which may change, some at a time."""
    places, count = np.argsort(bounds - least[pairs]), _FIRST
    while True:
        places = places[~(bounds[places].clip(0) >= least[pairs[places]] - _ROUNDING)]
        if len(places) == 0:
            return
        yield places[:count]
        places, count = places[count:], min(4 * count, _MOST)


def _lower_to_steps(least: NDArray, ends: list[NDArray], pair: NDArray) -> NDArray:
    """Lowers `least` to the distances of pairs (m,) at k steps, with bounds (k - 1, m) between.

    The `ends` are (k, m, 3) each.
    """
    a, b, c, d = ends
    u, v, w = b - a, d - c, a - c
    gaps = _gaps(u, v, w)
    np.minimum.at(least, pair, np.linalg.norm(gaps, axis=-1).min(axis=0))
    direction = gaps[:-1] + gaps[1:]  # about that of the shortest way between two steps
    apart = []
    for k in (slice(None, -1), slice(1, None)):
        along_u, along_v, along_w = ((direction * part[k]).sum(axis=-1) for part in (u, v, w))
        apart.append(along_w + np.minimum(along_u, 0) - np.maximum(along_v, 0))
    lengths = np.linalg.norm(direction, axis=-1)
    return np.minimum(*apart) / np.maximum(lengths, np.finfo(float).tiny)


def _lower_between(least: NDArray, ends: list[NDArray], pair: NDArray) -> None:
    """Lowers `least` to the distances of pairs (m,) between two steps, with `ends` (2, m, 3)."""
    starts, stops = np.array(ends).swapaxes(0, 1)
    starts, changes = laid_apart(starts), laid_apart(stops - starts)
    low, width, parts = np.zeros(len(pair)), 1.0, np.arange(_PARTS + 1)[:, None] / _PARTS
    for _ in range(_REFINEMENTS):  # about the nearest of some instants in each interval
        shares = (low + width * parts).clip(0, 1)
        between = starts[:, None] + shares[..., None] * changes[:, None]
        found = segment_distances(*between)
        np.minimum.at(least, pair, found.min(axis=0))
        nearest = shares[np.argmin(found, axis=0), np.arange(len(pair))]
        low, width = nearest - width / _PARTS, 2 * width / _PARTS
