"""A sampled loop as two traced functions from sample to sample, equal to its diagram to rounding.

At a sample, Drake's Simulator first makes the unrestricted updates, all at once, then the discrete
ones, and integrates to the next sample. So does the trace: `at_sample` makes both kinds of updates,
`after_sample` takes the steps of the third-order Runge-Kutta method and shows all signals at the
end of them, before the next updates.

Blocks that cannot be traced stand outside. One without inputs is evaluated at the instants at
which it is read. One whose outputs change at samples only, such as an optimization layer, is
stepped by a Simulator of its own, between the two functions.
"""

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator, SimulatorConfig
from pydrake.systems.framework import Context, Diagram, PortDataType, System

from drake_nonstop.systems.compilation import compiled
from drake_nonstop.systems.diagram_trace import (
    At,
    Instant,
    Wires,
    is_traceable,
    leaves,
    rates,
)
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError, object_array
from drake_nonstop.validation import ScenarioError, require

_MAX_STEPS = 20  # in a sample: all of them are in one trace
_ROUNDING = 1e-9  # s, of a duration
_STRETCH = 1.01  # of the longest step: a last one that is as much longer is one step


class Reading(NamedTuple):
    """A port of a block outside, and when it is read."""

    block: System
    port: int
    offset: float  # s, after the sample


@dataclass
class _Symbols:
    """The symbols of a function for what stands outside, in the order in which it is read."""

    readings: list[Reading] = field(default_factory=list)
    symbols: list[casadi.SX] = field(default_factory=list)

    def at(self, offset: float) -> Any:
        """Gives the values of ports at an instant."""

        def give(block: System, port: int) -> NDArray:
            reading = Reading(block, port, offset)
            if reading not in self.readings:
                size = block.get_output_port(port).size()
                self.readings.append(reading)
                self.symbols.append(casadi.SX.sym("outside", size))
            return object_array(self.symbols[self.readings.index(reading)])

        return give


def reason_against(diagram: Diagram, config: SimulatorConfig, control_period: float) -> str:
    """Why a loop cannot be a `CompiledLoop`, in words; empty where it can."""
    if control_period == 0:
        return "control_period = 0: it goes from sample to sample"
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
        if is_traceable(block):
            continue
        if block.num_input_ports() == 0:
            is_known = block.CreateDefaultContext().is_stateless()
        else:
            is_known = _is_held(block, wires)
        if not is_known:
            return f"{block.get_name()} = {type(block).__name__}: it has no equations to be traced"
    return ""


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


class CompiledLoop:
    """A loop that is stepped from sample to sample.

    Args:
        diagram: the loop, with a control period.
        config: the integrator's step.
        control_period: s.
        signal_period: s, between the instants at which signals are shown, at which a step of the
            integrator ends, too; a whole part of the control period, or None: every sample.
        compiles: whether the functions are compiled as C, see `systems.compilation`; if not,
            CasADi's virtual machine evaluates them, which takes some six times as long.

    Attributes:
        diagram: as given.
        signals: the names of the diagram's vector-valued output ports with their sizes, in order.

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
        compiles: bool = True,
    ):
        reason = reason_against(diagram, config, control_period)
        if reason:
            raise ScenarioError(f"{reason}; simulate its diagram, or change that")
        self.diagram, self._period = diagram, control_period
        self._compiles = compiles
        shown = control_period / (signal_period or control_period)
        self._shown_per_sample = round(shown)
        is_whole = self._shown_per_sample > 0 and math.isclose(shown, self._shown_per_sample)
        remedy = f"give a whole part of the control period, {control_period:g} s"
        require(is_whole, "signal_period", signal_period, remedy)
        between = control_period / self._shown_per_sample  # a step ends at each signal
        self._steps = _steps_to(between, config.max_step_size)
        blocks = diagram.GetSystems()
        self._outside = {block for block in blocks if not is_traceable(block)}
        self._held = [b for b in blocks if b in self._outside and b.num_input_ports() > 0]
        ports = [diagram.get_output_port(k) for k in range(diagram.num_output_ports())]
        self._ports = [p for p in ports if p.get_data_type() == PortDataType.kVectorValued]
        self.signals = {port.get_name(): port.size() for port in self._ports}
        self._trace()

    def _trace(self) -> None:
        root = self.diagram.CreateDefaultContext()
        self._wires = Wires(self.diagram)
        self._leaves = [
            leaf
            for block in self.diagram.GetSystems()
            if block not in self._outside
            for leaf in leaves(block)
        ]
        self._state_sizes = {leaf: _state_sizes(leaf, root) for leaf in self._leaves}
        self._with_parameters = [
            leaf
            for leaf in self._leaves
            if leaf.GetMyContextFromRoot(root).num_numeric_parameter_groups() > 0
        ]
        groups = [size for sizes in self._state_sizes.values() for size in sizes]
        numbers = [
            leaf.GetMyContextFromRoot(root).get_numeric_parameter(0).size()
            for leaf in self._with_parameters
        ]
        state, parameters = casadi.SX.sym("x", sum(groups)), casadi.SX.sym("p", sum(numbers))
        time = casadi.SX.sym("t", 1)
        values = object_array(parameters)
        self._parameters = dict(
            zip(self._with_parameters, np.split(values, np.cumsum(numbers)[:-1]), strict=False)
        )
        arguments = [state, parameters, time]
        self._at_start = self._make_updates(arguments, is_start=True)
        self._at_sample = self._make_updates(arguments, is_start=False)
        self._shown = self._make_shown(arguments)
        self._after_sample = self._make_steps(arguments)

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

    def _make_updates(self, arguments: list[casadi.SX], *, is_start: bool) -> "_Function":
        """The state after a sample's updates, and what the blocks that are held read."""
        state, _, time = arguments
        symbols = _Symbols()
        states = self._states(object_array(state))
        instant = self._instant(states, object_array(time), symbols.at(0.0))
        updating = [leaf for leaf in self._leaves if hasattr(leaf, "traced_update")]
        if is_start:
            updating = [leaf for leaf in updating if getattr(leaf, "updates_at_start", False)]
        after = dict(states)
        for leaf in updating:
            if getattr(leaf, "updates_first", False):
                after[leaf] = _updated(leaf, instant, states)
        instant = self._instant(after, object_array(time), symbols.at(0.0))
        last = dict(after)
        for leaf in updating:
            if not getattr(leaf, "updates_first", False):
                last[leaf] = _updated(leaf, instant, after)
        read = []
        self._read: list[tuple[System, int]] = []
        for block in self._held:
            for k in range(block.num_input_ports()):
                if block.get_input_port(k).get_data_type() != PortDataType.kVectorValued:
                    continue
                found = instant.input(block, k)
                if found is not None:
                    self._read.append((block, k))
                    read.append(found)
        compiles = self._compiles and not is_start
        return _Function([_stacked(last), _joined(read)], arguments, symbols, compiles)

    def _make_shown(self, arguments: list[casadi.SX]) -> "_Function":
        """All signals at an instant, as the states are."""
        state, _, time = arguments
        symbols = _Symbols()
        instant = self._instant(
            self._states(object_array(state)), object_array(time), symbols.at(0.0)
        )
        return _Function([_joined(self._signals_at(instant))], arguments, symbols)  # once a run

    def _signals_at(self, instant: Instant) -> list[NDArray]:
        found = []
        for port in self._ports:
            system, index = self.diagram.get_output_port_locator(port.get_index())
            found.append(instant.output(system, int(index)))
        return found

    def _make_steps(self, arguments: list[casadi.SX]) -> "_Function":
        """The state and all signals at the next sample, before its updates."""
        state, _, time = arguments
        symbols = _Symbols()
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
        end, signals = states, []
        for k in range(self._shown_per_sample):
            begin = k * self._period / self._shown_per_sample
            for step in self._steps:
                first = rate(now, begin)
                second = rate(moved([(step / 2, first)]), begin + step / 2)
                third = rate(moved([(-step, first), (2 * step, second)]), begin + step)
                weights = (step / 6, first), (2 * step / 3, second), (step / 6, third)
                now = moved(weights)
                begin += step
            end = states | {leaf: [now[leaf], *states[leaf][1:]] for leaf in moving}
            # To the bit at the next sample, where what stands outside is read again.
            offset = (k + 1) * self._period / self._shown_per_sample
            instant = self._instant(end, start + offset, symbols.at(offset))
            signals += self._signals_at(instant)
        return _Function([_stacked(end), _joined(signals)], arguments, symbols, self._compiles)

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
        samples = round(duration / self._period) if math.isfinite(duration) else -1
        is_multiple = samples >= 0 and abs(samples * self._period - duration) < _ROUNDING
        remedy = f"give a multiple of the control period, {self._period:g} s"
        require(is_multiple, "duration", duration, remedy)
        require(context.get_time() == 0, "context.time", context.get_time(), "start at 0")
        flight = _Flight(self, context)
        size, per_sample = sum(self.signals.values()), self._shown_per_sample
        shown = np.empty((samples * per_sample + 1, size))
        shown[0] = flight.start()
        for k in range(samples):
            first = 1 + k * per_sample
            shown[first : first + per_sample] = flight.advance().reshape(per_sample, size)
        ends = np.cumsum([*self.signals.values()])[:-1]
        times = self._period / per_sample * np.arange(len(shown))
        return times, dict(zip(self.signals, np.split(shown, ends, axis=1), strict=True))


class _Flight:
    """A run of a `CompiledLoop`."""

    def __init__(self, loop: CompiledLoop, context: Context):
        self._loop = loop
        own = context.Clone()
        self._sources = {
            block: _Source(block, block.GetMyContextFromRoot(own))
            for block in loop._outside
            if block not in loop._held
        }
        self._state = np.concatenate(
            [_state_of(leaf.GetMyContextFromRoot(own)) for leaf in loop._leaves] or [np.zeros(0)]
        )
        self._parameters = np.concatenate(
            [
                leaf.GetMyContextFromRoot(own).get_numeric_parameter(0).CopyToVector()
                for leaf in loop._with_parameters
            ]
            or [np.zeros(0)]
        )
        self._samples = 0
        self._simulators = {}
        self._fixed: dict[tuple[System, int], Any] = {}
        for block in loop._held:
            context = block.CreateDefaultContext()
            context.SetTimeStateAndParametersFrom(block.GetMyContextFromRoot(own))
            for k in range(block.num_input_ports()):
                self._fix(block, context, k)
            self._simulators[block] = Simulator(block, context)

    def _fix(self, block: System, context: Context, k: int) -> None:
        """Gives a held block's input a value: of an abstract one that of its source."""
        port = block.get_input_port(k)
        if (block, k) in self._loop._read:
            self._fixed[block, k] = port.FixValue(context, np.zeros(port.size()))
            return
        source = self._loop._wires.source(block, k)
        if source is None:
            return
        maker, index = source
        if maker not in self._sources:
            raise ScenarioError(f"{block.get_name()}.{port.get_name()}: it reads no trajectory")
        port.FixValue(context, self._sources[maker].value(index, 0.0))

    def start(self) -> NDArray:
        """All signals after the initialization."""
        self._state, read = self._call(self._loop._at_start)
        self._give(read)
        for simulator in self._simulators.values():
            simulator.Initialize()
        (signals,) = self._call(self._loop._shown)
        return signals

    def advance(self) -> NDArray:
        """All signals at the next sample, before its updates."""
        if self._samples > 0:
            self._state, read = self._call(self._loop._at_sample)
            if self._simulators:
                time = self._time()
                for simulator in self._simulators.values():
                    simulator.AdvanceTo(time)
                self._give(read)
                for simulator in self._simulators.values():
                    simulator.AdvancePendingEvents()
        self._state, signals = self._call(self._loop._after_sample)
        self._samples += 1
        return signals

    def _time(self, ahead: int = 0) -> float:
        """That of the sample, s, to the bit as Drake has it of events that begin with a period.

        Args:
            ahead: so many samples later.
        """
        period, number = self._loop._period, self._samples + ahead
        return period + (number - 1) * period if number > 0 else 0.0

    def _give(self, read: NDArray) -> None:
        start = 0
        for place in self._loop._read:
            values = self._fixed[place].GetMutableData().get_mutable_value()
            end = start + values.size()
            values.SetFromVector(read[start:end])
            start = end

    def _call(self, function: "_Function") -> list[NDArray]:
        time = self._time()
        outside = [self._value(reading, time) for reading in function.readings]
        return function(self._state, self._parameters, np.array([time]), outside)

    def _value(self, reading: Reading, time: float) -> NDArray:
        block, port, offset = reading
        if block in self._sources:
            is_next = offset == self._loop._period
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
    """A traced function of the state, the parameters, the time and what stands outside."""

    def __init__(
        self,
        results: list[casadi.SX],
        arguments: list[casadi.SX],
        symbols: _Symbols,
        compiles: bool = False,
    ):
        self.readings = symbols.readings
        outside = casadi.vertcat(*symbols.symbols) if symbols.symbols else casadi.SX.sym("none", 1)
        stacked = casadi.vertcat(*arguments, outside)
        norm = casadi.sumsqr(casadi.vertcat(*results))
        results = casadi.cse([*results, norm])
        function = casadi.Function("loop", [stacked], results)
        self._function = compiled(function) if compiles else function
        *results, norm = results
        self._buffer, self._evaluate = self._function.buffer()
        self._input = np.zeros(stacked.numel())
        self._outputs = [np.zeros(result.numel()) for result in (*results, norm)]
        self._buffer.set_arg(0, self._input.data)
        for k, output in enumerate(self._outputs):
            self._buffer.set_res(k, output.data)

    def __call__(
        self, state: NDArray, parameters: NDArray, time: NDArray, outside: list[NDArray]
    ) -> list[NDArray]:
        last = outside or [np.zeros(1)]
        np.concatenate([state, parameters, time, *last], out=self._input)
        self._evaluate()
        *results, norm = self._outputs
        if not norm[0] < LARGEST**2:
            raise NotFiniteError("the loop")
        return [result.copy() for result in results]


def _state_sizes(leaf: System, root: Context) -> list[int]:
    """The sizes of the continuous state, and of the discrete groups."""
    context = leaf.GetMyContextFromRoot(root)
    groups = range(context.num_discrete_state_groups())
    sizes = [context.get_discrete_state(k).size() for k in groups]
    return [context.num_continuous_states(), *sizes]


def _state_of(context: Context) -> NDArray:
    groups = range(context.num_discrete_state_groups())
    discrete = [context.get_discrete_state(k).CopyToVector() for k in groups]
    return np.concatenate([context.get_continuous_state_vector().CopyToVector(), *discrete])


def _updated(leaf: Any, instant: Instant, states: Mapping[System, list[NDArray]]) -> list[NDArray]:
    """A leaf's states after its update of the discrete ones."""
    return [states[leaf][0], *leaf.traced_update(At(instant, leaf))]


def _joined(arrays: list[NDArray]) -> casadi.SX:
    entries = [entry for array in arrays for entry in array]
    return casadi.densify(casadi.vertcat(*entries)) if entries else casadi.SX(0, 1)


def _stacked(states: Mapping[System, list[NDArray]]) -> casadi.SX:
    return _joined([group for groups in states.values() for group in groups])
