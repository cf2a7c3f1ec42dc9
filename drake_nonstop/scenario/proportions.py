"""Values out of proportion in a scenario: units that were mistaken, mostly."""

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.documentation import meanings
from drake_nonstop.validation import warn_user


def _share(scenario: Scenario) -> float:
    """A cable's share of the load's weight, N."""
    system = scenario.system
    return system.load_mass * system.gravity / len(system.attachments)


def _amplitude(scenario: Scenario) -> float:
    """The amplitude at which a cable's internal force is as large as its share of the weight."""
    pattern = scenario.pattern.make(np.array(scenario.system.attachments))
    of_cables = np.linalg.norm(pattern.basis.reshape(-1, 3 * pattern.basis.shape[1]), axis=1)
    return _share(scenario) / float(np.max(of_cables))


# What quantities are measured by, in SI units.
_MEASURES: dict[str, Callable[[Scenario], float]] = {
    "1/ξ": lambda scenario: 1 / float(scenario.optimization_layer.frequency),
    "a cable's length": lambda scenario: float(np.max(scenario.system.cable_length)),
    "a cable's length in 1 s": lambda scenario: float(np.max(scenario.system.cable_length)),
    "a radian": lambda _: 1.0,
    "a radian per second": lambda _: 1.0,
    "the attachments' distance from the load's centre": lambda scenario: float(
        np.max(np.linalg.norm(scenario.system.attachments, axis=1))
    ),
    "a cable's share of the weight by its length": lambda scenario: (
        _share(scenario) / float(np.max(scenario.system.cable_length))
    ),
    "that of internal forces like a cable's share of the weight": _amplitude,
}


class Proportion(NamedTuple):
    """A field, and the size that it is usually in proportion to."""

    field: str  # its path in the scenario
    of: str  # what it is measured by, one of `_MEASURES`
    hint: str
    most: float = math.inf  # times that, as is usual
    least: float = 0.0  # likewise


PROPORTIONS = tuple(
    Proportion(*row)
    for row in (
        ("control_period", "1/ξ", "in s: ms given?", 0.6),
        ("load_feedback.period", "1/ξ", "in s: ms given?", 0.6),
        ("load_feedback.delay", "1/ξ", "in s: ms given?", 0.6),
        ("load_feedback.position_noise", "a cable's length", "in m: mm given?", 0.1),
        ("load_feedback.orientation_noise", "a radian", "in rad: degrees given?", 0.3),
        ("load_feedback.velocity_noise", "a cable's length in 1 s", "in m/s: mm/s given?", 1.0),
        (
            "load_feedback.angular_velocity_noise",
            "a radian per second",
            "in rad/s: degrees per second given?",
            1.0,
        ),
        ("system.attachments", "a cable's length", "in m: mm given?", 50.0),
        (
            "system.cable_length",
            "the attachments' distance from the load's centre",
            "both in m",
            500.0,
        ),
        (
            "system.cable_stiffness",
            "a cable's share of the weight by its length",
            "in N/m: kN/m given?",
            math.inf,
            3.0,
        ),
        (
            "optimization_layer.amplitude",
            "that of internal forces like a cable's share of the weight",
            "in N, or for an elliptic carousel without a unit",
            10.0,
        ),
    )
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
            ratio = size / _MEASURES[row.of](scenario)
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
