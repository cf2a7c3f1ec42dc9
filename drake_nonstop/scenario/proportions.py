"""What is out of proportion in a scenario: units that were mistaken, mostly."""

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.field_comments import meanings
from drake_nonstop.validation import warn_user


def _cable_length(scenario: Scenario) -> float:
    """In m."""
    return scenario.system.cable_length


def _width(scenario: Scenario) -> float:
    """The farthest attachment's distance from the load's centre of mass, m."""
    return float(np.max(np.linalg.norm(scenario.system.attachments, axis=1)))


def _radian_time(scenario: Scenario) -> float:
    """1/ξ, s."""
    return 1 / float(scenario.optimization_layer.frequency)


def _share(scenario: Scenario) -> float:
    """A cable's share of the load's weight, N."""
    system = scenario.system
    return system.load_mass * system.gravity / len(system.attachments)


def _amplitude(scenario: Scenario) -> float:
    """The amplitude at which a cable's internal force is as large as its share of the weight."""
    pattern = scenario.pattern.make(np.array(scenario.system.attachments))
    of_cables = np.linalg.norm(pattern.basis.reshape(-1, 3 * pattern.basis.shape[1]), axis=1)
    return _share(scenario) / float(np.max(of_cables))


def _one(scenario: Scenario) -> float:
    """A unit of its own."""
    return 1.0


class Proportion(NamedTuple):
    """A field, and the size that it is usually in proportion to."""

    field: str  # its path in the scenario
    size: Callable[[Scenario], float]  # what it is measured by, SI units
    of: str  # the same in words
    hint: str
    least: float = 0.0  # times that size, as is usual
    most: float = math.inf  # likewise


_WEIGHT = "a cable's share of the weight"

PROPORTIONS = (
    Proportion("control_period", _radian_time, "1/ξ", "in s: ms given?", most=0.6),
    Proportion("load_feedback.period", _radian_time, "1/ξ", "in s: ms given?", most=0.6),
    Proportion("load_feedback.delay", _radian_time, "1/ξ", "in s: ms given?", most=0.6),
    Proportion(
        "load_feedback.position_noise",
        _cable_length,
        "a cable's length",
        "in m: mm given?",
        most=0.1,
    ),
    Proportion(
        "load_feedback.orientation_noise", _one, "a radian", "in rad: degrees given?", most=0.3
    ),
    Proportion(
        "load_feedback.velocity_noise",
        _cable_length,
        "a cable's length in 1 s",
        "in m/s: mm/s given?",
        most=1.0,
    ),
    Proportion(
        "load_feedback.angular_velocity_noise",
        _one,
        "a radian per second",
        "in rad/s: degrees per second given?",
        most=1.0,
    ),
    Proportion(
        "system.attachments", _cable_length, "a cable's length", "in m: mm given?", most=50.0
    ),
    Proportion(
        "system.cable_length",
        _width,
        "the attachments' distance from the load's centre",
        "both in m",
        most=500.0,
    ),
    Proportion(
        "system.cable_stiffness",
        lambda scenario: _share(scenario) / _cable_length(scenario),
        f"{_WEIGHT} by its length",
        "in N/m: kN/m given?",
        least=3.0,
    ),
    Proportion(
        "optimization_layer.amplitude",
        _amplitude,
        f"that of internal forces like {_WEIGHT}",
        "in N, or for an elliptic carousel without a unit",
        most=10.0,
    ),
)


def out_of_proportion(scenario: Scenario) -> list[str]:
    """A sentence for each quantity that is out of proportion, and what may have been meant.

    Quantities that a scenario does not have, or whose measure it does not have, are left out.
    """
    found = []
    for row in PROPORTIONS:
        value: Any = scenario
        for name in row.field.split("."):
            value = getattr(value, name, None)
        try:
            rows = np.atleast_2d(np.asarray(value, dtype=float))  # None: NaN, which is neither
            size = float(np.max(np.linalg.norm(rows, axis=-1)))
            ratio = size / row.size(scenario)
        except (TypeError, ValueError, AttributeError, ZeroDivisionError):
            continue
        for is_beyond, side, limit in (
            (ratio < row.least, "least", row.least),
            (ratio > row.most, "most", row.most),
        ):
            if is_beyond:
                found.append(
                    f"{row.field} = {size:g} is {ratio:.3g} times {row.of}, {limit:g} at {side} is "
                    f"usual; {row.hint}"
                )
    return found


def warn_of_angles(scenario: Scenario) -> None:
    """Warns of each angle beyond a turn, in a field whose unit is rad."""
    for path, value in _angles(scenario, ""):
        if np.any(np.abs(value[np.isfinite(value)]) > 2 * math.pi):
            hint = "an angle beyond 2π, it is in rad: degrees given?"
            warn_user(f"{path} = {value.tolist()}: {hint}")


def _angles(part: Any, owner: str) -> Iterator[tuple[str, NDArray]]:
    """Paths and values of a part's fields whose comments say that they are in rad."""
    about = meanings(type(part))
    for field in dataclasses.fields(part):
        value, path = getattr(part, field.name), f"{owner}{field.name}"
        if dataclasses.is_dataclass(value):
            yield from _angles(value, f"{path}.")
        elif about.get(field.name, "").split(",")[0].strip() == "rad":
            with contextlib.suppress(TypeError, ValueError):  # a distribution, rows of all lengths
                yield path, np.asarray(value, dtype=float)
