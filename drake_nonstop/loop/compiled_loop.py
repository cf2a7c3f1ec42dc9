"""A sampled loop as traced functions from sample to sample, equal to its diagram to rounding.

`drake_nonstop/loop/trace.py` says what they compute.

A block that is traced may ask to make an update itself, such as an optimization layer where its
last answer does not do: it has `traced_fast_update(at)` in place of `traced_update(at)`, which
tells the states after the sample, and whether they are right.

Blocks that cannot be traced stand outside. One without inputs is evaluated at the instants at
which it is read. One whose outputs change at samples only is stepped by a Simulator of its own,
between the two functions. Where there is none, both are one function.
"""

import functools
import math
import threading
from collections.abc import Collection
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import SimulatorConfig
from pydrake.systems.framework import Context, Diagram, DiscreteValues, PortDataType, System

from drake_nonstop.loop.block_events import timing_complaint
from drake_nonstop.loop.compiled_flight import CompiledFlight
from drake_nonstop.loop.derivatives import (
    DerivativeFlight,
    DerivativeFunctions,
    Sensitivities,
    derivative_functions,
)
from drake_nonstop.loop.functions import (
    Evaluation,
    LoopFunction,
    LoopFunctions,
    Symbols,
    Traced,
)
from drake_nonstop.loop.trace import LoopLayout, LoopTrace, Step
from drake_nonstop.mechanics.signal_layouts import by_name
from drake_nonstop.systems.block import LeafBlock, is_of_package, title
from drake_nonstop.systems.diagram_trace import (
    Wires,
    is_traceable,
    leaves,
    trace_content,
    updates_in_trace,
)
from drake_nonstop.systems.recent_traces import LruCache
from drake_nonstop.systems.tracing import LARGEST
from drake_nonstop.systems.wiring import require_context
from drake_nonstop.validation import ScenarioError, require, require_known

_MAX_STEPS = 128  # in a sample: all of them are in one function of C
_MOST_OPERATIONS = 50_000  # of a sample's steps, a rate each, beyond which C calls functions
_ROUNDING = 1e-9  # s, of a duration
_STRETCH = 1.01  # of the longest step: a last one that is as much longer is one step


def reason_against(
    diagram: Diagram, config: SimulatorConfig, control_period: float, *, compiles: bool = True
) -> str:
    """Why a loop cannot be a `CompiledLoop`, in words; empty where it can.

    As C it has a limit of the steps in a sample.
    """
    if not control_period > 0:
        return f"control_period = {control_period:g}: it goes from sample to sample"
    if config.integration_scheme != "runge_kutta3" or config.use_error_control:
        return "simulator_config: it takes the steps of runge_kutta3 without error control"
    steps = math.ceil(control_period / config.max_step_size - 1e-9)
    if compiles and steps > _MAX_STEPS:
        return f"simulator_config.max_step_size: {steps} steps a sample, at most {_MAX_STEPS}"
    if diagram.num_input_ports() > 0:
        names = [diagram.get_input_port(k).get_name() for k in range(diagram.num_input_ports())]
        return f"inputs = {', '.join(names)}: it has none from outside of the loop"
    wires = Wires(diagram)
    for block in diagram.GetSystems():
        if is_traceable(block):
            for leaf in leaves(block):
                complaint = _complaint_of_trace(leaf, control_period)
                if complaint:
                    return f"{title(block)} = {type(block).__name__}: {complaint}"
            continue
        if block.num_input_ports() == 0:
            is_known = block.CreateDefaultContext().is_stateless()
        else:
            is_known = _is_held(block, wires)
        if not is_known:
            return f"{title(block)} = {type(block).__name__}: it has no equations to be traced"
        complaint = timing_complaint(block, control_period)
        if complaint:
            return f"{title(block)} = {type(block).__name__}: {complaint}"
        for k in range(block.num_input_ports()):
            source, port = wires.source(block, k), block.get_input_port(k)
            is_vector = port.get_data_type() == PortDataType.kVectorValued
            if source is not None and not is_vector and source[0].num_input_ports() > 0:
                return f"{title(block)} reads {port.get_name()}, which is no vector of numbers"
    return ""


def _complaint_of_trace(leaf: Any, control_period: float) -> str:
    """Why the trace of a leaf has not its updates; empty where it may have."""
    period = getattr(leaf, "sample_period", 0.0)
    if period > 0:
        return "" if period == control_period else f"it samples every {period:g} s"
    if getattr(leaf, "updates_at_start", False) and not updates_in_trace(leaf):
        return "its continuous state starts of its inputs"
    timing = leaf.GetUniquePeriodicDiscreteUpdateAttribute()
    if not updates_in_trace(leaf):
        return "" if timing is None else "it has discrete updates, and no traced_update"
    if timing is None and not is_of_package(leaf):  # the package's may have unrestricted ones
        return "it has no discrete updates, or several timings of them"
    return timing_complaint(leaf, control_period, at_each=True)


def _schedule(period: float, shown: int, longest: float) -> list[Step]:
    """The steps that Drake's integrators take in a sample: one ends at each signal.

    Of a sample's period in s, in which signals are shown so often; the last step before a signal
    may be shorter than the longest one, in s.
    """
    steps = []
    for k in range(shown):
        begin, end, left = k * period / shown, (k + 1) * period / shown, period / shown
        while left > _STRETCH * longest:
            steps.append(Step(begin, longest, begin + longest, is_shown=False))
            begin += longest
            left -= longest
        steps.append(Step(begin, left, end, is_shown=True))
    return steps


def _is_held(block: System, wires: Wires) -> bool:
    """Whether a block's outputs change at samples only: no input feeds through, no state moves."""
    if not getattr(block, "is_sampled", False):
        return False
    connected = [k for k in range(block.num_input_ports()) if wires.source(block, k) is not None]
    outputs = range(block.num_output_ports())
    is_fed = any(block.HasDirectFeedthrough(k, i) for k in connected for i in outputs)
    return not is_fed and block.CreateDefaultContext().num_continuous_states() == 0


_recent_functions, _recent_derivatives = LruCache(), LruCache()  # by what they depend on


class CompiledLoop:
    """A loop that is stepped from sample to sample.

    Args:
        config: the integrator's step.
        signal_period: s, between the instants at which signals are shown, at which a step of the
            integrator ends, too; a whole part of the control period, or None: every sample.
        signals: those that are shown at these instants, names of the diagram's vector-valued
            output ports; None: all of them.
        step_signals: those that are shown at the end of every step of the integrator.
        compiles: whether the functions are compiled as C, see `systems.compilation`; if not,
            CasADi's virtual machine evaluates them, in six times the time and more; the numbers are
            the same to the bit.
        samples: how many are to be flown. From 100 in a process on C is used that is in the cache;
            what is not there, is compiled beside this process, for a later loop. Where many are to
            be flown without, the functions are made shorter. None: C is compiled at once, which
            takes seconds.

    Attributes:
        signals, step_signals: the names of the signals with their sizes, in order.
        step_ends: (steps,), s, where the integrator's steps end after a sample.
        shown_per_sample: the number of the signals' instants in a sample.
        layout: the order of its states and parameters.

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
        reason = reason_against(diagram, config, control_period, compiles=compiles)
        if reason:
            raise ScenarioError(f"{reason}; simulate its diagram, or change that")
        self.diagram, self.control_period = diagram, control_period
        shown = control_period / (signal_period or control_period)
        self.shown_per_sample = round(shown)
        is_whole = self.shown_per_sample > 0 and math.isclose(shown, self.shown_per_sample)
        remedy = f"give a whole part of the control period, {control_period:g} s"
        require(is_whole, "signal_period", signal_period, remedy)
        self._schedule = _schedule(control_period, self.shown_per_sample, config.max_step_size)
        self.step_ends = np.array([step.end for step in self._schedule])
        self.layout = LoopLayout(diagram)
        ports = [diagram.get_output_port(k) for k in range(diagram.num_output_ports())]
        vectors = [p for p in ports if p.get_data_type() == PortDataType.kVectorValued]
        sizes = {port.get_name(): port.size() for port in vectors}
        for name in (*(signals or ()), *step_signals):
            require_known(name, [*sizes], "signals", name)
        self.signals = {name: sizes[name] for name in (sizes if signals is None else signals)}
        self.step_signals = {name: sizes[name] for name in step_signals}
        self._compiles, self._samples = compiles, samples
        if compiles:
            _ = self._functions  # now, so that no flight waits for it

    @cached_property
    def _functions(self) -> LoopFunctions:
        functions: LoopFunctions = _recent_functions.get(self._key(), self._traced)
        functions.prepare(self._samples, self._compiles)
        return functions

    def prepare(self, samples: int) -> None:
        """Prepares the functions for so many more samples to be flown."""
        self._functions.prepare(samples, self._compiles)

    @cached_property
    def _content(self) -> Any:
        """Key of the traces of an instant, which can be hashed; None: it is not known."""
        layout = self.layout
        content = trace_content(self.diagram, layout.wires, layout.is_outside)
        states = tuple(map(tuple, layout.state_sizes.values()))
        return None if content is None else (content, states, *layout.parameter_sizes)

    def _key(self) -> Any:
        """Key of the traces of a sample."""
        layout, content = self.layout, self._content
        if content is None:
            return None
        ports = []
        for name in (*self.signals, *self.step_signals):
            port = self.diagram.GetOutputPort(name).get_index()
            system, index = self.diagram.get_output_port_locator(port)
            ports.append((layout.numbers[system], int(index)))
        return content, tuple(ports), len(self.signals), tuple(self._schedule)

    def _traced(self) -> LoopFunctions:
        trace = LoopTrace(self.layout)
        shown = trace.shown(self.signals, self.step_signals)
        symbols = Symbols(self.layout.numbers)
        at_once = Traced(shown(trace.arguments[0], 0.0, symbols), trace.arguments, symbols)
        calls = len(self._schedule) * trace.operations_of_rates > _MOST_OPERATIONS
        steps = trace.steps(self._schedule, shown, trace.called() if calls else None)
        updates = trace.updates()
        whole = None
        if not self.layout.held:
            whole = trace.whole(self._schedule, shown, updates, calls=calls)
        return LoopFunctions(
            at_start=LoopFunction(trace.updates(is_start=True)),
            shown=LoopFunction(at_once),
            after_sample=LoopFunction(steps),
            at_sample=LoopFunction(updates),
            whole=whole,
        )

    @property
    def rest_function(self) -> LoopFunction:
        """The signal `carrier_reference`, where there is one, and the rates of the state."""
        functions = self._functions
        if functions.rest is None:
            trace, symbols = LoopTrace(self.layout), Symbols(self.layout.numbers)
            now = trace.arguments[0], 0.0, symbols
            names = [name for name in ("carrier_reference",) if self.diagram.HasOutputPort(name)]
            results = [*trace.shown(names)(*now), *trace.rates(*now)]
            functions.rest = LoopFunction(Traced(results, trace.arguments, symbols))
        return functions.rest

    def fly(self, context: Context, largest: float = LARGEST) -> CompiledFlight:
        """A flight from a context of the diagram, at t = 0, which stays as it is.

        In flight a value beyond `largest`, in SI units, raises NotFiniteError.

        Raises:
            ScenarioError: the context is at another time, or that of another diagram.
        """
        self._require_start(context)
        return CompiledFlight(
            self.layout,
            self._functions,
            compiles=self._compiles,
            period=self.control_period,
            instants=(self.shown_per_sample, len(self.step_ends)),
            context=context,
            largest=largest,
        )

    def fly_on(self, flight: CompiledFlight, samples: int, config: SimulatorConfig) -> NDArray:
        """The `signals` (instants, size), as a flight goes on by samples with other steps.

        Each rate is evaluated by itself: of a few samples that takes less than the trace of the
        steps.

        Raises:
            ScenarioError: a block is stepped beside the trace.
            NotFiniteError, NotCompilableError: as of `CompiledFlight.advance`.
        """
        require(not self.blocks_beside, "loop", self.blocks_beside, "fly it with its own steps")
        schedule = _schedule(self.control_period, self.shown_per_sample, config.max_step_size)
        functions = self._functions.at_sample, self.rest_function
        parts = [Evaluation(function, self._compiles) for function in functions]
        return np.concatenate([flight.advance_in_steps(schedule, *parts) for _ in range(samples)])

    def prepare_lanes(self) -> None:
        """Takes the C by which `lanes.advance_together` flies its flights, where it is compiled.

        It is that of the cache, or is compiled now, which takes some seconds. Else flights of many
        samples have it compiled beside this process.
        """
        whole = self._functions.whole if self._compiles else None
        if whole is not None:
            whole.compile_lanes(builds=True)

    def _require_start(self, context: Context) -> None:
        require_context("context", self.diagram, context)
        require(context.get_time() == 0, "context.time", context.get_time(), "start at 0")

    def state_of(self, context: Context) -> NDArray:
        """The states (k,) of all blocks in a context of the diagram, as of `CompiledFlight`."""
        require_context("context", self.diagram, context)
        return self.layout.state_of(context)

    @property
    def state_names(self) -> list[str]:
        """Of each state the path of its system in the diagram, and its number in that."""
        return self.layout.state_names

    @property
    def parameter_names(self) -> list[str]:
        """Of each parameter its block's name and its own, and of an array's entry its number.

        Where a block's trace takes other numbers, as that of a layer that searches does, they have
        numbers alone.
        """
        return self.layout.parameter_names

    def fly_with_derivatives(self, context: Context) -> DerivativeFlight:
        """Returns the rates with the exact derivatives of the states.

        Raises:
            ScenarioError: a block of the loop searches, or stands beside the trace; or the context
                is at another time, or that of another diagram.
        """
        self._require_start(context)
        functions = self._derivatives
        return DerivativeFlight(
            self.layout, functions, self.control_period, self._schedule, context
        )

    @cached_property
    def _derivatives(self) -> DerivativeFunctions:
        made = functools.partial(derivative_functions, self.layout)
        functions: DerivativeFunctions = _recent_derivatives.get(self._content, made)
        return functions

    @property
    def blocks_without_derivatives(self) -> list[str]:
        """The names of those that search, or are stepped by Simulators of their own."""
        return [*self.layout.updating]

    @property
    def blocks_beside(self) -> list[str]:
        """The names of the blocks that are stepped by Simulators of their own."""
        return [block.get_name() for block in self.layout.held]

    @property
    def is_compiled(self) -> bool:
        """Whether it is evaluated as C, and not by CasADi's virtual machine."""
        found = [function.compiled for function in self._functions.of_samples]
        return self._compiles and None not in found

    @property
    def reason_against_c(self) -> str:
        """Why C of it can be neither taken nor compiled; empty where it can."""
        return next((each.reason for each in self._functions.of_samples if each.reason), "")

    def seconds_of_functions(self, context: Context, samples: int) -> float:
        """The time, s, that the traced functions alone take for so many samples."""
        flight = self.fly(context)
        flight.fly(1)
        return flight.seconds_of_functions(samples)

    def run(self, context: Context, duration: float) -> tuple[NDArray, dict[str, NDArray]]:
        """The times (instants,), s, and the signals (instants, size) by their names.

        From a context as of `fly`, for a duration in s, a multiple of the control period. A stall,
        which ends a run of `simulate`, does not end it.

        Raises:
            ScenarioError: the duration is no such multiple, or the context is at another time, or
                that of another diagram.
            NotFiniteError: a value is not finite, or is too large.
        """
        samples = self._samples_of(duration)
        rows = self.fly(context).fly(samples)
        times = self.control_period / self.shown_per_sample * np.arange(len(rows))
        return times, by_name(self.signals, rows)

    def sensitivities(self, context: Context, duration: float) -> Sensitivities:
        """How the state at the end of a `run` depends on that of its context, and on parameters.

        Raises:
            ScenarioError: as of `run` and `fly_with_derivatives`.
            NotFiniteError: a value is not finite, or is too large.
        """
        samples = self._samples_of(duration)
        flight = self.fly_with_derivatives(context)
        states, parameters = len(flight.state), len(flight.parameters)
        changes = np.eye(parameters, states + parameters, k=states)
        slopes = flight.start(np.eye(states, states + parameters), changes)
        while flight.samples < samples:
            slopes = flight.advance(slopes, changes)
        return Sensitivities(
            state=flight.state,
            by_state=slopes[:, :states],
            by_parameters=slopes[:, states:],
            state_names=self.state_names,
            parameter_names=self.parameter_names,
        )

    def _samples_of(self, duration: float) -> int:
        samples = round(duration / self.control_period) if math.isfinite(duration) else -1
        is_multiple = samples >= 0 and abs(samples * self.control_period - duration) < _ROUNDING
        remedy = f"give a multiple of the control period, {self.control_period:g} s"
        require(is_multiple, "duration", duration, remedy)
        return samples


class CompiledSystem(LeafBlock):
    """A discrete system that flies a `CompiledLoop` from sample to sample of its controllers.

    It stands for the loop in a bigger diagram, and a Simulator runs it like any other. Each signal
    of the loop is an output port of its name. From one sample to the next it shows what the
    loop's diagram does at the first of the two, before the controllers' update. It starts from the
    default context of the loop's diagram, with its parameters, at t = 0, and goes on from any of
    its states: contexts may be copied, and set back.

    .. pydrake_system::

        name: CompiledSystem
        output_ports:
        - (the loop's signals)

    Args:
        loop: with all blocks in the trace, and signals once a sample.

    Raises:
        ScenarioError: a block of the loop is stepped beside the trace, or signals are shown more
            often.
    """

    is_sampled = True

    def __init__(self, loop: CompiledLoop):
        super().__init__()
        beside = ", ".join(loop.blocks_beside)
        remedy = "it has a state of its own; use loop.run, or simulate the diagram"
        require(not beside, "loop", beside, remedy)
        shown = loop.shown_per_sample
        require(shown == 1, "loop.signal_period", shown, "give signal_period=None")
        self._loop = loop
        self._flight = loop.fly(loop.diagram.CreateDefaultContext())
        self._lock = threading.Lock()  # the flight is scratch memory of all contexts
        self._state = self.DeclareDiscreteState(self._flight.state)
        self._signals = []
        for name, size in loop.signals.items():
            self._signals.append(self.DeclareDiscreteState(size))
            self.DeclareStateOutputPort(name, self._signals[-1])
        period = loop.control_period
        self.DeclareInitializationDiscreteUpdateEvent(self._begin)
        self.DeclarePeriodicDiscreteUpdateEvent(period, period, self._advance)

    def _begin(self, context: Context, discrete_state: DiscreteValues) -> None:
        require(context.get_time() == 0, "context.time", context.get_time(), "start at 0")
        self._fly(context, discrete_state, 0)

    def _advance(self, context: Context, discrete_state: DiscreteValues) -> None:
        self._fly(context, discrete_state, round(context.get_time() / self._loop.control_period))

    def _fly(self, context: Context, discrete_state: DiscreteValues, sample: int) -> None:
        """Starts, or goes on to a sample from the last one."""
        self.require_floats("simulate the loop's diagram")
        with self._lock:
            self._flight.go_to(max(0, sample - 1), context.get_discrete_state(self._state).value())
            signals, _ = self._flight.advance() if sample else self._flight.start()
            discrete_state.set_value(self._state, self._flight.state)
        shown = by_name(self._loop.signals, signals.ravel())
        for index, values in zip(self._signals, shown.values(), strict=True):
            discrete_state.set_value(index, values)
