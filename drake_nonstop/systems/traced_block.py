"""Blocks that are one traced function, wired to their ports by Drake's own systems.

A callback into Python spends most of its time on its ports: to evaluate one input takes as long
as the traced function. Drake's systems, in C++, therefore stack the inputs to one vector, split the
outputs and hold the state, and Python is called once, for the function.
"""

import pickle
import weakref
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    InputPort,
    OutputPort,
    System,
)
from pydrake.systems.primitives import Selector, SelectorParams

from drake_nonstop.systems.block import DiagramBlock, InnerBlock, weakly
from drake_nonstop.systems.diagram_trace import At
from drake_nonstop.systems.parameters import NumericParameters, declare_parameters
from drake_nonstop.systems.tracing import ArrayFunction, LateFunction, Trace, object_array

_STATE = "(state)"  # no name of a port
_NUMBERS = "(parameters)"  # likewise
_INNER = {_STATE, _NUMBERS}  # inputs of the function that are no ports of the block


class LateOutputs(NamedTuple):
    """Outputs that are traced when one of them is evaluated for the first time.

    `function` takes the block's inputs whose names `reads` has, those of `optional`, and its
    parameters; every output feeds through all of these inputs. Those of `optional`, names and
    sizes, are inputs of the block besides, which may be left unconnected, and then are zero.
    `outputs` and `key` are as of the block.
    """

    function: Callable
    reads: Sequence[str]
    outputs: Mapping[str, int]
    optional: Mapping[str, int] = {}
    key: Any = None


class TracedBlock(DiagramBlock):
    """A block whose outputs are a traced function of its inputs and its state.

    What feeds through to an output are the inputs that its trace reads. Outputs that do not read
    the same inputs are made by calls of their own into Python. On AutoDiffXd and Expression the
    function itself is evaluated, on object arrays.

    Args:
        function: takes one flat array for the state, where there is one, and one per entry of
            `inputs`; returns what goes into the state, where there is one, and one flat array
            per entry of `outputs`. It is traced, see `TracedFunction`.
        inputs: the names of the input ports and their sizes.
        outputs: the names of the output ports and their sizes.
        state: what holds the state: an `Integrator`, or any other system with an input and an
            output of one size.
        state_port: the name of the output port that shows the state; none: no port does.
        reads_time: `function` takes the time (1,) in s after all others.
        parameters: what `function` takes by name, as arrays, numbers as (1,), besides: a numeric
            parameter of the context.
        key: as of `TracedFunction`; the parameters' values are no part of it.
        is_one_call: all outputs are made by one call into Python, and each depends on what any of
            them reads.
        late: makes further outputs, which most loops do not read.

    Raises:
        ValueError: there is nothing to take: neither an input nor a state nor the time.
    """

    def __init__(
        self,
        function: Callable,
        *,
        inputs: Mapping[str, int],
        outputs: Mapping[str, int] | None = None,
        state: System | None = None,
        state_port: str = "",
        reads_time: bool = False,
        parameters: NumericParameters | None = None,
        key: Any = None,
        is_one_call: bool = False,
        late: "LateOutputs | None" = None,
    ):
        super().__init__()
        parameters = parameters or NumericParameters({})
        read, made = dict(inputs), dict(outputs or {})
        initial = np.zeros(0)
        if state is not None:
            initial = state.get_output_port().Eval(state.CreateDefaultContext()).copy()
        if state is not None:
            own = {_STATE: len(initial)}
            read, made = own | read, own | made
        if not read and not reads_time:
            raise ValueError("inputs = none: give some, a state, or reads_time")
        own_inputs = len(read)
        if len(parameters) > 0:
            function = parameters.as_argument(function, own_inputs)
            read = read | {_NUMBERS: len(parameters)}
        time = len(read)
        trace = Trace(function, [*read.values(), *([1] if reads_time else [])], key=key)
        inner = {i for i, name in enumerate(read) if name in _INNER}
        dependence = trace.dependence
        if is_one_call:
            dependence = [set().union(*dependence)] * len(dependence)
        groups = _groups(dependence, {*inner, time}, has_state=state is not None)
        parts = [_part_of(trace, group, [*made], time) for group in groups]
        if late is not None:
            parts.append(_late_part(late, read, parameters))
            self.optional_inputs = tuple(late.optional)
        builder = DiagramBuilder()
        sizes = [*read.values()]
        traced = builder.AddNamedSystem("traced", _Traced(parts, sizes, parameters))
        inputs_of = traced.get_input_port
        if len(read) > 1 or (read and [part.reads for part in parts] != [[0]]):
            chosen = {f"inputs_{k}": part.reads for k, part in enumerate(parts) if part.reads}
            stacked = builder.AddNamedSystem("stacked", Selector(_stacking_of(read, chosen)))
            inputs_of = stacked.get_input_port
            for name in chosen:
                builder.Connect(stacked.GetOutputPort(name), traced.GetInputPort(name))
        outputs_of = _outputs(builder, traced, parts)
        for i, name in enumerate(read):
            if name not in _INNER:
                builder.ExportInput(inputs_of(i), name)
        for part in parts:
            for name in part.optional:
                builder.ExportInput(traced.GetInputPort(name), name)
        if len(parameters) > 0:
            builder.Connect(traced.GetOutputPort("parameters"), inputs_of(len(read) - 1))
        for name in [*made, *(late.outputs if late is not None else [])]:
            if name != _STATE:
                builder.ExportOutput(outputs_of[name], name)
        if state is not None:
            builder.AddNamedSystem(_STATE, state)
            builder.Connect(state.get_output_port(), inputs_of(0))
            builder.Connect(outputs_of[_STATE], state.get_input_port())
            if state_port:
                builder.ExportOutput(state.get_output_port(), state_port)
        builder.BuildInto(self)


class _Group(NamedTuple):
    """Outputs that depend on the same input ports, made together."""

    reads: list[int]  # the numbers of the inputs that any of them depends on
    makes: list[int]  # the outputs' numbers


def _groups(dependence: list[set[int]], inner: set[int], has_state: bool) -> list[_Group]:
    """The outputs in groups, in the order of their first ones.

    Args:
        dependence: as of `Trace`.
        inner: the numbers of the inputs that are no ports. An output is taken to depend on
            one of these where another one of its group does.
        has_state: the first output goes into the state: no port shows on which inputs it
            depends, and it is made with others that read these and more.
    """
    ports = [frozenset(depends - inner) for depends in dependence]
    if has_state:
        wider = [other for other in ports[1:] if other >= ports[0]]
        ports[0] = min(wider, key=len, default=ports[0])
    groups = []
    for own in dict.fromkeys(ports):
        makes = [i for i, other in enumerate(ports) if other == own]
        groups.append(_Group(sorted(set().union(*(dependence[i] for i in makes))), makes))
    return groups


class _Part(NamedTuple):
    """Outputs that are made together."""

    reads: list[int]  # the numbers of the inputs, but for the time
    reads_time: bool
    outputs: dict[str, int]  # names and sizes
    # Takes the scalar type and the name of the block, and returns what evaluates the part: a
    # `TracedFunction` or what stands in for one.
    make: Callable[[type, Callable[[], str]], Any]
    function: Callable[[], casadi.Function]  # of the inputs, stacked, and the time
    key: Any  # equal for parts of one function; None: there is no other
    optional: Mapping[str, int] = {}  # inputs besides, which may be left unconnected


def _part_of(trace: Trace, group: _Group, names: list[str], time: int) -> _Part:
    """A group of the outputs, which have these names, of a trace whose input `time` is the time."""

    def make(scalar: type, name: Callable[[], str]) -> Any:
        function = trace.compiled if scalar is float else trace.on_arrays
        return function(group.reads, group.makes, name=name)

    return _Part(
        [i for i in group.reads if i != time],
        time in group.reads,
        {names[i]: trace.output_sizes[i] for i in group.makes},
        make,
        lambda: trace.part(group.reads, group.makes),
        (trace.identity, *map(tuple, group)),
    )


def _late_part(
    late: LateOutputs, inputs: Mapping[str, int], parameters: NumericParameters
) -> _Part:
    """The part for late outputs of a block's inputs, whose names and sizes are given."""
    names, function = [*late.reads], late.function
    if len(parameters) > 0:
        function = parameters.as_argument(function, len(names))
        names.append(_NUMBERS)
    numbers = [[*inputs].index(name) for name in names]
    sizes = [*(inputs[name] for name in names), *late.optional.values()]
    names += late.optional
    whole = range(len(names)), range(len(late.outputs))

    def make(scalar: type, name: Callable[[], str]) -> Any:
        if scalar is not float:
            return ArrayFunction(function, sizes, *whole, name=name)
        return LateFunction(
            lambda: Trace(function, sizes, key=late.key).compiled(*whole, name=name)
        )

    def traced() -> casadi.Function:
        return Trace(function, sizes, key=late.key).part(*whole)

    key = None if late.key is None else pickle.dumps((late.key, sizes))
    return _Part(numbers, False, dict(late.outputs), make, traced, key, dict(late.optional))


class _Traced(InnerBlock):
    """The parts of a block: for each a vector of inputs, stacked, and one of outputs, likewise.

    They are one system, since each one costs time at each step. So do the parameters: they are
    another output, for the stack. Drake's ConstantVectorSource would make what reads it depend on
    the time.

    Args:
        parts: what is evaluated.
        sizes: of the block's inputs.
        parameters: of all parts.
    """

    def __init__(self, parts: Sequence[_Part], sizes: Sequence[int], parameters: NumericParameters):
        super().__init__()
        self._parts = parts
        self._ports: list[InputPort | None] = []  # of the parts
        self._optional: list[InputPort] = []  # of the one part that has any
        for k, part in enumerate(parts):
            function = part.make(self.scalar, weakly(self.box))
            size = sum(sizes[i] for i in part.reads)
            prerequisites = set()
            port = None
            if size > 0:
                port = self.DeclareVectorInputPort(f"inputs_{k}", size)
                prerequisites.add(self.input_port_ticket(port.get_index()))
            self._ports.append(port)
            for name, optional_size in part.optional.items():
                optional = self.DeclareVectorInputPort(name, optional_size)
                prerequisites.add(self.input_port_ticket(optional.get_index()))
                self._optional.append(optional)
            if part.reads_time:
                prerequisites.add(self.time_ticket())
            self.DeclareVectorOutputPort(
                f"results_{k}",
                sum(part.outputs.values()),
                _callback(weakref.ref(self), k, function, part),
                prerequisites or {self.nothing_ticket()},
            )
        if len(parameters) > 0:
            self.parameters = parameters
            declare_parameters(self, parameters)
            sources = {self.all_parameters_ticket()}
            size = len(parameters)
            self.DeclareVectorOutputPort("parameters", size, self._calc_parameters, sources)

    @property
    def trace_key(self) -> Any:
        """The functions of the parts."""
        keys = tuple(part.key for part in self._parts)
        return None if None in keys else keys

    def traced_output(self, port: str, at: At) -> NDArray:
        """The results of a part, or the parameters."""
        if port == "parameters":
            return at.parameters
        k = int(port.removeprefix("results_"))
        part = self._parts[k]
        read = [at.input(f"inputs_{k}")] if part.reads else []
        read += [at.input_or(name, np.zeros(size)) for name, size in part.optional.items()]
        read += [at.time] if part.reads_time else []
        results, _ = part.function()(casadi.vertcat(*np.concatenate(read)))
        return object_array(results)

    def _calc_parameters(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_numeric_parameter(0).CopyToVector())


def _callback(
    block: Callable[[], Any], k: int, function: Any, part: _Part
) -> Callable[[Context, BasicVector], None]:
    """What Drake calls for the results of part k of a `_Traced`, to which `block` refers weakly.

    A method, given with `weakly`, would take another call of Python.
    """
    if not part.reads:
        evaluate = function.of_vector

        def calc(context: Context, output: BasicVector) -> None:
            output.SetFromVector(evaluate(np.array([context.get_time()])))

    elif part.reads_time:
        evaluate = function.of_vector_and_time

        def calc(context: Context, output: BasicVector) -> None:
            inputs = block()._ports[k].Eval(context)
            output.SetFromVector(evaluate(inputs, context.get_time()))

    elif part.optional:
        evaluate = function.of_vector
        zeros = [np.zeros(size) for size in part.optional.values()]

        def calc(context: Context, output: BasicVector) -> None:
            own = block()
            vectors = [own._ports[k].Eval(context)]
            for port, zero in zip(own._optional, zeros, strict=True):
                vectors.append(port.Eval(context) if port.HasValue(context) else zero)
            output.SetFromVector(evaluate(np.concatenate(vectors)))

    else:
        evaluate = function.of_vector

        def calc(context: Context, output: BasicVector) -> None:
            output.SetFromVector(evaluate(block()._ports[k].Eval(context)))

    return calc


def _outputs(
    builder: DiagramBuilder, traced: System, parts: Sequence[_Part]
) -> dict[str, OutputPort]:
    """The ports of the parts' outputs by name; outputs that are made together are split."""
    outputs_of = {}
    stacks = {}
    for k, part in enumerate(parts):
        made = part.outputs
        if len(made) == 1:
            outputs_of[next(iter(made))] = traced.GetOutputPort(f"results_{k}")
        else:
            stacks[f"results_{k}"] = made
    if stacks:
        split = builder.AddNamedSystem("parts", Selector(_splitting_of(stacks)))
        for stack, made in stacks.items():
            builder.Connect(traced.GetOutputPort(stack), split.GetInputPort(stack))
            outputs_of |= {name: split.GetOutputPort(name) for name in made}
    return outputs_of


def stacking(sizes: Mapping[str, int], output: str = "stacked") -> SelectorParams:
    """Of a Selector that makes one vector of inputs of these names and sizes.

    Unlike Drake's Multiplexer it does nothing while only the time changes.
    """
    return _stacking_of(sizes, {output: range(len(sizes))})


def _stacking_of(sizes: Mapping[str, int], outputs: Mapping[str, Sequence[int]]) -> SelectorParams:
    """Of a Selector that stacks these of the inputs, by their numbers, for each of the outputs."""
    counts = [*sizes.values()]
    return SelectorParams(
        inputs=_inputs(sizes),
        outputs=[
            _output(name, [(i, k) for i in chosen for k in range(counts[i])])
            for name, chosen in outputs.items()
        ],
    )


def splitting(sizes: Mapping[str, int]) -> SelectorParams:
    """Of a Selector that makes outputs of these names and sizes of one vector."""
    return _splitting_of({"stacked": sizes})


def _splitting_of(stacks: Mapping[str, Mapping[str, int]]) -> SelectorParams:
    """Of a Selector that splits inputs: the names and sizes of the outputs of each, by its name."""
    outputs = []
    for i, sizes in enumerate(stacks.values()):
        start = 0
        for name, size in sizes.items():
            outputs.append(_output(name, [(i, start + k) for k in range(size)]))
            start += size
    inputs = _inputs({name: sum(sizes.values()) for name, sizes in stacks.items()})
    return SelectorParams(inputs=inputs, outputs=outputs)


def _inputs(sizes: Mapping[str, int]) -> list[SelectorParams.InputPortParams]:
    return [SelectorParams.InputPortParams(name=name, size=size) for name, size in sizes.items()]


def _output(name: str, selections: list[tuple[int, int]]) -> SelectorParams.OutputPortParams:
    return SelectorParams.OutputPortParams(
        name=name,
        selections=[
            SelectorParams.OutputSelection(input_port_index=i, input_offset=k)
            for i, k in selections
        ],
    )
