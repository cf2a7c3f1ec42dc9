"""Turns a function of `drake_nonstop.mechanics` into a fast evaluator.

The function is run once on CasADi symbols; the expression graph that results is then
evaluated by CasADi's virtual machine, about ten times faster than NumPy on arrays of
this size. CasADi is used here and nowhere else.
"""

import math
import threading
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import AutoDiffXd, ExtractValue
from pydrake.symbolic import Formula, Variable, if_then_else

from drake_nonstop.systems.recent_traces import recent_trace

LARGEST = 1e9  # SI units; no rate or force of a load on cables comes near it


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
            or a tuple of arrays of any shape. It may be a trace already, see `_traced`.
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
        self._function: casadi.Function = function
        if not isinstance(function, casadi.Function):
            self._function = _traced(function, input_sizes, jacobian_of, key)
        self._count = self._function.n_out() - (2 if jacobian_of is not None else 1)
        self._scratch = _Scratch(self._function, self._count)
        self._largest, self._largest_squared = largest, largest**2
        self._name = name

    @property
    def output_sizes(self) -> tuple[int, ...]:
        """The sizes of the outputs but for the Jacobian."""
        return tuple(self._function.size1_out(i) for i in range(self._count))

    def traced(self, *inputs: NDArray) -> tuple[NDArray, ...]:
        """The outputs, each flat, for symbolic inputs: as a part of another trace."""
        outputs = self._function(casadi.vertcat(*np.concatenate(inputs)))
        return tuple(object_array(output) for output in outputs[: self._count])

    def expressions(self, *inputs: casadi.MX) -> tuple[casadi.MX, ...]:
        """The outputs as expressions of CasADi's, for its solvers."""
        return tuple(self._function(casadi.vertcat(*inputs)))[: self._count]

    def __call__(self, *inputs: NDArray) -> tuple[NDArray, ...]:
        """The outputs for flat inputs of the declared sizes."""
        vector, evaluate, squared_norm, results = self._scratch.parts
        if len(inputs) == 1:
            vector[:] = inputs[0]
        else:
            np.concatenate(inputs, out=vector)
        evaluate()
        if not squared_norm[0] < self._largest_squared:
            self._raise(vector)
        return results

    def of_vectors(self, inputs: Sequence[NDArray]) -> NDArray:
        """The output, where there is one: as by a call, but sooner."""
        vector, evaluate, squared_norm, results = self._scratch.parts
        np.concatenate(inputs, out=vector)
        evaluate()
        if not squared_norm[0] < self._largest_squared:
            self._raise(vector)
        return results[0]

    def _raise(self, vector: NDArray) -> None:
        was_given = not np.all(np.abs(vector) < self._largest)
        raise NotFiniteError(self._name(), was_given=was_given)


def bound(
    function: casadi.Function, inputs: Iterable[NDArray], outputs: Sequence[NDArray]
) -> tuple[Any, Callable[[], None]]:
    """Evaluator of a function from arrays into arrays, and what has to live as long as it."""
    buffer, evaluate = function.buffer()
    for i, array in enumerate(inputs):
        buffer.set_arg(i, array.data)
    for i, array in enumerate(outputs):
        buffer.set_res(i, array.reshape(-1, order="F").data)
    return (buffer, function, inputs, outputs), evaluate


class _Scratch(threading.local):
    """The memory in which a thread evaluates a function: each thread has its own.

    `parts` are the input, what evaluates it, the square of the outputs' norm, and the results.
    """

    def __init__(self, function: casadi.Function, count: int):
        vector = np.zeros(function.size1_in(0))
        outputs = [np.zeros(function.size_out(i), order="F") for i in range(function.n_out())]
        self._kept_alive, evaluate = bound(function, [vector], outputs)
        results = tuple([array[:, 0] for array in outputs[:count]] + outputs[count + 1 :])
        self.parts = vector, evaluate, outputs[count][:, 0], results


# Numbers of inputs, and of the outputs that depend on the same ports among them.
OutputGroup = tuple[list[int], list[int]]


def grouped_outputs(
    dependence: list[set[int]], made: Sequence[int], inner: set[int], *, has_state: bool = False
) -> list[OutputGroup]:
    """Outputs `made` in groups, by their `dependence` on ports, in the order of their first ones.

    Inputs that are `inner` are no ports. Where there `has_state`, the first output goes into the
    state: no port shows on which inputs it depends, and it is made with others that read these and
    more.
    """
    ports = {i: frozenset(dependence[i] - inner) for i in made}
    if has_state:
        wider = [ports[i] for i in made[1:] if ports[i] >= ports[0]]
        ports[0] = min(wider, key=len, default=ports[0])
    groups = []
    for own in dict.fromkeys(ports.values()):
        makes = [i for i, other in ports.items() if other == own]
        groups.append((sorted(set().union(*(dependence[i] for i in makes))), makes))
    return groups


class Trace:
    """A function, traced once, and its parts: some of its outputs of some of its inputs.

    The arguments are as of `TracedFunction`.

    Attributes:
        output_sizes: the length of each output, flat.
        dependence: for each output the inputs, by their numbers, on which an entry depends.
        calls: whether it calls functions, see `for_each`.
    """

    def __init__(self, function: Callable, input_sizes: Sequence[int], *, key: Any = None):
        self._function, self.input_sizes = function, list(input_sizes)
        self._expressions: _Expressions = recent_trace(
            lambda: _Expressions(function, self.input_sizes), "parts", self.input_sizes, key
        )
        self.output_sizes = self._expressions.output_sizes
        self.dependence = self._expressions.dependence
        self.calls = self._expressions.calls

    @property
    def identity(self) -> object:
        """The same for traces of one function with one key; it can be hashed."""
        return self._expressions

    def part(self, reads: Sequence[int], makes: Sequence[int]) -> casadi.Function:
        """The function of the inputs `reads`, stacked, to the outputs `makes` and their size.

        Where it reads none, it takes a number (1,), and leaves that alone.
        """
        return self._expressions.part(tuple(reads), tuple(makes))

    def evaluator(
        self, reads: Sequence[int], makes: Sequence[int], scalar: type, name: Callable[[], str]
    ) -> Callable[[Sequence[NDArray]], NDArray]:
        """Evaluates a part on vectors of that scalar type: their outputs, stacked.

        On AutoDiffXd and Expression it calls the function itself. It raises NotFiniteError, as
        `TracedFunction` does, but on Expressions.
        """
        if scalar is float:
            function = self.part(reads, makes)
            return TracedFunction(function, [function.size1_in(0)], name=name).of_vectors
        unread = scalar(1.0) if scalar is AutoDiffXd else scalar(Variable("unread"))
        ends = np.cumsum([self.input_sizes[i] for i in reads])

        def evaluate(inputs: Sequence[NDArray]) -> NDArray:
            values = np.concatenate(inputs)
            given = [np.full(size, unread) for size in self.input_sizes]
            for i, read in zip(reads, np.split(values, ends[:-1]), strict=False):
                given[i] = read
            with np.errstate(invalid="ignore"):  # Expression raises the flag without a cause
                outputs = self._function(*given)
            if not isinstance(outputs, tuple):
                outputs = (outputs,)
            stacked = np.concatenate([np.ravel(outputs[i]) for i in makes])
            stacked = np.array([v if isinstance(v, scalar) else scalar(v) for v in stacked])
            if scalar is AutoDiffXd and not np.linalg.norm(ExtractValue(stacked)) < LARGEST:
                was_given = not np.all(np.abs(ExtractValue(values)) < LARGEST)
                raise NotFiniteError(name(), was_given=was_given)
            return stacked

        return evaluate


class _Expressions:
    """Expressions that a function makes of symbols, and functions of parts of it."""

    def __init__(self, function: Callable, input_sizes: Sequence[int]):
        self._inputs, self._outputs = _expressions(function, input_sizes)
        self.output_sizes = [output.numel() for output in self._outputs]
        every_input, every_output = tuple(range(len(input_sizes))), tuple(range(len(self._outputs)))
        self._parts: dict[tuple, casadi.Function] = {}
        whole = self.part(every_input, every_output)
        codes = map(whole.instruction_id, range(whole.n_instructions()))
        self.calls = casadi.OP_CALL in codes
        rows, columns = whole.jac_sparsity(0, 0).get_triplet()
        numbers = np.searchsorted(np.cumsum(self.output_sizes), rows, "right")
        read = np.searchsorted(np.cumsum(input_sizes), columns, "right")
        self.dependence: list[set[int]] = [{*read[numbers == i].tolist()} for i in every_output]

    def part(self, reads: tuple[int, ...], makes: tuple[int, ...]) -> casadi.Function:
        """Outputs, stacked, and the square of their norm, of inputs, stacked."""
        if (reads, makes) not in self._parts:
            read = casadi.vertcat(*[self._inputs[i] for i in reads] or [casadi.SX.sym("nothing")])
            stacked = casadi.vertcat(*[self._outputs[i] for i in makes])
            made = [stacked, casadi.densify(casadi.sumsqr(stacked))]
            function = casadi.Function("mechanics", [read], made, {"allow_free": True})
            if function.has_free():  # what is given to a function that is called, for other outputs
                unread = function.free_sx()
                made = casadi.substitute(made, unread, [casadi.SX(0)] * len(unread))
                function = casadi.Function("mechanics", [read], made)
            self._parts[reads, makes] = function
        return self._parts[reads, makes]


def _expressions(
    function: Callable, input_sizes: Sequence[int]
) -> tuple[list[casadi.SX], list[casadi.SX]]:
    """A symbol for each input, and the outputs, each dense and flat."""
    symbols = [casadi.SX.sym(f"input_{i}", size) for i, size in enumerate(input_sizes)]
    outputs = function(*map(object_array, symbols))
    if not isinstance(outputs, tuple):
        outputs = (outputs,)
    flat = [casadi.SX(casadi.vertcat(*output.ravel())) for output in outputs]
    return symbols, [casadi.densify(output) for output in flat]


def _traced(
    function: Callable, input_sizes: Sequence[int], jacobian_of: int | None, key: Any
) -> casadi.Function:
    """The outputs, the square of their norm and the Jacobian that was asked for, of one input."""

    def make() -> casadi.Function:
        symbols, expressions = _expressions(function, input_sizes)
        expressions = casadi.cse(expressions)  # before a Jacobian, of which it would take long
        stacked = casadi.vertcat(*expressions)
        expressions.append(casadi.densify(casadi.sumsqr(stacked)))
        if jacobian_of is not None:
            jacobian = casadi.jacobian(stacked, symbols[jacobian_of])
            expressions.append(casadi.densify(jacobian))
        return casadi.Function("mechanics", [casadi.vertcat(*symbols)], expressions)

    return recent_trace(make, list(input_sizes), jacobian_of, key)


def object_array(symbol: casadi.SX) -> NDArray:
    """A flat NumPy object array of the symbol's scalar entries."""
    return np.fromiter(map(_entry, symbol.elements()), dtype=object, count=symbol.numel())


def for_each(
    function: Callable[..., NDArray], own: Sequence[NDArray], shared: Sequence[NDArray]
) -> NDArray:
    """What a function makes (n, ...) of the rows of arrays (n, ...), and of `shared` ones.

    In a trace it is one function that is called with all rows: traced once, and once in the C,
    which makes rows side by side (`lane_code.with_rows_side_by_side`).
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


def to_symbols(values: NDArray) -> NDArray:
    """Numbers as entries of a trace."""
    return object_array(casadi.SX(casadi.DM(values)))


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
