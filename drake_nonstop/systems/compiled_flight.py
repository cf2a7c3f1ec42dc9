"""A flight of a compiled loop, from sample to sample, and flights side by side in lanes."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import ApplySimulatorConfig, InitializeParams, Simulator
from pydrake.systems.framework import Context

from drake_nonstop.mechanics.signal_layouts import by_name
from drake_nonstop.systems.block import set_state_values
from drake_nonstop.systems.diagnosis import source_of_fault
from drake_nonstop.systems.loop_equations import Now
from drake_nonstop.systems.native import Native
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import require

if TYPE_CHECKING:
    from drake_nonstop.systems.compiled_loop import CompiledLoop


_MOST_ROWS = 512  # samples whose rows are made at once
_MOST_SAMPLES = 4096  # that are flown in one call


def sample_times(numbers: Any, period: float) -> Any:
    """The times of samples by their numbers, an array or one, s.

    To the bit as Drake has it of events that begin with a period.
    """
    return (period + (numbers - 1) * period) * (numbers > 0)


class LaneInputs(NamedTuple):
    """What samples of a flight depend on, and room for their signals."""

    times: NDArray  # (samples + 1,), s
    state: NDArray  # (k,), which is written
    parameters: NDArray  # (p,)
    rows: NDArray  # (samples, size)
    shown: NDArray  # (samples, size), which are written
    steps: NDArray  # (samples, size), which are written

    def part(self, first: int, end: int) -> "LaneInputs":
        """Some of the samples."""
        times, state, parameters, *others = self
        own = (each[first:end] for each in others)
        return LaneInputs(times[first : end + 1], state, parameters, *own)


class CompiledFlight:
    """A flight of a `CompiledLoop`, which goes on from sample to sample.

    Attributes:
        loop: what it flies.
        largest: a value beyond it, in SI units, ends the flight.
        samples: the number of those that it has flown.
    """

    def __init__(self, loop: "CompiledLoop", context: Context, largest: float):
        self.loop, self.largest = loop, largest
        self._state, self._parameters = loop.state_of(context), loop.parameters_of(context)
        self._before = self._state  # the updates at the last sample
        self._due: list[int] = []  # layers that have to answer there yet
        self.samples = 0
        self._rows = np.zeros((0, 0))
        self._first = 0  # sample of the rows
        self._asked = {k: _Asked(loop, k, context) for k in loop.layers}

    @property
    def state(self) -> NDArray:
        """The states (k,) of all blocks after the updates at the last sample."""
        self._settle()
        return self._state.copy()

    @property
    def state_before_updates(self) -> NDArray:
        """The states (k,) of all blocks before the updates at the last sample."""
        return self._before.copy()

    @property
    def parameters(self) -> NDArray:
        """The parameters (p,) of all blocks."""
        return self._parameters.copy()

    @property
    def time(self) -> float:
        """That of the last sample, s."""
        return float(sample_times(self.samples, self.loop.control_period))

    def start(self) -> tuple[NDArray, NDArray]:
        """The loop's `signals` (size,) and `step_signals` (size,) after the initialization.

        Raises:
            NotFiniteError: a value is not finite, or is too large.
        """
        self._initialize()
        loop = self.loop
        found = []
        for names in (loop.signals, loop.step_signals):
            made = tuple(loop._makers[name] for name in names)
            found.append(self.evaluated(loop.functions.now("shown", made)))
        return found[0], found[1]

    def initialized(self, state: NDArray) -> NDArray:
        """The state after the initialization's updates from another one; as of `start`.

        Layers that get the same inputs as the last time are not asked again.
        """
        self.go_to(0, state)
        self._initialize()
        return self.state

    def _initialize(self) -> None:
        self._due = []
        first, others = (self.loop.functions.now("start", first=k) for k in (True, False))
        if first is not None:
            self._state = self.evaluated(first)
        state = self._state.copy() if others is None else self.evaluated(others)
        for k, asked in self._asked.items():
            state[self.loop.equations.places[k]] = asked.answer(self)
        self._state = self._before = state

    def evaluated(self, now: Now | None, time: float | None = None) -> NDArray:
        """The result of a function of an instant, at the last sample; as of `start`."""
        assert now is not None
        loop, time = self.loop, self.time if time is None else time
        given = loop.arguments(now, self._state, time, self._parameters)
        found: NDArray = now.function.call(given)[0].full().ravel()
        if not np.all(np.abs(found) < self.largest):
            raise self._divergence()
        return found

    def rates(self, time: float | None = None) -> NDArray:
        """The rates (m,) of the continuous states, at the last sample or another time, s."""
        return self.evaluated(self.loop.functions.now("rates"), time)

    def _settle(self) -> None:
        """Asks the layers that are due at the last sample; all read what was before them."""
        if self._due:
            answers = {k: self._asked[k].answer(self) for k in self._due}
            self._state = self._state.copy()
            for k, answer in answers.items():
                self._state[self.loop.equations.places[k]] = answer
            self._due = []

    def fly(self, samples: int) -> NDArray:
        """Starts, and goes on to a sample; the `signals` (1 + instants, size).

        Raises:
            NotFiniteError: as of `advance`.
        """
        shown = [self.start()[0][None]]
        while self.samples < samples:
            shown.append(self.advance(samples - self.samples)[0])
        return np.concatenate(shown)

    def advance(self, samples: int = 1) -> tuple[NDArray, NDArray]:
        """Goes on by samples, and makes the updates at the last of them.

        It flies fewer than so many where that is simpler, but one at least. Returns the `signals`
        (instants, size) and the `step_signals` (steps, size) since the last sample, with those at
        its end, of each sample that was flown, one after the other.

        Raises:
            ScenarioError: `samples` is below 1.
            NotFiniteError: a value is not finite, or is too large; the flight stands at the last
                sample before that.
        """
        require(samples >= 1, "samples", samples, "give 1 or more")
        (inputs,) = _with_room(self.loop, [self.lane_inputs(samples)])
        evaluator = self.loop.evaluator()
        (made,) = _flown(lambda own: [evaluator.fly(*own[0], self.largest)], [inputs])
        return self.take(*made, inputs)

    def lane_inputs(self, most: int) -> LaneInputs:
        """What the next samples depend on: `most`, or fewer; layers have answered.

        There is no room for the signals.
        """
        self._settle()
        samples = self.free_samples(most)
        times, rows = self.ahead(samples, most)
        none = np.zeros((0, 0))
        return LaneInputs(times, self._state.copy(), self._parameters, rows, none, none)

    def free_samples(self, most: int) -> int:
        """The samples, `most` at the most, up to the next at which a layer is due."""
        due = [each.every - self.samples % each.every for each in self.loop.layers.values()]
        return min(most, _MOST_SAMPLES, *due) if due else min(most, _MOST_SAMPLES)

    def take(self, flown: int, before: NDArray, made: LaneInputs) -> tuple[NDArray, NDArray]:
        """Goes on by samples that were flown; as of `advance`.

        Args:
            flown: how many are finite.
            before: the state at the beginning of the last of them.
            made: the state after the updates at its end, and the signals.
        """
        if flown == 0:
            raise self._divergence()
        loop = self.loop
        moving = loop.equations.moving_size  # no update changes its part
        self._before = np.concatenate([made.state[:moving], before[moving:]])
        self._state = made.state
        self.samples += flown
        self._due = [k for k, layer in loop.layers.items() if self.samples % layer.every == 0]
        return (
            made.shown[:flown].reshape(flown * loop.shown_per_sample, -1),
            made.steps[:flown].reshape(flown * len(loop.step_ends), -1),
        )

    def _divergence(self) -> NotFiniteError:
        """An error that names the block whose value in the next sample is not finite, and the time.

        The diagram flies that sample.
        """
        loop, context = self.loop, self.loop.diagram.CreateDefaultContext()
        loop.write_parameters(context, self._parameters)
        loop.write_state(context, self._before)
        simulator = Simulator(loop.diagram, context)
        ApplySimulatorConfig(loop.config, simulator)  # which sets the time to zero
        context.SetTime(self.time)
        block = "the loop"
        try:
            simulator.Initialize(InitializeParams(suppress_initialization_events=True))
            simulator.AdvanceTo(self.time + loop.control_period)
        except NotFiniteError as error:
            block = source_of_fault(error, loop.diagram, context)
        except Exception:  # of a block that refuses such values
            pass
        return NotFiniteError(f"{block}, at t = {self.time:g} s,", largest=self.largest)

    def ahead(self, samples: int, most: int = 1) -> tuple[NDArray, NDArray]:
        """The times (samples + 1,), s, and the rows (samples, size) of the next samples.

        Rows of `most` samples are made at once, if that is more than one.
        """
        first, period = self.samples, self.loop.control_period
        times = sample_times(np.arange(first, first + samples + 1), period)
        if not self.loop.sample.readings:
            return times, np.zeros((samples, 0))
        end = self._first + len(self._rows)
        if not (self._first <= first and first + samples <= end):
            many = most if most > 1 else max(16, first)
            count = max(samples, min(_MOST_ROWS, many))
            try:
                rows = self.loop.rows_of(first, count)
            except Exception:  # of what may be known no longer than the flight
                if count == samples:
                    raise
                rows = self.loop.rows_of(first, samples)
            self._first, self._rows = first, rows
        start = first - self._first
        return times, np.ascontiguousarray(self._rows[start : start + samples])

    def map_jacobian(self) -> NDArray:
        """The derivatives (k, k) of a map from sample to sample, of a loop without layers.

        Of the state before the updates at the next sample, by that before those at the last one.
        """
        loop, (moving, states) = self.loop, (self.loop.equations.moving_size, len(self._state))
        updates = loop.functions.now("updates", loop.control_period)
        assert updates is not None
        given = loop.arguments(updates, self._before, self.time, self._parameters)
        by_updates, _ = loop.functions.derivative(updates.function).call(given)
        times, rows = self.ahead(1)
        given = [self._state, times, self._parameters, rows[0]]
        by_state = loop.functions.derivative(loop.sample.function).call(given)[0]
        going_on = np.vstack([by_state.full()[:moving], np.eye(states)[moving:]])
        found: NDArray = going_on @ by_updates.full()
        return found

    def go_to(self, samples: int, state: NDArray) -> None:
        """Goes on from the state after the updates at another sample, by its number.

        0: `start` comes next, or the state is one that has started.
        """
        self.samples, self._state, self._due = samples, np.array(state, float), []
        self._before = self._state

    def set_parameters(self, place: slice, values: NDArray) -> None:
        """Sets some of the parameters (p,) from the last sample on."""
        self._parameters[place] = values

    def write_state(self, context: Context, state: NDArray | None = None) -> None:
        """Sets the states of a context of the loop's diagram to those before the last updates.

        A Simulator that goes on from there makes these updates. `state` is one in their place.
        """
        self.loop.write_state(context, self._before if state is None else state)


def _with_room(loop: "CompiledLoop", flights: Sequence[LaneInputs]) -> list[LaneInputs]:
    """The inputs of flights with room for their signals: one array, which pages of memory share."""
    most, count = max(len(each.rows) for each in flights), len(flights)
    signals, of_steps = (sum(sizes.values()) for sizes in _sizes_of(loop))
    shown = np.empty((count, most, loop.shown_per_sample * signals))
    steps = np.empty((count, most, len(loop.step_ends) * of_steps))
    return [
        each._replace(shown=shown[k, : len(each.rows)], steps=steps[k, : len(each.rows)])
        for k, each in enumerate(flights)
    ]


def _flown(
    fly: Callable[[list[LaneInputs]], list[int]], group: Sequence[LaneInputs]
) -> list[tuple[int, NDArray]]:
    """How many samples of each flight are finite, and the state at the beginning of the last one.

    The last sample of each is flown by itself, for the sampled states before its updates.
    """
    starts = [each.state.copy() for each in group]
    ends = [len(each.rows) for each in group]
    counts = fly([each.part(0, end - 1) for each, end in zip(group, ends, strict=True)])
    before = [each.state.copy() for each in group]
    rest = [(each, k) for each, k, end in zip(group, counts, ends, strict=True) if k == end - 1]
    last = iter(fly([each.part(k, k + 1) for each, k in rest]) if rest else [])
    found = []
    for each, start, k, end, own in zip(group, starts, counts, ends, before, strict=True):
        count = k + next(last) if k == end - 1 else k
        if 0 < count < end:  # anew up to the last one that is finite
            each.state[:] = start
            fly([each.part(0, count - 1)])
            own = each.state.copy()
            fly([each.part(count - 1, count)])
        found.append((count, own))
    return found


class _Asked:
    """A layer that is asked beside the function of a sample, in a context of its own."""

    def __init__(self, loop: "CompiledLoop", number: int, context: Context):
        self._layer, self._number = loop.layers[number], number
        self._now = loop.functions.now("read", number)
        own = loop.diagram.GetSubsystemContext(self._layer, context)
        self._context = self._layer.CreateDefaultContext()
        self._context.SetTimeStateAndParametersFrom(own)
        self._sizes = self._layer.equations_of_block.inputs
        self._inputs: dict[str, Any] = {}
        self._begun: tuple[Any, NDArray] | None = None  # what it was given at the start, its answer
        for k in range(self._layer.num_input_ports()):
            port = self._layer.get_input_port(k)
            if port.HasValue(own):  # one that is an object stays
                value = port.FixValue(self._context, port.Eval(own))
                if port.get_name() in self._sizes:
                    self._inputs[port.get_name()] = value

    def answer(self, flight: CompiledFlight) -> NDArray:
        """The next state of the layer, of the signals at the last sample of a flight."""
        read = flight.evaluated(self._now)
        own = flight._state[flight.loop.equations.places[self._number]]
        given = read.tobytes(), own.tobytes()
        if flight.samples == 0 and self._begun is not None and self._begun[0] == given:
            return self._begun[1]
        for name, values in by_name(self._sizes, read).items():
            if name in self._inputs:
                self._inputs[name].GetMutableData().get_mutable_value().SetFromVector(values)
        self._context.SetTime(flight.time)
        set_state_values(self._context, own)
        answer = self._layer.asked(self._context)
        if flight.samples == 0:
            self._begun = given, answer
        return answer


class Advance(NamedTuple):
    """What a flight has shown on its way through some samples, as of `CompiledFlight.advance`."""

    signals: NDArray  # (instants, size)
    step_signals: NDArray  # (steps, size)
    error: BaseException | None  # that ended it before the sample which raised it


class _Way:
    """A flight on its way to a sample, `end`, and what it has shown."""

    def __init__(self, flight: CompiledFlight, samples: int):
        self.flight, self.end = flight, flight.samples + samples
        self.shown: list[tuple[NDArray, NDArray]] = []
        self.error: BaseException | None = None

    @property
    def left(self) -> int:
        """The number of samples that are to be flown."""
        return 0 if self.error else self.end - self.flight.samples

    def advance(self) -> None:
        """Goes on by itself."""
        try:
            self.shown.append(self.flight.advance(self.left))
        except (Exception, SystemExit) as error:  # whatever blocks may raise
            self.error = error

    def take(self, *made: Any) -> None:
        """Takes what was flown beside others, as of `CompiledFlight.take`."""
        try:
            self.shown.append(self.flight.take(*made))
        except NotFiniteError as error:
            self.error = error

    def lane_inputs(self) -> LaneInputs | None:
        """As of the flight; None: a layer has raised."""
        try:
            return self.flight.lane_inputs(self.left)
        except (Exception, SystemExit) as error:  # whatever blocks may raise
            self.error = error
            return None

    def result(self) -> Advance:
        """All that it has shown."""
        if not self.shown:
            none = [np.zeros((0, sum(s.values()))) for s in _sizes_of(self.flight.loop)]
            return Advance(none[0], none[1], self.error)
        if len(self.shown) == 1:
            return Advance(*self.shown[0], self.error)
        signals, step_signals = map(np.concatenate, zip(*self.shown, strict=True))
        return Advance(signals, step_signals, self.error)


def _sizes_of(loop: "CompiledLoop") -> tuple[dict[str, int], dict[str, int]]:
    return loop.signals, loop.step_signals


def advance_together(flights: Sequence[CompiledFlight], samples: Sequence[int]) -> list[Advance]:
    """Goes on with each flight by all of its samples (one or more), in the order given.

    Flights of one function fly in the lanes of a processor core, where these are compiled; others
    one by one: each as it would alone. A flight that raises keeps what it had shown before, and
    stands at its last sample; the others go on.

    Raises:
        ScenarioError: a number of samples is below 1.
    """
    for count in samples:
        require(count >= 1, "samples", count, "give 1 or more")
    ways = [_Way(flight, count) for flight, count in zip(flights, samples, strict=True)]
    together: dict[Any, list[_Way]] = {}
    for way in ways:
        loop = way.flight.loop
        together.setdefault((id(loop.functions), loop._key, way.flight.largest), []).append(way)
    for own in together.values():
        lanes = own[0].flight.loop.lanes() if len(own) > 1 else None
        while lanes is not None and len(own) > 1:
            _advance_in_lanes(lanes, own)
            own = [way for way in own if way.left]
    for way in ways:
        while way.left:
            way.advance()
    return [way.result() for way in ways]


def _advance_in_lanes(lanes: Native, ways: Sequence[_Way]) -> None:
    """Goes on with each flight until its end, or the next sample at which a layer is due."""
    given = [(way, inputs) for way in ways if (inputs := way.lane_inputs()) is not None]
    if not given:
        return
    roomy = _with_room(ways[0].flight.loop, [inputs for _, inputs in given])
    given = [(way, inputs) for (way, _), inputs in zip(given, roomy, strict=True)]
    groups = [given[k : k + lanes.lanes] for k in range(0, len(given), lanes.lanes)]

    largest = ways[0].flight.largest

    def fly(group: Sequence[tuple[_Way, LaneInputs]]) -> list[tuple[int, NDArray]]:
        return _flown(lambda own: lanes.fly_lanes(own, largest), [inputs for _, inputs in group])

    with ThreadPoolExecutor(os.cpu_count()) as pool:  # C is without Python's lock
        flown = pool.map(fly, groups) if len(groups) > 1 else map(fly, groups)
        for group, made in zip(groups, flown, strict=True):
            for (way, inputs), own in zip(group, made, strict=True):
                way.take(*own, inputs)
