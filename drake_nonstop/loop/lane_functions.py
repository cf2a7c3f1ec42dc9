"""A loop's function for flights side by side, as C in GCC's and Clang's vector extensions.

A value is a vector with a lane for each flight: 8 where the processor has AVX-512, else 4. Each
lane gets the very bits of the function's C for one flight: no operation is contracted or done in
another order, comparisons give 1 or 0, and what has no vector instruction is called lane by lane.
"""

import ctypes
from collections.abc import Iterator, Sequence
from importlib.resources import files
from typing import NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray

from drake_nonstop.systems.compilation import CompilationError

_FLY_LANES = files(__package__).joinpath("fly_lanes.c").read_text()
_BEGIN = """\
#include <math.h>
#pragma GCC optimize("no-tree-pre", "ira-region=one") /* compiles in half the time */
#ifdef __AVX512F__
enum { W = 8 };
#define COPIES(c) {c, c, c, c, c, c, c, c}
#else
enum { W = 4 };
#define COPIES(c) {c, c, c, c}
#endif
typedef double lanes __attribute__((vector_size(8 * W)));
typedef long long masks __attribute__((vector_size(8 * W)));
static inline lanes all(double c) { return (lanes)COPIES(c); }
static inline lanes where(masks mask, lanes x) { return (lanes)(mask & (masks)x); } /* else 0 */
static inline lanes is(masks mask) { return where(mask, all(1.0)); }
static double sign(double x) { return x < 0 ? -1 : x > 0 ? 1 : x; }
"""
_BY_LANE = """\
static inline lanes {name}_by_lane({arguments}) {{
  lanes z;
#pragma GCC unroll 8 /* so that sin and cos of an angle are made at once */
  for (int i = 0; i < W; i++) z[i] = {name}({entries});
  return z;
}}
"""
_OPERATORS = {
    casadi.OP_ASSIGN: "{0}",
    casadi.OP_NEG: "-{0}",
    casadi.OP_SQ: "{0} * {0}",
    casadi.OP_TWICE: "{0} + {0}",
    casadi.OP_INV: "all(1.0) / {0}",
    casadi.OP_FABS: "(lanes)((masks){0} & ~(masks)all(-0.0))",
    casadi.OP_NOT: "is({0} == all(0.0))",
    casadi.OP_ADD: "{0} + {1}",
    casadi.OP_SUB: "{0} - {1}",
    casadi.OP_MUL: "{0} * {1}",
    casadi.OP_DIV: "{0} / {1}",
    casadi.OP_LT: "is({0} < {1})",
    casadi.OP_LE: "is({0} <= {1})",
    casadi.OP_EQ: "is({0} == {1})",
    casadi.OP_NE: "is({0} != {1})",
    casadi.OP_AND: "is(({0} != all(0.0)) & ({1} != all(0.0)))",
    casadi.OP_OR: "is(({0} != all(0.0)) | ({1} != all(0.0)))",
    casadi.OP_IF_ELSE_ZERO: "where({0} != all(0.0), {1})",
}
_FUNCTIONS = {  # of libm, by the number of their arguments
    1: (
        *("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"),
        *("asinh", "acosh", "atanh", "exp", "log", "expm1", "log1p", "erf", "floor", "ceil"),
        "sign",
    ),
    2: ("atan2", "pow", "fmin", "fmax", "fmod", "remainder", "hypot", "copysign"),
}
_FORMS = _OPERATORS | {
    getattr(casadi, f"OP_{name.upper()}"): f"{name}_by_lane({', '.join(['{0}', '{1}'][:count])})"
    for count, names in _FUNCTIONS.items()
    for name in names
}
_FORMS[casadi.OP_CONSTPOW] = _FORMS[casadi.OP_POW]


class LaneInputs(NamedTuple):
    """What the next samples of a flight depend on."""

    largest: float  # value, in SI units
    state: NDArray  # (x,)
    parameters: NDArray  # (p,)
    times: NDArray  # (samples,), s
    outside: NDArray  # (samples, size), what stands outside of the function


class LaneFunction:
    """A function of a whole sample for several flights, in a `library` of `lanes_code`."""

    def __init__(self, library: ctypes.CDLL, function: casadi.Function):
        self._sizes = function.nnz_out(1), function.nnz_out(2)
        self._call = library.fly_lanes
        self._call.restype = None
        self._call.argtypes = [ctypes.c_longlong, *[ctypes.c_void_p] * 9]

    def fly(self, inputs: Sequence[LaneInputs]) -> tuple[list[int], NDArray, NDArray, NDArray]:
        """Flies each flight's samples; it ends before one as of `functions.Evaluation.fly`.

        Returns how many samples each has flown, the states (flights, x) after these, the signals
        (samples, size) and the signals of steps (samples, size), with rows for all the samples of
        the first flight, then of the second, flown or not.
        """
        largest, *columns = zip(*inputs, strict=True)
        states, parameters = map(np.array, columns[:2])
        times, outside = map(np.concatenate, columns[2:])
        samples = np.array([*map(len, columns[2])], np.int64)
        limits, flown = np.square(largest), np.empty_like(samples)
        signals, steps = (np.empty((len(times), size)) for size in self._sizes)
        given = samples, limits, states, parameters, times, outside, signals, steps, flown
        self._call(len(samples), *(array.ctypes.data for array in given))
        return flown.tolist(), states, signals, steps


def lanes_code(function: casadi.Function, argument_sizes: list[int]) -> str:
    """The C text of a function of a whole sample for flights side by side, and of `fly_lanes`.

    Args:
        function: of SX, with one argument and the results that fly_lanes.c tells.
        argument_sizes: of the state, the parameters, the time and the blocks' own updates, which
            are stacked in the argument before what stands outside.

    Raises:
        CompilationError: an operation is none of those known here.
    """
    state, parameters, _, answers = argument_sizes
    results = [function.nnz_out(k) for k in range(function.n_out())]
    _, signals, steps, read, is_valid, _ = results
    outside = function.nnz_in(0) - sum(argument_sizes)
    sizes = {"STATE": state, "PARAMETERS": parameters, "ANSWERS": answers, "OUTSIDE": outside}
    sizes |= {"SIGNALS": signals, "STEPS": steps, "READ": read, "IS_VALID": is_valid}
    names = ", ".join(f"a{k}" for k in range(function.sz_w()))
    return "\n".join(
        [
            _BEGIN,
            *_by_lane(),
            "static void side_by_side(const lanes *restrict input, lanes *restrict results) {",
            f"lanes {names};",
            *_statements(function, results),
            "}",
            *(f"enum {{ {name} = {size} }};" for name, size in sizes.items()),
            _FLY_LANES,
        ]
    )


def _by_lane() -> Iterator[str]:
    for count, names in _FUNCTIONS.items():
        arguments = ", ".join(["lanes x", "lanes y"][:count])
        entries = ", ".join(["x[i]", "y[i]"][:count])
        for name in names:
            yield _BY_LANE.format(name=name, arguments=arguments, entries=entries)


def _statements(function: casadi.Function, results: list[int]) -> Iterator[str]:
    """An assignment for each instruction; the results, of these sizes, follow each other."""
    starts = [sum(results[:k]) for k in range(len(results))]
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        inputs, outputs = function.instruction_input(k), function.instruction_output(k)
        if code == casadi.OP_OUTPUT:
            yield f"results[{starts[outputs[0]] + outputs[1]}] = a{inputs[0]};"
        elif code == casadi.OP_INPUT:
            yield f"a{outputs[0]} = input[{inputs[1]}];"
        elif code == casadi.OP_CONST:
            yield f"a{outputs[0]} = all({_number(function.instruction_constant(k))});"
        elif code in _FORMS:
            yield f"a{outputs[0]} = {_FORMS[code].format(*(f'a{i}' for i in inputs))};"
        else:
            raise CompilationError(f"there are no lanes for CasADi's operation {code}")


def _number(value: float) -> str:
    """A number as C writes it, to the bit."""
    return {"inf": "INFINITY", "-inf": "-INFINITY", "nan": "NAN"}.get(repr(value), repr(value))
