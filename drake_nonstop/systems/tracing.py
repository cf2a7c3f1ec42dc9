"""Turns a function of `drake_nonstop.mechanics` into a fast evaluator.

The function is run once on CasADi symbols; the expression graph that results is then
evaluated by CasADi's virtual machine, about ten times faster than NumPy on arrays of
this size. CasADi is used here, and for comparison in `benchmarks.peers`, and nowhere else.
"""

import pickle
from collections.abc import Callable, Sequence
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

_MAX_TRACES = 32
_traces: dict[bytes, casadi.Function] = {}  # by their keys; the most recently used is the last

LARGEST = 1e9  # SI units; no rate or force of a load on cables comes near it


class NotFiniteError(ArithmeticError):
    """A block made, or was given, a value that is not finite or is far too large.

    Args:
        block: its name.
        was_given: whether the value is among its inputs.
    """

    def __init__(self, block: str, *, was_given: bool = False):
        super().__init__(
            f"{block} {'was given' if was_given else 'made'} a value that is not finite, or beyond "
            f"{LARGEST:.0e} in SI units"
        )
        self.block, self.was_given = block, was_given


class TracedFunction:
    """Evaluates `function`, traced once, on flat float vectors.

    Args:
        function: takes one flat array per entry of `input_sizes` and returns an array
            or a tuple of arrays of any shape.
        input_sizes: the length of each input.
        name: tells what evaluates the function, for the error.
        largest: an output whose norm exceeds it counts as a divergence; SI units.
        jacobian_of: if given, the index of the input with respect to which the exact
            Jacobian of the outputs, flattened and stacked, is one more output (rows,
            columns).
        key: if given, everything that `function` depends on besides its arguments, in a form
            that can be pickled: a second function with an equal key is not traced again.

    A call returns the outputs in a tuple, each flat but for the Jacobian. They are views
    of buffers that the next call overwrites; copy them to keep them.

    Raises:
        NotFiniteError: an output is NaN, infinite or beyond `largest`. Fixed-step
            integrators would pass it on in silence, and error-controlled ones can hang on it.
    """

    def __init__(
        self,
        function: Callable,
        input_sizes: Sequence[int],
        *,
        name: Callable[[], str],
        largest: float = LARGEST,
        jacobian_of: int | None = None,
        key: Any = None,
    ):
        self._function = _traced(function, input_sizes, jacobian_of, key)
        self._count = count = self._function.n_out() - (2 if jacobian_of is not None else 1)
        # The buffer borrows the function and the arrays: all must live as long as it.
        self._buffer, self._evaluate = self._function.buffer()
        self._input = np.zeros(sum(input_sizes))
        self._outputs = [
            np.zeros(self._function.size_out(i), order="F") for i in range(self._function.n_out())
        ]
        self._buffer.set_arg(0, self._input.data)
        for i, array in enumerate(self._outputs):
            self._buffer.set_res(i, array.reshape(-1, order="F").data)
        self._results = tuple(
            [array[:, 0] for array in self._outputs[:count]] + self._outputs[count + 1 :]
        )
        self._squared_norm = self._outputs[count][:, 0]
        self._largest, self._largest_squared = largest, largest**2
        self._name = name

    def traced(self, *inputs: NDArray) -> tuple[NDArray, ...]:
        """The outputs, each flat, for symbolic inputs: as a part of another trace."""
        outputs = self._function(casadi.vertcat(*np.concatenate(inputs)))
        return tuple(_object_array(output) for output in outputs[: self._count])

    def expressions(self, *inputs: casadi.MX) -> tuple[casadi.MX, ...]:
        """The outputs as expressions of CasADi's, for its solvers."""
        return tuple(self._function(casadi.vertcat(*inputs)))[: self._count]

    def __call__(self, *inputs: NDArray) -> tuple[NDArray, ...]:
        """The outputs for flat inputs of the declared sizes."""
        if len(inputs) == 1:
            self._input[:] = inputs[0]
        else:
            np.concatenate(inputs, out=self._input)
        self._evaluate()
        if not self._squared_norm[0] < self._largest_squared:
            was_given = not np.all(np.abs(self._input) < self._largest)
            raise NotFiniteError(self._name(), was_given=was_given)
        return self._results


class LateTracedFunction:
    """A `TracedFunction` that is traced at its first call, for what most runs do not evaluate.

    Arguments are those of `TracedFunction`.
    """

    def __init__(self, *arguments: Any, **named: Any):
        self._arguments, self._named = arguments, named
        self._traced: TracedFunction | None = None

    def __call__(self, *inputs: NDArray) -> tuple[NDArray, ...]:
        """As of `TracedFunction`."""
        if self._traced is None:
            self._traced = self._make()
        return self._traced(*inputs)

    def _make(self) -> TracedFunction:
        return TracedFunction(*self._arguments, **self._named)


def _traced(
    function: Callable, input_sizes: Sequence[int], jacobian_of: int | None, key: Any
) -> casadi.Function:
    """The outputs, the square of their norm and the Jacobian that was asked for, of one input."""
    if key is not None:
        pickled = pickle.dumps((list(input_sizes), jacobian_of, key))
        if pickled in _traces:
            _traces[pickled] = found = _traces.pop(pickled)
            return found
    symbol = casadi.SX.sym("inputs", sum(input_sizes))
    ends = np.cumsum([0, *input_sizes])
    outputs = function(*np.split(_object_array(symbol), ends[1:-1]))
    if not isinstance(outputs, tuple):
        outputs = (outputs,)
    expressions = [casadi.densify(casadi.vertcat(*output.ravel())) for output in outputs]
    stacked = casadi.vertcat(*expressions)
    expressions.append(casadi.densify(casadi.sumsqr(stacked)))
    if jacobian_of is not None:
        columns = slice(ends[jacobian_of], ends[jacobian_of + 1])
        jacobian = casadi.jacobian(stacked, symbol)[:, columns]
        expressions.append(casadi.densify(jacobian))
    result = casadi.Function("mechanics", [symbol], expressions)
    if key is not None:
        _traces[pickled] = result
        if len(_traces) > _MAX_TRACES:
            del _traces[next(iter(_traces))]
    return result


def _object_array(symbol: casadi.SX) -> NDArray:
    """A flat NumPy object array of the symbol's scalar entries."""
    array = np.empty(symbol.numel(), dtype=object)
    for i in range(symbol.numel()):
        array[i] = symbol[i]
    return array
