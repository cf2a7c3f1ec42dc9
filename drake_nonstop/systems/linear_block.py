"""Blocks that are one linear function, evaluated by Drake's own systems.

A linear function of `drake_nonstop.mechanics` is a matrix, found at unit vectors. Drake's systems
multiply by it in C++, in half the time of a callback into Python: a small matrix as it is, of a
large one the entries that are not zero only, so that the costs grow with the number of carriers and
not with its square.
"""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    Adder,
    Gain,
    Integrator,
    MatrixGain,
    Selector,
    SelectorParams,
)

from drake_nonstop.systems.block import DiagramBlock
from drake_nonstop.systems.traced_block import Equations, splitting, stacking

_STATE = "(state)"  # not the name of a port
_RELATIVE_TOLERANCE = 1e-9  # of what counts as linear
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
