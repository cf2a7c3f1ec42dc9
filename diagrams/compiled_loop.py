"""A sampled loop as traced functions from sample to sample, equal to its diagram to rounding.

At a sample, Drake's Simulator first makes the unrestricted updates, all at once, then the discrete
ones, and integrates to the next sample. So does the trace: `at_sample` makes both kinds of updates,
`after_sample` takes the steps of the third-order Runge-Kutta method and shows all signals at the
end of them, before the next updates.

A block that is traced may ask to make an update itself, such as an optimization layer where its
last answer does not do: it has `traced_attempt(at)`, which returns its states after the sample,
and whether they hold, in place of `traced_update(at)`.

Blocks that cannot be traced stand outside. One without inputs is evaluated at the instants at
which it is read. One whose outputs change at samples only is stepped by a Simulator of its own,
between the two functions. Where there is none, both are one function.
"""

import itertools
import math
import time
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator, SimulatorConfig
from pydrake.systems.framework import Context, Diagram, DiscreteValues, PortDataType, System

from drake_nonstop.blocks.sample_and_hold import SampleAndHold
from drake_nonstop.blocks.speed_bound_layer import COMMAND
from drake_nonstop.systems.compilation import compiled
from drake_nonstop.systems.diagram_trace import (
    At,
    Instant,
    Wires,
    is_traceable,
    leaves,
    rates,
    trace_content,
)
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError, object_array
from drake_nonstop.validation import ScenarioError, require, require_known

_MAX_STEPS = 20  # in a sample: all of them are in one trace
_ROUNDING = 1e-9  # s, of a duration
_STRETCH = 1.01  # of the longest step: a last one that is as much longer is one step


class Reading(NamedTuple):
    """A port of a block outside, and when it is read."""

    block: int  # its number in the diagram
    port: int
    offset: float  # s, after the sample


@dataclass
class _Symbols:
    """The symbols of a function for what stands outside, in the order in which it is read."""

    numbers: Mapping[System, int]  # of the diagram's blocks
    readings: list[Reading] = field(default_factory=list)
    symbols: list[casadi.SX] = field(default_factory=list)

    def at(self, offset: float) -> Any:
        """Gives the values of ports at an instant."""

        def give(block: System, port: int) -> NDArray:
            reading = Reading(self.numbers[block], port, offset)
            if reading not in self.readings:
                size = block.get_output_port(port).size()
                self.readings.append(reading)
                self.symbols.append(casadi.SX.sym("outside", size))
            return object_array(self.symbols[self.readings.index(reading)])

        return give


def reason_against(diagram: Diagram, config: SimulatorConfig, control_period: float) -> str:
    """Why a loop cannot be a `CompiledLoop`, in words; empty where it can."""
    if not control_period > 0:
        return f"control_period = {control_period:g}: it goes from sample to sample"
    if config.integration_scheme != "runge_kutta3" or config.use_error_control:
        return "simulator_config: it takes the steps of runge_kutta3 without error control"
    steps = math.ceil(control_period / config.max_step_size - 1e-9)
    if steps > _MAX_STEPS:
        return f"simulator_config.max_step_size: {steps} steps a sample, at most {_MAX_STEPS}"
    if diagram.num_input_ports() > 0:
        names = [diagram.get_input_port(k).get_name() for k in range(diagram.num_input_ports())]
        return f"inputs = {', '.join(names)}: it has none from outside of the loop"
    wires = Wires(diagram)
    for block in diagram.GetSystems():
        for k in range(block.num_input_ports()):
            is_command = block.get_input_port(k).get_name() == COMMAND
            if is_command and wires.source(block, k) is not None:
                return f"{block.get_name()} reads {COMMAND}: the diagram checks its range"
        if is_traceable(block):
            for leaf in leaves(block):
                own = _period_of(leaf)
                if own not in (None, control_period):
                    return f"control_period = {control_period:g}: {block.get_name()} has {own:g}"
            continue
        if block.num_input_ports() == 0:
            is_known = block.CreateDefaultContext().is_stateless()
        else:
            is_known = _is_held(block, wires)
        if not is_known:
            return f"{block.get_name()} = {type(block).__name__}: it has no equations to be traced"
        for k in range(block.num_input_ports()):
            source, port = wires.source(block, k), block.get_input_port(k)
            is_vector = port.get_data_type() == PortDataType.kVectorValued
            if source is not None and not is_vector and source[0].num_input_ports() > 0:
                return f"{block.get_name()} reads {port.get_name()}, which is no vector of numbers"
    return ""


def _period_of(leaf: Any) -> float | None:
    """The period, s, of a leaf's own updates, as far as it is known."""
    if isinstance(leaf, SampleAndHold):
        return leaf.period
    if not (hasattr(leaf, "traced_update") or hasattr(leaf, "traced_attempt")):
        return None
    timing = leaf.GetUniquePeriodicDiscreteUpdateAttribute()
    return None if timing is None else timing.period_sec()


def _steps_to(interval: float, longest: float) -> list[float]:
    """The steps, s, that Drake's integrators take in an interval: a last one may be shorter."""
    steps = []
    left = interval
    while left > _STRETCH * longest:
        steps.append(longest)
        left -= longest
    return [*steps, left]


def _is_held(block: System, wires: Wires) -> bool:
    """Whether a block's outputs change at samples only: no input feeds through, no state moves."""
    if not getattr(block, "is_sampled", False):
        return False
    connected = [k for k in range(block.num_input_ports()) if wires.source(block, k) is not None]
    outputs = range(block.num_output_ports())
    is_fed = any(block.HasDirectFeedthrough(k, i) for k in connected for i in outputs)
    return not is_fed and block.CreateDefaultContext().num_continuous_states() == 0


class _Traced(NamedTuple):
    """Results in symbols, of arguments and of what stands outside."""

    results: list[casadi.SX]
    arguments: list[casadi.SX]
    symbols: _Symbols


@dataclass
class _Functions:
    """What loops of one content are traced to."""

    at_start: "_Function"
    shown: "_Function"
    after_sample: "_Function"
    at_sample: "_Function | None"  # where blocks are stepped between it and `after_sample`
    whole: "_Function | None"  # where none are: both in one
    samples: int = 0  # that loops have asked for

    @property
    def of_samples(self) -> list["_Function"]:
        """Those that are evaluated at every sample, or nearly."""
        parts = [self.at_sample, self.after_sample] if self.whole is None else [self.whole]
        return [part for part in parts if part is not None]

    def compile(self, samples: int | None) -> None:
        """Takes C in place of the virtual machine, as `CompiledLoop` says."""
        self.samples += samples or 0
        builds = samples is None or self.samples >= _WORTH_COMPILING
        for function in self.of_samples:
            function.compile(builds)


_functions: dict[Any, _Functions] = {}  # of the last loops
_MOST_FUNCTIONS = 32
_WORTH_COMPILING = 20_000  # samples, 2 s in the virtual machine


class CompiledLoop:
    """A loop that is stepped from sample to sample.

    Args:
        diagram: the loop, with a control period.
        config: the integrator's step.
        control_period: s.
        signal_period: s, between the instants at which signals are shown, at which a step of the
            integrator ends, too; a whole part of the control period, or None: every sample.
        signals: those that are shown at these instants, names of the diagram's vector-valued
            output ports; None: all of them.
        step_signals: those that are shown at the end of every step of the integrator.
        compiles: whether the functions are compiled as C, see `systems.compilation`; if not,
            CasADi's virtual machine evaluates them, to the same numbers in ten times the time.
        samples: how many are to be flown. Where C is in the cache it is used; else it is compiled,
            which takes seconds, where this process has more of them to fly than it pays for.
            None: it is compiled at once.

    Attributes:
        diagram: as given.
        control_period: as given.
        signals: the names of the signals with their sizes, in order.
        step_signals: likewise.
        step_ends: (steps,), s, where the integrator's steps end after a sample.
        shown_per_sample: the number of the signals' instants in a sample.

    Raises:
        ScenarioError: the loop cannot be traced, see `reason_against`, or the signals' period is no
            part of the control period.
    """

    def __init__(
        self,
        diagram: Diagram,
        config: SimulatorConfig,
        control_period: float,
        *,
        signal_period: float | None = None,
        signals: Collection[str] | None = None,
        step_signals: Collection[str] = (),
        compiles: bool = True,
        samples: int | None = None,
    ):
        reason = reason_against(diagram, config, control_period)
        if reason:
            raise ScenarioError(f"{reason}; simulate its diagram, or change that")
        self.diagram, self.control_period = diagram, control_period
        shown = control_period / (signal_period or control_period)
        self.shown_per_sample = round(shown)
        is_whole = self.shown_per_sample > 0 and math.isclose(shown, self.shown_per_sample)
        remedy = f"give a whole part of the control period, {control_period:g} s"
        require(is_whole, "signal_period", signal_period, remedy)
        between = control_period / self.shown_per_sample  # a step ends at each signal
        self._steps = _steps_to(between, config.max_step_size)
        self.step_ends = np.cumsum([*self._steps] * self.shown_per_sample)
        blocks = diagram.GetSystems()
        self._outside = {block for block in blocks if not is_traceable(block)}
        self._held = [b for b in blocks if b in self._outside and b.num_input_ports() > 0]
        ports = [diagram.get_output_port(k) for k in range(diagram.num_output_ports())]
        vectors = [p for p in ports if p.get_data_type() == PortDataType.kVectorValued]
        sizes = {port.get_name(): port.size() for port in vectors}
        for name in (*(signals or ()), *step_signals):
            require_known(name, [*sizes], "signals", name)
        self.signals = {name: sizes[name] for name in (sizes if signals is None else signals)}
        self.step_signals = {name: sizes[name] for name in step_signals}
        self._compiles = compiles
        self._prepare()
        if compiles:
            self._functions.compile(samples)

    def _prepare(self) -> None:
        root = self.diagram.CreateDefaultContext()
        self._wires = Wires(self.diagram)
        self._numbers = {block: k for k, block in enumerate(self.diagram.GetSystems())}
        self._leaves = [
            leaf
            for block in self.diagram.GetSystems()
            if block not in self._outside
            for leaf in leaves(block)
        ]
        self._state_sizes = {
            leaf: _state_sizes(self.diagram.GetSubsystemContext(leaf, root))
            for leaf in self._leaves
        }
        ends = np.cumsum([0, *map(sum, self._state_sizes.values())])
        self._places = {  # of the discrete states, in the loop's
            leaf: slice(start + sizes[0], end)
            for (leaf, sizes), (start, end) in zip(
                self._state_sizes.items(), itertools.pairwise(ends), strict=True
            )
        }
        self._attempting = [leaf for leaf in self._leaves if hasattr(leaf, "traced_attempt")]
        self._with_parameters = [
            leaf
            for leaf in self._leaves
            if self.diagram.GetSubsystemContext(leaf, root).num_numeric_parameter_groups() > 0
        ]
        self._read = [
            (block, k)
            for block in [*self._held, *self._attempting]
            for k in range(block.num_input_ports())
            if block.get_input_port(k).get_data_type() == PortDataType.kVectorValued
            and self._wires.source(block, k) is not None
        ]
        sizes = [
            len(_parameters_of(leaf, self.diagram.GetSubsystemContext(leaf, root)))
            for leaf in self._with_parameters
        ]
        key = self._key(sizes)
        functions = _functions.pop(key, None) or self._traced(sizes)
        if key is not None:
            _functions[key] = functions
            if len(_functions) > _MOST_FUNCTIONS:
                _functions.pop(next(iter(_functions)), None)
        self._functions = functions

    def _key(self, parameter_sizes: list[int]) -> Any:
        """What the functions depend on, which can be hashed; None: it is not known."""
        content = trace_content(self.diagram, self._wires, self._outside.__contains__)
        if content is None:
            return None
        ports = []
        for name in (*self.signals, *self.step_signals):
            port = self.diagram.GetOutputPort(name).get_index()
            system, index = self.diagram.get_output_port_locator(port)
            ports.append((self._numbers[system], int(index)))
        states = tuple(map(tuple, self._state_sizes.values()))
        periods = self.control_period, self.shown_per_sample, *self._steps
        return content, tuple(ports), len(self.signals), states, *parameter_sizes, periods

    def _traced(self, parameter_sizes: list[int]) -> "_Functions":
        groups = [size for sizes in self._state_sizes.values() for size in sizes]
        state = casadi.SX.sym("x", sum(groups))
        parameters = casadi.SX.sym("p", sum(parameter_sizes))
        time = casadi.SX.sym("t", 1)
        values = np.split(object_array(parameters), np.cumsum(parameter_sizes)[:-1])
        self._parameters = dict(zip(self._with_parameters, values, strict=False))
        arguments = [state, parameters, time]
        start = self._make_updates(arguments, is_start=True)
        updates = self._make_updates(arguments, is_start=False)
        steps = self._make_steps(arguments)
        has_parts = bool(self._held)
        return _Functions(
            at_start=_Function(start, is_frequent=False),
            shown=_Function(self._make_shown(arguments), is_frequent=False),
            after_sample=_Function(steps, is_frequent=has_parts),
            at_sample=_Function(updates, is_frequent=True) if has_parts else None,
            whole=None if has_parts else self._make_whole(arguments, updates, steps),
        )

    def _instant(self, states: Mapping[System, list[NDArray]], time: Any, outside: Any) -> Instant:
        return Instant(
            self._wires,
            dict(states),
            self._parameters,
            time,
            outside,
            self._outside.__contains__,
        )

    def _states(self, state: NDArray) -> dict[System, list[NDArray]]:
        """The parts of the state, by leaves and groups."""
        found, start = {}, 0
        for leaf, sizes in self._state_sizes.items():
            ends = start + np.cumsum([0, *sizes])
            found[leaf] = [state[a:b] for a, b in itertools.pairwise(ends)]
            start = ends[-1]
        return found

    def _make_whole(
        self, arguments: list[casadi.SX], updates: _Traced, steps: _Traced
    ) -> "_Function":
        """The state and all signals at the next sample, and what `updates` tells besides.

        A further argument has the states that blocks have made themselves, and which have.
        """
        state, parameters, time = arguments
        symbols, blocks = _Symbols(self._numbers), self.diagram.GetSystems()

        def results_of(traced: _Traced, state: casadi.SX) -> list[casadi.SX]:
            outside = [
                symbols.at(r.offset)(blocks[r.block], r.port) for r in traced.symbols.readings
            ]
            old = casadi.vertcat(*arguments, *traced.symbols.symbols)
            new = casadi.vertcat(state, parameters, time, *itertools.chain(*outside))
            return casadi.Function("part", [old], traced.results)(new)

        answers = casadi.SX.sym("a", self._answers_size)
        after, read, keeps = results_of(updates, state)
        start = len(self._attempting)
        for k, leaf in enumerate(self._attempting):
            place = self._places[leaf]
            end = start + place.stop - place.start
            after[place] = casadi.if_else(answers[k], answers[start:end], after[place])
            start = end
        results = [*results_of(steps, after), read, keeps]
        return _Function(_Traced(results, [*arguments, answers], symbols), is_frequent=True)

    @property
    def _answers_size(self) -> int:
        """Of the argument of a whole sample: which blocks give their states, and these."""
        sizes = [1 + sum(self._state_sizes[leaf][1:]) for leaf in self._attempting]
        return sum(sizes)

    def _make_updates(self, arguments: list[casadi.SX], *, is_start: bool) -> _Traced:
        """The state after a sample's updates, and what the blocks that are held read."""
        state, _, time = arguments
        symbols = _Symbols(self._numbers)
        states = self._states(object_array(state))
        instant = self._instant(states, object_array(time), symbols.at(0.0))
        updating = [leaf for leaf in self._leaves if hasattr(leaf, "traced_update")]
        if is_start:
            updating = [leaf for leaf in updating if getattr(leaf, "updates_at_start", False)]
        first = {leaf for leaf in updating if getattr(leaf, "updates_first", False)}
        if is_start:
            first |= {leaf for leaf in updating if getattr(leaf, "starts_first", False)}
        after = dict(states)
        for leaf in first:
            after[leaf] = _updated(leaf, instant, states, is_start)
        instant = self._instant(after, object_array(time), symbols.at(0.0))
        last = dict(after)
        for leaf in updating:
            if leaf not in first:
                last[leaf] = _updated(leaf, instant, after, is_start)
        keeps: list[Any] = []
        for leaf in self._attempting if not is_start else ():
            values, kept = leaf.traced_attempt(At(instant, leaf))
            last[leaf] = [last[leaf][0], *values]
            keeps.append(kept)
        found = (instant.input(*place) for place in self._read)
        read = [values for values in found if values is not None]
        results = [_stacked(last), _joined(read), _joined([np.array(keeps)])]
        return _Traced(results, arguments, symbols)

    def _make_shown(self, arguments: list[casadi.SX]) -> _Traced:
        """All signals at an instant, as the states are."""
        state, _, time = arguments
        symbols = _Symbols(self._numbers)
        instant = self._instant(
            self._states(object_array(state)), object_array(time), symbols.at(0.0)
        )
        results = [_joined(self._at(instant, s)) for s in (self.signals, self.step_signals)]
        return _Traced(results, arguments, symbols)

    def _at(self, instant: Instant, signals: Iterable[str]) -> list[NDArray]:
        """What signals show at an instant."""
        found = []
        for name in signals:
            port = self.diagram.GetOutputPort(name).get_index()
            system, index = self.diagram.get_output_port_locator(port)
            found.append(instant.output(system, int(index)))
        return found

    def _make_steps(self, arguments: list[casadi.SX]) -> _Traced:
        """The state and all signals at the next sample, before its updates."""
        state, _, time = arguments
        symbols = _Symbols(self._numbers)
        states = self._states(object_array(state))
        moving = [leaf for leaf, sizes in self._state_sizes.items() if sizes[0] > 0]
        start = object_array(time)

        def rate(now: dict[System, NDArray], offset: float) -> dict[System, NDArray]:
            own = {leaf: [now[leaf], *states[leaf][1:]] for leaf in moving}
            instant = self._instant(states | own, start + offset, symbols.at(offset))
            return {leaf: rates(leaf, instant) for leaf in moving}

        def moved(by: Iterable[tuple[float, dict[System, NDArray]]]) -> dict[System, NDArray]:
            total = dict(now)
            for factor, rate in by:
                total = {leaf: total[leaf] + factor * rate[leaf] for leaf in moving}
            return total

        now = {leaf: states[leaf][0] for leaf in moving}
        signals, step_signals = [], []
        for k in range(self.shown_per_sample):
            begin = k * self.control_period / self.shown_per_sample
            for number, step in enumerate(self._steps, start=1):
                first = rate(now, begin)
                second = rate(moved([(step / 2, first)]), begin + step / 2)
                third = rate(moved([(-step, first), (2 * step, second)]), begin + step)
                weights = (step / 6, first), (2 * step / 3, second), (step / 6, third)
                now = moved(weights)
                begin += step
                is_shown = number == len(self._steps)
                if is_shown:  # to the bit at the next sample, where what stands outside is read
                    begin = (k + 1) * self.control_period / self.shown_per_sample
                end = states | {leaf: [now[leaf], *states[leaf][1:]] for leaf in moving}
                instant = self._instant(end, start + begin, symbols.at(begin))
                step_signals += self._at(instant, self.step_signals)
                signals += self._at(instant, self.signals if is_shown else ())
        results = [_stacked(end), _joined(signals), _joined(step_signals)]
        return _Traced(results, arguments, symbols)

    def fly(self, context: Context, largest: float = LARGEST) -> "CompiledFlight":
        """A flight from a context of the diagram, at t = 0, which stays as it is.

        Args:
            context: of the diagram.
            largest: a value beyond it, in SI units, raises NotFiniteError.

        Raises:
            ScenarioError: the context is at another time.
        """
        require(context.get_time() == 0, "context.time", context.get_time(), "start at 0")
        return CompiledFlight(self, context, largest)

    @property
    def blocks_beside(self) -> list[str]:
        """The names of the blocks that are stepped by Simulators of their own."""
        return [block.get_name() for block in self._held]

    @property
    def is_compiled(self) -> bool:
        """Whether it is evaluated as C, and not by CasADi's virtual machine."""
        found = [function.compiled for function in self._functions.of_samples]
        return self._compiles and None not in found

    def seconds_of_functions(self, context: Context, samples: int) -> float:
        """The time, s, that the traced functions alone take for so many samples."""
        flight = self.fly(context)
        flight.start()
        flight.advance()
        return flight.seconds_of_functions(samples)

    def run(self, context: Context, duration: float) -> tuple[NDArray, dict[str, NDArray]]:
        """The times (instants,), s, and the signals (instants, size) by their names.

        A stall, which ends a run of `simulate`, does not end it.

        Args:
            context: of the diagram, at t = 0, which stays as it is.
            duration: s, a multiple of the control period.

        Raises:
            ScenarioError: the duration is no such multiple, or the context is at another time.
            NotFiniteError: a value is not finite, or is too large.
        """
        samples = round(duration / self.control_period) if math.isfinite(duration) else -1
        is_multiple = samples >= 0 and abs(samples * self.control_period - duration) < _ROUNDING
        remedy = f"give a multiple of the control period, {self.control_period:g} s"
        require(is_multiple, "duration", duration, remedy)
        flight = self.fly(context)
        shown = [flight.start()[0][None]]
        shown += [flight.advance()[0] for _ in range(samples)]
        rows = np.concatenate(shown)
        ends = np.cumsum([*self.signals.values()])[:-1]
        times = self.control_period / self.shown_per_sample * np.arange(len(rows))
        return times, dict(zip(self.signals, np.split(rows, ends, axis=1), strict=True))


class CompiledFlight:
    """A flight of a `CompiledLoop`, which is advanced from sample to sample.

    Attributes:
        samples: the number of those that it has flown.
    """

    def __init__(self, loop: CompiledLoop, context: Context, largest: float):
        self._loop, self._largest = loop, largest
        functions, compiles = loop._functions, loop._compiles
        self._at_start = _Evaluation(functions.at_start, compiles)  # with memory of its own
        self._shown = _Evaluation(functions.shown, compiles)
        self._after_sample = _Evaluation(functions.after_sample, compiles)
        at_sample, whole = functions.at_sample, functions.whole
        self._at_sample = None if at_sample is None else _Evaluation(at_sample, compiles)
        self._whole = None if whole is None else _Evaluation(whole, compiles)
        self._no_answers = np.zeros(loop._answers_size)
        own = loop.diagram.CreateDefaultContext()
        own.SetTimeStateAndParametersFrom(context)
        self._sources = {
            block: _Source(block, loop.diagram.GetSubsystemContext(block, own))
            for block in loop._outside
            if block not in loop._held
        }
        self._state = np.concatenate(
            [_state_of(loop.diagram.GetSubsystemContext(leaf, own)) for leaf in loop._leaves]
            or [np.zeros(0)]
        )
        self._parameters = np.concatenate(
            [
                _parameters_of(leaf, loop.diagram.GetSubsystemContext(leaf, own))
                for leaf in loop._with_parameters
            ]
            or [np.zeros(0)]
        )
        self._blocks = loop.diagram.GetSystems()
        self.samples = 0
        self._simulators = {}
        self._fixed: dict[tuple[System, int], Any] = {}
        self._abstract: list[tuple[Any, tuple[System, int]]] = []  # inputs that are no vectors
        self._asked: dict[System, Context] = {}
        for block in (*loop._held, *loop._attempting):
            context = block.CreateDefaultContext()
            context.SetTimeStateAndParametersFrom(loop.diagram.GetSubsystemContext(block, own))
            for k in range(block.num_input_ports()):
                self._fix(block, context, k)
            if block in loop._held:
                self._simulators[block] = Simulator(block, context)
            else:
                self._asked[block] = context

    def _fix(self, block: System, context: Context, k: int) -> None:
        """Gives a held block's input a value: of an abstract one that of its source."""
        port = block.get_input_port(k)
        if (block, k) in self._loop._read:
            self._fixed[block, k] = port.FixValue(context, np.zeros(port.size()))
            return
        source = self._loop._wires.source(block, k)
        if source is None:
            return
        value = self._sources[source[0]].value(source[1], 0.0)
        self._abstract.append((port.FixValue(context, value), source))

    def start(self) -> tuple[NDArray, NDArray]:
        """The loop's `signals` (size,) and `step_signals` (size,) after the initialization."""
        self._state, read, _ = self._call(self._at_start)
        self._give(read)
        for simulator in self._simulators.values():
            simulator.Initialize()
        for leaf, context in self._asked.items():
            self._set(leaf, context, self._state)
            Simulator(leaf, context).Initialize()
            self._state[self._loop._places[leaf]] = _discrete_of(context.get_discrete_state())
        signals, step_signals = self._call(self._shown)
        return signals, step_signals

    def advance(self) -> tuple[NDArray, NDArray]:
        """Goes on to the next sample, before its updates.

        Returns:
            The `signals` (instants, size), and the `step_signals` (steps, size), since the last
            sample, with those at its end.

        Raises:
            NotFiniteError: a value is not finite, or is too large.
        """
        if self.samples == 0:
            self._state, signals, step_signals = self._call(self._after_sample)
        elif self._whole is not None:
            signals, step_signals = self._advance_whole(self._whole)
        else:
            signals, step_signals = self._advance_in_parts()
        self.samples += 1
        shown, steps = self._loop.shown_per_sample, len(self._loop.step_ends)
        return signals.reshape(shown, -1), step_signals.reshape(steps, -1)

    def _advance_whole(self, whole: "_Evaluation") -> tuple[NDArray, NDArray]:
        """The signals of a sample in one call, or in a second one with what blocks answer."""
        state, signals, step_signals, read, keeps = self._call(whole, self._no_answers)
        if not keeps.all():
            self._give(read)
            answers = [
                self._place_of(leaf, self._state) if kept else self._asked_for(leaf, self._state)
                for leaf, kept in zip(self._asked, keeps, strict=True)
            ]
            given = np.concatenate([1.0 - keeps, *answers])
            state, signals, step_signals, *_ = self._call(whole, given)
        self._state = state
        return signals, step_signals

    def _advance_in_parts(self) -> tuple[NDArray, NDArray]:
        """The signals of a sample, with blocks that are stepped after its updates."""
        before = self._state
        assert self._at_sample is not None
        self._state, read, keeps = self._call(self._at_sample)
        for simulator in self._simulators.values():
            simulator.AdvanceTo(self.time)
        self._give(read)
        for simulator in self._simulators.values():
            simulator.AdvancePendingEvents()
        for leaf, kept in zip(self._asked, keeps, strict=True):
            if not kept:
                self._state[self._loop._places[leaf]] = self._asked_for(leaf, before)
        self._state, signals, step_signals = self._call(self._after_sample)
        return signals, step_signals

    def _place_of(self, leaf: System, state: NDArray) -> NDArray:
        """The discrete states of a leaf."""
        return state[self._loop._places[leaf]]

    def _asked_for(self, leaf: System, state: NDArray) -> NDArray:
        """The states that a leaf makes by its own update, from the loop's before the sample."""
        context = self._asked[leaf]
        self._set(leaf, context, state)
        return _discrete_of(leaf.EvalUniquePeriodicDiscreteUpdate(context))

    def _set(self, leaf: System, context: Context, state: NDArray) -> None:
        """Sets a leaf's own context to the time of the last sample and the loop's states."""
        context.SetTime(self.time)
        sizes = self._loop._state_sizes[leaf][1:]
        parts = np.split(self._place_of(leaf, state), np.cumsum(sizes)[:-1])
        for group, values in enumerate(parts):
            context.SetDiscreteState(group, values)

    @property
    def state(self) -> NDArray:
        """The states of all traced blocks at the last sample, before its updates, stacked."""
        return self._state.copy()

    def go_to(self, samples: int, state: NDArray) -> None:
        """Goes on from another sample; that is all of a flight where no blocks are beside it.

        Args:
            samples: the number of those that were flown; 0: `start` comes next.
            state: as of `state`.
        """
        self.samples, self._state = samples, np.array(state)

    @property
    def time(self) -> float:
        """That of the last sample, s."""
        return self._time()

    def seconds_of_functions(self, samples: int) -> float:
        """As of `CompiledLoop`; the flight stays where it is."""
        if self._whole is not None:
            parts = [self._whole]
            self._call(self._whole, self._no_answers)  # with the inputs of now
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

        Its time stays.

        Args:
            context: of the diagram.
            state: that of another sample, as of `state`, where no blocks are beside the trace.
        """
        start, values_of_all = 0, self._state if state is None else state
        for leaf, sizes in self._loop._state_sizes.items():
            own = self._loop.diagram.GetMutableSubsystemContext(leaf, context)
            continuous, *discrete = np.split(
                values_of_all[start : start + sum(sizes)], np.cumsum(sizes)[:-1]
            )
            if len(continuous):
                own.SetContinuousState(continuous)
            for group, values in enumerate(discrete):
                own.SetDiscreteState(group, values)
            start += sum(sizes)
        for block, simulator in self._simulators.items():
            own = self._loop.diagram.GetMutableSubsystemContext(block, context)
            own.SetStateAndParametersFrom(simulator.get_context())

    def _time(self, ahead: int = 0) -> float:
        """That of the last sample, or of one after it, s.

        To the bit as Drake has it of events that begin with a period.
        """
        period, number = self._loop.control_period, self.samples + ahead
        return period + (number - 1) * period if number > 0 else 0.0

    def _give(self, read: NDArray) -> None:
        """Gives blocks that are about to make an update what they read."""
        for fixed, (maker, index) in self._abstract:
            fixed.GetMutableData().set_value(self._sources[maker].value(index, self.time))
        start = 0
        for place in self._loop._read:
            values = self._fixed[place].GetMutableData().get_mutable_value()
            end = start + values.size()
            values.SetFromVector(read[start:end])
            start = end

    def _call(self, function: "_Evaluation", *answers: NDArray) -> list[NDArray]:
        time = self._time()
        outside = [self._value(reading, time) for reading in function.readings]
        own = self._state, self._parameters, np.array([time]), *answers
        *results, norm = function([*own, *(outside or [np.zeros(1)])])
        if not norm[0] < self._largest**2:
            raise NotFiniteError("the loop")
        return results

    def _value(self, reading: Reading, time: float) -> NDArray:
        number, port, offset = reading
        block = self._blocks[number]
        if block in self._sources:
            is_next = offset == self._loop.control_period
            return self._sources[block].value(port, self._time(1) if is_next else time + offset)
        return block.get_output_port(port).Eval(self._simulators[block].get_context())


class _Source:
    """A block without inputs, in a context of its own: to set the time of a loop's is slow."""

    def __init__(self, block: System, context: Context):
        self._context = block.CreateDefaultContext()
        self._context.SetTimeStateAndParametersFrom(context)
        self._ports = [block.get_output_port(k) for k in range(block.num_output_ports())]
        self._time = math.nan
        self._known: dict[int, Any] = {}  # at that time

    def value(self, port: int, time: float) -> Any:
        """What a port shows at a time in s."""
        if time != self._time:
            self._context.SetTime(time)
            self._time = time
            self._known.clear()
        if port not in self._known:
            self._known[port] = self._ports[port].Eval(self._context)
        return self._known[port]


class _Function:
    """A traced function of the state, the parameters, the time and what stands outside.

    The last of its results is the sum of the others' squares.
    """

    def __init__(self, traced: _Traced, *, is_frequent: bool):
        results, arguments, symbols = traced
        self.readings = symbols.readings
        outside = casadi.vertcat(*symbols.symbols) if symbols.symbols else casadi.SX.sym("none", 1)
        stacked = casadi.vertcat(*arguments, outside)
        norm = casadi.sumsqr(casadi.vertcat(*results))
        results = [*results, norm]
        if is_frequent:  # it takes longer than an evaluation saves
            results = casadi.cse(results)
        self.function = casadi.Function("loop", [stacked], results)
        self.compiled: casadi.Function | None = None  # the same, as C
        self._is_looked_for = self._is_tried = False  # in the cache, to compile it

    def compile(self, builds: bool) -> None:
        """Takes C that is in the cache, or builds it."""
        is_done = self._is_tried if builds else self._is_looked_for
        if self.compiled is None and not is_done:
            self._is_tried |= builds
            function = compiled(self.function, builds=builds)
            self.compiled = None if function is self.function else function
            self._is_looked_for = True


class _Evaluation:
    """Evaluates a function, in memory of its own."""

    def __init__(self, function: _Function, compiles: bool):
        self.readings = function.readings
        self._function = function.function  # the buffer borrows it and the arrays
        if compiles and function.compiled is not None:
            self._function = function.compiled
        self._buffer, self.evaluate = self._function.buffer()
        self._input = np.zeros(self._function.size1_in(0))
        sizes = [self._function.size1_out(k) for k in range(self._function.n_out())]
        self._outputs = list(map(np.zeros, sizes))
        self._buffer.set_arg(0, self._input.data)
        for k, output in enumerate(self._outputs):
            self._buffer.set_res(k, output.data)

    def __call__(self, inputs: list[NDArray]) -> list[NDArray]:
        np.concatenate(inputs, out=self._input)
        self.evaluate()
        return [output.copy() for output in self._outputs]


def _state_sizes(context: Context) -> list[int]:
    """The sizes of the continuous state, and of the discrete groups."""
    groups = range(context.num_discrete_state_groups())
    sizes = [context.get_discrete_state(k).size() for k in groups]
    return [context.num_continuous_states(), *sizes]


def _state_of(context: Context) -> NDArray:
    groups = range(context.num_discrete_state_groups())
    discrete = [context.get_discrete_state(k).CopyToVector() for k in groups]
    return np.concatenate([context.get_continuous_state_vector().CopyToVector(), *discrete])


def _discrete_of(values: DiscreteValues) -> NDArray:
    groups = range(values.num_groups())
    return np.concatenate([values.get_vector(k).CopyToVector() for k in groups])


def _parameters_of(leaf: Any, context: Context) -> NDArray:
    """What a leaf's trace takes of the parameters in a context of its own."""
    if hasattr(leaf, "trace_parameters"):
        return leaf.trace_parameters(context)
    return context.get_numeric_parameter(0).CopyToVector()


def _updated(
    leaf: Any, instant: Instant, states: Mapping[System, list[NDArray]], is_start: bool
) -> list[NDArray]:
    """A leaf's states after its update of the discrete ones."""
    start = getattr(leaf, "traced_start", leaf.traced_update) if is_start else leaf.traced_update
    return [states[leaf][0], *start(At(instant, leaf))]


def _joined(arrays: list[NDArray]) -> casadi.SX:
    entries = [entry for array in arrays for entry in array]
    return casadi.densify(casadi.vertcat(*entries)) if entries else casadi.SX(0, 1)


def _stacked(states: Mapping[System, list[NDArray]]) -> casadi.SX:
    return _joined([group for groups in states.values() for group in groups])
