"""How far carriers and cables of a run are apart, and how near they come to obstacles."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.distances import nearest_over_time, segment_distances
from drake_nonstop.mechanics.rounded_box import RoundedBox, nearest_to


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
        """What is said of it."""
        how = "hit" if self.distance < 0 else f"came within {self.distance:.3g} m of"
        return f"{self.body} {how} {self.obstacle} at t = {self.time:.2f} s"


def closest_approach(
    kind: str, bodies: NDArray, times: NDArray, obstacle: str, box: RoundedBox
) -> Approach:
    """How near bodies come to an obstacle, see `nearest_over_time`.

    Args:
        kind: load, cable or carrier.
        bodies: segments of each body (k, bodies, segments, 2, 3), in W, m.
        times: (k,), s.
        obstacle: its name.
        box: where it is.
    """
    count, parts = bodies.shape[1:3]
    segments = bodies.reshape(len(times), -1, 2, 3)
    found = nearest_over_time(
        lambda ends: nearest_to(box, ends[:, 0])[0], segments, np.arange(count * parts)[:, None]
    )
    nearest, first = int(np.argmin(found.distances)), int(np.argmin(found.inside))
    step, at = found.steps[nearest], nearest
    if math.isfinite(found.inside[first]):
        step, at = found.inside[first], first
    body = f"{kind} {at // parts + 1}" if count > 1 else f"the {kind}"
    time = float(np.interp(step, np.arange(len(times)), times))
    return Approach(kind, obstacle, float(found.distances[nearest]), body, time)


def least_cable_distances(ends: NDArray, carriers: NDArray) -> NDArray:
    """The least distance (pairs,) of each two straight cables over k steps, m.

    The pairs are in the order of `itertools.combinations`.

    Args:
        ends: of the cables at the load at each step (k, n, 3), m.
        carriers: their other ends (k, n, 3), m.
    """
    pairs = np.transpose(np.triu_indices(ends.shape[1], 1))
    cables = np.stack([ends, carriers], axis=2)
    return nearest_over_time(
        lambda both: segment_distances(*both[:, 0].swapaxes(0, 1), *both[:, 1].swapaxes(0, 1)),
        cables,
        pairs,
    ).distances
