"""What happens after every step of a simulation."""

import time
from collections.abc import Callable

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, EventStatus

from drake_nonstop.simulation.interruption import Interruption
from drake_nonstop.simulation.run import SIGNAL_PERIOD, StepAction
from drake_nonstop.systems.block import LeafBlock

_WAITING_PERIOD = 0.02  # s of wall time, between two questions of a run that waits
_REPORT_PERIOD = 0.1  # s of wall time, between two calls of `progress`
_AT_SAMPLE = 1e-6  # of the period, from an instant to what counts as there


class SampleInstants(LeafBlock):
    """Has the integrator's steps end at the instants of the signals' samples.

    A log's own period does not: it starts at 0 and the controllers' at their first sample, so
    that a rounding apart every tenth step or so had no length.
    """

    def __init__(self) -> None:
        super().__init__()
        self.DeclarePeriodicPublishEvent(
            period_sec=SIGNAL_PERIOD, offset_sec=SIGNAL_PERIOD, publish=lambda context: None
        )


class Monitor:
    """Takes samples, reports progress, asks what to do, and ends the run where it is asked to."""

    def __init__(
        self,
        simulator: Simulator,
        nonstop: Diagram,
        interruption: Interruption,
        *,
        sample: Callable[[], None],
        progress: Callable[[float], None] | None,
        after_step: Callable[[Simulator, Diagram], StepAction] | None,
        is_over: Callable[[], bool] | None = None,
    ):
        self._simulator = simulator
        self._nonstop = nonstop
        self._interruption = interruption
        self._sample = sample
        self._samples = 0
        self._progress = progress
        self._after_step = after_step
        self._is_over = is_over
        self.has_ended = False  # by a block's own decision
        self._last_report = 0.0
        self.waited = 0.0  # s of wall time

    def __call__(self, root_context: Context) -> EventStatus:
        """What Drake calls after every step."""
        if root_context.get_time() > (self._samples - _AT_SAMPLE) * SIGNAL_PERIOD:
            self._sample()
            self._samples += 1
        if self._interruption.number:
            return EventStatus.ReachedTermination(self._nonstop, "interrupted")
        now = time.perf_counter()
        if self._progress is not None and now - self._last_report > _REPORT_PERIOD:
            self._last_report = now
            self._progress(root_context.get_time())
        if self._after_step is not None and self._ends():
            return EventStatus.ReachedTermination(self._nonstop, "ended")
        if self._is_over is not None and self._is_over():
            self.has_ended = True
            return EventStatus.ReachedTermination(self._nonstop, "over")
        return EventStatus.DidNothing()

    def _ends(self) -> bool:
        then = self._after_step(self._simulator, self._nonstop)  # type: ignore[misc]
        if then is StepAction.WAIT:
            start = time.perf_counter()
            while then is StepAction.WAIT and not self._interruption.number:
                time.sleep(_WAITING_PERIOD)
                then = self._after_step(self._simulator, self._nonstop)  # type: ignore[misc]
            self.waited += time.perf_counter() - start
            self._simulator.ResetStatistics()  # the real-time rate is kept from here on
        return then is StepAction.END or bool(self._interruption.number)

    def __enter__(self) -> "Monitor":
        return self

    def __exit__(self, *exception: object) -> None:
        self._simulator.clear_monitor()  # each would keep the other alive
