"""Obstacles of a scenario, which load, cables and carriers have to keep clear of."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from drake_nonstop.mechanics.rotation import roll_pitch_yaw_to_quaternion, rotation_matrix
from drake_nonstop.mechanics.rounded_box import RoundedBox
from drake_nonstop.validation import (
    StrictFields,
    checked,
    fulfilling,
    positive,
    require,
    require_positive,
    vector,
)

_MOST = 100
_DEPTH = 1e6  # m, of half the ground, at least


def _named(default: str) -> Any:
    def check(field: str, name: Any) -> None:
        remedy = "name it with letters, digits, spaces, _, - and . only, 50 at most"
        require(re.fullmatch(r"\w[\w .-]{0,49}", name), field, name, remedy)

    return checked(default, check)


def _check_sizes(field: str, sizes: Any) -> None:
    for size in sizes:
        require_positive(field, size)


@dataclass(kw_only=True)
class SphereConfig(StrictFields):
    """A sphere."""

    name: str = _named("sphere")  # in what is said of it
    position: list[float] = vector([0.0, 0.0, 0.0], "in m")  # m, of its centre
    radius: float = positive(1.0)  # m

    def shape(self) -> RoundedBox:
        """Where it is."""
        return RoundedBox(np.array(self.position), np.zeros(3), radius=self.radius)


@dataclass(kw_only=True)
class BoxConfig(StrictFields):
    """A box, such as a tower or a wall."""

    name: str = _named("box")  # in what is said of it
    position: list[float] = vector([0.0, 0.0, 0.0], "in m")  # m, of its centre
    roll_pitch_yaw: list[float] = vector([0.0, 0.0, 0.0], "angles in rad")  # rad, of its axes in W
    size: list[float] = vector([1.0, 1.0, 1.0], "in m", _check_sizes)  # m, along its axes

    def shape(self) -> RoundedBox:
        """Where it is."""
        rotation = rotation_matrix(roll_pitch_yaw_to_quaternion(np.array(self.roll_pitch_yaw)))
        return RoundedBox(np.array(self.position), np.array(self.size) / 2, rotation)


@dataclass(kw_only=True)
class GroundConfig(StrictFields):
    """The ground, level: all below a height."""

    name: str = _named("ground")  # in what is said of it
    height: float = fulfilling(0.0, math.isfinite, "give a finite number, a height in m")  # m

    def shape(self) -> RoundedBox:
        """Where it is."""
        half = max(_DEPTH, 2 * abs(self.height))  # also below all where the ground is high
        return RoundedBox(
            np.array([0.0, 0.0, self.height - half]), np.array([np.inf, np.inf, half])
        )


Obstacle = SphereConfig | BoxConfig | GroundConfig


def require_obstacles(field: str, obstacles: Sequence[Obstacle]) -> None:
    """Raises ScenarioError for too many obstacles, or two of one name."""
    require(len(obstacles) <= _MOST, field, f"{len(obstacles)} of them", f"give at most {_MOST}")
    names = [each.name for each in obstacles]
    for k, name in enumerate(names):
        is_new = name not in names[:k]
        require(is_new, f"{field}[{k}].name", name, "give each obstacle a name of its own")
