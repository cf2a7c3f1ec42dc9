"""Actions after every step of a simulation."""

import itertools
import time
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, EventStatus

from drake_nonstop.mechanics.signal_layouts import by_name
from drake_nonstop.mechanics.signals import SIGNAL_PERIOD
from drake_nonstop.run.interruption import Interruption
from drake_nonstop.run.run import StepAction
from drake_nonstop.systems.block import LeafBlock, is_of_package

_WAITING_PERIOD = 0.02  # s of wall time, between two questions of a run that waits
_REPORT_PERIOD = 0.1  # s of wall time, between two calls of `progress`
AT_INSTANT = 1e-6 * SIGNAL_PERIOD  # s, from an instant to what counts as there
SAME_RATIO = 1e-13  # of periods that come together again and again: no error adds up
_MOST_INSTANTS = 100  # in the time after which samples and signals are at one instant again


def at_instant(time_: Any) -> Any:
    """Whether a time, or each of an array, s, is an instant of the signals' samples."""
    return abs(time_ - SIGNAL_PERIOD * np.round(time_ / SIGNAL_PERIOD)) < AT_INSTANT


def other_instants(control_period: float) -> tuple[float, list[float]]:
    """The signals' instants that are no samples of the controllers: period and offsets, s.

    Where both are at one instant an event of each would be a rounding apart: of such events
    Drake's Simulator loses one now and then, and steps between them have no length.

    Args:
        control_period: s; 0: the controllers have no samples.
    """
    ratio = SIGNAL_PERIOD / control_period if control_period > 0 else 0.0
    common = Fraction(ratio).limit_denominator(_MOST_INSTANTS)
    if ratio == 0 or abs(ratio - common) > SAME_RATIO * ratio:
        return SIGNAL_PERIOD, [SIGNAL_PERIOD]
    instants = range(1, common.denominator)
    return common.denominator * SIGNAL_PERIOD, [k * SIGNAL_PERIOD for k in instants]


class SampleInstants(LeafBlock):
    """Has the integrator's steps end at the instants of the signals' samples.

    Args:
        control_period: s, of the controllers, at whose samples steps end anyway; 0: none.
    """

    def __init__(self, control_period: float) -> None:
        super().__init__()
        period, offsets = other_instants(control_period)
        for offset in offsets:
            self.DeclarePeriodicPublishEvent(period, offset, lambda context: None)


class EndingBlocks:
    """The blocks of a loop that may end a run, with their contexts in that of a root.

    Each has `ends_run(context, shown)`, of what its port shows that `ending_signal` names.
    """

    def __init__(self, loop: Diagram, root: Context):
        blocks: list[Any] = [block for block in loop.GetSystems() if hasattr(block, "ends_run")]
        self._blocks = [(block, block.GetMyContextFromRoot(root)) for block in blocks]
        self.signals = [block.ending_signal for block in blocks]

    def end_now(self) -> bool:
        """Whether one ends the run in the state of its context."""
        return any(b.ends_run(c, b.GetOutputPort(b.ending_signal).Eval(c)) for b, c in self._blocks)

    def first_end(self, sizes: Mapping[str, int], rows: NDArray) -> int | None:
        """The first of the rows (k, size) of signals of these sizes with which one ends the run."""
        shown, ends = by_name(sizes, rows), list[int]()
        for block, context in self._blocks:
            values = shown[block.ending_signal]
            if not is_of_package(block) or block.ends_run(context, values):  # takes rows, too
                found = (k for k, value in enumerate(values) if block.ends_run(context, value))
                ends += itertools.islice(found, 1)
        return min(ends, default=None)


class Monitor:
    """Reports progress, asks what to do, and ends the run where it is asked to.

    Args:
        simulator: of the diagram around the loop.
        nonstop: the loop's diagram.
        interruption: what Ctrl-C leaves.
        progress, after_step: as of `simulate`.
        ending: the blocks that may end the run.

    Attributes:
        has_ended: whether a block has ended the run.
        time: s, of the last step.
        waited: s of wall time.
    """

    def __init__(
        self,
        simulator: Simulator,
        nonstop: Diagram,
        interruption: Interruption,
        *,
        progress: Callable[[float], None] | None,
        after_step: Callable[[Simulator, Diagram], StepAction] | None,
        ending: EndingBlocks,
    ):
        self._simulator = simulator
        self._nonstop = nonstop
        self._interruption = interruption
        self._progress = progress
        self._after_step = after_step
        self._ending = ending
        self.has_ended = False
        self._last_report = 0.0
        self.time = self.waited = 0.0

    def __call__(self, root_context: Context) -> EventStatus:
        """The function that Drake calls after every step."""
        if self.ends(root_context.get_time()):
            return EventStatus.ReachedTermination(self._nonstop, "ended")
        if self._ending.end_now():
            self.has_ended = True
            return EventStatus.ReachedTermination(self._nonstop, "over")
        return EventStatus.DidNothing()

    @property
    def is_interrupted(self) -> bool:
        """Whether a signal has asked for the end."""
        return self._interruption.number > 0

    def ends(self, time_: float) -> bool:
        """Takes note of a step that ends at a time in s; whether the run ends there."""
        self.time = time_
        if self.is_interrupted:
            return True
        now = time.perf_counter()
        if self._progress is not None and now - self._last_report > _REPORT_PERIOD:
            self._last_report = now
            self._progress(time_)
        return self._after_step is not None and self._is_ended(self._after_step)

    def _is_ended(self, after_step: Callable[[Simulator, Diagram], StepAction]) -> bool:
        then = after_step(self._simulator, self._nonstop)
        if then is StepAction.WAIT:
            start = time.perf_counter()
            while then is StepAction.WAIT and not self._interruption.number:
                time.sleep(_WAITING_PERIOD)
                then = after_step(self._simulator, self._nonstop)
            self.waited += time.perf_counter() - start
            self._simulator.ResetStatistics()  # the real-time rate is kept from here on
        return then is StepAction.END or bool(self._interruption.number)
