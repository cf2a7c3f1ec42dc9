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
    require_ranges,
    vector,
)

_MOST = 100


def _check_name(field: str, value: Any) -> None:
    is_name = isinstance(value, str) and re.fullmatch(r"\w[\w .-]{0,49}", value)
    remedy = "name it with letters, digits, spaces, _, - and . only, 50 at most"
    require(is_name, field, value, remedy)


def _check_sizes(field: str, value: Any) -> None:
    for axis, size in enumerate(value):
        require_positive(f"{field}[{axis}]", size)


@dataclass(kw_only=True)
class SphereConfig(StrictFields):
    """A sphere."""

    name: str = checked("sphere", _check_name)  # in what is said of it
    position: list[float] = vector([0.0, 0.0, 0.0], "in m")  # m, of its centre
    radius: float = positive(1.0)  # m

    def shape(self) -> RoundedBox:
        """The sphere in W."""
        point = np.zeros(3)
        return RoundedBox(np.array(self.position), np.eye(3), point, point, self.radius)


@dataclass(kw_only=True)
class BoxConfig(StrictFields):
    """A box, such as a tower or a wall."""

    name: str = checked("box", _check_name)  # in what is said of it
    position: list[float] = vector([0.0, 0.0, 0.0], "in m")  # m, of its centre
    roll_pitch_yaw: list[float] = vector([0.0, 0.0, 0.0], "angles in rad")  # rad
    size: list[float] = vector([1.0, 1.0, 1.0], "in m", _check_sizes)  # m, along its axes

    def shape(self) -> RoundedBox:
        """The box in W."""
        rotation = rotation_matrix(roll_pitch_yaw_to_quaternion(np.array(self.roll_pitch_yaw)))
        half = np.array(self.size) / 2
        return RoundedBox(np.array(self.position), rotation, -half, half)


@dataclass(kw_only=True)
class GroundConfig(StrictFields):
    """The ground: all below a height."""

    name: str = checked("ground", _check_name)  # in what is said of it
    height: float = fulfilling(0.0, math.isfinite, "give a finite number, a height in m")  # m

    def shape(self) -> RoundedBox:
        """The half space in W."""
        upper = np.array([np.inf, np.inf, 0.0])
        height = np.array([0.0, 0.0, self.height])
        return RoundedBox(height, np.eye(3), np.full(3, -np.inf), upper)


Obstacle = SphereConfig | BoxConfig | GroundConfig
OBSTACLES = (SphereConfig, BoxConfig, GroundConfig)


def require_obstacles(field: str, obstacles: Sequence[Obstacle]) -> None:
    """Raises ScenarioError for obstacles out of range, too many, or two of one name."""
    require(len(obstacles) <= _MOST, field, f"{len(obstacles)} of them", f"give at most {_MOST}")
    names: set[str] = set()
    for k, obstacle in enumerate(obstacles):
        path = f"{field}[{k}]"
        is_one = isinstance(obstacle, OBSTACLES)
        require(is_one, path, obstacle, "give one of !Sphere, !Box and !Ground")
        require_ranges(path, obstacle)
        remedy = "give each obstacle a name of its own"
        require(obstacle.name not in names, f"{path}.name", obstacle.name, remedy)
        names.add(obstacle.name)
