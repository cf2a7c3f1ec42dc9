"""Blocks that are one traced function, wired to their ports by Drake's own systems.

A callback into Python spends most of its time on its ports: to evaluate one input takes as long
as the traced function. Drake's systems, in C++, therefore stack the inputs to one vector, split the
outputs and hold the state, and Python is called once, for the function.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, System
from pydrake.systems.primitives import Integrator, Selector, SelectorParams

from drake_nonstop.systems.block import DiagramBlock, InnerBlock
from drake_nonstop.systems.parameters import NumericParameters, declare_parameters
from drake_nonstop.systems.tracing import LateTrace, Trace

_STATE = "(state)"  # no name of a port
_NUMBERS = "(parameters)"  # likewise
_INNER = {_STATE, _NUMBERS}  # inputs of the function that are no ports of the block


@dataclass(frozen=True)
class Equations:
    """What a block computes, as a part of a larger trace.

    `function` takes one flat array for the state, where there is one, and one per entry of
    `inputs`; it returns the rate of the state, where there is one, and one array per entry of
    `outputs`. `inputs` and `outputs` are sizes by the names of ports. The state begins at
    `initial_state`, which is empty where there is none, and `state_port` shows it, if any
    port does.
    """

    function: Callable
    inputs: Mapping[str, int]
    outputs: Mapping[str, int]
    initial_state: NDArray = field(default_factory=lambda: np.zeros(0))
    state_port: str = ""


class TracedBlock(DiagramBlock):
    """A block whose outputs are a traced function of its inputs and its state.

    What feeds through to an output are the inputs that its trace reads. Outputs that do not read
    the same inputs are made by calls of their own into Python. On AutoDiffXd and Expression the
    function itself is evaluated, on object arrays.

    `equations` can be a part of a larger trace; they are None where the state is not continuous
    or the time is read.

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
            parameter of the context. `equations` have the default values.
        key: as of `TracedFunction`; the parameters' values are no part of it.
        is_traced_late: the function is traced when an output is evaluated for the first time, for
            what most loops do not read; every output feeds through every input.
        is_one_call: all outputs are made by one call into Python, and each depends on what any of
            them reads.

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
        is_traced_late: bool = False,
        is_one_call: bool = False,
    ):
        super().__init__()
        parameters = parameters or NumericParameters({})
        read, made = dict(inputs), dict(outputs or {})
        initial = np.zeros(0)
        if state is not None:
            initial = state.get_output_port().Eval(state.CreateDefaultContext()).copy()
        self.equations: Equations | None = None
        if not reads_time and (state is None or isinstance(state, Integrator)):
            self.equations = Equations(
                parameters.filled_in(function), dict(inputs), dict(made), initial, state_port
            )
        if state is not None:
            own = {_STATE: len(initial)}
            read, made = own | read, own | made
        if not read and not reads_time:
            raise ValueError("inputs = none: give some, a state, or reads_time")
        if len(parameters) > 0:
            function = parameters.as_argument(function, len(read))
            read = read | {_NUMBERS: len(parameters)}
        time = len(read)
        sizes = [*read.values(), *([1] if reads_time else [])]
        if is_traced_late:
            trace: Trace = LateTrace(function, sizes, [*made.values()], key=key)
        else:
            trace = Trace(function, sizes, key=key)
        inner = {i for i, name in enumerate(read) if name in _INNER}
        dependence = trace.dependence
        if is_one_call:
            dependence = [set().union(*dependence)] * len(dependence)
        groups = _groups(dependence, {*inner, time}, has_state=state is not None)
        builder = DiagramBuilder()
        traced = [
            builder.AddNamedSystem(
                f"traced_{k}" if k else "traced",
                _Traced(trace, group, time, None if k else parameters),
            )
            for k, group in enumerate(groups)
        ]
        names = [part.get_name() for part in traced]
        inputs_of, outputs_of = traced[0].get_input_port, traced[0].get_output_port
        if len(read) > 1 or (read and groups != [_Group([0], [*range(len(made))])]):
            chosen = [[i for i in group.reads if i != time] for group in groups]
            params = _stacking_of(read, dict(zip(names, chosen, strict=True)))
            stacked = builder.AddNamedSystem("stacked", Selector(params))
            inputs_of = stacked.get_input_port
            for part, numbers in zip(traced, chosen, strict=True):
                if numbers:
                    source = stacked.GetOutputPort(part.get_name())
                    builder.Connect(source, part.get_input_port())
        if len(made) > 1:
            makes = {name: group.makes for name, group in zip(names, groups, strict=True)}
            parts = builder.AddNamedSystem("parts", Selector(_splitting_of(made, makes)))
            outputs_of = parts.get_output_port
            for part in traced:
                builder.Connect(part.GetOutputPort("results"), parts.GetInputPort(part.get_name()))
        for i, name in enumerate(read):
            if name not in _INNER:
                builder.ExportInput(inputs_of(i), name)
        if len(parameters) > 0:
            builder.Connect(traced[0].GetOutputPort("parameters"), inputs_of(len(read) - 1))
        for i, name in enumerate(made):
            if name != _STATE:
                builder.ExportOutput(outputs_of(i), name)
        if state is not None:
            builder.AddNamedSystem(_STATE, state)
            builder.Connect(state.get_output_port(), inputs_of(0))
            builder.Connect(outputs_of(0), state.get_input_port())
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


class _Traced(InnerBlock):
    """A part of a trace: a function of one vector, the inputs stacked, with one output, likewise.

    The parameters are another output, for the stack: a system of their own would cost time at each
    step, and Drake's ConstantVectorSource makes what reads it depend on the time.

    Args:
        trace: of the whole function.
        group: the part's inputs and outputs.
        time: the number of the input that is the time.
        parameters: of the whole function; None: another part has them.
    """

    def __init__(
        self, trace: Trace, group: _Group, time: int, parameters: NumericParameters | None
    ):
        super().__init__()
        make = trace.compiled if self.scalar is float else trace.on_arrays
        self._evaluate = make(group.reads, group.makes, name=self.box)
        input_size = sum(trace.input_sizes[i] for i in group.reads if i != time)
        calc, prerequisites = self._calc, set()
        if input_size > 0:
            self._inputs = self.DeclareVectorInputPort("inputs", input_size)
            prerequisites.add(self.all_input_ports_ticket())
        if time in group.reads:
            prerequisites.add(self.time_ticket())
        if input_size == 0 or time in group.reads:
            calc = self._calc_at_time if input_size > 0 else self._calc_of_time
        result_size = sum(trace.output_sizes[i] for i in group.makes)
        self.DeclareVectorOutputPort(
            "results", result_size, calc, prerequisites or {self.nothing_ticket()}
        )
        if parameters is not None and len(parameters) > 0:
            self.parameters = parameters
            declare_parameters(self, parameters)
            sources = {self.all_parameters_ticket()}
            size = len(parameters)
            self.DeclareVectorOutputPort("parameters", size, self._calc_parameters, sources)

    def _calc_parameters(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_numeric_parameter(0).CopyToVector())

    def _calc(self, context: Context, output: BasicVector) -> None:
        (results,) = self._evaluate(self._inputs.Eval(context))
        output.SetFromVector(results)

    def _calc_of_time(self, context: Context, output: BasicVector) -> None:
        (results,) = self._evaluate(np.array([context.get_time()]))
        output.SetFromVector(results)

    def _calc_at_time(self, context: Context, output: BasicVector) -> None:
        (results,) = self._evaluate(self._inputs.Eval(context), (context.get_time(),))
        output.SetFromVector(results)


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
    return _splitting_of(sizes, {"stacked": range(len(sizes))})


def _splitting_of(sizes: Mapping[str, int], inputs: Mapping[str, Sequence[int]]) -> SelectorParams:
    """Of a Selector that splits inputs, each of which has these of the outputs stacked."""
    counts = [*sizes.values()]
    places: dict[int, list[tuple[int, int]]] = {}
    for i, chosen in enumerate(inputs.values()):
        start = 0
        for number in chosen:
            places[number] = [(i, start + k) for k in range(counts[number])]
            start += counts[number]
    return SelectorParams(
        inputs=_inputs({name: sum(counts[i] for i in chosen) for name, chosen in inputs.items()}),
        outputs=[_output(name, places[i]) for i, name in enumerate(sizes)],
    )


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
