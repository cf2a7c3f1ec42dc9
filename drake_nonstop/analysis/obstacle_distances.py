"""How near load, cables and carriers come to obstacles."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rounded_box import Nearest, RoundedBox, nearest_to

_AT_ONCE = 2**12  # segments that are looked at: this bounds the memory
_TOLERANCE = 1e-4  # m, and of a distance: to which the least one is found


class Bodies(NamedTuple):
    """Bodies of one kind that move, each made of as many segments."""

    kind: str  # load, cable or carrier
    segments: NDArray  # (k, bodies, segments, 2, 3), at each step, in W, m


class Instant(NamedTuple):
    """A body at an instant."""

    body: str
    time: float  # s


class Approach(NamedTuple):
    """How near the bodies of a kind come to an obstacle."""

    kind: str  # load, cable or carrier
    obstacle: str
    distance: float  # m, the least; negative inside
    nearest: Instant
    contact: Instant | None  # the first within the obstacle, at a step if any; None: there is none

    @property
    def order(self) -> tuple[float, float]:
        """By which the first contact comes first, and without any the nearest approach."""
        return math.inf if self.contact is None else self.contact.time, self.distance

    @property
    def text(self) -> str:
        """The sentence with the distance, such as "the load came within 0.3 m of tower at …"."""
        return self.sentence.format(f"{self.distance:.3g} m")

    @property
    def dictionary(self) -> dict[str, Any]:
        """The same for a JSON file."""
        return {
            "obstacle": self.obstacle,
            "nearest": self.nearest.body,
            "distance_min_m": self.distance,
            "distance_min_at_s": self.nearest.time,
            "contact": self.contact and self.contact.body,
            "contact_at_s": self.contact and self.contact.time,
        }

    @property
    def sentence(self) -> str:
        """What is said of it, with {} for the distance of what is still outside."""
        if self.contact is not None:
            return f"{self.contact.body} hit {self.obstacle} at t = {self.contact.time:.2f} s"
        body, time = self.nearest
        return f"{body} came within {{}} of {self.obstacle} at t = {time:.2f} s"


def closest_approach(obstacle: str, box: RoundedBox, bodies: Bodies, times: NDArray) -> Approach:
    """How near bodies come to an obstacle at times (k,), s, and between two of them.

    From one to the next the ends of their segments are taken to move along straight lines.
    """
    count, parts = bodies.segments.shape[1:3]
    segments = bodies.segments.reshape(len(times), count * parts, 2, 3)
    at_steps = _nearest(box, segments)

    def instant(step: float, segment: int) -> Instant:
        number = f"{bodies.kind} {segment // parts + 1}" if count > 1 else f"the {bodies.kind}"
        return Instant(number, float(np.interp(step, np.arange(len(times)), times)))

    distance, step, segment = _least(box, segments, at_steps)
    nearest, contact = instant(step, segment), None
    inside = np.argwhere(at_steps.distances < 0)
    if len(inside):
        contact = instant(*inside[0])
    elif distance < 0:
        contact = nearest
    return Approach(bodies.kind, obstacle, distance, nearest, contact)


def _least(box: RoundedBox, segments: NDArray, at_steps: Nearest) -> tuple[float, float, int]:
    """The least distance of segments (k, m, 2, 3), its step with a fraction, and the segment.

    Where a bound between two steps is below the least distance known, these are halved.
    """
    step, segment = np.unravel_index(np.argmin(at_steps.distances), at_steps.distances.shape)
    least = float(at_steps.distances[step, segment]), float(step), int(segment)
    before = [segments[:-1], *(values[:-1] for values in at_steps)]
    after = [segments[1:], *(values[1:] for values in at_steps)]
    begins, which = np.indices(before[1].shape)
    length = 1.0
    while True:
        tolerance = _TOLERANCE * (1 + abs(least[0]))
        is_open = _bounds(before, after) < least[0] - tolerance
        before, after = ([values[is_open] for values in part] for part in (before, after))
        begins, which = begins[is_open], which[is_open]
        if len(which) == 0:
            return least
        length /= 2
        halves = (before[0] + after[0]) / 2
        middle = [halves, *_nearest(box, halves)]
        k = int(np.argmin(middle[1]))
        least = min(least, (float(middle[1][k]), float(begins[k]) + length, int(which[k])))
        begins = np.concatenate([begins, begins + length])
        which = np.concatenate([which, which])
        before, after = (
            [np.concatenate(pair) for pair in zip(one, other, strict=True)]
            for one, other in ((before, middle), (middle, after))
        )


def _bounds(before: list[NDArray], after: list[NDArray]) -> NDArray:
    """Bounds below the distances on the way of segments from one instant to another.

    The distance from a convex obstacle is convex: it is nowhere below its tangent at the nearest
    point, which is linear in where it is asked for, and least at an end of the way. Besides, it
    changes by no more than the ends move. Inside, a deeper place is not asked for.
    """
    way = np.linalg.norm(after[0] - before[0], axis=-1).max(axis=-1)
    bounds = [(before[1] + after[1] - way) / 2]
    for (_, distances, points, normals), (ends, *_) in ((before, after), (after, before)):
        nearer = ((ends - points[..., None, :]) * normals[..., None, :]).sum(axis=-1).min(axis=-1)
        bounds.append(distances + np.where(distances < 0, 0, np.minimum(nearer, 0)))
    return np.max(bounds, axis=0)


def _nearest(box: RoundedBox, segments: NDArray) -> Nearest:
    """`nearest_to` of segments (k, …, 2, 3), some steps at a time."""
    at_once = max(1, _AT_ONCE // max(1, segments[0].size // 6))
    parts = [nearest_to(box, segments[k : k + at_once]) for k in range(0, len(segments), at_once)]
    return Nearest(*map(np.concatenate, zip(*parts, strict=True)))
