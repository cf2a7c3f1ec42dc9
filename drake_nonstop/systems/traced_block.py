"""Blocks that are one traced function, wired to their ports by Drake's own systems.

A callback into Python spends most of its time on its ports: to evaluate one input takes as long
as the traced function. Drake's systems, in C++, therefore stack the inputs to one vector, split the
outputs and hold the state, and Python is called once, for the function.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, System
from pydrake.systems.primitives import Integrator, Selector, SelectorParams

from drake_nonstop.systems.block import DiagramBlock, InnerBlock
from drake_nonstop.systems.tracing import LateTracedFunction, TracedFunction

_STATE = "(state)"  # no name of a port


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

    For Drake every output depends on every input, and only the state's port on none.
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
        key: as of `TracedFunction`.
        is_traced_late: the function is traced when an output is evaluated for the first time.

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
        key: Any = None,
        is_traced_late: bool = False,
    ):
        super().__init__()
        read, made = dict(inputs), dict(outputs or {})
        initial = np.zeros(0)
        if state is not None:
            initial = state.get_output_port().Eval(state.CreateDefaultContext()).copy()
        self.equations: Equations | None = None
        if not reads_time and (state is None or isinstance(state, Integrator)):
            self.equations = Equations(function, dict(inputs), dict(made), initial, state_port)
        if state is not None:
            own = {_STATE: len(initial)}
            read, made = own | read, own | made
        if not read and not reads_time:
            raise ValueError("inputs = none: give some, a state, or reads_time")
        builder = DiagramBuilder()
        evaluator = LateTracedFunction if is_traced_late else TracedFunction
        traced = builder.AddNamedSystem(
            "traced",
            _Traced(function, [*read.values()], sum(made.values()), reads_time, key, evaluator),
        )
        inputs_of, outputs_of = traced.get_input_port, traced.get_output_port
        if len(read) > 1:
            stacked = builder.AddNamedSystem("stacked", Selector(stacking(read)))
            builder.Connect(stacked.get_output_port(), traced.get_input_port())
            inputs_of = stacked.get_input_port
        if len(made) > 1:
            parts = builder.AddNamedSystem("parts", Selector(splitting(made)))
            builder.Connect(traced.get_output_port(), parts.get_input_port())
            outputs_of = parts.get_output_port
        for i, name in enumerate(read):
            if name != _STATE:
                builder.ExportInput(inputs_of(i), name)
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


class _Traced(InnerBlock):
    """A traced function of one vector, the inputs stacked, with one output, likewise."""

    def __init__(
        self,
        function: Callable,
        sizes: list[int],
        result_size: int,
        reads_time: bool,
        key: Any,
        evaluator: type[TracedFunction] | type[LateTracedFunction],
    ):
        super().__init__()

        def stacked(*inputs: NDArray) -> NDArray:
            results = function(*inputs)
            return np.concatenate(results if isinstance(results, tuple) else (results,), axis=None)

        self._evaluate = evaluator(
            stacked,
            [*sizes, 1] if reads_time else sizes,
            name=self.box,
            key=key,
        )
        calc, prerequisites = self._calc, set()
        if sizes:
            self._inputs = self.DeclareVectorInputPort("inputs", sum(sizes))
            prerequisites.add(self.all_input_ports_ticket())
        if reads_time:
            calc = self._calc_at_time if sizes else self._calc_of_time
            prerequisites.add(self.time_ticket())
        self.DeclareVectorOutputPort("results", result_size, calc, prerequisites)

    def _calc(self, context: Context, output: BasicVector) -> None:
        (results,) = self._evaluate(self._inputs.Eval(context))
        output.SetFromVector(results)

    def _calc_of_time(self, context: Context, output: BasicVector) -> None:
        (results,) = self._evaluate(np.array([context.get_time()]))
        output.SetFromVector(results)

    def _calc_at_time(self, context: Context, output: BasicVector) -> None:
        (results,) = self._evaluate(self._inputs.Eval(context), np.array([context.get_time()]))
        output.SetFromVector(results)


def stacking(sizes: Mapping[str, int], output: str = "stacked") -> SelectorParams:
    """Of a Selector that makes one vector of inputs of these names and sizes.

    Unlike Drake's Multiplexer it does nothing while only the time changes.
    """
    selections = [(i, k) for i, size in enumerate(sizes.values()) for k in range(size)]
    return SelectorParams(
        inputs=[
            SelectorParams.InputPortParams(name=name, size=size) for name, size in sizes.items()
        ],
        outputs=[_output(output, selections)],
    )


def splitting(sizes: Mapping[str, int]) -> SelectorParams:
    """Of a Selector that makes outputs of these names and sizes of one vector."""
    ends = np.cumsum([*sizes.values()])
    return SelectorParams(
        inputs=[SelectorParams.InputPortParams(name="stacked", size=int(ends[-1]))],
        outputs=[
            _output(name, [(0, k) for k in range(end - size, end)])
            for (name, size), end in zip(sizes.items(), ends, strict=True)
        ],
    )


def _output(name: str, selections: list[tuple[int, int]]) -> SelectorParams.OutputPortParams:
    return SelectorParams.OutputPortParams(
        name=name,
        selections=[
            SelectorParams.OutputSelection(input_port_index=i, input_offset=k)
            for i, k in selections
        ],
    )
