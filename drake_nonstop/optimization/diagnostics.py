"""How the updates of the optimization layer ended, and how often."""

from collections.abc import Collection
from enum import IntEnum
from typing import NamedTuple

from numpy.typing import NDArray

from drake_nonstop.mechanics.signal_layouts import Layout, Part


class Outcome(IntEnum):
    """How an update of the layer ended; the first entry of `diagnostics`."""

    NONE = 0  # no update yet
    KEPT = 1  # the previous parameters fulfil the constraints: they are the optimum
    SOLVED = 2  # parameters were found that fulfil the constraints
    RELAXED = 3  # none were: the least infeasible ones were taken
    HELD = 4  # the previous parameters are the least infeasible ones: they stay


class Diagnostics(NamedTuple):
    """The entries of the signal `diagnostics` (7), in their order: numbers, or logs (k,)."""

    outcome: NDArray | float  # of the last update, an `Outcome`
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


class MissedLimits(NamedTuple):
    """The entries of the signal `missed_limits` (5): numbers, or logs (k,).

    How many updates ended with a plan that does not keep the bound on the airspeed, or a limit of
    the aircraft.
    """

    airspeed: NDArray | float
    lift: NDArray | float
    bank: NDArray | float
    climb: NDArray | float
    thrust: NDArray | float

    @classmethod
    def view(cls, values: NDArray) -> "MissedLimits":
        """The entries (...) of an array (..., 5)."""
        return cls(*[values[..., i] for i in range(MISSED_LIMITS_SIZE)])


MISSED_LIMITS_SIZE = len(MissedLimits._fields)
DIAGNOSTICS_SIZE = len(Diagnostics._fields)
DIAGNOSTICS = Layout(
    *(Part(name, "1", "m/s" if name == "speed_margin" else "") for name in Diagnostics._fields)
)
MISSED_LIMITS = Layout(*(Part(name, "1") for name in MissedLimits._fields))
_PLACES = {name: place for place, name in enumerate(Diagnostics._fields)}


def count_update(diagnostics: NDArray, outcome: Outcome, speed_margin: float) -> None:
    """Adds an update to the vector `diagnostics` (7), in place."""
    diagnostics[_PLACES["outcome"]] = outcome
    diagnostics[_PLACES["updates"]] += 1
    diagnostics[_PLACES[outcome.name.lower()]] += 1
    diagnostics[_PLACES["speed_margin"]] = speed_margin


def count_missed(missed: NDArray, kinds: Collection[str]) -> None:
    """Adds an update that misses limits of these names to the vector `missed_limits`, in place."""
    for kind in set(kinds):
        missed[MissedLimits._fields.index(kind)] += 1


def update_count(diagnostics: NDArray) -> int:
    """How many updates the vector `diagnostics` (7) counts."""
    return int(diagnostics[_PLACES["updates"]])
