"""Functions for several arguments side by side, as C in GCC's and Clang's vector extensions.

A value is a vector with a lane for each argument: 8 where the processor has AVX-512, else 4. Each
lane gets the very bits of the function's C for one: no operation is contracted or done in another
order, comparisons give 1 or 0, and what has no vector instruction is called lane by lane.
"""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import casadi

FAST_TO_COMPILE = '#pragma GCC optimize("no-tree-pre", "ira-region=one") /* in half the time */'
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
static void copy(lanes *to, const lanes *of, int count) {
  for (int i = 0; i < count; i++) to[i] = of[i];
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


_ROWS_SIDE_BY_SIDE = """{{
  lanes x[{inputs}], y[{outputs}];
  for (int first = 0; first < {rows}; first += W) {{
    for (int k = 0; k < W; k++) {{ /* the last row again where there is none */
      int row = first + k < {rows} ? first + k : {rows} - 1;
      for (int i = 0; i < {inputs}; i++) x[i][k] = arg[0][row * {inputs} + i];
    }}
    {name}(x, y);
    for (int k = 0; k < W && first + k < {rows}; k++)
      for (int i = 0; i < {outputs}; i++) res[0][(first + k) * {outputs} + i] = y[i][k];
  }}
  return 0;
}}
"""


class CompilationError(RuntimeError):
    """Nothing was compiled; the message tells why, in a few words."""


class _Called(NamedTuple):
    """A function that another one calls, and its name in C."""

    name: str
    function: casadi.Function


def side_by_side(function: casadi.Function, *, shares_angles: bool = False) -> str:
    """The C text of `side_by_side(input, results)` for a function with one argument.

    Both are arrays of `lanes`; the results follow each other.

    Args:
        function: of SX, or of MX; it may call others.
        shares_angles: an argument that is the same in all lanes is likely, and looked for.

    Raises:
        CompilationError: an operation is none of those known here.
    """
    written = _written(_Called("side_by_side", function), {})
    return "\n".join([_BEGIN, *_by_lane(shares_angles), *written])


def with_rows_side_by_side(text: str, function: casadi.Function) -> str:
    """CasADi's C text of a function, in which `tracing.for_each` makes the rows side by side.

    Raises:
        CompilationError: an operation is none of those known here.
    """
    maps: dict[str, casadi.Function] = {}
    _find_maps(function, maps)
    names: dict[int, str] = {}
    made: list[str] = []
    for told, rows in maps.items():
        if text.count(f"/* {told} */") > 1:
            continue  # others have that name and these sizes: they stay as they are
        each, name = rows.info()["f"], f"row_{len(made)}"
        begin = text.index("{", text.index(f"/* {told} */"))
        end = text.index("\n}\n", begin) + 3
        made += _written(_Called(name, each), names)
        sizes = {"inputs": each.nnz_in(0), "outputs": each.nnz_out(0), "rows": rows.info()["n"]}
        text = text[:begin] + _ROWS_SIDE_BY_SIDE.format(name=name, **sizes) + text[end:]
    return "\n".join([_BEGIN, *_by_lane(False), *made, text]) if maps else text


def _find_maps(function: casadi.Function, found: dict[str, casadi.Function]) -> None:
    """Adds the maps that a function calls, by what CasADi's C text calls them."""
    for other in _calls(function).values():
        if other.is_a("Map"):
            found[str(other).rpartition(" ")[0]] = other
        else:
            _find_maps(other, found)


def _by_lane(shares: bool) -> Iterator[str]:
    for count, names in _FUNCTIONS.items():
        arguments = ", ".join(["lanes x", "lanes y"][:count])
        entries = ", ".join(["x[i]", "y[i]"][:count])
        for name in names:
            same = _SAME.format(name=name) if shares and name in ("sin", "cos") else ""
            yield _BY_LANE.format(name=name, arguments=arguments, entries=entries, same=same)


def _written(own: _Called, names: dict[int, str]) -> Iterator[str]:
    """A function, behind those which it calls and whose hashes are not among the `names` yet."""
    name, function = own
    called = {}
    for k, other in _calls(function).items():
        key = hash(other)  # of its node: each call gives another object of Python's
        if key not in names:
            names[key] = f"called_{len(names)}"
            yield from _written(_Called(names[key], other), names)
        called[k] = _Called(names[key], other)
    arguments = ", ".join(f"const lanes *restrict input{k}" for k in range(function.n_in()))
    yield f"static void {name}({arguments}, lanes *restrict results) {{"
    if function.is_a("Map"):
        steps = f"input0 + i * {called[0].function.nnz_in(0)}, results + i * "
        yield f"for (int i = 0; i < {function.info()['n']}; i++)"
        yield f"{called[0].name}({steps}{called[0].function.nnz_out(0)});"
        yield "}"
        return
    yield from (_of_vectors if function.is_a("MXFunction") else _statements)(function, called)
    yield "}"


def _calls(function: casadi.Function) -> dict[int, casadi.Function]:
    """The functions that are called, by the numbers of the instructions."""
    if function.is_a("Map"):
        return {0: function.info()["f"]}
    numbers = range(function.n_instructions())
    calls = [k for k in numbers if function.instruction_id(k) == casadi.OP_CALL]
    if function.is_a("MXFunction"):
        return {k: function.instruction_MX(k).which_function() for k in calls}
    instructions = function.instructions_sx() if calls else []
    return {k: instructions[k].which_function() for k in calls}


def _starts(function: casadi.Function) -> list[int]:
    """Where each of a function's results begins, and the end of the last one."""
    sizes = [function.nnz_out(k) for k in range(function.n_out())]
    return [0, *itertools.accumulate(sizes)]


def _form(code: int, *operands: str) -> str:
    """An operation in C."""
    if code not in _FORMS:
        raise CompilationError(f"there are no lanes for CasADi's operation {code}")
    return _FORMS[code].format(*operands)


def _statements(function: casadi.Function, called: dict[int, _Called]) -> Iterator[str]:
    """An assignment for each instruction of a function of SX."""
    yield f"lanes {', '.join(f'a{k}' for k in range(function.sz_w()))};"
    starts = _starts(function)
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        inputs, outputs = function.instruction_input(k), function.instruction_output(k)
        if code == casadi.OP_OUTPUT:
            yield f"results[{starts[outputs[0]] + outputs[1]}] = a{inputs[0]};"
        elif code == casadi.OP_INPUT:
            yield f"a{outputs[0]} = input{inputs[0]}[{inputs[1]}];"
        elif code == casadi.OP_CONST:
            yield f"a{outputs[0]} = all({_number(function.instruction_constant(k))});"
        elif code == casadi.OP_CALL:
            given = ", ".join(f"a{i}" for i in inputs)
            taken = " ".join(f"a{i} = y[{j}];" for j, i in enumerate(outputs) if i >= 0)
            sizes = [called[k].function.nnz_in(i) for i in range(called[k].function.n_in())]
            starts_of = itertools.accumulate(sizes[:-1], initial=0)
            call = f"{called[k].name}({''.join(f'x + {s}, ' for s in starts_of)}y);"
            yield f"{{ lanes x[] = {{{given}}}, y[{len(outputs)}]; {call} {taken} }}"
        else:
            yield f"a{outputs[0]} = {_form(code, *(f'a{i}' for i in inputs))};"


def _of_vectors(function: casadi.Function, called: dict[int, _Called]) -> list[str]:
    """Copies, loops and calls for the instructions of a function of MX, between vectors."""
    places = _starts(function)  # of what comes next of each result
    sizes: dict[int, int] = {}  # of the vectors as they are
    room: dict[int, int] = {}  # that they need
    made = []
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        inputs, outputs = function.instruction_input(k), function.instruction_output(k)
        if code == casadi.OP_OUTPUT:
            made.append(f"copy(results + {places[outputs[0]]}, w{inputs[0]}, {sizes[inputs[0]]});")
            places[outputs[0]] += sizes[inputs[0]]
            continue
        lengths = [max((sizes.get(i, 0) for i in inputs), default=0)]
        if code == casadi.OP_INPUT:
            lengths = [function.nnz_in(inputs[0])]
            made.append(f"copy(w{outputs[0]}, input{inputs[0]}, {lengths[0]});")
        elif code == casadi.OP_CONST:
            numbers = function.instruction_MX(k).to_DM().nonzeros()
            lengths = [len(numbers)]
            made += [f"w{outputs[0]}[{i}] = all({_number(v)});" for i, v in enumerate(numbers)]
        elif code == casadi.OP_VERTCAT:
            starts = [0, *itertools.accumulate(sizes[i] for i in inputs)]
            lengths = starts[-1:]
            pairs = zip(inputs, starts, strict=False)
            made += [f"copy(w{outputs[0]} + {start}, w{i}, {sizes[i]});" for i, start in pairs]
        elif code in (casadi.OP_VERTSPLIT, casadi.OP_CALL):
            source, starts = f"w{inputs[0]}", function.instruction_MX(k).info().get("offset")
            if code == casadi.OP_CALL:
                source, starts = "y", _starts(called[k].function)
                given = "".join(f"w{i}, " for i in inputs)
                made.append(f"{{ lanes y[{starts[-1] + 1}]; {called[k].name}({given}y);")
            lengths = [end - start for start, end in itertools.pairwise(starts)]
            parts = [part for part in zip(outputs, starts, lengths, strict=False) if part[0] >= 0]
            made += [f"copy(w{i}, {source} + {start}, {count});" for i, start, count in parts]
            made += ["}"] if code == casadi.OP_CALL else []
        elif code == casadi.OP_DOT:
            lengths = [1]
            product = _form(casadi.OP_MUL, *(f"w{i}[i]" for i in inputs))
            made.append(f"w{outputs[0]}[0] = all(0.0);")
            made.append(
                f"for (int i = 0; i < {sizes[inputs[0]]}; i++) w{outputs[0]}[0] += {product};"
            )
        else:
            operands = (f"w{i}[{'i' if sizes[i] > 1 else 0}]" for i in inputs)
            value = _form(code, *operands)
            made.append(f"for (int i = 0; i < {lengths[0]}; i++) w{outputs[0]}[i] = {value};")
        for i, size in zip(outputs, lengths, strict=False):
            sizes[i], room[i] = size, max(size, room.get(i, 1))
    room.pop(-1, None)  # of what is not read
    # In memory of the thread, whose stack may have too little for them.
    return [*(f"static _Thread_local lanes w{i}[{size}];" for i, size in room.items()), *made]


def _number(value: float) -> str:
    """A number as C writes it, to the bit."""
    return {"inf": "INFINITY", "-inf": "-INFINITY", "nan": "NAN"}.get(repr(value), repr(value))
