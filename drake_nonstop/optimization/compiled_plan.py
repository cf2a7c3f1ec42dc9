"""solve_plan.c: successive quadratic programs for a plan, in one call."""

import ctypes
import functools
import threading
from collections.abc import Callable, Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import daqp
import numpy as np
from numpy.typing import NDArray

from drake_nonstop.optimization.elementwise import tell_not_compiled
from drake_nonstop.optimization.horizon_motion import HorizonData
from drake_nonstop.optimization.horizon_problem import MarginFunction
from drake_nonstop.systems.native import CompilationError, shared_library
from drake_nonstop.systems.tracing import NotFiniteError

if TYPE_CHECKING:
    from drake_nonstop.optimization.horizon_solver import HorizonSolver

_TEXT = files(__package__).joinpath("solve_plan.c").read_text(encoding="utf-8")
_NOT_FINITE, _NO_MEMORY = -1, -2
_NUMBERS = 5  # that are given and made


class _Structure(ctypes.Structure):
    """A structure of C, made of numbers and of arrays, which it keeps alive."""

    def __init__(self, *values: Any):
        arrays = (np.ndarray, ctypes.Array)
        self.kept_alive = [np.ascontiguousarray(v) if type(v) is np.ndarray else v for v in values]
        super().__init__(*(_address(v) if isinstance(v, arrays) else v for v in self.kept_alive))


def _address(array: Any) -> int:
    is_numpy = isinstance(array, np.ndarray)
    return array.ctypes.data if is_numpy else ctypes.addressof(array)


def _fields(**kinds: str) -> list[tuple[str, Any]]:
    """The fields of kinds of names: p for pointers, i for whole numbers, d for others."""
    types = {"p": ctypes.c_void_p, "i": ctypes.c_int64, "d": ctypes.c_double}
    return [(name, types[kind]) for kind, names in kinds.items() for name in names.split()]


class _Margins(_Structure):
    _fields_ = [
        *_fields(p="evaluate buffer inputs results", i="values rows columns"),
        *_fields(p="instants places", i="along"),
        *_fields(p="angles term_rows term_columns", i="terms constants of_flight"),
    ]


class _Limits(_Structure):
    _fields_ = _fields(p="evaluate buffer inputs results", i="values phases carriers")


class _Neighbours(_Structure):
    _fields_ = _fields(i="first rows columns")


class _Horizon(_Structure):
    _fields_ = [
        *_fields(p="daqp", i="instants count fixed constraints slacks angles differences carriers"),
        *_fields(p="jacobians ends hessian step_hessian step_rows fixed_rows weights bounds"),
        *_fields(p="difference_rows largest instant_of slack_of before after widths"),
        *_fields(i="function_count neighbour_count", p="functions neighbours"),
        *_fields(i="terminal terminal_count amplitude_count", p="terminal_at"),
        *_fields(i="bound fast apart", d="terminal_unit least_amplitude amplitude_spacing"),
        *_fields(p="limits settings"),
    ]


class _Data(_Structure):
    _fields_ = [
        *_fields(d="bound unit", p="excess losses loss_slopes lossy_plan tables", i="table_size"),
        *_fields(p="apart terminal_terms bounds"),
        *_fields(p="terms", i="terms_size"),
        *_fields(p="flight", i="flight_size"),
    ]


@functools.cache
def compiled_solver() -> Callable[..., int] | None:
    """`solve_plan` of solve_plan.c; None: it cannot be compiled, which a ScenarioWarning tells."""
    try:
        if not _quadprog():
            raise CompilationError("the wheel of daqp does not show its function in C")
        solve = shared_library(_TEXT, "solve_plan").solve_plan
    except CompilationError as error:
        tell_not_compiled(str(error))
        return None
    solve.restype = ctypes.c_int64
    solve.argtypes = [*[ctypes.c_void_p] * 2, ctypes.c_int64, *[ctypes.c_void_p] * 3]
    return solve


def _quadprog() -> int:
    """The address of DAQP's function in C; 0: there is none."""
    quadprog = getattr(ctypes.CDLL(daqp.__file__), "daqp_quadprog", None)
    return ctypes.cast(quadprog, ctypes.c_void_p).value or 0 if quadprog else 0


class CompiledPlan(threading.local):
    """Solves the plans of a `HorizonSolver` in C; each thread in memory of its own.

    Args:
        solve_plan: of `compiled_solver`.
        solver: whose plans they are.
        settings: the numbers that both have in common, in the order of solve_plan.c.
    """

    def __init__(
        self, solve_plan: Callable[..., int], solver: "HorizonSolver", settings: Sequence[float]
    ):
        problem = solver.problem
        self._solve, self._name, self._functions = solve_plan, problem.name, problem.functions
        layout, terminal = problem.layout, problem.terminal_places
        rows = np.stack(problem.jacobians)
        functions = [_margins(part) for part in problem.functions]
        memory = problem.limits_of_carriers.memory
        memory.inputs[12:18] = problem.orbit_directions
        memory.inputs[20:] = problem.numbers[:, None, None]
        limits = _Limits(memory.evaluate, memory.buffer, *memory[:2], *np.shape(memory.outputs))
        self._kept_alive = functions, limits
        low, spacing = problem.amplitudes[0], problem.amplitudes[1] - problem.amplitudes[0]
        neighbours = [_Neighbours(int(p[0, 0]), *p.shape) for p in problem.neighbouring]
        self._horizon = _Horizon(
            _quadprog(),
            *(len(problem.instants), problem.count, solver.fixed, len(layout.names)),
            *(len(solver.weights), problem.intervals, len(solver.differences), problem.model.n),
            *(rows, _ends(rows), problem.hessian, *_of_steps(solver, rows), solver.weights),
            np.concatenate([bound.ravel() for bound in problem.bounds]),
            *(solver.differences, solver.largest_differences),
            *(layout.instants, layout.slacks, layout.before, layout.after, layout.widths),
            *(len(functions), len(neighbours)),
            (_Margins * len(functions))(*functions),
            (_Neighbours * len(neighbours))(*neighbours),
            *(int(terminal[0, 0]), np.shape(terminal)[1], len(problem.amplitudes)),
            problem.terminal_at,
            *(int(kind in problem.terminal_kinds) for kind in range(3)),
            *(problem.terminal_unit, low, spacing),
            ctypes.addressof(limits),
            np.array(settings),
        )
        self._margins = np.zeros(len(layout.names))

    def solved(
        self,
        data: HorizonData,
        x: NDArray,
        max_iterations: int,
        tolerance: float,
        scale: float,
        *,
        until_feasible: bool,
    ) -> tuple[float, float, int, float, bool, NDArray, float]:
        """Improves coefficients (2, N), which are changed, as `HorizonSolver.solve` says.

        Returns the fields of a `PlanAnswer` after them.

        Raises:
            NotFiniteError: the merit of the start is not finite.
        """
        tables = data.terminal
        given = _Data(
            *(data.speed_bound, data.speed_unit, data.excess, *(data.losses or [None] * 3)),
            *(tables.limits.ctypes.data, tables.limits.strides[0] // tables.limits.itemsize),
            *(tables.apart, tables.flat_terms, tables.bounds),
            *(
                data.flat_terms,
                data.flat_terms.shape[1],
                data.flat_flight,
                data.flat_flight.shape[1],
            ),
        )
        numbers = np.zeros(_NUMBERS)
        numbers[:4] = data.start_angle, tolerance, scale, until_feasible
        addresses = ctypes.addressof(self._horizon), ctypes.addressof(given)
        arrays = (array.ctypes.data for array in (x, numbers, self._margins))
        iterations = self._solve(*addresses, max_iterations, *arrays)
        if iterations == _NOT_FINITE:
            raise NotFiniteError(self._name())
        if iterations == _NO_MEMORY:
            raise MemoryError
        cost, slack, scale, slowest, converged = numbers.tolist()
        margins, slowest = self._margins.copy(), data.speed_of(slowest)
        return cost, slack, iterations, scale, bool(converged), margins, slowest


def _margins(part: MarginFunction) -> _Margins:
    inputs, outputs, evaluate, buffer = part.function.memory
    inputs[-2 - len(part.constants) : -2] = part.constants
    arrays = part.instants, part.places, part.along, part.angles, part.rows, part.columns
    own = len(part.columns), len(part.constants), int(part.source == "flat_flight")
    return _Margins(evaluate, buffer, inputs, outputs, *part.places.shape, *arrays, *own)


def _of_steps(solver: "HorizonSolver", rows: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Of the program of a step: its Hessian, `rows` by z, and its fixed rows; see solve_plan.c.

    x = T z with T = R⁻¹ and the cost's Hessian H = RᵀR, which is that of each spline by itself.
    """
    size, slacks, fixed = len(solver.free), len(solver.weights), solver.fixed
    changes = np.linalg.inv(np.linalg.cholesky(solver.step_hessian[:size, :size]).T)
    xi, amplitude = changes[: size // 2, : size // 2], changes[size // 2 :, size // 2 :]
    own = [rows[:3, :, fixed:] @ xi, rows[3:, :, fixed:] @ amplitude]
    others = np.vstack([changes, solver.fixed_rows[:, :size] @ changes])
    hessian = np.diag(np.repeat([0.0, 1.0], [slacks, size]))
    return hessian, np.concatenate(own), np.hstack([np.zeros((len(others), slacks)), others])


def _ends(rows: NDArray) -> NDArray:
    """Where rows (..., N) begin and end to be other than zero, (..., 2)."""
    is_there = rows != 0
    begins = is_there.argmax(axis=-1)
    ends = rows.shape[-1] - is_there[..., ::-1].argmax(axis=-1)
    return np.stack([begins, np.where(is_there.any(axis=-1), ends, begins)], axis=-1)
