"""The compiled engine of a run: what it can fly of it, and how that is recorded."""

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator, SimulatorConfig
from pydrake.systems.framework import Context

from drake_nonstop.loop.block_events import NotCompilableError, sample_times
from drake_nonstop.loop.compiled_loop import CompiledFlight, CompiledLoop, reason_against
from drake_nonstop.loop.lanes import Advance, advance_together
from drake_nonstop.mechanics.signal_layouts import by_name
from drake_nonstop.mechanics.signals import SIGNAL_PERIOD
from drake_nonstop.scenario.schema import COMPILED, Scenario
from drake_nonstop.simulation.monitor import SAME_RATIO, EndingBlocks, Monitor, at_instant
from drake_nonstop.simulation.recording import LogSignals, RecordingError
from drake_nonstop.simulation.run import WALL_TIME
from drake_nonstop.simulation.step_size import FlightSamples, RestorableState, SavedState, flown
from drake_nonstop.systems.block import is_of_package, release
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError
from drake_nonstop.systems.wiring import maker_of
from drake_nonstop.validation import one_line, warn_user

NOT_COMPILED = "engine = compiled"  # how the warning begins that tells why
_ROUNDING = 1e-9  # s, of instants
_SAME = 1e-9  # of 1 + a signal's largest value: what both engines show
_COMPARED = 3  # samples, of loops with a user's own blocks
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
) -> CompiledLoop | str:
    """The loop as a run flies it by the compiled engine, or why it cannot be, in words.

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
    if reason:
        return reason
    samples = int(scenario.simulation_duration / period)
    return recorded_loop(logs, config, period, samples=samples)


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


@dataclass(frozen=True)
class CompiledState:
    """A `SavedState` whose context is written when it is asked for, which takes longer."""

    time: float
    state: NDArray
    samples: int  # up to there
    flight: CompiledFlight
    loop: CompiledLoop

    def restore(self, context: Context) -> None:
        """Sets the state of a context of the same diagram."""
        context.SetTime(self.time)
        self.flight.write_state(context, self.state)

    def fly(self, duration: float, config: SimulatorConfig) -> FlightSamples:
        """A flight from it on as of `ShortFlights`, by steps of the config; its own one is over."""
        self.flight.go_to(self.samples, self.state)
        loop, period = self.loop, self.loop.control_period
        samples = math.ceil(duration / period - _ROUNDING)
        rows = loop.fly_on(self.flight, samples, config)
        times = self.time + period / loop.shown_per_sample * np.arange(1, len(rows) + 1)
        kept = at_instant(times)
        return FlightSamples.of(times[kept], by_name(loop.signals, rows[kept]))


class CompiledRun:
    """Flies as much of a run as a compiled loop can, from the start on, and records it.

    Args:
        loop: what is flown.
        logs: take the signals.
        context: the root context at the start.
        ending: as of `Monitor`.
        compared: of another diagram of the loop, which the first samples are compared with, for
            what a user's own blocks may have declared falsely; None: there are no such blocks.

    Attributes:
        evaluator: that of the loop's functions, "C" or "virtual machine".
        failure: the error of a block with which it left the rest to the diagram; empty: none.
        error: that of a user's own block, which the diagram has to meet again; None: there is none.
    """

    def __init__(
        self,
        loop: CompiledLoop,
        logs: LogSignals,
        context: Context,
        ending: EndingBlocks,
        compared: Simulator | None = None,
    ):
        self._loop, self._rows, self._context = loop, logs.rows(context), context
        self._start = loop.diagram.CreateDefaultContext()
        self._start.SetTimeStateAndParametersFrom(loop.diagram.GetMyContextFromRoot(context))
        self._flight = loop.fly(self._start, _UNUSUAL)
        self._ending = ending
        self._signal_ends = np.arange(1, loop.shown_per_sample + 1) / loop.shown_per_sample
        self._recorded = 0, self._flight.state  # samples, and the state after them
        self._end = 0.0  # s, of what is recorded
        self.evaluator, self.failure = "C" if loop.is_compiled else "virtual machine", ""
        self.error: BaseException | None = None
        self._compared, self._expected = compared, np.zeros((0, 0))

    def _state(self) -> RestorableState:
        """The state of the last sample, for a flight of the diagram from there."""
        if not self._loop.blocks_beside:
            flight = self._flight
            return CompiledState(flight.time, flight.state, flight.samples, flight, self._loop)
        self._write_state()
        return SavedState.of(self._loop.diagram.GetMyContextFromRoot(self._context))

    def _write_state(self) -> None:
        """Sets the root context to the last sample."""
        self._context.SetTime(self._flight.time)
        self._flight.write_state(self._loop.diagram.GetMyMutableContextFromRoot(self._context))

    def fly(self, duration: float, monitor: Monitor) -> Flying[bool]:
        """Flies up to a time in s, and sets the context to the end of what was flown.

        What is left then is less than a sample, or follows an error of a block, a value that is not
        finite, or one so large that it may become one: the Simulator flies that, and tells of it.
        False where nothing was flown.

        Raises:
            NotCompilableError: a block does what it has not declared: all of the flight is wrong.
        """
        period = self._loop.control_period
        samples = int((duration + _ROUNDING) / period)
        if samples == 0:
            return False
        try:
            if self._compared is not None:
                self._expected = self._rows_of(self._compared, min(samples, _COMPARED))
            signals, steps = self._flight.start()
            self._compare(signals[None])
            self._rows.add(np.zeros(1), signals[None], np.zeros(1), steps[None])
            self._recorded = 0, self._flight.state
            monitor.has_ended = self._is_over(steps[None]) is not None
            ends = monitor.ends(0.0, self._state) or monitor.has_ended
            while not ends and self._flight.samples < samples:
                to_save = math.ceil((monitor.saved.next_time - self._flight.time) / period)
                most = min(samples - self._flight.samples, max(1, to_save))
                first = self._flight.samples
                advance = yield self._flight, most
                if len(advance.signals):
                    ends = self._record(monitor, duration, first, advance)
                if advance.error is not None and not ends:
                    raise advance.error
        except (RecordingError, NotCompilableError):
            raise
        except BaseException as error:  # whatever blocks raise: the diagram does again, at its step
            if monitor.is_interrupted:
                raise
            if self._compared is not None and not isinstance(error, NotFiniteError):
                self.error = error
            self._go_back()
            self.failure = f"{one_line(error)}; from t = {self._flight.time:g} s on"
            self._end = self._flight.time
            if self._flight.samples == 0:
                return False
        finally:
            self._context.SetTime(self._end)
        if not monitor.has_ended:
            self._write_state()
        if abs(self._flight.time - duration) < _ROUNDING:
            self._context.SetTime(duration)
        return True

    def _record(self, monitor: Monitor, duration: float, first: int, advance: Advance) -> bool:
        """Records samples from the first one on; whether the run ends with them."""
        signals, steps, period = advance.signals, advance.step_signals, self._loop.control_period
        samples = len(signals) // self._loop.shown_per_sample
        self._compare(signals)
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
        self._recorded = self._flight.samples, self._flight.state
        return monitor.ends(self._end, self._state)

    def _rows_of(self, simulator: Simulator, samples: int) -> NDArray:
        """Signals (instants, size) of a diagram like the loop's, of the start and some samples."""
        simulator.get_mutable_context().SetTimeStateAndParametersFrom(self._start)
        simulator.Initialize()
        shown, period = len(self._signal_ends), self._loop.control_period
        part, whole = np.modf(np.arange(samples * shown + 1) / shown)
        times = sample_times(whole, period) + part * period
        rows = flown(simulator, self._loop.signals, times)
        release(simulator.get_system())
        return np.hstack([*rows.values()])

    def _compare(self, signals: NDArray) -> None:
        """Compares the next rows of signals (instants, size) with those of the diagram.

        Raises:
            NotCompilableError: they differ; it names a user's own block, where one shows it.
        """
        now, self._expected = np.split(self._expected, [len(signals)])
        for row, expected_row in zip(signals, now, strict=False):
            shown, expected = (by_name(self._loop.signals, each) for each in (row, expected_row))
            wrong = [
                (maker_of(self._loop.diagram, name), name)
                for name in shown
                if name != WALL_TIME and not _is_same(shown[name], expected[name])
            ]
            for maker, name in sorted(wrong, key=lambda one: is_of_package(one[0])):
                raise NotCompilableError(maker, f"compiled, {name} is not what its diagram shows")

    def _is_over(self, steps: NDArray) -> int | None:
        """How many steps there are until a block ends the run; None: none does."""
        last = self._ending.first_end(self._loop.step_signals, steps)
        return None if last is None else last + 1

    def _go_back(self) -> None:
        """Goes back to the last sample that is recorded."""
        samples, state = self._recorded
        if not self._loop.blocks_beside:
            self._flight.go_to(samples, state)
            return
        self._flight = self._loop.fly(self._start, _UNUSUAL)
        if samples > 0:
            self._flight.fly(samples)


def _is_same(values: NDArray, expected: NDArray) -> bool:
    """Whether both engines show the same."""
    tolerance = _SAME * (1 + np.abs(expected).max(initial=0.0))
    return np.allclose(values, expected, rtol=0, atol=tolerance, equal_nan=True)
