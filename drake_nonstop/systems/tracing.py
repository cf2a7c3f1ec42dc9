"""Turns a function of `drake_nonstop.mechanics` into a fast evaluator.

The function is run once on CasADi symbols; the expression graph that results is then
evaluated by CasADi's virtual machine, about ten times faster than NumPy on arrays of
this size.
"""

import itertools
import math
import pickle
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray
from pydrake.symbolic import Formula, if_then_else

LARGEST = 1e9  # SI units; no rate or force of a load on cables comes near it
_MOST_TRACES = 400  # that a process keeps


class NotFiniteError(ArithmeticError):
    """A block made, or `was_given`, a value that is not finite, or beyond the `largest` (SI)."""

    def __init__(self, block: str, *, was_given: bool = False, largest: float = LARGEST):
        super().__init__(
            f"{block} {'was given' if was_given else 'made'} a value that is not finite, or beyond "
            f"{largest:.0e} in SI units"
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
            that can be hashed, or pickled: a second function with an equal key is not traced again.

    A call returns the outputs in a tuple, each flat but for the Jacobian. They are views
    of buffers that the thread's next call overwrites; copy them to keep them.

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
        self._function: casadi.Function = recent(
            lambda: _traced(function, input_sizes, jacobian_of),
            tuple(input_sizes),
            jacobian_of,
            key,
        )
        self._count = self._function.n_out() - (jacobian_of is not None)
        self._evaluate = Evaluator(self._function, self._count, largest)
        self._name = name

    @property
    def output_sizes(self) -> tuple[int, ...]:
        """The sizes of the outputs but for the Jacobian."""
        return tuple(self._function.size1_out(i) for i in range(self._count))

    def traced(self, *inputs: NDArray) -> tuple[NDArray, ...]:
        """The outputs, each flat, for symbolic inputs: as a part of another trace."""
        outputs = self._function.call([casadi.SX(casadi.vertcat(*values)) for values in inputs])
        return tuple(object_array(output) for output in outputs[: self._count])

    def expressions(self, *inputs: casadi.MX) -> tuple[casadi.MX, ...]:
        """The outputs as expressions of CasADi's, for its solvers."""
        return tuple(self._function.call(inputs))[: self._count]

    def __call__(self, *inputs: NDArray) -> tuple[NDArray, ...]:
        """The outputs for flat inputs of the declared sizes."""
        return self._evaluate(inputs, self._name)


class Evaluator(threading.local):
    """Evaluates a function of CasADi's with floats, in memory that belongs to the thread.

    Args:
        function: of columns, to dense results.
        checked: so many of its results have to be finite.
        largest: that their norm may have; SI units.
    """

    def __init__(self, function: casadi.Function, checked: int, largest: float = LARGEST):
        given, arguments = _rows([function.numel_in(k) for k in range(function.n_in())])
        made, results = _rows([function.numel_out(k) for k in range(function.n_out())])
        self._kept_alive, evaluate = bound(function, arguments, results)
        shaped = [v.reshape(function.size_out(k), order="F") for k, v in enumerate(results)]
        outputs = (*results[:checked], *shaped[checked:])
        own = made[: sum(map(len, results[:checked]))]
        self._parts = given, evaluate, own, outputs, largest

    def __call__(self, values: Sequence[NDArray], name: Callable[[], str]) -> tuple[NDArray, ...]:
        """The results, in views that the next call overwrites: flat, others of their shapes.

        Raises:
            NotFiniteError: those that are checked are not finite, or beyond the largest.
        """
        given, evaluate, made, outputs, largest = self._parts
        if values:
            np.concatenate(values, out=given)
        evaluate()
        if not np.vdot(made, made) < largest * largest:
            raise NotFiniteError(name(), was_given=not np.all(np.abs(given) < largest))
        return outputs


def _rows(sizes: Sequence[int]) -> tuple[NDArray, list[NDArray]]:
    """Memory for vectors of these sizes, in a row, and each of them."""
    whole, ends = np.zeros(sum(sizes)), np.cumsum([0, *sizes]).tolist()
    return whole, [whole[start:end] for start, end in itertools.pairwise(ends)]


def bound(
    function: casadi.Function, inputs: Iterable[NDArray], outputs: Sequence[NDArray]
) -> tuple[Any, Callable[[], None]]:
    """Evaluator of a function from flat arrays into flat arrays, and what has to live as long."""
    buffer, evaluate = function.buffer()
    for i, array in enumerate(inputs):
        buffer.set_arg(i, array.data)
    for i, array in enumerate(outputs):
        buffer.set_res(i, array.data)
    return (buffer, function, inputs, outputs), evaluate


_recent: OrderedDict[Any, Any] = OrderedDict()
_lock = threading.RLock()


def recent(make: Callable[[], Any], *key: Any) -> Any:
    """What was made for an equal key lately, or is made now; a key that ends with None has none."""
    if key[-1] is None:
        return make()
    own = tuple(map(_hashed, key))
    with _lock:
        if own not in _recent:
            _recent[own] = make()
        _recent.move_to_end(own)
        if len(_recent) > _MOST_TRACES:
            _recent.popitem(last=False)
        return _recent[own]


def _hashed(key: Any) -> Any:
    """A key as it is, or pickled where it cannot be hashed."""
    try:
        hash(key)
    except TypeError:
        return pickle.dumps(key)
    return key


def _traced(
    function: Callable, input_sizes: Sequence[int], jacobian_of: int | None
) -> casadi.Function:
    """The function of flat inputs to the outputs, flat, and the Jacobian that was asked for."""
    symbols = [casadi.SX.sym(f"input_{i}", size) for i, size in enumerate(input_sizes)]
    outputs = function(*map(object_array, symbols))
    outputs = outputs if isinstance(outputs, tuple) else (outputs,)
    expressions = [casadi.densify(casadi.SX(casadi.vertcat(*v.ravel()))) for v in outputs]
    expressions = casadi.cse(expressions)  # before a Jacobian, of which it would take long
    if jacobian_of is not None:
        jacobian = casadi.jacobian(casadi.vertcat(*expressions), symbols[jacobian_of])
        expressions.append(casadi.densify(jacobian))
    return casadi.Function("mechanics", symbols, expressions)


def object_array(symbol: casadi.SX) -> NDArray:
    """A flat NumPy object array of the symbol's scalar entries."""
    return np.fromiter(map(_entry, symbol.elements()), dtype=object, count=symbol.numel())


def for_each(
    function: Callable[..., NDArray], own: Sequence[NDArray], shared: Sequence[NDArray]
) -> NDArray:
    """What a function makes (n, ...) of the rows of arrays (n, ...), and of `shared` ones.

    In a trace it is one function that is called with all rows: traced once, and once in the C.
    """
    if not any(isinstance(entry, casadi.SX) for array in own for entry in array.flat):
        return np.stack([function(*entries, *shared) for entries in zip(*own, strict=True)])
    shapes = [*(array.shape[1:] for array in own), *(array.shape for array in shared)]
    symbols = [casadi.SX.sym("own", math.prod(shape)) for shape in shapes]
    made = function(
        *(object_array(s).reshape(shape) for s, shape in zip(symbols, shapes, strict=True))
    )
    results = casadi.cse([casadi.densify(casadi.SX(casadi.vertcat(*made.ravel())))])
    name = function.__name__ if function.__name__.isidentifier() else "row"  # no lambda
    of_row = casadi.Function(name, [casadi.vertcat(*symbols)], results)
    n, rest = len(own[0]), [array.ravel() for array in shared]
    inputs = casadi.MX.sym("inputs", of_row.size1_in(0), n)
    called = casadi.Function("rows", [inputs], [of_row.map(n)(inputs)], {"never_inline": True})
    each = [np.concatenate([*(e.ravel() for e in own), *rest]) for own in zip(*own, strict=True)]
    found = called(casadi.reshape(casadi.vertcat(*np.concatenate(each)), inputs.shape))
    return object_array(casadi.vec(found)).reshape(n, *made.shape)


_Values = NDArray | Callable[[], NDArray]


def where(condition: Any, values: _Values, others: _Values) -> NDArray:
    """Values where a condition holds, or others, which may then be no numbers.

    The condition is one of numbers or of symbols. Of a condition that is known, only what it
    chooses is computed, where functions make both.
    """
    if isinstance(condition, Formula) and not condition.GetFreeVariables():
        condition = condition.Evaluate()
    if isinstance(condition, bool | np.bool_):
        return _made(values if condition else others)
    pairs = zip(_made(values), _made(others), strict=True)
    if_else = if_then_else if isinstance(condition, Formula) else casadi.if_else
    return np.fromiter((if_else(condition, *pair) for pair in pairs), dtype=object)


def _made(values: _Values) -> NDArray:
    return values() if callable(values) else values


def _entry(symbol: casadi.SX) -> casadi.SX:
    symbol.__class__ = _Entry
    return symbol


def _operators(symbol: str, code: int) -> tuple[Callable, Callable]:
    """An operator of `_Entry` and its reflected one."""
    general = getattr(casadi.SX, f"__{symbol}__"), getattr(casadi.SX, f"__r{symbol}__")

    def operate(x: casadi.SX, y: Any) -> Any:
        if isinstance(y, _SCALARS):
            return _entry(casadi.SX.binary(code, x, y))
        return general[0](x, y)

    def reflected(x: casadi.SX, y: Any) -> Any:
        if isinstance(y, _SCALARS):
            return _entry(casadi.SX.binary(code, y, x))
        return general[1](x, y)

    return operate, reflected


class _Entry(casadi.SX):
    """A scalar of a trace, for which CasADi need not look for an operator among those of all types.

    That search takes ten times as long as the operation, and most of the time of a trace.
    """

    __add__, __radd__ = _operators("add", casadi.OP_ADD)
    __sub__, __rsub__ = _operators("sub", casadi.OP_SUB)
    __mul__, __rmul__ = _operators("mul", casadi.OP_MUL)
    __truediv__, __rtruediv__ = _operators("truediv", casadi.OP_DIV)
    __pow__, __rpow__ = _operators("pow", casadi.OP_POW)
    __iadd__, __isub__, __imul__, __itruediv__ = __add__, __sub__, __mul__, __truediv__

    def __neg__(self) -> casadi.SX:
        return _entry(super().__neg__())


_SCALARS = (casadi.SX, float, int)
