"""A diagram in symbols: values of its ports, rates of its states, and its updates at samples.

Every leaf system of the diagram is one of these:

- a `LeafBlock` with the method `traced_output(port, at)`, and for its states `traced_rates(at)` and
  `traced_update(at)`, which take a `TraceContext` and compute with NumPy on arrays of symbols. A
  method `trace_parameters(context)` gives numbers in place of its first numeric parameter. The
  quantities that it reads by `TraceContext.known` are evaluated before a flight;
- one of Drake's systems that are linear and have no state: their matrix is found at unit vectors;
- Drake's Integrator or TrajectorySource.

All other systems are outside of the trace: their outputs are symbols that it takes as inputs.
"""

import weakref
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import (
    BasicVector,
    Context,
    Diagram,
    InputPortIndex,
    OutputPortIndex,
    System,
)
from pydrake.systems.primitives import (
    Adder,
    Demultiplexer,
    Gain,
    Integrator,
    MatrixGain,
    Multiplexer,
    PassThrough,
    Selector,
    TrajectorySource,
)

from drake_nonstop.systems.block import has_own
from drake_nonstop.systems.tracing import object_array, to_symbols
from drake_nonstop.systems.wiring import systems_in

# Methods of blocks, which give rows (k, size) at times (k,), s: of the outputs of a block without
# inputs, and of quantities that a traced block reads by `TraceContext.known`. The first takes the
# block's own context, too, where the block has `TAKE_CONFIG(context, config)`, which sets there
# whatever a config says.
TAKE_CONFIG = "take_config"
ROWS, QUANTITIES = "precomputed_outputs", "precomputed_inputs"
_LINEAR = Selector, Gain, MatrixGain, Adder, Multiplexer, Demultiplexer, PassThrough

Place = tuple[System, int]  # a port, by its system and its number
# Gives symbols (size,) of a system's output, by number, or quantity, by name: system, which, size.
Outside = Callable[[System, int | str, int], NDArray]


def leaves(system: System) -> Iterator[Any]:
    """Returns the leaf systems in a system, or the system itself if it is one."""
    return (part for part in systems_in(system) if not isinstance(part, Diagram))


def is_traceable(system: System) -> bool:
    """Whether all leaf systems in a system can be traced."""
    return all(
        isinstance(leaf, (Integrator, TrajectorySource, *_LINEAR)) or _has_trace(leaf)
        for leaf in leaves(system)
    )


def updates_in_trace(leaf: System) -> bool:
    """Whether a leaf has discrete updates in a trace."""
    return hasattr(leaf, "traced_update") or hasattr(leaf, "traced_fast_update")


def is_precomputed(leaf: System) -> bool:
    """Whether a traceable leaf has outputs or quantities that depend on the time alone."""
    return hasattr(leaf, QUANTITIES) or isinstance(leaf, TrajectorySource)


def _has_trace(leaf: System) -> bool:
    """Whether a leaf has methods for a trace, and no derived class may compute other values."""
    has_trace = getattr(leaf, "traced_output", None) is not None
    is_own = has_own(leaf, "traced_output") or _is_one_function(leaf)
    return has_trace and is_own and getattr(leaf, "is_traced", True)


def _is_one_function(leaf: Any) -> bool:
    """Whether a leaf computes a `TracedBlock`'s function alone, even if its class is derived."""
    if not getattr(leaf, "is_one_function", False):
        return False
    packages = __name__.split(".")[0], "pydrake"
    rates = (vars(kind).get("DoCalcTimeDerivatives") for kind in type(leaf).__mro__)
    return all(own is None or own.__module__.split(".")[0] in packages for own in rates)


def trace_content(diagram: Diagram, wires: "Wires", outside: Callable[[System], bool]) -> Any:
    """Key of a diagram's trace, which can be hashed: diagrams of equal keys have one trace.

    None: a system's part of it is not known, see `LeafBlock.trace_key`. `outside` tells of each of
    the diagram's own systems whether it is outside of the trace.
    """
    systems = [part for own in diagram.GetSystems() for part in _parts(own, outside)]
    numbers = {system: k for k, system in enumerate(systems)}
    found = []
    for system in systems:
        inputs, outputs = range(system.num_input_ports()), range(system.num_output_ports())
        sources = [wires.source(system, k) for k in inputs]
        read = [None if s is None else (numbers[s[0]], s[1]) for s in sources]
        ports = [system.get_input_port(k) for k in inputs]
        ports += [system.get_output_port(k) for k in outputs]
        content = _content(system, wires, outside)
        if content is None:
            return None
        if isinstance(system, Diagram) and not outside(system):
            locators = [system.get_output_port_locator(OutputPortIndex(k)) for k in outputs]
            content = [(numbers[part], int(index)) for part, index in locators]
        sizes = tuple((port.get_name(), port.size()) for port in ports)
        found.append((tuple(read), sizes, tuple(content)))
    return tuple(found)


def _parts(system: System, outside: Callable[[System], bool]) -> Iterator[System]:
    """A system and all systems in it, or it alone if it is outside of the trace."""
    return iter((system,)) if outside(system) else systems_in(system)


def _content(system: Any, wires: "Wires", outside: Callable[[System], bool]) -> Any:
    """Key of a system's part of a trace, besides its ports; None: it is not known."""
    kind = type(system)
    if isinstance(system, Diagram) or outside(system):
        return ()
    if isinstance(system, _LINEAR):
        outputs = range(system.num_output_ports())
        parts = [(k, *part) for k in outputs for part in wires.matrices_of(system, k).items()]
        return (kind, *((k, name, matrix.full().tobytes()) for k, name, matrix in parts))
    if isinstance(system, (Integrator, TrajectorySource)):
        return (kind,)
    key = None
    if has_own(system, "trace_key") or _is_one_function(system):
        key = system.trace_key
    return None if key is None else (kind, key)


class Wires:
    """Where each input of a diagram's systems comes from, however deep they are."""

    def __init__(self, diagram: Diagram):
        self._root = diagram
        self._matrices: dict[Place, dict[str, casadi.DM]] = {}  # of outputs of linear leaves
        self._sources: dict[Place, Place] = {}
        self._parents: dict[System, Diagram] = {}
        self._outer: dict[Place, Place] = {}  # of an exported input: its diagram's
        self._add(diagram)

    def _add(self, diagram: Diagram) -> None:
        for (reader, index), (maker, output) in diagram.connection_map().items():
            self._sources[reader, int(index)] = (maker, int(output))
        for k in range(diagram.num_input_ports()):
            for reader, index in diagram.GetInputPortLocators(InputPortIndex(k)):
                self._outer[reader, int(index)] = (diagram, k)
        for part in diagram.GetSystems():
            self._parents[part] = diagram
            if isinstance(part, Diagram):
                self._add(part)

    def source(self, reader: System, index: int) -> Place | None:
        """The output port, of a leaf or a diagram, that feeds an input; None: there is none."""
        place = (reader, index)
        while place not in self._sources:
            if place not in self._outer:
                return None
            place = self._outer[place]
        return self._sources[place]

    def matrices_of(self, leaf: System, index: int) -> dict[str, casadi.DM]:
        """The matrices (outputs, inputs) to a linear leaf's output, by names of inputs it reads."""
        if (leaf, index) not in self._matrices:
            self._matrices[leaf, index] = _matrices(leaf, index)
        return self._matrices[leaf, index]

    def block_of(self, system: System) -> System:
        """The diagram's own subsystem that a system is, or is in."""
        while self._parents[system] is not self._root:
            system = self._parents[system]
        return system


class DiagramSnapshot:
    """A diagram at one instant: all values in symbols, each found once.

    Args:
        wires: those of the diagram.
        states: of each leaf with a state its continuous state, then its discrete groups.
        parameters: the first numeric parameter of each leaf that has one.
        time: that of the instant (1,), s.
        outside: gives symbols of the outputs of systems outside of the trace.
        is_outside: tells of each of the diagram's own systems whether it is one of these.
    """

    def __init__(
        self,
        wires: Wires,
        states: dict[System, list[NDArray]],
        parameters: dict[System, NDArray],
        time: Any,
        outside: Outside,
        is_outside: Callable[[System], bool],
    ):
        self.wires, self.time, self.outside = wires, time, outside
        self.states, self.parameters, self._is_outside = states, parameters, is_outside
        self._shown: dict[Place, NDArray] = {}
        self.made: dict[Any, NDArray] = {}  # values that leaves make once, by leaf and key

    def output(self, system: System, index: int) -> NDArray:
        """Value (size,) of an output port."""
        block = self.wires.block_of(system)
        if self._is_outside(block):
            if system is not block:
                path = system.GetSystemPathname()
                raise ValueError(f"system = {path}: it is inside what stands outside")
            return self.outside(block, int(index), block.get_output_port(int(index)).size())
        while isinstance(system, Diagram):
            system, index = system.get_output_port_locator(OutputPortIndex(int(index)))
        place = (system, int(index))
        if place not in self._shown:
            values = _output(system, int(index), self)
            self._shown[place] = values if values.dtype == object else to_symbols(values)
        return self._shown[place]

    def input(self, system: System, index: int) -> NDArray | None:
        """Value (size,) of an input port; None: it is not connected."""
        source = self.wires.source(system, index)
        return None if source is None else self.output(*source)


class FastUpdate(NamedTuple):
    """Update, in symbols, that holds where a block which searches need not do so."""

    states: list[NDArray]  # the discrete groups after the update
    is_valid: Any  # 1; or 0: `states` are wrong, and the block has to make the update itself


class TraceContext:
    """Inputs, states and parameters of a leaf in a `DiagramSnapshot`, for its methods."""

    def __init__(self, instant: DiagramSnapshot, leaf: System):
        self._instant, self._leaf = instant, leaf

    def input(self, name: str) -> NDArray:
        """Value (size,) of an input port, which has to be connected."""
        values = self._instant.input(self._leaf, self._index(name))
        assert values is not None, f"{self._leaf.GetSystemPathname()}.{name} is not connected"
        return values

    def input_or(self, name: str, other: NDArray) -> NDArray:
        """Value of an input port, or `other` where it is not connected."""
        values = self._instant.input(self._leaf, self._index(name))
        return other if values is None else values

    def has_input(self, name: str) -> bool:
        """Whether an input port is connected."""
        return self._instant.wires.source(self._leaf, self._index(name)) is not None

    def known(self, name: int | str, size: int) -> NDArray:
        """Value (size,) of a quantity that depends on the time alone, and is not traced.

        It is an output of the leaf, by its number, or a quantity of the leaf, by its name: the
        method `precomputed_inputs(names, times)` gives rows (k, size) of each, at times (k,) in s.
        """
        return self._instant.outside(self._leaf, name, size)

    @property
    def time(self) -> NDArray:
        """The time (1,), s."""
        return self._instant.time

    @property
    def parameters(self) -> NDArray:
        """The leaf's first numeric parameter."""
        return self._instant.parameters[self._leaf]

    def state(self, group: int) -> NDArray:
        """The continuous state (0), or a discrete group (from 1 on)."""
        return self._instant.states[self._leaf][group]

    def once(self, key: Any, make: Callable[[], NDArray]) -> NDArray:
        """A value that the leaf makes once for several ports."""
        made, own = self._instant.made, (self._leaf, key)
        if own not in made:
            made[own] = make()
        return made[own]

    def _index(self, name: str) -> int:
        return int(self._leaf.GetInputPort(name).get_index())


class InContext:
    """A `TraceContext` that reads Drake's context of a block, of any scalar type.

    With it `traced_output`, `traced_update` and `traced_rates` compute for Drake's callbacks, too.
    """

    def __init__(self, block: Any, context: Context):
        self._block, self._context = block, context

    def input(self, name: str) -> NDArray:
        """Value of an input port."""
        return self._block.GetInputPort(name).Eval(self._context)

    def input_or(self, name: str, other: NDArray) -> NDArray:
        """Value of an input port, or `other` where it is not connected."""
        return self.input(name) if self.has_input(name) else other

    def has_input(self, name: str) -> bool:
        """Whether an input port is connected."""
        return self._block.GetInputPort(name).HasValue(self._context)

    def known(self, name: str, size: int) -> NDArray:
        """Value (size,) of one of the block's `precomputed_inputs` at the context's time."""
        return self._block.precomputed_inputs([name], self.time)[0][0]

    @property
    def time(self) -> NDArray:
        """The time (1,), s."""
        return np.array([self._context.get_time()])

    def state(self, group: int) -> NDArray:
        """The continuous state (0), or a discrete group (from 1 on)."""
        if group == 0:
            return self._context.get_continuous_state_vector().CopyToVector()
        return self._context.get_discrete_state(group - 1).CopyToVector()


def shown(block: Any, port: str) -> Callable[[Context, BasicVector], None]:
    """Returns Drake's callback of an output port, by `traced_output`; the block is held weakly."""
    me: Any = weakref.ref(block)

    def calc(context: Context, output: BasicVector) -> None:
        output.SetFromVector(me().traced_output(port, InContext(me(), context)))

    return calc


def _output(leaf: Any, index: int, instant: DiagramSnapshot) -> NDArray:
    at, port = TraceContext(instant, leaf), leaf.get_output_port(index)
    if hasattr(leaf, "traced_output"):
        return leaf.traced_output(port.get_name(), at)
    if isinstance(leaf, Integrator):
        return at.state(0)
    if isinstance(leaf, TrajectorySource):
        return at.known(index, port.size())
    total = casadi.SX.zeros(port.size())
    for name, matrix in instant.wires.matrices_of(leaf, index).items():
        total += matrix @ casadi.vertcat(*at.input(name))
    return object_array(casadi.densify(total))


def _matrices(leaf: System, index: int) -> dict[str, casadi.DM]:
    """Sparse matrices of a linear leaf without a state, as `Wires.matrices_of` has them."""
    context = leaf.CreateDefaultContext()
    ports = [leaf.get_input_port(k) for k in range(leaf.num_input_ports())]
    fixed = [port.FixValue(context, np.zeros(port.size())) for port in ports]
    output = leaf.get_output_port(index)
    found = {}
    for port, value in zip(ports, fixed, strict=True):
        columns = []
        for k in range(port.size()):
            value.GetMutableData().get_mutable_value().SetAtIndex(k, 1.0)
            columns.append(output.Eval(context).copy())
            value.GetMutableData().get_mutable_value().SetAtIndex(k, 0.0)
        if np.any(columns):
            found[port.get_name()] = casadi.sparsify(casadi.DM(np.array(columns).T))
    return found


def rates(leaf: Any, instant: DiagramSnapshot) -> NDArray:
    """The time derivative of a leaf's continuous state, in symbols."""
    at = TraceContext(instant, leaf)
    if isinstance(leaf, Integrator):
        return at.input(leaf.get_input_port().get_name())
    return leaf.traced_rates(at)
