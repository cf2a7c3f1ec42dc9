"""Traced functions that are evaluated at many points, for each of several sets of constants."""

import ctypes
import functools
from collections.abc import Callable
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from drake_nonstop.systems.native import LANES, CompilationError, shared_library
from drake_nonstop.systems.tracing import LARGEST, NotFiniteError, object_array, recent
from drake_nonstop.validation import warn_user

_EVALUATE = """
__attribute__((visibility("default")))
void evaluate(const double *points, const double *constants, double *results,
    casadi_int count, casadi_int sets) {
  casadi_real x[POINT + CONSTANTS + 1], y[RESULTS + 1], *res[] = {y};
  const casadi_real *arg[] = {x};
  for (casadi_int c = 0; c < sets; c++) {
    for (casadi_int i = 0; i < CONSTANTS; i++) x[POINT + i] = constants[i * sets + c];
    for (casadi_int i, e = 0; e < count; e += WIDTH) {
      if (e > count - WIDTH) e = count - WIDTH; /* the last ones once more */
      for (i = 0; i < POINT; i++) __builtin_memcpy(x + i, points + i * count + e, sizeof(*x));
      entry(arg, res, 0, 0, 0);
      for (i = 0; i < RESULTS; i++)
        __builtin_memcpy(results + (i * sets + c) * count + e, y + i, sizeof(*y));
    }
  }
}
"""


class GridFunction:
    """A function of a point and of constants, at many points and for many sets, in one call.

    C evaluates several points side by side; without it CasADi's virtual machine evaluates one after
    the other.

    Args:
        function: takes a point (size,) and constants (count,), and returns an array or a sequence
            of arrays, of m numbers in all: plain arithmetic, without branches on values.
        size: of a point.
        constants: their count in a set.
        key: all that the function depends on besides its arguments: a second one with an equal key
            is not traced again.
        by: the number of the first entries of a point by which it is differentiated.
        compiles: whether it is compiled, which is waited for; else the virtual machine will do.

    Attributes:
        by: (g,), the entries among these on which a result depends at all.
    """

    def __init__(
        self,
        function: Callable,
        size: int,
        constants: int = 0,
        *,
        key: Any,
        by: int = 0,
        compiles: bool = True,
    ):
        self._function, self.by = recent(
            lambda: _traced(function, size, constants, by),
            *("grid function", size, constants, by, key),
        )
        self._library = None
        if compiles:
            self._library = recent(lambda: _library(self._function), "grid library", self._function)

    def __call__(
        self, points: NDArray, constants: NDArray | None = None
    ) -> tuple[NDArray, NDArray]:
        """The values (m, c, k) and derivatives (m, g, c, k) at points (size, k).

        For c sets of constants (count, c); None: one without any.
        """
        given = np.zeros((0, 1)) if constants is None else constants
        count, sets = points.shape[1], given.shape[1]
        most = max(count, LANES)
        if count < most:
            points = np.pad(points, ((0, 0), (0, most - count)))
        arrays = [np.ascontiguousarray(array, float) for array in (points, given)]
        size = self._function.size1_out(0)
        found = np.empty((size, sets, most))
        if self._library is not None:
            self._library(*(array.ctypes.data for array in (*arrays, found)), most, sets)
        else:
            of_all = recent(lambda: self._function.map(most), "map", self._function, most)
            for k, own in enumerate(arrays[1].T):
                found[:, k] = of_all(arrays[0], np.tile(own[:, None], most)).full()
        found = found.reshape(size // (1 + len(self.by)), -1, *found.shape[1:])[..., :count]
        return found[:, 0], found[:, 1:]

    def rows(self, points: NDArray, name: Callable[[], str]) -> NDArray:
        """The values (k, m) at points (k, size), for the one set of no constants.

        Raises:
            NotFiniteError: one is not finite, or beyond 1e9; `name` tells what made it.
        """
        found = self(points.T)[0][:, 0].T
        if not np.abs(found).max(initial=0.0) < LARGEST:
            raise NotFiniteError(name(), was_given=not np.all(np.abs(points) < LARGEST))
        return found


def _traced(
    function: Callable, size: int, constants: int, by: int
) -> tuple[casadi.Function, NDArray]:
    """Each result and its derivatives, as a function of a point and constants; and by which."""
    point, own = casadi.SX.sym("point", size), casadi.SX.sym("constants", constants)
    with np.errstate(divide="ignore", invalid="ignore"):  # symbols raise the flags without a cause
        made = function(object_array(point), object_array(own))
    parts = made if isinstance(made, (tuple, list)) else [made]
    entries = np.concatenate([np.ravel(part) for part in parts])
    values = casadi.cse(casadi.densify(casadi.SX(casadi.vertcat(*entries))))
    jacobian = casadi.jacobian(values, point[:by])
    depends = np.flatnonzero(np.array(casadi.sum1(casadi.DM(jacobian.sparsity(), 1))).ravel())
    rows = casadi.horzcat(values, casadi.densify(jacobian)[:, depends.tolist()])
    results = casadi.cse(casadi.vec(rows.T))
    return casadi.Function("entry", [point, own], [results]), depends


def _library(function: casadi.Function) -> Callable[..., None] | None:
    """The C of a function for all points; None: it cannot be compiled, which a warning tells."""
    x = casadi.SX.sym("x", function.size1_in(0) + function.size1_in(1))
    parts = casadi.vertsplit(x, [0, function.size1_in(0), x.numel()])
    generator = casadi.CodeGenerator("entry", {"with_header": False})
    generator.add(casadi.Function("entry", [x], function.call(parts)))
    sizes = f"POINT = {function.size1_in(0)}, CONSTANTS = {function.size1_in(1)}"
    sizes += f", RESULTS = {function.size1_out(0)}, WIDTH = {LANES}"
    text = f"{generator.dump()}\nenum {{ {sizes} }};{_EVALUATE}"
    try:
        evaluate = shared_library(text, "evaluate", lanes=LANES).evaluate
    except CompilationError as error:
        _tell_not_compiled(str(error))
        return None
    evaluate.restype = None
    evaluate.argtypes = [*[ctypes.c_void_p] * 3, *[ctypes.c_longlong] * 2]
    return evaluate


@functools.cache
def _tell_not_compiled(reason: str) -> None:
    """Warns of plans that no C makes, once for each reason."""
    warn_user(f"plans: {reason}; CasADi's virtual machine makes them, more slowly, instead")
