"""A flight of a compiled loop, and what stands beside the trace as it goes on."""

import functools
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, PortDataType, System

from drake_nonstop.loop.block_events import SteppedBlock, sample_times
from drake_nonstop.loop.functions import Evaluation, LoopFunctions, Reading
from drake_nonstop.loop.lane_functions import LaneFunction, LaneInputs
from drake_nonstop.loop.trace import LoopLayout, discrete_state_of
from drake_nonstop.systems.block import has_own
from drake_nonstop.systems.diagram_trace import (
    QUANTITIES,
    ROWS,
    TAKE_CONFIG,
    updates_in_trace,
)
from drake_nonstop.systems.port_state import copied_context, set_discrete_values
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import require

_MOST_SAMPLES = 128  # for which what stands outside is evaluated at once
_MOST_KEPT = 100  # times so many samples, for flights that share them


class LoopFlight:
    """A flight of a loop's traced functions, and what stands outside of them.

    It starts from a `context` of the diagram, at t = 0, which stays as it is, and goes on by
    samples of the `period`, s. A value beyond `largest`, in SI units, raises NotFiniteError.

    Attributes:
        samples: the number of those that it has flown.
    """

    def __init__(self, layout: LoopLayout, period: float, context: Context, largest: float):
        self._layout, self._period, self._largest = layout, period, largest
        self._state, self._parameters = layout.state_of(context), layout.parameters_of(context)
        self._sources = {
            layout.numbers[block]: _Source(block, own_context(layout, block, context))
            for block in (*layout.outside - {*layout.held}, *layout.precomputing)
        }
        self.samples = 0

    @property
    def state(self) -> NDArray:
        """The states (k,) of all traced blocks at the last sample, before its updates."""
        return self._state.copy()

    @property
    def parameters(self) -> NDArray:
        """The parameters (p,) of all traced blocks."""
        return self._parameters.copy()

    @property
    def time(self) -> float:
        """That of the last sample, s."""
        return sample_times(self.samples, self._period)

    def _time_after(self, offset: float) -> float:
        """An offset (s) after the last sample; after a period that of the next."""
        if offset == self._period:
            return sample_times(self.samples + 1, self._period)
        return self.time + offset

    def _evaluated(self, function: Evaluation, *inputs: NDArray) -> list[NDArray]:
        *results, norm = function(inputs)
        self._require_finite(norm[0])
        return results

    def _require_finite(self, squares: float) -> None:
        if not squares < self._largest**2:
            raise NotFiniteError("the loop", largest=self._largest)


class CompiledFlight(LoopFlight):
    """A flight that `CompiledLoop.fly` makes, which is advanced from sample to sample."""

    def __init__(
        self,
        layout: LoopLayout,
        functions: LoopFunctions,
        *,
        compiles: bool,
        period: float,
        instants: tuple[int, int],
        context: Context,
        largest: float,
    ):
        super().__init__(layout, period, context, largest)
        self._instants = instants
        parts = functions.at_start, functions.shown, functions.after_sample
        self._at_start, self._shown, self._after_sample = (
            Evaluation(part, compiles) for part in parts
        )
        at_sample, whole = functions.at_sample, functions.whole
        self._at_sample = None if at_sample is None else Evaluation(at_sample, compiles)
        self._whole = None if whole is None else Evaluation(whole, compiles)
        self._in_lanes = whole if compiles else None
        self._no_answers = np.zeros(layout.answers_size)
        self._systems = [*layout.numbers]
        self._outside = _ExogenousInputs(
            [] if whole is None else whole.readings, self._sources, period
        )
        self._stepped: dict[System, SteppedBlock] = {}
        self._watched = [_watched(layout, block, context) for block in layout.of_users]
        self._fixed: dict[tuple[System, int], Any] = {}
        self._abstract: list[tuple[Any, tuple[System, int]]] = []  # inputs that are no vectors
        self._asked: dict[Any, Context] = {}
        for block in (*layout.held, *layout.self_updating):
            block_context = own_context(layout, block, context)
            for k in range(block.num_input_ports()):
                self._fix(block, block_context, k)
            if block in layout.held:
                self._stepped[block] = SteppedBlock(block, block_context)
            else:
                self._asked[block] = block_context

    def _fix(self, block: System, context: Context, k: int) -> None:
        """Gives a block's input a value: of an abstract one that of its source."""
        port = block.get_input_port(k)
        if (block, k) in self._layout.read:
            self._fixed[block, k] = port.FixValue(context, np.zeros(port.size()))
            return
        source = self._layout.wires.source(block, k)
        if source is None:
            return
        value = self._abstract_value(source, 0.0)
        self._abstract.append((port.FixValue(context, value), source))

    def _abstract_value(self, source: tuple[System, int], at: float) -> Any:
        maker, index = source
        return self._sources[self._layout.numbers[maker]].value(index, at)

    def start(self) -> tuple[NDArray, NDArray]:
        """The loop's `signals` (size,) and `step_signals` (size,) after the initialization.

        Raises:
            NotFiniteError: a value is not finite, or is too large.
            NotCompilableError: as of `advance`.
        """
        # Those whose first update what samples at the start reads begin before it.
        shown = [leaf for leaf in self._asked if getattr(leaf, "shows_first_update", False)]
        for leaf in shown:
            self._give(self._call(self._at_start)[1])
            self._begin(leaf)
        self._state, read, *_ = self._call(self._at_start)
        self._give(read)
        for block in (*self._stepped.values(), *self._watched):
            block.start()
        for leaf in self._asked:
            if leaf not in shown:
                self._begin(leaf)
        signals, step_signals = self._call(self._shown)
        return signals, step_signals

    def _begin(self, leaf: System) -> None:
        """Lets a leaf make its own updates of the initialization, with the inputs it was given."""
        context = self._asked[leaf]
        self._set(leaf, context, self._state)
        Simulator(leaf, context).Initialize()
        self._state[self._layout.places[leaf]] = discrete_state_of(context.get_discrete_state())

    def fly(self, samples: int) -> NDArray:
        """Starts, and goes on to a sample; the `signals` (1 + instants, size).

        Raises:
            NotFiniteError, NotCompilableError: as of `advance`.
        """
        shown = [self.start()[0][None]]
        while self.samples < samples:
            shown.append(self.advance(samples - self.samples)[0])
        return np.concatenate(shown)

    def advance(self, samples: int = 1) -> tuple[NDArray, NDArray]:
        """Goes on by samples, and ends before the updates of the next one.

        It flies fewer than so many where that is simpler, but one at least. Returns the `signals`
        (instants, size) and the `step_signals` (steps, size) since the last sample, with those at
        its end, of each sample that was flown, one after the other.

        Raises:
            ScenarioError: `samples` is below 1.
            NotFiniteError: a value is not finite, or is too large.
            NotCompilableError: a block does what it has not declared, or has events that are not
                flown.
        """
        require(samples >= 1, "samples", samples, "give 1 or more")
        shown = self._advance(samples)
        for block in self._watched:
            block.watch_to(self.time)
        return shown

    def _advance(self, samples: int) -> tuple[NDArray, NDArray]:
        if self.samples == 0:
            self._state, signals, step_signals = self._call(self._after_sample)
        elif self._whole is None:
            signals, step_signals = self._advance_in_parts()
        else:
            return self._advance_whole(self._whole, samples)
        self.samples += 1
        return self._in_rows(1, signals, step_signals)

    @property
    def no_rows(self) -> tuple[NDArray, NDArray]:
        """Signals and signals of steps (0, size) of no samples."""
        sizes = self._shown.output_sizes
        return np.zeros((0, sizes[0])), np.zeros((0, sizes[1]))

    def _in_rows(self, samples: int, *rows: NDArray) -> tuple[NDArray, NDArray]:
        """Signals, and signals of steps, with a row for each of their instants."""
        signals, step_signals = rows
        per_sample, steps = self._instants
        return (
            signals.reshape(samples * per_sample, -1),
            step_signals.reshape(samples * steps, -1),
        )

    def _advance_whole(self, whole: Evaluation, samples: int) -> tuple[NDArray, NDArray]:
        """Samples in one call, or one of them that blocks make an update for."""
        times, outside = self._outside.of_samples(self.samples, samples)
        inputs = [self._state, self._parameters, self._no_answers]
        state, *rows = whole.fly(inputs, times, outside, self._largest)
        flown = len(rows[0])
        if flown == 0:
            flown = 1
            state, *rows = self._with_answers(whole, outside[0])
        self._state = state
        self.samples += flown
        return self._in_rows(flown, *rows)

    @property
    def lanes(self) -> LaneFunction | None:
        """The function by which it may fly with others, after its first sample; None: alone."""
        if self._in_lanes is None:
            return None
        self._in_lanes.compile_lanes(builds=False)
        return self._in_lanes.lanes

    def lane_inputs(self, samples: int) -> LaneInputs:
        """What the next samples depend on: so many, or fewer."""
        times, outside = self._outside.of_samples(self.samples, samples)
        return LaneInputs(self._largest, self._state, self._parameters, times, outside)

    def take(self, state: NDArray, signals: NDArray, steps: NDArray) -> tuple[NDArray, NDArray]:
        """Goes on as of `advance`, by samples that a LaneFunction has flown."""
        self._state = state
        self.samples += len(signals)
        for block in self._watched:
            block.watch_to(self.time)
        return self._in_rows(len(signals), signals, steps)

    def _with_answers(self, whole: Evaluation, outside: NDArray) -> list[NDArray]:
        """The state, and the signals, after a sample that some blocks' own updates are asked for.

        Raises:
            NotFiniteError: a value is not finite, or is too large.
        """
        own = self._state, self._parameters, np.array([self.time])
        *_, read, is_valid, _ = whole([*own, self._no_answers, outside])
        self._require_finite(float(read @ read))
        self._give(read)
        answers = [
            self._place_of(leaf, self._state) if is_right else self._asked_for(leaf, self._state)
            for leaf, is_right in zip(self._asked, is_valid, strict=True)
        ]
        given = np.concatenate([1.0 - is_valid, *answers])
        state, signals, step_signals, *_ = self._evaluated(whole, *own, given, outside)
        return [state, signals, step_signals]

    def _advance_in_parts(self) -> tuple[NDArray, NDArray]:
        """The signals of a sample, with blocks that are stepped after its updates."""
        before = self._state
        assert self._at_sample is not None
        self._state, read, is_valid = self._call(self._at_sample)
        for block in self._stepped.values():
            block.advance_to(self.time)
        self._give(read)
        for block in self._stepped.values():
            block.update()
        for leaf, is_right in zip(self._asked, is_valid, strict=True):
            if not is_right:
                self._state[self._layout.places[leaf]] = self._asked_for(leaf, before)
        self._state, signals, step_signals = self._call(self._after_sample)
        return signals, step_signals

    def _place_of(self, leaf: System, state: NDArray) -> NDArray:
        """The discrete states of a leaf."""
        return state[self._layout.places[leaf]]

    def _asked_for(self, leaf: System, state: NDArray) -> NDArray:
        """The states that a leaf makes by its own update, from the loop's before the sample."""
        context = self._asked[leaf]
        self._set(leaf, context, state)
        return discrete_state_of(leaf.EvalUniquePeriodicDiscreteUpdate(context))

    def _set(self, leaf: System, context: Context, state: NDArray) -> None:
        """Sets a leaf's own context to the time of the last sample and the loop's states."""
        context.SetTime(self.time)
        set_discrete_values(context, self._place_of(leaf, state))

    def go_to(self, samples: int, state: NDArray) -> None:
        """Goes on from another sample, by its number; 0: `start` comes next.

        The state is all of a flight where no blocks are beside it.
        """
        self.samples, self._state = samples, np.array(state)

    def set_parameters(self, place: slice, values: NDArray) -> None:
        """Sets some of the parameters (p,) from the last sample on."""
        self._parameters[place] = values

    def share(self, other: "CompiledFlight") -> None:
        """Takes what stands outside from what another flight of the loop has evaluated of it.

        Where it is the same in both. One thread alone flies them.
        """
        if all(source.is_like(other._sources[k]) for k, source in self._sources.items()):
            other._outside.keep()
            self._outside = other._outside

    def times_of(self, samples: NDArray) -> NDArray:
        """Times of samples by their numbers (k,), s."""
        return sample_times(samples, self._period)

    def seconds_of_functions(self, samples: int) -> float:
        """Values as of `CompiledLoop`; the flight stays where it is."""
        if self._whole is not None:
            parts = [self._whole]
            _, outside = self._outside.of_samples(self.samples, 1)
            own = self._state, self._parameters, np.array([self.time])
            self._evaluated(self._whole, *own, self._no_answers, outside[0])  # the inputs of now
        else:
            assert self._at_sample is not None
            parts = [self._at_sample, self._after_sample]
            for part in parts:
                self._call(part)
        start = time.perf_counter()
        for _ in range(samples):
            for part in parts:
                part.evaluate()
        return time.perf_counter() - start

    def write_state(self, context: Context, state: NDArray | None = None) -> None:
        """Sets the states of a context of the loop's diagram to those of the last sample.

        Its time stays. Where no blocks are beside the trace, the `state` may be that of another.
        """
        self._layout.write_state(context, self._state if state is None else state)
        for block, stepped in self._stepped.items():
            own = self._layout.diagram.GetMutableSubsystemContext(block, context)
            own.SetStateAndParametersFrom(stepped.context)

    def _give(self, read: NDArray) -> None:
        """Gives blocks that are about to make an update what they read."""
        for fixed, source in self._abstract:
            fixed.GetMutableData().set_value(self._abstract_value(source, self.time))
        start = 0
        for place in self._layout.read:
            values = self._fixed[place].GetMutableData().get_mutable_value()
            end = start + values.size()
            values.SetFromVector(read[start:end])
            start = end

    def _call(self, function: Evaluation) -> list[NDArray]:
        now, ahead = self.time, self._time_after(self._period)
        outside = [self._value(reading, now, ahead) for reading in function.readings]
        own = self._state, self._parameters, np.array([now])
        return self._evaluated(function, *own, *outside)

    def _value(self, reading: Reading, now: float, ahead: float) -> NDArray:
        number, output, offset = reading
        if number in self._sources:
            at = ahead if offset == self._period else now + offset
            return self._sources[number].value(output, at)
        block = self._systems[number]
        return block.get_output_port(output).Eval(self._stepped[block].context)


def _watched(layout: LoopLayout, block: System, context: Context) -> SteppedBlock:
    """A user's own block that is not stepped by itself, to look for events; its inputs stay."""
    own = copied_context(block, layout.diagram.GetSubsystemContext(block, context))
    watched = SteppedBlock(block, own, is_held=False, may_update=updates_in_trace(block))
    if block not in layout.outside:
        watched.require_declared(layout.reads_of(block))
    return watched


def own_context(layout: LoopLayout, block: System, context: Context) -> Context:
    """A context of a block by itself, with time, state and parameters of the loop's."""
    own = block.CreateDefaultContext()
    own.SetTimeStateAndParametersFrom(layout.diagram.GetSubsystemContext(block, context))
    return own


class _Source:
    """Outputs known beforehand: of a block without inputs, or a traced one's functions of time.

    The context is the block's own, by itself: to set the time of a whole loop's is slow.
    """

    def __init__(self, block: Any, context: Context):
        self._block, self._context = block, context
        self._time = math.nan
        self._known: dict[int | str, Any] = {}  # at that time

    def is_like(self, other: "_Source") -> bool:
        """Whether it is certain that another one of the block has the same values."""
        own, others = self._context, other._context
        return own.num_abstract_parameters() == 0 and all(
            np.array_equal(*(c.get_numeric_parameter(k).value() for c in (own, others)))
            for k in range(own.num_numeric_parameter_groups())
        )

    def value(self, output: int | str, at: float) -> Any:
        """Value of a port or a quantity at a time in s."""
        if at != self._time:
            self._context.SetTime(at)
            self._time = at
            self._known.clear()
        if output not in self._known:
            if self._has_rows(output):
                self._known[output] = self._rows([output], np.array([at]))[0][0]
            else:
                self._known[output] = self._block.get_output_port(output).Eval(self._context)
        return self._known[output]

    def values(self, outputs: Sequence[int | str], times: NDArray) -> list[NDArray]:
        """Rows of each of some outputs, at times (k,) in s."""
        given = [output for output in outputs if self._has_rows(output)]
        rows = zip(given, self._rows(given, times), strict=True) if given else ()
        found: dict[int | str, NDArray] = dict(rows)
        others = [output for output in outputs if output not in found]
        evaluated = [[self.value(k, at) for k in others] for at in times.tolist() if others]
        found |= zip(others, map(np.array, zip(*evaluated, strict=True)), strict=True)
        return [found[output] for output in outputs]

    def _has_rows(self, output: int | str) -> bool:
        """Whether the block gives rows of an output, and not its ports alone."""
        if isinstance(output, str):
            return True
        port = self._block.get_output_port(output)
        return has_own(self._block, ROWS) and port.get_data_type() == PortDataType.kVectorValued

    def _rows(self, outputs: Sequence[int | str], times: NDArray) -> list[NDArray]:
        """Values of quantities, or of ports.

        Raises:
            ValueError: the block gives other rows than its ports have.
        """
        if isinstance(outputs[0], str):
            return getattr(self._block, QUANTITIES)(outputs, times)
        ports = [self._block.get_output_port(output) for output in outputs]
        names = [port.get_name() for port in ports]
        given = (self._context,) if hasattr(self._block, TAKE_CONFIG) else ()
        rows = getattr(self._block, ROWS)(names, times, *given)
        for port, own in zip(ports, rows, strict=True):
            if own.shape != (len(times), port.size()):
                name = f"{self._block.get_name()}.{ROWS}"
                raise ValueError(f"{name}: rows {own.shape} of {port.get_name()} ({port.size()})")
        return rows


class _ExogenousInputs:
    """Inputs from outside of the function of a whole sample, for many samples at once."""

    def __init__(self, readings: Sequence[Reading], sources: Mapping[int, _Source], period: float):
        self._readings, self._sources, self._period = readings, sources, period
        self._first = self._end = 0  # samples, of the rows
        self._times = np.zeros(0)
        self._rows = np.zeros((0, 0))
        self._kept: Any = None

    def keep(self) -> None:
        """Keeps rows, made for blocks of samples, for several flights."""
        self._kept = self._kept or functools.lru_cache(_MOST_KEPT)(self._made)

    def of_samples(self, first: int, most: int) -> tuple[NDArray, NDArray]:
        """The times (k,), s, and the rows (k, size) of samples from the first on."""
        if not self._first <= first < self._end:
            self._first, count = first, min(most, _MOST_SAMPLES)
            if self._kept is not None:
                self._first, count = first - first % _MOST_SAMPLES, _MOST_SAMPLES
            self._times, self._rows = (self._kept or self._made)(self._first, count)
            self._end = self._first + count
        chosen = slice(first - self._first, first - self._first + most)
        return self._times[chosen], self._rows[chosen]

    def _made(self, first: int, count: int) -> tuple[NDArray, NDArray]:
        """Each source is evaluated once at each time."""
        ends = sample_times(np.arange(first, first + count + 1), self._period)
        now, after = ends[:-1], ends[1:]
        columns: list[Any] = [None] * len(self._readings)
        for number in dict.fromkeys(reading.system for reading in self._readings):
            own = [k for k, reading in enumerate(self._readings) if reading.system == number]
            at = [
                after if offset == self._period else now + offset
                for offset in (self._readings[k].offset for k in own)
            ]
            times, places = np.unique(np.array(at), return_inverse=True)
            places = places.reshape(len(own), -1)
            outputs = [*dict.fromkeys(self._readings[k].output for k in own)]
            rows = dict(zip(outputs, self._sources[number].values(outputs, times), strict=True))
            for k, place in zip(own, places, strict=True):
                columns[k] = rows[self._readings[k].output][place]
        return now, np.hstack([np.zeros((count, 0)), *columns])
