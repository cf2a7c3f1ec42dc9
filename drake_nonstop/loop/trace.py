"""The states of a loop's blocks, stacked, and the traces of its updates and of its motion.

At a sample, Drake's Simulator first makes the unrestricted updates, all at once, then the discrete
ones, and integrates to the next sample. So does a `LoopTrace`: `updates` makes both kinds of
updates, `steps` takes the steps of the third-order Runge-Kutta method and shows all signals at the
end of them, before the next updates.
"""

import functools
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram, DiscreteValues, PortDataType, System

from drake_nonstop.loop.functions import LoopFunction, Symbols, Traced
from drake_nonstop.systems.block import is_of_package
from drake_nonstop.systems.diagram_trace import (
    DiagramSnapshot,
    TraceContext,
    Wires,
    is_precomputed,
    is_traceable,
    leaves,
    rates,
)
from drake_nonstop.systems.port_state import set_state_values, state_values
from drake_nonstop.systems.tracing import object_array
from drake_nonstop.systems.wiring import systems_in


class LoopLayout:
    """The blocks of a loop, sorted, and how their states and parameters are stacked.

    Attributes:
        diagram, wires: the loop, and its wires.
        blocks: the diagram's own.
        numbers: of all systems in it, each block followed by what is in it.
        outside: the blocks that are not traced.
        held: those of them that have inputs; their outputs change at samples only.
        leaves: the leaf systems that are traced.
        state_sizes: of each leaf: of its continuous state, and of its discrete groups.
        places: of each leaf's discrete states, in the loop's.
        self_updating: the leaves that may ask to make an update themselves.
        with_parameters, parameter_sizes: those with numeric parameters, and what traces take of it.
        precomputing: those with precomputed inputs, see `diagram_trace.TraceContext.known`.
        of_users: the systems that are a user's own, of those that are evaluated or traced.
        read: the inputs that are given to blocks which make updates themselves: block and number.
    """

    def __init__(self, diagram: Diagram):
        root = diagram.CreateDefaultContext()
        self.diagram, self.wires = diagram, Wires(diagram)
        self.shared_rows: dict[Any, list[NDArray]] = {}  # see `ExogenousInputs`
        self.blocks = diagram.GetSystems()
        self.outside = {block for block in self.blocks if not is_traceable(block)}
        self.held = [b for b in self.blocks if b in self.outside and b.num_input_ports() > 0]
        everything = [part for block in self.blocks for part in systems_in(block)]
        self.numbers = {system: k for k, system in enumerate(everything)}
        self.leaves: list[Any] = [
            leaf for block in self.blocks if block not in self.outside for leaf in leaves(block)
        ]

        def own(leaf: System) -> Context:
            return diagram.GetSubsystemContext(leaf, root)

        self.state_sizes = {leaf: _state_sizes(own(leaf)) for leaf in self.leaves}
        ends = np.cumsum([0, *map(sum, self.state_sizes.values())])
        pairs = zip(self.state_sizes.items(), itertools.pairwise(ends), strict=True)
        self.places = {leaf: slice(start + sizes[0], end) for (leaf, sizes), (start, end) in pairs}
        self.self_updating = [leaf for leaf in self.leaves if hasattr(leaf, "traced_fast_update")]
        self.with_parameters = [
            leaf for leaf in self.leaves if own(leaf).num_numeric_parameter_groups() > 0
        ]
        self.parameter_sizes = [
            len(_parameters_of(leaf, own(leaf))) for leaf in self.with_parameters
        ]
        self.precomputing = [leaf for leaf in self.leaves if is_precomputed(leaf)]
        self.of_users = [
            *(b for b in self.outside - {*self.held} if not is_of_package(b)),
            *(b for b in self.leaves if hasattr(b, "traced_output") and not is_of_package(b)),
        ]
        self.read = [
            (block, k)
            for block in [*self.held, *self.self_updating]
            for k in range(block.num_input_ports())
            if block.get_input_port(k).get_data_type() == PortDataType.kVectorValued
            and self.wires.source(block, k) is not None
        ]

    @property
    def answers_size(self) -> int:
        """Of the argument of a whole sample: which blocks give their states, and these."""
        return sum(1 + sum(self.state_sizes[leaf][1:]) for leaf in self.self_updating)

    @property
    def updating(self) -> dict[str, System]:
        """Leaves that make updates themselves, at every sample or some, by their blocks' names."""
        names = {self.wires.block_of(leaf).get_name(): leaf for leaf in self.self_updating}
        return {block.get_name(): block for block in self.held} | names

    @property
    def state_names(self) -> list[str]:
        """Of each state the path of its system in the diagram, and its number in that."""
        root, names = self.diagram.GetSystemPathname(), []
        for leaf, sizes in self.state_sizes.items():
            path = leaf.GetSystemPathname().removeprefix(root).strip(":").replace("::", ".")
            names += [f"{path}[{k}]" for k in range(sum(sizes))]
        return names

    @property
    def parameter_names(self) -> list[str]:
        """Names as of `CompiledLoop`."""
        names = []
        for leaf, size in zip(self.with_parameters, self.parameter_sizes, strict=True):
            box = self.wires.block_of(leaf).get_name()
            shapes = {"parameters": (size,)}
            own: Any = getattr(leaf, "parameters", None)
            if hasattr(own, "defaults") and not hasattr(leaf, "trace_parameters"):
                shapes = {name: value.shape for name, value in own.defaults.items()}
            for name, shape in shapes.items():
                names += [f"{box}.{name}{list(at) or ''}" for at in np.ndindex(shape)]
        return names

    def reads_of(self, leaf: Any) -> dict[int, tuple[bool, list[int]]]:
        """Reads of a traced leaf's outputs, by numbers: whether the time, and which inputs."""
        symbols: dict[Any, casadi.SX] = {}
        parameters = dict(zip(self.with_parameters, self.parameter_sizes, strict=True))

        def symbol(system: System, name: int | str, size: int) -> NDArray:
            return object_array(symbols.setdefault((system, name), casadi.SX.sym("u", size)))

        class OfSymbols(DiagramSnapshot):
            def output(self, system: System, index: int) -> NDArray:
                return symbol(system, index, system.get_output_port(index).size())

        instant = OfSymbols(
            self.wires,
            {leaf: [symbol(leaf, f"x{k}", n) for k, n in enumerate(self.state_sizes[leaf])]},
            {leaf: symbol(leaf, "p", parameters.get(leaf, 0))},
            symbol(leaf, "t", 1),
            symbol,
            self.is_outside,
        )
        sources = {k: self.wires.source(leaf, k) for k in range(leaf.num_input_ports())}
        found = {}
        for k in range(leaf.num_output_ports()):
            port = leaf.get_output_port(k)
            if port.get_data_type() != PortDataType.kVectorValued:
                continue
            values = leaf.traced_output(port.get_name(), TraceContext(instant, leaf))
            shown = casadi.SX(casadi.vertcat(*values))
            read = {s for s, values in symbols.items() if casadi.depends_on(shown, values)}
            found[k] = (leaf, "t") in read, [i for i, s in sources.items() if s in read]
        return found

    def is_outside(self, block: System) -> bool:
        """Whether a block of the diagram is not traced."""
        return block in self.outside

    def states(self, state: NDArray) -> dict[System, list[NDArray]]:
        """The parts of a state, of numbers or symbols, by leaves and groups."""
        found, start = {}, 0
        for leaf, sizes in self.state_sizes.items():
            ends = start + np.cumsum([0, *sizes])
            found[leaf] = [state[a:b] for a, b in itertools.pairwise(ends)]
            start = ends[-1]
        return found

    def state_of(self, context: Context) -> NDArray:
        """The stacked state of a context of the diagram."""
        return _stacked(state_values(self._own(leaf, context)) for leaf in self.leaves)

    def parameters_of(self, context: Context) -> NDArray:
        """The stacked parameters of a context of the diagram."""
        own = ((leaf, self._own(leaf, context)) for leaf in self.with_parameters)
        return _stacked(itertools.starmap(_parameters_of, own))

    def write_state(self, context: Context, state: NDArray) -> None:
        """Sets the states of the traced blocks in a context of the diagram."""
        for leaf, parts in self.states(state).items():
            own = self.diagram.GetMutableSubsystemContext(leaf, context)
            set_state_values(own, np.concatenate(parts))

    def _own(self, leaf: System, context: Context) -> Context:
        return self.diagram.GetSubsystemContext(leaf, context)


def discrete_state_of(values: DiscreteValues) -> NDArray:
    """The groups of a discrete state, stacked."""
    return _stacked(values.get_vector(k).CopyToVector() for k in range(values.num_groups()))


def _stacked(parts: Iterable[NDArray]) -> NDArray:
    return np.concatenate([np.zeros(0), *parts])


def _state_sizes(context: Context) -> list[int]:
    groups = range(context.num_discrete_state_groups())
    sizes = [context.get_discrete_state(k).size() for k in groups]
    return [context.num_continuous_states(), *sizes]


def _parameters_of(leaf: Any, context: Context) -> NDArray:
    """Parameters that a leaf's trace takes, from a context of its own."""
    if hasattr(leaf, "trace_parameters"):
        return leaf.trace_parameters(context)
    return context.get_numeric_parameter(0).CopyToVector()


_Part = Callable[[casadi.SX, float, Symbols], list[casadi.SX]]  # of a state and an offset in s


class Step(NamedTuple):
    """A step of the integrator; times in s after a sample."""

    begin: float
    length: float
    end: float  # where what stands outside is read, to the bit as at the next sample
    is_shown: bool  # whether all signals are shown at its end


def runge_kutta3(rate: Callable[[Any, float], Any], state: Any, step: Step) -> Any:
    """The state after a step of the third-order Runge-Kutta method, of symbols or numbers.

    `rate` is that of a state at an offset in s.
    """
    begin, length, *_ = step
    first = rate(state, begin)
    second = rate(state + length / 2 * first, begin + length / 2)
    third = rate(state - length * first + 2 * length * second, begin + length)
    return state + length / 6 * first + 2 * length / 3 * second + length / 6 * third


class LoopTrace:
    """Trace of a loop.

    Attributes:
        arguments: symbols of its stacked state and parameters, and of the sample's time, s.
    """

    def __init__(self, layout: LoopLayout):
        self._layout = layout
        sizes = layout.parameter_sizes
        state = casadi.SX.sym("x", sum(map(sum, layout.state_sizes.values())))
        parameters = casadi.SX.sym("p", sum(sizes))
        self.arguments = [state, parameters, casadi.SX.sym("t", 1)]
        values = np.split(object_array(parameters), np.cumsum(sizes)[:-1])
        self._parameters = dict(zip(layout.with_parameters, values, strict=False))

    def _instant(self, states: Mapping[System, list[NDArray]], outside: Any) -> DiagramSnapshot:
        return DiagramSnapshot(
            self._layout.wires,
            dict(states),
            self._parameters,
            object_array(self.arguments[2]),
            outside,
            self._layout.is_outside,
        )

    def updates(self, *, is_start: bool = False) -> Traced:
        """The state after a sample's updates, and what blocks that may make some themselves read.

        Then whether what is made in their place is right. `is_start` has those of the
        initialization.
        """
        symbols = Symbols(self._layout.numbers)
        before = self._layout.states(object_array(self.arguments[0]))
        updating = [leaf for leaf in self._layout.leaves if hasattr(leaf, "traced_update")]
        early: tuple[str, ...] = ("updates_first",)
        if is_start:
            updating = [leaf for leaf in updating if getattr(leaf, "updates_at_start", False)]
            early = ("updates_first", "starts_first")
        first = [leaf for leaf in updating if any(getattr(leaf, name, False) for name in early)]
        late = [leaf for leaf in updating if leaf not in first]
        instant = self._instant(before, symbols.at(0.0))
        after = before | {leaf: _updated(leaf, instant, before, is_start) for leaf in first}
        instant = self._instant(after, symbols.at(0.0))
        last = after | {leaf: _updated(leaf, instant, after, is_start) for leaf in late}
        is_valid = []
        for leaf in self._layout.self_updating if not is_start else ():
            made = leaf.traced_fast_update(TraceContext(instant, leaf))
            last[leaf] = [last[leaf][0], *made.states]
            is_valid.append(made.is_valid)
        inputs = (instant.input(*place) for place in self._layout.read)
        read = [values for values in inputs if values is not None]
        results = [_stacked_symbols(last), _joined(read), _joined([np.array(is_valid)])]
        return Traced(results, self.arguments, symbols)

    def steps(
        self, schedule: Sequence[Step], shown: _Part, updates: Traced | None = None
    ) -> Traced:
        """The state after a sample's steps, and all signals that are shown on the way.

        `updates` are the sample's, whose first result is the state; None: it is the argument.
        """
        symbols = Symbols(self._layout.numbers) if updates is None else updates.symbols

        def rate(state: casadi.SX, offset: float) -> casadi.SX:
            return self.rates(state, offset, symbols)[0]

        arguments = symbols.arguments or self.arguments
        now = arguments[0] if updates is None else updates.results[0]
        signals, step_signals = [], []
        for step in schedule:
            now = runge_kutta3(rate, now, step)
            own_signals, own_step_signals = shown(now, step.end, symbols)
            step_signals.append(own_step_signals)
            signals += [own_signals] if step.is_shown else []
        results = [now, casadi.vertcat(*signals), casadi.vertcat(*step_signals)]
        return Traced(results, arguments, symbols)

    def whole(
        self, schedule: Sequence[Step], shown: _Part, updates: Traced, *, calls: bool = False
    ) -> LoopFunction:
        """The state and all signals at the next sample, and what its updates tell besides.

        `updates` are the sample's. A further argument has which blocks have made updates
        themselves, and their states after these. If it `calls` the functions of an instant, its C
        does not have all their operations again at each step.
        """
        answers = casadi.SX.sym("a", self._layout.answers_size)
        after, read, is_valid = casadi.SX(updates.results[0]), *updates.results[1:]
        start = len(self._layout.self_updating)
        for k, leaf in enumerate(self._layout.self_updating):
            place = self._layout.places[leaf]
            end = start + place.stop - place.start
            after[place] = casadi.if_else(answers[k], answers[start:end], after[place])
            start = end
        arguments, symbols = [*self.arguments, answers], updates.symbols
        if calls:
            own = symbols
            stacked = casadi.vertcat(*arguments, *own.symbols.values())
            made = casadi.cse([after, read, is_valid])
            function = casadi.Function("updates", [stacked], made)
            _, arguments, symbols = self.called(answers)
            outside = [symbols.of(r, s.numel()) for r, s in own.symbols.items()]
            taken = casadi.vertcat(*arguments, *itertools.chain(*outside))
            after, read, is_valid = function.call([taken])
        moved = self.steps(schedule, shown, Traced([after], arguments, symbols))
        results = [*moved.results, read, is_valid]
        return LoopFunction(Traced(results, arguments, symbols), is_whole=True)

    def called(self, *others: casadi.SX) -> Traced:
        """The state, of arguments for calls of functions, with others behind them."""
        sizes = [each.numel() for each in (*self.arguments, *others)]
        arguments = [casadi.MX.sym("argument", size) for size in sizes]
        return Traced(arguments[:1], arguments, Symbols(self._layout.numbers, arguments=arguments))

    def shown(self, *signals: Iterable[str]) -> _Part:
        """Some lists of signals, by the names of the diagram's ports."""
        return self._part(lambda at: [_joined(self._at(at, names)) for names in signals])

    @cached_property
    def rates(self) -> _Part:
        """The rates of the loop's state, 0 of all that is discrete."""
        return self._part(self._rates_at)

    @cached_property
    def operations_of_rates(self) -> int:
        """How many operations the rates take."""
        symbols = Symbols(self._layout.numbers)
        results = self.rates(self.arguments[0], 0.0, symbols)
        read = [*self.arguments, *symbols.symbols.values()]
        return int(casadi.Function("rates", [casadi.vertcat(*read)], results).n_instructions())

    def _rates_at(self, instant: DiagramSnapshot) -> list[casadi.SX]:
        found = []
        for leaf, (continuous, *discrete) in self._layout.state_sizes.items():
            found += [rates(leaf, instant)] if continuous else []
            found.append(np.zeros(sum(discrete)))
        return [_joined(found)]

    def _part(self, make: Callable[[DiagramSnapshot], list[casadi.SX]]) -> _Part:
        """Values of an instant, traced once, of any state, offset (s) and `Symbols`."""
        state, *others = self.arguments
        own = Symbols(self._layout.numbers)
        states = self._layout.states(object_array(state))
        results = make(self._instant(states, own.at(0.0)))
        taken = [state, *others, *own.symbols.values()]
        function = casadi.Function("part", taken, casadi.cse(results))

        @functools.cache
        def apart() -> list[casadi.Function]:
            # What calls functions has only those whose results are read.
            return [casadi.Function("part", taken, [casadi.cse(each)]) for each in results]

        def part(now: casadi.SX, offset: float, symbols: Symbols) -> list[casadi.SX]:
            read = own.symbols.items()
            _, parameters, time, *_ = symbols.arguments or self.arguments
            outside = [symbols.of(r._replace(offset=offset), s.numel()) for r, s in read]
            inputs = [now, parameters, time + offset, *(casadi.vertcat(*o) for o in outside)]
            if symbols.arguments:
                return [each(*inputs) for each in apart()]
            return function.call(inputs)

        return part

    def _at(self, instant: DiagramSnapshot, signals: Iterable[str]) -> list[NDArray]:
        """Values of signals at an instant."""
        found = []
        for name in signals:
            port = self._layout.diagram.GetOutputPort(name).get_index()
            system, index = self._layout.diagram.get_output_port_locator(port)
            found.append(instant.output(system, int(index)))
        return found


def _updated(
    leaf: Any, instant: DiagramSnapshot, states: Mapping[System, list[NDArray]], is_start: bool
) -> list[NDArray]:
    """A leaf's states after its update of the discrete ones."""
    start = getattr(leaf, "traced_start", leaf.traced_update) if is_start else leaf.traced_update
    return [states[leaf][0], *start(TraceContext(instant, leaf))]


def _joined(arrays: list[NDArray]) -> casadi.SX:
    entries = [entry for array in arrays for entry in array]
    return casadi.densify(casadi.vertcat(*entries)) if entries else casadi.SX(0, 1)


def _stacked_symbols(states: Mapping[System, list[NDArray]]) -> casadi.SX:
    return _joined([group for groups in states.values() for group in groups])
