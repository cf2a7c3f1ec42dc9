"""How near load, cables and carriers come to obstacles."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rounded_box import RoundedBox, nearest_to

_AT_ONCE = 2**14  # segments that are looked at: this bounds the memory
_TOLERANCE = 1e-4  # m, and of a distance: to which the least one is found


class Approach(NamedTuple):
    """How near bodies of a kind come to an obstacle; `body` and `time` are where they hit it first.

    Where they do not hit it, these are where they are nearest.
    """

    kind: str  # load, cable or carrier
    obstacle: str
    distance: float  # m, the least; negative inside
    body: str
    time: float  # s

    @property
    def order(self) -> tuple[float, float]:
        """By which what is hit first comes first, and what is hit before what is near."""
        return self.time if self.distance < 0 else math.inf, self.distance

    @property
    def sentence(self) -> str:
        """What is said of it, with {} for the distance of what is not hit."""
        how = "hit" if self.distance < 0 else "came within {} of"
        return f"{self.body} {how} {self.obstacle} at t = {self.time:.2f} s"


def closest_approach(
    kind: str, bodies: NDArray, times: NDArray, obstacle: str, box: RoundedBox
) -> Approach:
    """How near bodies come to an obstacle at times (k,), s, and between two of them.

    There the ends of their segments are taken to move along straight lines. Where a bound on the
    distance between two instants is below the least one known, their middle is looked at, too. Of
    bodies that hit it the first is found at these times, if it is inside at any.

    Args:
        kind: load, cable or carrier.
        bodies: segments of each body (k, bodies, segments, 2, 3), in W, m.
        times: (k,), s.
        obstacle: its name.
        box: where it is.
    """
    count, parts = bodies.shape[1:3]
    points = bodies.reshape(len(times), -1, 2, 3)
    middles = points.mean(axis=2, keepdims=True).repeat(2, axis=2)
    around = np.linalg.norm(points - middles, axis=-1).max(axis=-1)
    around += np.linalg.norm(np.diff(points, axis=0, append=points[-1:]), axis=-1).max(axis=-1)
    coarse = nearest_to(box, middles)[0]
    begins, which = np.nonzero(coarse - around <= max(coarse.min(), 0.0))
    least, at, first, length = math.inf, (0.0, 0), None, 1.0
    while len(begins):
        ends = np.minimum(begins + length, len(times) - 1)
        before, after = (_at(points, steps, which) for steps in (begins, ends))
        found = [_nearest(box, segments) for segments in (before, after)]
        distances = found[0][0]
        k = int(np.argmin(distances))
        if distances[k] < least:
            least, at = float(distances[k]), (float(begins[k]), int(which[k]))
        if first is None and least < 0:  # in the order of the steps
            k = int(np.argmax(distances < 0))
            first = float(begins[k]), int(which[k])
        is_open = _bounds(before, after, found) < least - _TOLERANCE * (1 + abs(least))
        begins, which, length = begins[is_open], np.tile(which[is_open], 2), length / 2
        begins = np.concatenate([begins, begins + length])
    step, segment = first or at
    body = f"{kind} {segment // parts + 1}" if count > 1 else f"the {kind}"
    time = float(np.interp(step, np.arange(len(times)), times))
    return Approach(kind, obstacle, least, body, time)


def _at(points: NDArray, steps: NDArray, which: NDArray) -> NDArray:
    """Segments (j, 2, 3) at steps (j,), with a fraction for between two."""
    whole = np.minimum(steps.astype(int), len(points) - 2).clip(0)
    share = (steps - whole)[:, None, None]
    if not np.any(share):
        return points[whole, which]
    return (1 - share) * points[whole, which] + share * points[whole + 1, which]


def _nearest(box: RoundedBox, segments: NDArray) -> list[NDArray]:
    """`nearest_to` of segments (j, 2, 3), some at a time."""
    starts = range(0, len(segments), _AT_ONCE)
    found = [nearest_to(box, segments[start : start + _AT_ONCE]) for start in starts]
    return [*map(np.concatenate, zip(*found, strict=True))]


def _bounds(before: NDArray, after: NDArray, found: list[list[NDArray]]) -> NDArray:
    """Bounds (j,) below the distances of segments (j, 2, 3) on their way to others, m.

    The distance is convex: nowhere below its tangent at a nearest point, which is least at an end
    of the way. Besides, it changes by no more than the ends move.
    """
    way = np.linalg.norm(after - before, axis=-1).max(axis=-1)
    bounds = [(found[0][0] + found[1][0] - way) / 2]
    for (distances, points, gradients), others in zip(found, (after, before), strict=True):
        nearer = ((others - points[:, None]) * gradients[:, None]).sum(axis=-1).min(axis=-1)
        bounds.append(distances + np.minimum(nearer, 0))
    return np.max(bounds, axis=0)
