"""How the updates of the optimization layer ended, and how often."""

from enum import IntEnum
from typing import Any, NamedTuple

from numpy.typing import NDArray


class Outcome(IntEnum):
    """How an update of the layer ended; the first entry of `diagnostics`."""

    NONE = 0  # no update yet
    KEPT = 1  # the previous parameters fulfil the constraints: they are the optimum
    SOLVED = 2  # parameters were found that fulfil the constraints
    RELAXED = 3  # none were: the least infeasible ones were taken
    HELD = 4  # the previous parameters are the least infeasible ones: they stay


class Diagnostics(NamedTuple):
    """The entries of the signal `diagnostics` (7), in their order: numbers, or logs (k,)."""

    outcome: Any  # of the last update, an `Outcome`
    updates: Any  # how many there were
    kept: Any  # how many of them ended in this way, as the next three
    solved: Any
    relaxed: Any
    held: Any
    speed_margin: Any  # m/s, the smallest predicted speed minus the untightened bound

    @classmethod
    def view(cls, values: NDArray) -> "Diagnostics":
        """The entries (...) of an array (..., 7)."""
        return cls(*[values[..., i] for i in range(DIAGNOSTICS_SIZE)])

    def after(self, outcome: Outcome, speed_margin: float) -> "Diagnostics":
        """The diagnostics after one more update."""
        return Diagnostics(
            outcome=outcome,
            updates=self.updates + 1,
            kept=self.kept + (outcome == Outcome.KEPT),
            solved=self.solved + (outcome == Outcome.SOLVED),
            relaxed=self.relaxed + (outcome == Outcome.RELAXED),
            held=self.held + (outcome == Outcome.HELD),
            speed_margin=speed_margin,
        )


DIAGNOSTICS_SIZE = len(Diagnostics._fields)
