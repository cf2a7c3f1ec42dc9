"""Drake's nonlinear solvers on the problem of one update, each from one start."""

import threading
from collections.abc import Callable
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.solvers import (
    IpoptSolver,
    MathematicalProgram,
    NloptSolver,
    SnoptSolver,
    SolverInterface,
    SolverOptions,
)

from drake_nonstop.systems.block import weakly
from drake_nonstop.systems.tracing import TracedFunction

_CONSTRAINT_TOLERANCE = 1e-7  # on a margin


class LocalSolver(threading.local):
    """Two MathematicalPrograms over [ξ, A], built once: the nearest and the fastest point.

    Each thread has its own, built of the same arguments. Cost and margins are functions of [ξ, A]
    and a flat vector of data, with gradients as second outputs; the first `speed_count` margins are
    those of the speed bound. Without any there is no fastest point.
    """

    NAMES: ClassVar[dict[str, Callable[[], SolverInterface]]] = {
        "snopt": SnoptSolver,
        "ipopt": IpoptSolver,
        "nlopt": NloptSolver,
    }

    def __init__(
        self,
        name: str,
        cost: TracedFunction,
        margins: TracedFunction,
        speed_count: int,
        data_size: int,
    ):
        self._cost, self._margins, self._speed_count = cost, margins, speed_count
        self._solver, self._options = self.NAMES[name](), _options()
        self._data = np.zeros(data_size)
        nothing = np.zeros(2)
        (count,) = margins.output_sizes
        zero, infinity = np.zeros(count), np.full(count, np.inf)

        self._nearest = MathematicalProgram()
        x = self._nearest.NewContinuousVariables(2, "x")
        self._nearest_box = self._nearest.AddBoundingBoxConstraint(nothing, nothing, x)
        self._nearest.AddCost(weakly(self._evaluate_cost), vars=x)
        self._nearest.AddConstraint(weakly(self._evaluate_margins), zero, infinity, vars=x)
        if speed_count == 0:
            return
        self._fastest = MathematicalProgram()
        x = self._fastest.NewContinuousVariables(2, "x")
        worst = self._fastest.NewContinuousVariables(1, "worst_margin")
        self._fastest_box = self._fastest.AddBoundingBoxConstraint(nothing, nothing, x)
        self._fastest.AddLinearCost(-worst[0])
        self._fastest.AddConstraint(
            weakly(self._evaluate_speed_margins_above_worst),
            zero[:speed_count],
            infinity[:speed_count],
            vars=[*x, *worst],
        )

    def nearest(self, start: NDArray, data: NDArray, lower: NDArray, upper: NDArray) -> NDArray:
        """The [ξ, A] (2,) of the least cost that fulfils the constraints, from `start` on."""
        return self._solve(self._nearest, self._nearest_box, start, data, lower, upper, [])

    def fastest(self, start: NDArray, data: NDArray, lower: NDArray, upper: NDArray) -> NDArray:
        """The [ξ, A] (2,) of the largest worst margin of the speeds, from `start` on."""
        worst = float(np.min(self._margins(start, data)[0][: self._speed_count]))
        return self._solve(self._fastest, self._fastest_box, start, data, lower, upper, [worst])

    def _solve(self, program, box, start, data, lower, upper, more_guess) -> NDArray:
        # The programs' callbacks read the data from here; set anew for every solve.
        self._data[:] = data
        box.evaluator().set_bounds(lower, upper)
        result = self._solver.Solve(program, np.array([*start, *more_guess]), self._options)
        x = result.get_x_val()[:2]
        if not np.all(np.isfinite(x)):
            return start.copy()
        return np.clip(x, lower, upper)  # IPOPT ends up to 1e-8 outside

    # Drake calls these with floats or with AutoDiffXd, and wants the same back.
    def _evaluate_cost(self, x: NDArray) -> AutoDiffXd | float:
        if x.dtype == float:
            return float(self._cost(x, self._data)[0][0])
        cost, gradient = self._cost(ExtractValue(x)[:, 0], self._data)
        return AutoDiffXd(cost[0], gradient[0] @ ExtractGradient(x))

    def _evaluate_margins(self, x: NDArray) -> NDArray:
        if x.dtype == float:
            return self._margins(x, self._data)[0]
        margins, gradients = self._margins(ExtractValue(x)[:, 0], self._data)
        return InitializeAutoDiff(margins, gradients @ ExtractGradient(x))

    def _evaluate_speed_margins_above_worst(self, x: NDArray) -> NDArray:
        return self._evaluate_margins(x[:2]).reshape(-1)[: self._speed_count] - x[2]


def _options() -> SolverOptions:
    """Options that keep the solvers quiet, fast and exact on two variables."""
    options = SolverOptions()
    snopt, ipopt, nlopt = SnoptSolver.id(), IpoptSolver.id(), NloptSolver.id()
    options.SetOption(snopt, "Major iterations limit", 50)
    options.SetOption(snopt, "Major feasibility tolerance", _CONSTRAINT_TOLERANCE)
    options.SetOption(snopt, "Scale option", 0)
    options.SetOption(ipopt, "max_iter", 100)
    options.SetOption(ipopt, "constr_viol_tol", _CONSTRAINT_TOLERANCE)
    options.SetOption(ipopt, "print_level", 0)
    options.SetOption(nlopt, NloptSolver.AlgorithmName(), "LN_COBYLA")
    options.SetOption(nlopt, NloptSolver.ConstraintToleranceName(), _CONSTRAINT_TOLERANCE)
    options.SetOption(nlopt, NloptSolver.MaxEvalName(), 200)
    return options
