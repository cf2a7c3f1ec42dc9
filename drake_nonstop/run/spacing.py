"""How far carriers and cables of a run are apart, and how near they come to obstacles."""

import math
from abc import ABC, abstractmethod
from functools import cached_property
from itertools import combinations
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.distances import least_length, nearest_over_time, segment_distances
from drake_nonstop.mechanics.rounded_box import RoundedBox, nearest_to
from drake_nonstop.model.system import SystemParameters
from drake_nonstop.scenario.schema import Scenario


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


class Spacing(ABC):
    """How close load, carriers and cables of a run come to each other and to obstacles.

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
        positions = self.carrier_positions
        pairs = combinations(range(positions.shape[1]), 2)
        return min(least_length(positions[:, i] - positions[:, j]) for i, j in pairs)

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
