"""Blocks that are one linear function, evaluated by Drake's own systems.

A linear function of `drake_nonstop.mechanics` is a matrix, found at unit vectors. Drake's systems
multiply by it in C++, in half the time of a callback into Python: a small matrix as it is, of a
large one the entries that are not zero only, so that the costs grow with the number of carriers and
not with its square.
"""

import pickle
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, InputPortIndex
from pydrake.systems.primitives import (
    Adder,
    Gain,
    MatrixGain,
    PortSwitch,
    Selector,
    SelectorParams,
)

from drake_nonstop.systems.block import DiagramBlock, InnerBlock
from drake_nonstop.systems.diagram_trace import ADJUSTED, At
from drake_nonstop.systems.parameters import NumericParameters, declare_parameters
from drake_nonstop.systems.traced_block import stacking
from drake_nonstop.systems.tracing import TracedFunction

_RELATIVE_TOLERANCE = 1e-9  # of what counts as linear
_PORTS = InputPortIndex(1), InputPortIndex(2)  # of a switch, whose selector's is the first
_LARGEST_DENSE = 1500  # entries of a matrix that is multiplied as it is


class LinearBlock(DiagramBlock):
    """A block whose output is a matrix times its inputs, by the entries that are not zero.

    Products are summed in the order of the inputs.

    Args:
        matrix: (size of the output, sum of the inputs' sizes).
        inputs: the names of the input ports and their sizes.
    """

    def __init__(self, matrix: NDArray, inputs: Mapping[str, int]):
        super().__init__()
        terms = _terms(matrix)
        builder = DiagramBuilder()
        chosen = builder.AddNamedSystem("chosen", Selector(_choosing(inputs, terms)))
        products = [
            builder.AddNamedSystem(f"gain_{k}", Gain(gains)) for k, (_, gains) in enumerate(terms)
        ]
        for k, gain in enumerate(products):
            builder.Connect(chosen.get_output_port(k), gain.get_input_port())
        total = products[0]
        if len(products) > 1:
            total = builder.AddNamedSystem("sum", Adder(len(products), len(matrix)))
            for k, gain in enumerate(products):
                builder.Connect(gain.get_output_port(), total.get_input_port(k))
        for i, name in enumerate(inputs):
            builder.ExportInput(chosen.get_input_port(i), name)
        builder.ExportOutput(total.get_output_port(), "output")
        builder.BuildInto(self)


class AdjustableLinear:
    """A linear function without a state, whose coefficients follow from parameters of the context.

    While the parameters have their default values it is Drake's `MatrixGain` or a `LinearBlock`,
    since pydrake has no system that multiplies two signals. With other values it is a traced
    function, which takes a callback, and whose results may differ by rounding. Its systems go into
    the block's own diagram: each diagram inside another costs time at each step.

    Args:
        builder: the block's.
        function: takes one flat array per entry of `inputs`, and the parameters by name, as that of
            a `TracedBlock`; returns a flat array. It is evaluated at unit vectors.
        inputs: the names of the input ports and their sizes.
        size: of the output.
        parameters: a numeric parameter of the context.
        key: as of `TracedFunction`; the parameters' values are no part of it.

    Attributes:
        function: with the default values.
        inputs: by name, the ports that take an input.
        output: the port.

    Raises:
        ValueError: the function is not linear.
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
        matrix = _matrix(self.function, [*inputs.values()])
        is_dense = len(inputs) == 1 and matrix.size <= _LARGEST_DENSE
        default = builder.AddNamedSystem(
            "default", MatrixGain(matrix) if is_dense else LinearBlock(matrix, inputs)
        )
        adjusted = builder.AddNamedSystem(
            ADJUSTED, _Adjusted(function, inputs, size, parameters, key)
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
        self._names = [*inputs]
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

    @property
    def trace_key(self) -> Any:
        """The key of its function."""
        return None if self._key is None else pickle.dumps((self._key, self._sizes))

    def traced_output(self, port: str, at: At) -> NDArray:
        """As of `systems.diagram_trace`."""
        values = [at.input(name) for name in self._names]
        return np.ravel(self._function(*values, at.parameters))

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


def _matrix(function: Callable[..., NDArray], sizes: Sequence[int]) -> NDArray:
    """That of a linear function of inputs of these sizes."""

    def values(vector: NDArray) -> NDArray:
        return function(*np.split(vector, np.cumsum(sizes)[:-1]))

    matrix = np.stack([values(unit) for unit in np.eye(sum(sizes))], axis=1)
    probe = np.random.default_rng(0).normal(size=sum(sizes))
    expected = values(probe)
    error = np.max(np.abs(matrix @ probe - expected), initial=0.0)
    if not error <= _RELATIVE_TOLERANCE * np.max(np.abs(expected), initial=0.0):
        raise ValueError(f"function = {function}: give one that is linear")
    return matrix


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
