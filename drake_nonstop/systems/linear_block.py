"""Blocks that are one linear function, evaluated by Drake's own systems.

A linear function of `drake_nonstop.mechanics` is a matrix, found at unit vectors. Drake's systems
multiply by it in C++, in half the time of a callback into Python: a small matrix as it is, of a
large one the entries that are not zero only, so that the costs grow with the number of carriers and
not with its square.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, InputPortIndex
from pydrake.systems.primitives import (
    Adder,
    Gain,
    Integrator,
    MatrixGain,
    PortSwitch,
    Selector,
    SelectorParams,
)

from drake_nonstop.systems.block import DiagramBlock, InnerBlock
from drake_nonstop.systems.parameters import NumericParameters, declare_parameters
from drake_nonstop.systems.traced_block import Equations, splitting, stacking
from drake_nonstop.systems.tracing import TracedFunction

_STATE = "(state)"  # not the name of a port
_RELATIVE_TOLERANCE = 1e-9  # of what counts as linear
_PORTS = InputPortIndex(1), InputPortIndex(2)  # of a switch, whose selector's is the first
_LARGEST_DENSE = 1500  # entries of a matrix that is multiplied as it is


class LinearBlock(DiagramBlock):
    """A block whose outputs and state's rate are a linear function of its inputs and its state.

    `equations` are the same function, for a bigger trace. Products are summed in the order of the
    inputs, the state last.

    Args:
        function: takes one flat array for the state, where there is one, and one per entry of
            `inputs`; returns the rate of the state, where there is one, and one flat array per
            entry of `outputs`. It is evaluated at unit vectors.
        inputs: the names of the input ports and their sizes.
        outputs: the names of the output ports and their sizes.
        state_size: the size of the continuous state, which begins at zero; 0: there is none.
        initial_state: the continuous state at the start, instead of `state_size`.
        state_port: the name of the output port that shows the state; none: no port does.

    Raises:
        ValueError: the function is not linear.
    """

    def __init__(
        self,
        function: Callable,
        *,
        inputs: Mapping[str, int],
        outputs: Mapping[str, int] | None = None,
        state_size: int = 0,
        initial_state: NDArray | None = None,
        state_port: str = "",
    ):
        super().__init__()
        read, made = dict(inputs), dict(outputs or {})
        initial = np.zeros(state_size) if initial_state is None else initial_state
        state_size = len(initial)
        self.equations = Equations(function, dict(inputs), dict(made), initial, state_port)
        matrix = _matrix(self.equations)
        builder = DiagramBuilder()
        # Not with a state: a LinearSystem draws one from the generator of a Monte Carlo study.
        is_one_product = len(read) == len(made) == 1 and state_size == 0
        if is_one_product and matrix.size <= _LARGEST_DENSE:
            product = builder.AddNamedSystem("linear", MatrixGain(matrix))
            builder.ExportInput(product.get_input_port(), *read)
            builder.ExportOutput(product.get_output_port(), *made)
            builder.BuildInto(self)
            return
        terms = _terms(matrix)
        if state_size > 0:
            read, made = read | {_STATE: state_size}, {_STATE: state_size} | made
        chosen = builder.AddNamedSystem("chosen", Selector(_choosing(read, terms)))
        products = [
            builder.AddNamedSystem(f"gain_{k}", Gain(gains)) for k, (_, gains) in enumerate(terms)
        ]
        for k, gain in enumerate(products):
            builder.Connect(chosen.get_output_port(k), gain.get_input_port())
        total = products[0]
        if len(products) > 1:
            total = builder.AddNamedSystem("sum", Adder(len(products), len(terms[0][1])))
            for k, gain in enumerate(products):
                builder.Connect(gain.get_output_port(), total.get_input_port(k))
        outputs_of = total.get_output_port
        if len(made) > 1:
            parts = builder.AddNamedSystem("parts", Selector(splitting(made)))
            builder.Connect(total.get_output_port(), parts.get_input_port())
            outputs_of = parts.get_output_port
        for i, name in enumerate(read):
            if name != _STATE:
                builder.ExportInput(chosen.get_input_port(i), name)
        for i, name in enumerate(made):
            if name != _STATE:
                builder.ExportOutput(outputs_of(i), name)
        if state_size > 0:
            state = builder.AddNamedSystem("state", Integrator(initial))
            builder.Connect(state.get_output_port(), chosen.get_input_port(len(read) - 1))
            builder.Connect(outputs_of(0), state.get_input_port())
            if state_port:
                builder.ExportOutput(state.get_output_port(), state_port)
        builder.BuildInto(self)


class AdjustableLinear:
    """A linear function without a state, whose coefficients follow from parameters of the context.

    While the parameters have their default values it is Drake's `MatrixGain` or a `LinearBlock`,
    since pydrake has no system that multiplies two signals. With other values it is a traced
    function, which takes a callback, and whose results may differ by rounding. Its systems go into
    the block's own diagram: each diagram inside another costs time at each step.

    Args:
        builder: the block's.
        function: as of `LinearBlock`; it takes the parameters by name, as that of a `TracedBlock`.
        inputs: the names of the input ports and their sizes.
        size: of the output.
        parameters: a numeric parameter of the context.
        key: as of `TracedFunction`; the parameters' values are no part of it.

    Attributes:
        function: with the default values.
        inputs: by name, the ports that take an input.
        output: the port.
    """

    def __init__(
        self,
        builder: DiagramBuilder,
        function: Callable,
        *,
        inputs: Mapping[str, int],
        size: int,
        parameters: NumericParameters,
        key: Any = None,
    ):
        self.function = parameters.filled_in(function)
        matrix = _matrix(Equations(self.function, inputs, {"output": size}))
        is_dense = len(inputs) == 1 and matrix.size <= _LARGEST_DENSE
        default = builder.AddNamedSystem(
            "default",
            MatrixGain(matrix)
            if is_dense
            else LinearBlock(self.function, inputs=inputs, outputs={"output": size}),
        )
        adjusted = builder.AddNamedSystem(
            "adjusted", _Adjusted(function, inputs, size, parameters, key)
        )
        switch = builder.AddNamedSystem("switch", PortSwitch(size))
        for source in (default.get_output_port(), adjusted.GetOutputPort("results")):
            port = switch.DeclareInputPort(source.get_system().get_name())
            builder.Connect(source, port)
        builder.Connect(adjusted.GetOutputPort("choice"), switch.get_port_selector_input_port())
        self.inputs = {
            name: [system.get_input_port(i) for system in (default, adjusted)]
            for i, name in enumerate(inputs)
        }
        self.output = switch.get_output_port()


class _Adjusted(InnerBlock):
    """The function with the parameters of the context, and which port of a switch to take.

    That is the first where the parameters are floats with their default values.
    """

    def __init__(
        self,
        function: Callable,
        inputs: Mapping[str, int],
        size: int,
        parameters: NumericParameters,
        key: Any,
    ):
        super().__init__()
        self.parameters = parameters
        self._function = parameters.as_argument(function, len(inputs))
        self._sizes, self._key = [*inputs.values(), len(parameters)], key
        self._evaluate: TracedFunction | None = None
        self._inputs = [self.DeclareVectorInputPort(*port) for port in inputs.items()]
        declare_parameters(self, parameters)
        self.DeclareVectorOutputPort(
            "results",
            size,
            self._calc_results,
            {self.all_input_ports_ticket(), self.all_parameters_ticket()},
        )
        self.DeclareAbstractOutputPort(
            "choice",
            lambda: AbstractValue.Make(_PORTS[0]),
            self._calc_choice,
            {self.all_parameters_ticket()},
        )

    def _calc_results(self, context: Context, output: BasicVector) -> None:
        values = [port.Eval(context) for port in self._inputs]
        values.append(context.get_numeric_parameter(0).CopyToVector())
        if values[-1].dtype != float:
            output.SetFromVector(self._function(*values))
            return
        if self._evaluate is None:
            self._evaluate = TracedFunction(
                self._function, self._sizes, name=self.box, key=self._key
            )
        (results,) = self._evaluate(*values)
        output.SetFromVector(results)

    def _calc_choice(self, context: Context, output: AbstractValue) -> None:
        values = context.get_numeric_parameter(0).CopyToVector()
        is_default = values.dtype == float and np.array_equal(values, self.parameters.vector)
        output.set_value(_PORTS[0 if is_default else 1])


def _matrix(equations: Equations) -> NDArray:
    """The matrix from [inputs, state] to [rate of the state, outputs]."""
    count = len(equations.initial_state)
    sizes = [count, *equations.inputs.values()] if count else [*equations.inputs.values()]

    def values(vector: NDArray) -> NDArray:
        results = equations.function(*np.split(vector, np.cumsum(sizes)[:-1]))
        return np.concatenate(results if isinstance(results, tuple) else (results,))

    size = sum(sizes)
    columns = np.stack([values(unit) for unit in np.eye(size)], axis=1)
    probe = np.random.default_rng(0).normal(size=size)
    expected = values(probe)
    error = np.max(np.abs(columns @ probe - expected), initial=0.0)
    if not error <= _RELATIVE_TOLERANCE * np.max(np.abs(expected), initial=0.0):
        raise ValueError(f"function = {equations.function}: give one that is linear")
    return np.roll(columns, -count, axis=1)


def _terms(matrix: NDArray) -> list[tuple[NDArray, NDArray]]:
    """Columns and gains (rows,), a pair for each of a row's terms: few, where others are zero.

    A row with fewer terms than others gets gains of zero.
    """
    count = max(1, int(np.max(np.count_nonzero(matrix, axis=1), initial=0)))
    # A row's columns with gains in order, and after them some of those without.
    order = np.argsort(matrix == 0, axis=1, kind="stable")[:, :count]
    gains = np.take_along_axis(matrix, order, axis=1)
    return [(order[:, k], gains[:, k]) for k in range(count)]


def _choosing(sizes: Mapping[str, int], terms: list[tuple[NDArray, NDArray]]) -> SelectorParams:
    """Of a Selector from inputs of these sizes to the entries that each of the terms multiplies."""
    places = [(i, k) for i, size in enumerate(sizes.values()) for k in range(size)]
    params = stacking(sizes)
    params.outputs = [
        SelectorParams.OutputPortParams(
            name=f"term_{k}",
            selections=[
                SelectorParams.OutputSelection(
                    input_port_index=places[column][0], input_offset=places[column][1]
                )
                for column in columns
            ],
        )
        for k, (columns, _) in enumerate(terms)
    ]
    return params
