"""How the updates of the optimization layer ended, and how often."""

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

from numpy.typing import NDArray

from drake_nonstop.mechanics.signal_layouts import Layout, Part, SomeOf
from drake_nonstop.model.system import Model
from drake_nonstop.planning.limits import LIMITS, asked


class Outcome(IntEnum):
    """How an update of the layer ended; the first entry of `diagnostics`."""

    NONE = 0  # no update yet
    KEPT = 1  # the previous parameters fulfil the constraints: they are the optimum
    SOLVED = 2  # parameters were found that fulfil the constraints
    RELAXED = 3  # none were: the least infeasible ones were taken
    HELD = 4  # the previous parameters are the least infeasible ones: they stay


class Diagnostics(NamedTuple):
    """The entries of the signal `diagnostics` (7), in their order: numbers, or logs (k,)."""

    # of the last update: 1 kept, 2 solved, 3 relaxed, 4 held, as counted below; 0: none yet
    outcome: NDArray | float
    updates: NDArray | float  # how many there were
    kept: NDArray | float  # how many of them ended in this way, as the next three
    solved: NDArray | float
    relaxed: NDArray | float
    held: NDArray | float
    speed_margin: NDArray | float  # m/s, the smallest predicted speed minus the untightened bound

    @classmethod
    def view(cls, values: NDArray) -> "Diagnostics":
        """The entries (...) of an array (..., 7)."""
        return cls(*[values[..., i] for i in range(DIAGNOSTICS_SIZE)])


DIAGNOSTICS_SIZE = len(Diagnostics._fields)
DIAGNOSTICS = Layout(
    *(Part(name, "1", "m/s" if name == "speed_margin" else "") for name in Diagnostics._fields)
)
# What `missed_limits` may count: plans that miss the bound, of aircraft, or a limit, by its name.
BOUND = "airspeed"
MISSED_LIMITS = SomeOf(*(Part(name, "1") for name in (BOUND, *(limit.name for limit in LIMITS))))
LAYER_LAYOUTS: dict[str, Layout] = {"diagnostics": DIAGNOSTICS, "missed_limits": MISSED_LIMITS}
_PLACES = {name: place for place, name in enumerate(Diagnostics._fields)}


def count_update(diagnostics: NDArray, outcome: Outcome, speed_margin: float) -> None:
    """Adds an update to the vector `diagnostics` (7), in place."""
    diagnostics[_PLACES["outcome"]] = outcome
    diagnostics[_PLACES["updates"]] += 1
    diagnostics[_PLACES[outcome.name.lower()]] += 1
    diagnostics[_PLACES["speed_margin"]] = speed_margin


def missed_limits_of(config: Any, model: Model) -> tuple[str, ...]:
    """The entries of a layer's `missed_limits`: the limits that it is asked for, by their names.

    Of aircraft also the bound on the airspeed; it comes first.
    """
    bound = () if model.aircraft is None else (BOUND,)
    return (*bound, *(limit.name for limit, _ in asked(config)))


def missed_layout(names: Sequence[str]) -> Layout:
    """That of a `missed_limits` with these entries."""
    return Layout(*(Part(name, "1") for name in names))
