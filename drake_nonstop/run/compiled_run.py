"""The compiled engine of a run: what it can fly of it, and how that is recorded."""

import math
from collections.abc import Generator, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import SimulatorConfig
from pydrake.systems.framework import Context

from drake_nonstop.mechanics.signals import SIGNAL_PERIOD
from drake_nonstop.run.monitor import SAME_RATIO, EndingBlocks, Monitor, at_instant
from drake_nonstop.run.recording import LogSignals, RecordingError
from drake_nonstop.scenario.schema import COMPILED, Scenario
from drake_nonstop.systems.compiled_flight import (
    Advance,
    CompiledFlight,
    advance_together,
    sample_times,
)
from drake_nonstop.systems.compiled_loop import CompiledLoop, reason_against
from drake_nonstop.systems.tracing import LARGEST
from drake_nonstop.validation import one_line, warn_user

NOT_COMPILED = "engine = compiled"  # how the warning begins that tells why
_ROUNDING = 1e-9  # s, of instants
_AT_ONCE = 0.5  # s of flight, between which the user is asked and told
_UNUSUAL = 1e-3 * LARGEST  # a value beyond it may become one that a block of the diagram refuses

Result = TypeVar("Result")
# Of what flies by a compiled loop, perhaps beside others: it asks for samples of a flight, so many,
# gets what these show, and returns its result in the end.
Flying = Generator[tuple[CompiledFlight, int], Advance, Result]


def flown_alone(flying: Flying[Result]) -> Result:
    """The result of what flies, with no others beside it."""
    try:
        flight, samples = next(flying)
        while True:
            try:
                (advance,) = advance_together([flight], [samples])
            except BaseException as error:  # such as the SystemExit of a block
                flight, samples = flying.throw(error)
            else:
                flight, samples = flying.send(advance)
    except StopIteration as end:
        result: Result = end.value
        return result


def compiled_loop_of(
    scenario: Scenario,
    logs: LogSignals,
    config: SimulatorConfig,
    steering: Sequence[str],
    flights: int = 1,
) -> CompiledLoop | str:
    """The loop as a run flies it by the compiled engine, or why it cannot be, in words.

    Args:
        scenario: of the run.
        logs: of its loop.
        config: the integrator's step.
        steering: the arguments of `simulate` that need the Simulator's own steps.
        flights: how many like it are to be flown.
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
    if reason:
        return reason
    loop = recorded_loop(logs, config, period, compiles=None)
    loop.prepare(int(scenario.simulation_duration / period), flights)
    return loop


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


def tell_not_compiled(reason: str, engine: str) -> None:
    """Warns of what is not compiled where that `engine` was asked for."""
    if engine == COMPILED:
        warn_user(f"{NOT_COMPILED}: {reason} the diagram is simulated instead")


class _Recorded(NamedTuple):
    """The last sample that was recorded."""

    time: float  # s
    before: NDArray  # the state before the updates at that sample


class CompiledRun:
    """Flies as much of a run as a compiled loop can, from the start on, and records it.

    Args:
        loop: what is flown.
        logs: take the signals.
        context: the root context at the start.
        ending: as of `Monitor`.

    Attributes:
        evaluator: that of the loop's functions, "C" or "virtual machine".
        failure: the error of a block with which it left the rest to the diagram; empty: none.
    """

    def __init__(
        self, loop: CompiledLoop, logs: LogSignals, context: Context, ending: EndingBlocks
    ):
        self._loop, self._rows, self._context = loop, logs.rows(context), context
        start = loop.diagram.CreateDefaultContext()
        start.SetTimeStateAndParametersFrom(loop.diagram.GetMyContextFromRoot(context))
        self._flight = loop.fly(start, _UNUSUAL)
        self._ending = ending
        self._signal_ends = np.arange(1, loop.shown_per_sample + 1) / loop.shown_per_sample
        self._recorded = self._state()
        self._end = 0.0  # s, of what is recorded
        self.evaluator, self.failure = "C" if loop.is_compiled else "virtual machine", ""

    def _state(self) -> _Recorded:
        """The last sample of the flight."""
        return _Recorded(self._flight.time, self._flight.state_before_updates)

    def _write_state(self) -> None:
        """Sets the root context to the last sample."""
        own = self._loop.diagram.GetMyMutableContextFromRoot(self._context)
        self._flight.write_state(own, self._recorded.before)
        self._context.SetTime(self._recorded.time)

    def fly(self, duration: float, monitor: Monitor) -> Flying[bool]:
        """Flies up to a time in s, and sets the context to the end of what was flown.

        What is left then is less than a sample, or follows an error of a block, a value that is not
        finite, or one so large that it may become one: the Simulator flies that, and tells of it.
        False where nothing was flown.
        """
        period = self._loop.control_period
        samples = int((duration + _ROUNDING) / period)
        if samples == 0:
            return False
        try:
            signals, steps = self._flight.start()
            self._rows.add(np.zeros(1), signals[None], np.zeros(1), steps[None])
            self._recorded = self._state()
            monitor.has_ended = self._is_over(steps[None]) is not None
            ends = monitor.ends(0.0) or monitor.has_ended
            while not ends and self._flight.samples < samples:
                most = min(samples - self._flight.samples, math.ceil(_AT_ONCE / period))
                first = self._flight.samples
                advance = yield self._flight, most
                if len(advance.signals):
                    ends = self._record(monitor, duration, first, advance)
                if advance.error is not None and not ends:
                    raise advance.error
        except RecordingError:
            raise
        except BaseException as error:  # whatever blocks raise: the diagram does again, at its step
            if monitor.is_interrupted:
                raise
            self._end = self._recorded.time
            self.failure = f"{one_line(error)}; from t = {self._end:g} s on"
            if self._end == 0:
                return False
        finally:
            self._context.SetTime(self._end)
        if not monitor.has_ended:
            self._write_state()
        if abs(self._recorded.time - duration) < _ROUNDING:
            self._context.SetTime(duration)
        return True

    def _record(self, monitor: Monitor, duration: float, first: int, advance: Advance) -> bool:
        """Records samples from the first one on; whether the run ends with them."""
        signals, steps, period = advance.signals, advance.step_signals, self._loop.control_period
        samples = len(signals) // self._loop.shown_per_sample
        begins = sample_times(np.arange(first, first + samples), period)[:, None]
        ends = np.append(begins[1:, 0], self._flight.time)
        if abs(ends[-1] - duration) < _ROUNDING:
            ends[-1] = duration  # as of a Simulator
        times = begins + period * self._signal_ends
        step_times = begins + self._loop.step_ends
        times[:, -1] = step_times[:, -1] = ends
        times, step_times = times.ravel(), step_times.ravel()
        last = self._is_over(steps)
        steps, step_times = steps[:last], step_times[:last]
        # No sample is between the signals' instants, where the control period is a shorter one.
        kept = at_instant(times) & (times <= step_times[-1] + _ROUNDING)
        self._end = float(step_times[-1])
        self._rows.add(times[kept], signals[kept], step_times, steps)
        if last is not None:
            monitor.has_ended = True
            return True
        self._recorded = self._state()
        return monitor.ends(self._end)

    def _is_over(self, steps: NDArray) -> int | None:
        """How many steps there are until a block ends the run; None: none does."""
        last = self._ending.first_end(self._loop.step_signals, steps)
        return None if last is None else last + 1
