"""The compiled engine of a run: what it can fly of it, alone or beside others, and its record."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import SimulatorConfig
from pydrake.systems.framework import Context

from drake_nonstop.mechanics.signals import SIGNAL_PERIOD
from drake_nonstop.run.monitor import SAME_RATIO, EndingBlocks, Monitor, at_instant
from drake_nonstop.run.recording import LogSignals, RecordingError
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.compiled_flight import Advance, advance_together, sample_times
from drake_nonstop.systems.compiled_loop import CompiledLoop, reason_against
from drake_nonstop.systems.tracing import LARGEST
from drake_nonstop.validation import one_line

NOT_COMPILED = "engine = compiled"  # how the warning begins that tells why
_ROUNDING = 1e-9  # s, of instants
_AT_ONCE = 0.5  # s of flight, between which the user is asked and told
_UNUSUAL = 1e-3 * LARGEST  # a value beyond it may become one that a block of the diagram refuses


def reason_not_compiled(
    scenario: Scenario, logs: LogSignals, config: SimulatorConfig, steering: Sequence[str]
) -> str:
    """Why the compiled engine cannot fly a loop, in words; "": it can.

    Args:
        scenario: of the run.
        logs: of its loop.
        config: the integrator's step.
        steering: the arguments of `simulate` that need the Simulator's own steps.
    """
    period = scenario.control_period
    reason = f"for {steering[0]} the steps of Drake's Simulator are needed" if steering else ""
    reason = reason or reason_against(logs.nonstop, config, period)
    ratio = max(SIGNAL_PERIOD, period) / min(SIGNAL_PERIOD, period) if period > 0 else 1.0
    if not reason and abs(ratio - round(ratio)) > SAME_RATIO * ratio:
        reason = (
            f"control_period = {period:g} and the {SIGNAL_PERIOD:g} s between signals are no "
            "multiples of each other"
        )
    return reason


def recorded_loop(
    logs: LogSignals, config: SimulatorConfig, period: float, **options: Any
) -> CompiledLoop:
    """The compiled loop that shows what logs take, with further options of its class."""
    return CompiledLoop(
        logs.nonstop,
        config,
        period,
        signal_period=min(SIGNAL_PERIOD, period),
        signals=logs.sampled,
        step_signals=logs.stepped,
        **options,
    )


class CompiledRun:
    """Flies as much of a run as a compiled loop can, from the start on, and records it.

    What is left then is less than a sample, or follows an error of a block, a value that is not
    finite, or one so large that it may become one: the Simulator flies that, and tells of it.

    Args:
        loop: what is flown.
        logs: take the signals.
        context: the root context at the start.
        ending: as of `Monitor`.
        monitor: of the run.
        duration: of the run, s.

    Attributes:
        flight: of the loop.
        evaluator: that of the loop's functions, "C" or "virtual machine".
        is_begun: whether anything was flown.
        is_over: whether nothing more is flown by it.
        failure: the error of a block with which it left the rest to the diagram; empty: none.
        error: one that ends the run.
    """

    def __init__(
        self,
        loop: CompiledLoop,
        logs: LogSignals,
        context: Context,
        ending: EndingBlocks,
        monitor: Monitor,
        duration: float,
    ):
        self._loop, self._rows, self._context = loop, logs.rows(context), context
        self._ending, self._monitor, self._duration = ending, monitor, duration
        start = loop.diagram.CreateDefaultContext()
        start.SetTimeStateAndParametersFrom(loop.diagram.GetMyContextFromRoot(context))
        self.flight = loop.fly(start, _UNUSUAL)
        self.evaluator = "C" if loop.is_compiled else "virtual machine"
        self._samples = int((duration + _ROUNDING) / loop.control_period)
        self._signal_ends = np.arange(1, loop.shown_per_sample + 1) / loop.shown_per_sample
        self._end = 0.0  # s, of what is recorded
        self._at = 0.0, self.flight.state_before_updates  # the last sample that is recorded
        self.is_begun, self.is_over = False, self._samples == 0
        self.failure = ""
        self.error: BaseException | None = None

    @property
    def samples_ahead(self) -> int:
        """The number of samples that are to be flown next."""
        most = math.ceil(_AT_ONCE / self._loop.control_period)
        return min(self._samples - self.flight.samples, most)

    def begin(self) -> None:
        """Records the start."""

        def start() -> bool:
            signals, steps = self.flight.start()
            self._rows.add(np.zeros(1), signals[None], np.zeros(1), steps[None])
            self.is_begun = True
            self._at = 0.0, self.flight.state_before_updates
            self._monitor.has_ended = self._steps_to_end(steps[None]) is not None
            return self._monitor.ends(0.0) or self._monitor.has_ended

        if not self.is_over:
            self._try(start)

    def record(self, advance: Advance) -> None:
        """Records the samples that were flown."""

        def record() -> bool:
            ends = bool(len(advance.signals)) and self._record(advance)
            if advance.error is not None and not ends:
                raise advance.error
            return ends or self.flight.samples >= self._samples

        self._try(record)

    def _try(self, action: Callable[[], bool]) -> None:
        """Is over where an action says so, or raises."""
        try:
            self.is_over = action()
        except BaseException as error:  # whatever blocks raise: the diagram does again, at its step
            self.is_over = True
            if isinstance(error, RecordingError) or self._monitor.is_interrupted:
                self.error = error
                return
            self._end = self._at[0]
            self.failure = f"{one_line(error)}; from t = {self._end:g} s on"
            self.is_begun = self._end > 0

    def end(self) -> None:
        """Sets the root context to the end of what was flown."""
        time, before = self._at
        self._context.SetTime(self._end)
        if not self.is_begun:
            return
        if not (self._monitor.has_ended or self.error):
            own = self._loop.diagram.GetMyMutableContextFromRoot(self._context)
            self.flight.write_state(own, before)
            self._context.SetTime(time)
        if abs(time - self._duration) < _ROUNDING:
            self._context.SetTime(self._duration)

    def _record(self, advance: Advance) -> bool:
        """Records samples; whether the run ends with them."""
        signals, steps, period = advance.signals, advance.step_signals, self._loop.control_period
        samples = len(signals) // self._loop.shown_per_sample
        first = self.flight.samples - samples
        begins = sample_times(np.arange(first, first + samples), period)[:, None]
        ends = np.append(begins[1:, 0], self.flight.time)
        if abs(ends[-1] - self._duration) < _ROUNDING:
            ends[-1] = self._duration  # as of a Simulator
        times = begins + period * self._signal_ends
        step_times = begins + self._loop.step_ends
        times[:, -1] = step_times[:, -1] = ends
        times, step_times = times.ravel(), step_times.ravel()
        last = self._steps_to_end(steps)
        steps, step_times = steps[:last], step_times[:last]
        # No sample is between the signals' instants, where the control period is a shorter one.
        kept = at_instant(times) & (times <= step_times[-1] + _ROUNDING)
        self._rows.add(times[kept], signals[kept], step_times, steps)
        self._end = float(step_times[-1])
        if last is not None:
            self._monitor.has_ended = True
            return True
        self._at = self.flight.time, self.flight.state_before_updates
        return self._monitor.ends(self._end)

    def _steps_to_end(self, steps: NDArray) -> int | None:
        """How many steps there are until a block ends the run; None: none does."""
        last = self._ending.first_end(self._loop.step_signals, steps)
        return None if last is None else last + 1


def fly_together(runs: Sequence[CompiledRun], check: Callable[[], None] = lambda: None) -> None:
    """Flies what compiled loops can of runs; those of one function in the lanes of a core.

    Args:
        runs: what is flown.
        check: is called on the way, and may raise.
    """
    try:
        for run in runs:
            run.begin()
        while going := [run for run in runs if not run.is_over]:
            check()
            asked = [run.samples_ahead for run in going]
            flown = advance_together([run.flight for run in going], asked)
            for run, advance in zip(going, flown, strict=True):
                run.record(advance)
    finally:
        for run in runs:
            run.end()
