"""What the blocks of a loop are to its trace, and where their states are in it."""

import itertools
from collections.abc import Iterable
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram, DiscreteValues, PortDataType, System

from drake_nonstop.systems.block import is_of_package
from drake_nonstop.systems.diagram_trace import (
    At,
    Instant,
    Wires,
    is_traceable,
    knows_beforehand,
    leaves,
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
        knowing: those that know quantities beforehand, see `systems.diagram_trace.At.known`.
        of_users: the systems that are a user's own, of those that are evaluated or traced.
        read: the inputs that are given to blocks which make updates themselves: block and number.
    """

    def __init__(self, diagram: Diagram):
        root = diagram.CreateDefaultContext()
        self.diagram, self.wires = diagram, Wires(diagram)
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
        self.knowing = [leaf for leaf in self.leaves if knows_beforehand(leaf)]
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
        """Those that make updates themselves, at every sample or some, by their blocks' names."""
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
        """As of `CompiledLoop`."""
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
        """What a traced leaf's outputs read, by numbers: whether the time, and which inputs."""
        symbols: dict[Any, casadi.SX] = {}
        parameters = dict(zip(self.with_parameters, self.parameter_sizes, strict=True))

        def symbol(system: System, name: int | str, size: int) -> NDArray:
            return object_array(symbols.setdefault((system, name), casadi.SX.sym("u", size)))

        class OfSymbols(Instant):
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
            values = leaf.traced_output(port.get_name(), At(instant, leaf))
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
    """What a leaf's trace takes of the parameters in a context of its own."""
    if hasattr(leaf, "trace_parameters"):
        return leaf.trace_parameters(context)
    return context.get_numeric_parameter(0).CopyToVector()
