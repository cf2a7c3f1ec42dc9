"""A sampled loop as traced functions from sample to sample, equal to its diagram to rounding.

At a sample, Drake's Simulator first makes the unrestricted updates, all at once, then the discrete
ones, and integrates to the next sample. So does the trace: `at_sample` makes both kinds of updates,
`after_sample` takes the steps of the third-order Runge-Kutta method and shows all signals at the
end of them, before the next updates.

A block that is traced may ask to make an update itself, such as an optimization layer where its
last answer does not do: it has `traced_attempt(at, found)` in place of `traced_update(at)`, which
tells the states after the sample, and whether they hold. `found` is what its `traced_search` in C
has found, after a 1; or zeros.

Blocks that cannot be traced stand outside. One without inputs is evaluated at the instants at
which it is read. One whose outputs change at samples only is stepped by a Simulator of its own,
between the two functions. Where there is none, both are one function.
"""

import itertools
import math
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import SimulatorConfig
from pydrake.systems.framework import Context, Diagram, PortDataType, System

from drake_nonstop.blocks.sample_and_hold import SampleAndHold
from drake_nonstop.blocks.speed_bound_layer import COMMAND
from drake_nonstop.diagrams.compiled_flight import CompiledFlight
from drake_nonstop.diagrams.loop_functions import LoopFunction, LoopFunctions, Symbols, Traced
from drake_nonstop.diagrams.loop_layout import LoopLayout
from drake_nonstop.systems.diagram_trace import (
    FOUND_SIZE,
    At,
    Instant,
    Wires,
    is_traceable,
    leaves,
    rates,
    trace_content,
)
from drake_nonstop.systems.tracing import LARGEST, object_array
from drake_nonstop.validation import ScenarioError, require, require_known

_MAX_STEPS = 20  # in a sample: all of them are in one trace
_ROUNDING = 1e-9  # s, of a duration
_STRETCH = 1.01  # of the longest step: a last one that is as much longer is one step


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


_functions: dict[Any, LoopFunctions] = {}  # of the last loops
_MOST_FUNCTIONS = 32


_Part = Callable[[casadi.SX, float, Symbols], list[casadi.SX]]  # of a state and an offset in s


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
        self._layout = LoopLayout(diagram)
        ports = [diagram.get_output_port(k) for k in range(diagram.num_output_ports())]
        vectors = [p for p in ports if p.get_data_type() == PortDataType.kVectorValued]
        sizes = {port.get_name(): port.size() for port in vectors}
        for name in (*(signals or ()), *step_signals):
            require_known(name, [*sizes], "signals", name)
        self.signals = {name: sizes[name] for name in (sizes if signals is None else signals)}
        self.step_signals = {name: sizes[name] for name in step_signals}
        self._compiles = compiles
        key = self._key()
        functions = _functions.pop(key, None) or self._traced()
        if key is not None:
            _functions[key] = functions
            if len(_functions) > _MOST_FUNCTIONS:
                _functions.pop(next(iter(_functions)), None)
        self._functions = functions
        if compiles:
            functions.compile(samples)

    def _key(self) -> Any:
        """What the functions depend on, which can be hashed; None: it is not known."""
        layout = self._layout
        content = trace_content(self.diagram, layout.wires, layout.is_outside)
        if content is None:
            return None
        ports = []
        for name in (*self.signals, *self.step_signals):
            port = self.diagram.GetOutputPort(name).get_index()
            system, index = self.diagram.get_output_port_locator(port)
            ports.append((layout.numbers[system], int(index)))
        states = tuple(map(tuple, layout.state_sizes.values()))
        periods = self.control_period, self.shown_per_sample, *self._steps
        return content, tuple(ports), len(self.signals), states, *layout.parameter_sizes, periods

    def _traced(self) -> LoopFunctions:
        layout = self._layout
        state = casadi.SX.sym("x", sum(map(sum, layout.state_sizes.values())))
        parameters = casadi.SX.sym("p", sum(layout.parameter_sizes))
        time = casadi.SX.sym("t", 1)
        values = np.split(object_array(parameters), np.cumsum(layout.parameter_sizes)[:-1])
        self._parameters = dict(zip(layout.with_parameters, values, strict=False))
        arguments = [state, parameters, time]
        start = self._make_updates(arguments, is_start=True)
        shown = self._part(arguments, self._shown_at)
        symbols = Symbols(layout.numbers)
        at_once = Traced(shown(state, 0.0, symbols), arguments, symbols)
        steps = self._make_steps(arguments, shown)
        at_sample = whole = None
        if layout.held:
            at_sample = LoopFunction(self._make_updates(arguments), is_frequent=True)
        else:
            whole = self._make_whole(arguments, steps)
        return LoopFunctions(
            at_start=LoopFunction(start, is_frequent=False),
            shown=LoopFunction(at_once, is_frequent=False),
            after_sample=LoopFunction(steps, is_frequent=whole is None),
            at_sample=at_sample,
            whole=whole,
        )

    def _instant(self, states: Mapping[System, list[NDArray]], time: Any, outside: Any) -> Instant:
        return Instant(
            self._layout.wires,
            dict(states),
            self._parameters,
            time,
            outside,
            self._layout.is_outside,
        )

    def _make_whole(self, arguments: list[casadi.SX], steps: Traced) -> LoopFunction:
        """The state and all signals at the next sample, and what its updates tell besides.

        A further argument has what a search has found, which blocks have made updates themselves,
        and their states after these.
        """
        _, parameters, time = arguments
        found = casadi.SX.sym("f", FOUND_SIZE)
        updates = self._make_updates([*arguments, found], found=found)
        symbols = updates.symbols
        answers = casadi.SX.sym("a", self._layout.answers_size)
        after, read, holds, data = updates.results
        start = len(self._layout.attempting)
        for k, leaf in enumerate(self._layout.attempting):
            place = self._layout.places[leaf]
            end = start + place.stop - place.start
            after[place] = casadi.if_else(answers[k], answers[start:end], after[place])
            start = end
        own = steps.symbols
        known = zip(own.readings, own.symbols, strict=True)
        outside = [symbols.of(reading, symbol.numel()) for reading, symbol in known]
        old = casadi.vertcat(*arguments, *own.symbols)
        new = casadi.vertcat(after, parameters, time, *itertools.chain(*outside))
        moved = casadi.Function("part", [old], steps.results)(new)
        traced = Traced([*moved, read, holds, data], [*arguments, found, answers], symbols)
        search = None
        if len(self._layout.attempting) == 1:
            search = getattr(self._layout.attempting[0], "traced_search", None)
        return LoopFunction(traced, is_frequent=True, is_whole=True, search=search)

    def _make_updates(
        self, arguments: list[casadi.SX], *, is_start: bool = False, found: Any = None
    ) -> Traced:
        """The state after a sample's updates, and what blocks that may make some themselves read.

        Then whether what is made in their place holds, and the data of a search.

        Args:
            arguments: of the function.
            is_start: whether they are those of the initialization.
            found: what a search has found; None: there is none.
        """
        state, _, time, *_ = arguments
        symbols = Symbols(self._layout.numbers)
        states = self._layout.states(object_array(state))
        instant = self._instant(states, object_array(time), symbols.at(0.0))
        updating = [leaf for leaf in self._layout.leaves if hasattr(leaf, "traced_update")]
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
        found = np.zeros(FOUND_SIZE) if found is None else object_array(found)
        attempts = {
            leaf: leaf.traced_attempt(At(instant, leaf), found)
            for leaf in (self._layout.attempting if not is_start else ())
        }
        for leaf, attempt in attempts.items():
            last[leaf] = [last[leaf][0], *attempt.states]
        inputs = (instant.input(*place) for place in self._layout.read)
        read = [values for values in inputs if values is not None]
        holds = np.array([attempt.holds for attempt in attempts.values()])
        data = [attempt.data for attempt in attempts.values()]
        return Traced(
            [_stacked(last), _joined(read), _joined([holds]), _joined(data)], arguments, symbols
        )

    def _part(
        self, arguments: list[casadi.SX], make: Callable[[Instant], list[casadi.SX]]
    ) -> _Part:
        """What is made of an instant, traced once, of any state, offset (s) and `Symbols`."""
        state, parameters, time = arguments
        own = Symbols(self._layout.numbers)
        states = self._layout.states(object_array(state))
        results = make(self._instant(states, object_array(time), own.at(0.0)))
        stacked = casadi.vertcat(state, parameters, time, *own.symbols)
        function = casadi.Function("part", [stacked], results)

        def part(now: casadi.SX, offset: float, symbols: Symbols) -> list[casadi.SX]:
            read = zip(own.readings, own.symbols, strict=True)
            outside = [symbols.of(r._replace(offset=offset), s.numel()) for r, s in read]
            inputs = casadi.vertcat(now, parameters, time + offset, *itertools.chain(*outside))
            return function.call([inputs])

        return part

    def _shown_at(self, instant: Instant) -> list[casadi.SX]:
        """The signals, and the signals of steps, at an instant."""
        return [_joined(self._at(instant, s)) for s in (self.signals, self.step_signals)]

    def _rates_at(self, instant: Instant) -> list[casadi.SX]:
        """The rates of the loop's state, 0 of all that is discrete."""
        found = []
        for leaf, (continuous, *discrete) in self._layout.state_sizes.items():
            found += [rates(leaf, instant)] if continuous else []
            found.append(np.zeros(sum(discrete)))
        return [_joined(found)]

    def _at(self, instant: Instant, signals: Iterable[str]) -> list[NDArray]:
        """What signals show at an instant."""
        found = []
        for name in signals:
            port = self.diagram.GetOutputPort(name).get_index()
            system, index = self.diagram.get_output_port_locator(port)
            found.append(instant.output(system, int(index)))
        return found

    def _make_steps(self, arguments: list[casadi.SX], shown: _Part) -> Traced:
        """The state and all signals at the next sample, before its updates."""
        symbols = Symbols(self._layout.numbers)
        rates_of = self._part(arguments, self._rates_at)

        def rate(state: casadi.SX, offset: float) -> casadi.SX:
            return rates_of(state, offset, symbols)[0]

        now = arguments[0]
        signals, step_signals = [], []
        for k in range(self.shown_per_sample):
            begin = k * self.control_period / self.shown_per_sample
            for number, step in enumerate(self._steps, start=1):
                first = rate(now, begin)
                second = rate(now + step / 2 * first, begin + step / 2)
                third = rate(now - step * first + 2 * step * second, begin + step)
                now = now + step / 6 * first + 2 * step / 3 * second + step / 6 * third
                begin += step
                is_shown = number == len(self._steps)
                if is_shown:  # to the bit at the next sample, where what stands outside is read
                    begin = (k + 1) * self.control_period / self.shown_per_sample
                own_signals, own_step_signals = shown(now, begin, symbols)
                step_signals.append(own_step_signals)
                signals += [own_signals] if is_shown else []
        results = [now, casadi.vertcat(*signals), casadi.vertcat(*step_signals)]
        return Traced(results, arguments, symbols)

    def fly(self, context: Context, largest: float = LARGEST) -> CompiledFlight:
        """A flight from a context of the diagram, at t = 0, which stays as it is.

        Args:
            context: of the diagram.
            largest: a value beyond it, in SI units, raises NotFiniteError.

        Raises:
            ScenarioError: the context is at another time.
        """
        require(context.get_time() == 0, "context.time", context.get_time(), "start at 0")
        return CompiledFlight(
            self._layout,
            self._functions,
            compiles=self._compiles,
            period=self.control_period,
            instants=(self.shown_per_sample, len(self.step_ends)),
            context=context,
            largest=largest,
        )

    @property
    def blocks_beside(self) -> list[str]:
        """The names of the blocks that are stepped by Simulators of their own."""
        return [block.get_name() for block in self._layout.held]

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
        while flight.samples < samples:
            shown.append(flight.advance(samples - flight.samples)[0])
        rows = np.concatenate(shown)
        ends = np.cumsum([*self.signals.values()])[:-1]
        times = self.control_period / self.shown_per_sample * np.arange(len(rows))
        return times, dict(zip(self.signals, np.split(rows, ends, axis=1), strict=True))


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
