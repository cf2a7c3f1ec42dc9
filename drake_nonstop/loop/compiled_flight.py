"""A flight of a compiled loop, and what stands beside the trace as it goes on."""

import time
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, System

from drake_nonstop.loop.block_events import SteppedBlock, sample_times
from drake_nonstop.loop.exogenous_inputs import ExogenousInputs, Source
from drake_nonstop.loop.functions import Evaluation, LoopFunctions, Reading
from drake_nonstop.loop.lane_functions import LaneInputs
from drake_nonstop.loop.trace import LoopLayout, Step, discrete_state_of, runge_kutta3
from drake_nonstop.systems.diagram_trace import updates_in_trace
from drake_nonstop.systems.port_state import copied_context, set_discrete_values
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import require


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
            layout.numbers[block]: Source(block, own_context(layout, block, context))
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

    def evaluated(self, function: Evaluation, *inputs: NDArray) -> list[NDArray]:
        """Results of all inputs; raises NotFiniteError where one is not finite, or too large."""
        *results, norm = function(inputs)
        self._require_finite(norm[0])
        return results

    def _require_finite(self, squares: float) -> None:
        if not squares < self._largest**2:
            raise NotFiniteError("the loop", largest=self._largest)


class CompiledFlight(LoopFlight):
    """A flight that `CompiledLoop.fly` makes, which is advanced from sample to sample.

    Attributes:
        side_by_side: the function by which it may fly with others, but for its first sample.
    """

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
        whole = functions.whole
        self._at_sample = Evaluation(functions.at_sample, compiles) if whole is None else None
        self._whole = None if whole is None else Evaluation(whole, compiles)
        self.side_by_side = whole if compiles else None
        self._no_answers = np.zeros(layout.answers_size)
        self._systems = [*layout.numbers]
        self._outside = ExogenousInputs(
            [] if whole is None else whole.readings, self._sources, period, layout.shared_rows
        )
        self._stepped: dict[System, SteppedBlock] = {}
        self._watched = [_watched(layout, block, context) for block in layout.of_users]
        self._fixed: dict[tuple[System, int], Any] = {}
        self._abstract: list[tuple[Any, tuple[System, int]]] = []  # inputs that are no vectors
        self._asked: dict[Any, Context] = {}
        self._begun: dict[Any, tuple[Any, NDArray]] = {}  # what was given to them, and their states
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
        self._initialize()
        signals, step_signals = self._call(self._shown)
        return signals, step_signals

    def initialized(self, state: NDArray) -> NDArray:
        """The state after the initialization's updates from another one; as of `start`.

        Blocks that make updates themselves, with inputs as the last time, are not asked again.
        """
        self.go_to(0, state)
        self._initialize()
        return self.state

    def values_of(self, function: Evaluation, state: NDArray, offset: float = 0.0) -> list[NDArray]:
        """Results of a function, an offset (s) after the last sample, of another state."""
        return self.evaluated(function, state, *self.given_at(function, offset))

    def given_at(self, function: Evaluation, offset: float) -> list[NDArray]:
        """What a function takes besides the state, an offset (s) after the last sample."""
        readings = (each._replace(offset=each.offset + offset) for each in function.readings)
        now, ahead = self.time, self._time_after(self._period)
        outside = [self._value(reading, now, ahead) for reading in readings]
        return [self._parameters, np.array([self._time_after(offset)]), *outside]

    def _initialize(self) -> None:
        # Those whose first update what samples at the start reads begin before it.
        shown = [leaf for leaf in self._asked if getattr(leaf, "shows_first_update", False)]
        for leaf in shown:
            read = self._call(self._at_start)[1]
            self._give(read)
            self._begin(leaf, read)
        self._state, read, *_ = self._call(self._at_start)
        self._give(read)
        for block in (*self._stepped.values(), *self._watched):
            block.start()
        for leaf in self._asked:
            if leaf not in shown:
                self._begin(leaf, read)

    def _begin(self, leaf: System, read: NDArray) -> None:
        """Lets a leaf make its own updates of the initialization, with the inputs it was given."""
        given = read.tobytes(), self._place_of(leaf, self._state).tobytes()
        if leaf not in self._begun or self._begun[leaf][0] != given:
            context = self._asked[leaf]
            self._set(leaf, context, self._state)
            Simulator(leaf, context).Initialize()
            self._begun[leaf] = given, discrete_state_of(context.get_discrete_state())
        self._state[self._layout.places[leaf]] = self._begun[leaf][1]

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
        state, signals, step_signals, *_ = self.evaluated(whole, *own, given, outside)
        return [state, signals, step_signals]

    def _advance_in_parts(self) -> tuple[NDArray, NDArray]:
        """The signals of a sample, with blocks that are stepped after its updates."""
        assert self._at_sample is not None
        self._make_updates(self._at_sample)
        self._state, signals, step_signals = self._call(self._after_sample)
        return signals, step_signals

    def advance_in_steps(
        self, schedule: Sequence[Step], updates: Evaluation, rates: Evaluation
    ) -> NDArray:
        """Goes on by a sample with other steps than the loop's; the `signals` (instants, size).

        The functions are `LoopFunctions.at_sample`, and one whose last result are the rates.
        """
        if self.samples > 0:
            self._make_updates(updates)
        shown = []
        for step in schedule:
            rate = partial(self._rate, rates)
            self._state = runge_kutta3(rate, self._state, step)
            if step.is_shown:
                shown.append(self.values_of(self._shown, self._state, step.end)[0])
        self.samples += 1
        return np.array(shown)

    def _rate(self, rates: Evaluation, state: NDArray, offset: float) -> NDArray:
        return self.values_of(rates, state, offset)[-1]

    def _make_updates(self, updates: Evaluation) -> None:
        """Makes the updates of a sample, with those that blocks make themselves."""
        before = self._state
        self._state, read, is_valid = self._call(updates)
        for block in self._stepped.values():
            block.advance_to(self.time)
        self._give(read)
        for block in self._stepped.values():
            block.update()
        for leaf, is_right in zip(self._asked, is_valid, strict=True):
            if not is_right:
                self._state[self._layout.places[leaf]] = self._asked_for(leaf, before)

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

    def seconds_of_functions(self, samples: int) -> float:
        """Values as of `CompiledLoop`; the flight stays where it is."""
        if self._whole is not None:
            parts = [self._whole]
            _, outside = self._outside.of_samples(self.samples, 1)
            own = self._state, self._parameters, np.array([self.time])
            self.evaluated(self._whole, *own, self._no_answers, outside[0])  # the inputs of now
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
        return self.values_of(function, self._state)

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
