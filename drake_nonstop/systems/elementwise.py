"""Traced functions that are evaluated for all entries of arrays, or all rows, in one call.

A symbol stands for a whole array, so that each operation of CasADi's virtual machine is one loop
over its entries.
"""

import ctypes
import functools
import math
import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray

from drake_nonstop.systems.recent_traces import recent_trace
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError, bound

_ROWS = 60  # that a `RowsFunction` evaluates at once


class ElementwiseFunction:
    """Evaluates `function` for every entry of arrays, with its derivatives, in one call.

    A symbol of the trace stands for a whole array, so that each operation is one loop over its
    entries: several times faster than NumPy, and than a trace that is evaluated for each entry.

    Args:
        function: takes one flat array per entry of `input_sizes` and returns an array or a tuple
            of arrays, of m numbers in all; it is differentiated by the g numbers of the first.
        input_sizes: the length of each input.
        shape: that of the arrays which stand for a number.
        key: as of `TracedFunction`.
        has_derivatives: if not, g is 0.

    A call takes an array (size, *shape) for each input, or one that broadcasts to it, and returns
    new arrays: the values (m, *shape) and the derivatives (m, g, *shape).
    """

    def __init__(
        self,
        function: Callable,
        input_sizes: Sequence[int],
        shape: tuple[int, ...],
        *,
        key: Any,
        has_derivatives: bool = True,
    ):
        by_count = input_sizes[0] if has_derivatives else 0
        made = recent_trace(
            lambda: _elementwise(function, input_sizes, math.prod(shape), by_count),
            "elementwise",
            [*input_sizes, by_count],
            shape,
            key,
        )
        self._scratch = _ElementwiseScratch(made, input_sizes, shape, by_count)

    @property
    def memory(self) -> "ElementwiseMemory":
        """That in which this thread evaluates it."""
        return self._scratch.memory

    def __call__(self, *inputs: NDArray) -> tuple[NDArray, NDArray]:
        """The values and the derivatives."""
        parts, evaluate, outputs, by_count = self._scratch.parts
        for part, values in zip(parts, inputs, strict=True):
            part[...] = values
        evaluate()
        found = outputs.reshape(-1, 1 + by_count, *outputs.shape[1:]).copy()
        return found[:, 0], found[:, 1:]


class RowsFunction:
    """Evaluates `function` for rows of its inputs, some at a time.

    The arguments are as of `TracedFunction`.
    """

    def __init__(
        self,
        function: Callable,
        input_sizes: Sequence[int],
        *,
        name: Callable[[], str],
        key: Any = None,
    ):
        size, ends = sum(input_sizes), np.cumsum(input_sizes)[:-1]

        def of_row(row: NDArray) -> list[NDArray]:
            return [np.ravel(function(*np.split(row, ends)))]

        self._function = ElementwiseFunction(
            of_row, [size], (_ROWS,), key=key, has_derivatives=False
        )
        self._name = name

    def __call__(self, rows: NDArray) -> NDArray:
        """The outputs (k, m), flat, for rows (k, size) of all inputs, stacked.

        Raises:
            NotFiniteError: one is not finite, or beyond 1e9.
        """
        parts = np.split(rows, range(_ROWS, len(rows), _ROWS))
        made = [self._function(np.resize(part, (_ROWS, part.shape[1])).T)[0].T for part in parts]
        found = np.concatenate(made)[: len(rows)]
        if not np.abs(found).max(initial=0.0) < LARGEST:
            was_given = not np.all(np.abs(rows) < LARGEST)
            raise NotFiniteError(self._name(), was_given=was_given)
        return found


class ElementwiseMemory(NamedTuple):
    """Memory of an `ElementwiseFunction`, which C evaluates by `evaluate(buffer)`.

    Both are addresses, of a `void (*)(void *)` and of its argument.
    """

    inputs: NDArray  # (inputs, *shape)
    outputs: NDArray  # (values * (1 + derivatives), *shape)
    evaluate: int
    buffer: int


class _ElementwiseScratch(threading.local):
    """The memory in which a thread evaluates an `ElementwiseFunction`.

    `parts` are its inputs, what evaluates it, all outputs and the number of derivatives of each.
    """

    def __init__(
        self,
        function: casadi.Function,
        input_sizes: Sequence[int],
        shape: tuple[int, ...],
        by_count: int,
    ):
        inputs, outputs = (
            np.zeros((count, *shape)) for count in (function.n_in(), function.n_out())
        )
        rows = [values.reshape(-1) for values in (*inputs, *outputs)]
        self._kept_alive, evaluate = bound(function, rows[: len(inputs)], rows[len(inputs) :])
        parts = np.split(inputs, np.cumsum(input_sizes)[:-1])
        self.parts = parts, evaluate, outputs, by_count
        buffer = _pointer(self._kept_alive[0]._self(), None)
        self.memory = ElementwiseMemory(inputs, outputs, evaluate_address(), buffer)


@functools.cache
def evaluate_address() -> int:
    """The address of what evaluates a function that is bound to memory; 0: it is not known."""
    libraries = ctypes.CDLL(casadi._casadi.__file__)  # with those that it is linked to
    evaluate = getattr(libraries, "_ZN6casadi21_function_buffer_evalEPv", None)
    return ctypes.cast(evaluate, ctypes.c_void_p).value or 0 if evaluate else 0


_pointer = ctypes.pythonapi.PyCapsule_GetPointer
_pointer.restype, _pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]


def _elementwise(
    function: Callable, input_sizes: Sequence[int], entries: int, by_count: int
) -> casadi.Function:
    """Each output and its derivatives by the first inputs, which stand for arrays."""
    symbols = [casadi.MX.sym(f"input_{i}", entries) for i in range(sum(input_sizes))]
    array = np.fromiter(symbols, dtype=object, count=len(symbols))
    with np.errstate(divide="ignore"):  # symbols raise the flag without a cause
        outputs = function(*np.split(array, np.cumsum(input_sizes)[:-1]))
    by, seed = symbols[:by_count], casadi.MX.ones(entries)
    found = []
    for value in np.concatenate([np.ravel(output) for output in outputs]):
        found += [value, *(casadi.reverse([value], by, [[seed]])[0] if by else [])]
    return casadi.Function("elementwise", symbols, [*map(casadi.densify, found)], {"cse": True})
