"""Traced functions that are evaluated for all entries of arrays, or all rows, in one call.

C evaluates some entries side by side. Without it a symbol stands for a whole array, so that each
operation of CasADi's virtual machine is one loop over its entries. Both give the same, to the bit.
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

from drake_nonstop.systems.native import LANES, CompilationError, shared_library
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError, bound, recent
from drake_nonstop.validation import warn_user

_ROWS = 60  # that a `RowsFunction` evaluates at once
_EVALUATE = """
__attribute__((visibility("default")))
void evaluate(const casadi_int *memory) { /* inputs, outputs, and the number of entries */
  const double *inputs = (const double *)memory[0];
  double *outputs = (double *)memory[1];
  casadi_real x[INPUTS], y[RESULTS], *res[] = {y};
  const casadi_real *arg[] = {x};
  for (casadi_int i, e = 0, entries = memory[2]; e < entries; e += WIDTH) {
    if (e > entries - WIDTH) e = entries - WIDTH; /* the last ones once more */
    for (i = 0; i < INPUTS; i++) __builtin_memcpy(x + i, inputs + i * entries + e, sizeof(*x));
    entry(arg, res, 0, 0, 0);
    for (i = 0; i < RESULTS; i++) __builtin_memcpy(outputs + i * entries + e, y + i, sizeof(*y));
  }
}
"""


class ElementwiseFunction:
    """Evaluates `function` for every entry of arrays, with its derivatives, in one call.

    It is several times faster than NumPy, and than a trace that is evaluated for each entry.

    Args:
        function: takes one flat array per entry of `input_sizes` and returns an array or a tuple
            of arrays, of m numbers in all; it is differentiated by the g numbers of the first.
        input_sizes: the length of each input.
        shape: that of the arrays which stand for a number.
        key: as of `TracedFunction`.
        has_derivatives: if not, g is 0.
        compiles: whether C evaluates it, which is waited for; else CasADi's virtual machine.

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
        compiles: bool = False,
    ):
        by_count = input_sizes[0] if has_derivatives else 0
        sizes, entries = [*input_sizes, by_count], math.prod(shape)
        library = None
        if compiles and entries >= LANES:
            library = recent(
                lambda: _library(_elementwise(function, input_sizes, 1, by_count)),
                *("elementwise lanes", *sizes, key),
            )
        made = library or recent(
            lambda: _elementwise(function, input_sizes, entries, by_count),
            *("elementwise", *sizes, shape, key),
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


class _Library:
    """A function of one entry as C for all of them, `evaluate(memory)` of `_EVALUATE`."""

    def __init__(self, library: ctypes.CDLL, function: casadi.Function):
        self.n_in, self.n_out, self.evaluate = function.n_in, function.n_out, library.evaluate
        self.evaluate.restype, self.evaluate.argtypes = None, [ctypes.c_void_p]
        self.address = ctypes.cast(self.evaluate, ctypes.c_void_p).value or 0


def _library(function: casadi.Function) -> _Library | None:
    """A function of MX of one entry as C; None: it cannot be compiled, which a warning tells."""
    argument = casadi.SX.sym("x", function.n_in())
    results = function.expand().call(casadi.vertsplit(argument))
    generator = casadi.CodeGenerator("entry", {"with_header": False})
    stacked = [casadi.cse(casadi.vertcat(*results))]
    generator.add(casadi.Function("entry", [argument], stacked))
    sizes = f"INPUTS = {function.n_in()}, RESULTS = {function.n_out()}, WIDTH = {LANES}"
    text = f"{generator.dump()}\nenum {{ {sizes} }};{_EVALUATE}"
    try:
        return _Library(shared_library(text, "evaluate", lanes=LANES), function)
    except CompilationError as error:
        tell_not_compiled(str(error))
    return None


@functools.cache
def tell_not_compiled(reason: str) -> None:
    """Warns of plans that no C makes, once for each reason."""
    warn_user(f"plans: {reason}; Python makes them, ten times slower, instead")


class ElementwiseMemory(NamedTuple):
    """Memory of an `ElementwiseFunction`, which C evaluates by `evaluate(buffer)`.

    Both are addresses, of a `void (*)(void *)` and of its argument; 0 where C does not.
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
        function: "casadi.Function | _Library",
        input_sizes: Sequence[int],
        shape: tuple[int, ...],
        by_count: int,
    ):
        inputs, outputs = (
            np.zeros((count, *shape)) for count in (function.n_in(), function.n_out())
        )
        rows = [values.reshape(-1) for values in (*inputs, *outputs)]
        evaluate: Callable[[], None]
        if isinstance(function, _Library):
            self._kept_alive = np.array([inputs.ctypes.data, outputs.ctypes.data, rows[0].size])
            buffer = self._kept_alive.ctypes.data
            evaluate, address = functools.partial(function.evaluate, buffer), function.address
        else:
            self._kept_alive, evaluate = bound(function, rows[: len(inputs)], rows[len(inputs) :])
            address = buffer = 0
        parts = np.split(inputs, np.cumsum(input_sizes)[:-1])
        self.parts = parts, evaluate, outputs, by_count
        self.memory = ElementwiseMemory(inputs, outputs, address, buffer)


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
