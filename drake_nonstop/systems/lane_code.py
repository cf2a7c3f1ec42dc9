"""Functions for several arguments side by side, as C in GCC's and Clang's vector extensions.

A value is a vector with a lane for each argument: 8 where the processor has AVX-512, else 4. Each
lane gets the very bits of the function's C for one: no operation is contracted or done in another
order, comparisons give 1 or 0, and what has no vector instruction is called lane by lane.
"""

from collections.abc import Iterator

import casadi

from drake_nonstop.systems.compilation import FAST_TO_COMPILE, CompilationError

_BEGIN = (
    f"""\
#include <math.h>
{FAST_TO_COMPILE}
"""
    """\
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
static inline int is_same(lanes x) {
  masks is_other = (masks)x != (masks)all(x[0]);
  long long found = 0;
  for (int i = 1; i < W; i++) found |= is_other[i];
  return !found;
}
static double sign(double x) { return x < 0 ? -1 : x > 0 ? 1 : x; }
"""
)
_BY_LANE = """\
static inline lanes {name}_by_lane({arguments}) {{
  lanes z;
{same}#pragma GCC unroll 8 /* so that sin and cos of an angle are made at once */
  for (int i = 0; i < W; i++) z[i] = {name}({entries});
  return z;
}}
"""
_SAME = "  if (is_same(x)) return all({name}(x[0]));\n"
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


def side_by_side(function: casadi.Function, *, shares_angles: bool = False) -> str:
    """The C text of `side_by_side(input, results)` for a function of SX with one argument.

    Both are arrays of `lanes`; the results follow each other.

    Args:
        function: it.
        shares_angles: an argument that is the same in all lanes is likely, and looked for.

    Raises:
        CompilationError: an operation is none of those known here.
    """
    names = ", ".join(f"a{k}" for k in range(function.sz_w()))
    return "\n".join(
        [
            _BEGIN,
            *_by_lane(shares_angles),
            "static void side_by_side(const lanes *restrict input, lanes *restrict results) {",
            f"lanes {names};",
            *_statements(function),
            "}",
        ]
    )


def _by_lane(shares: bool) -> Iterator[str]:
    for count, names in _FUNCTIONS.items():
        arguments = ", ".join(["lanes x", "lanes y"][:count])
        entries = ", ".join(["x[i]", "y[i]"][:count])
        for name in names:
            same = _SAME.format(name=name) if shares and name in ("sin", "cos") else ""
            yield _BY_LANE.format(name=name, arguments=arguments, entries=entries, same=same)


def _statements(function: casadi.Function) -> Iterator[str]:
    """An assignment for each instruction."""
    results = [function.nnz_out(k) for k in range(function.n_out())]
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
