"""The quadratic program of a step of a plan, and the solvers that it can be given to."""

from collections.abc import Callable
from typing import NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray
from pydrake.solvers import (
    ClarabelSolver,
    IpoptSolver,
    MathematicalProgram,
    SnoptSolver,
    SolverInterface,
    SolverOptions,
)

DAQP = "daqp"
_SOLVERS: dict[str, Callable[[], SolverInterface]] = {
    "clarabel": ClarabelSolver,
    "snopt": SnoptSolver,
    "ipopt": IpoptSolver,
}
SOLVERS = (DAQP, *_SOLVERS)
_UNLIMITED = 1e30  # of DAQP
_IS_OPTIMAL = 1  # its exit flag


class StepProgram(NamedTuple):
    """min ½ xᵀ H x + gᵀ x with l ≤ x ≤ u and the same of rows R x, of v variables."""

    hessian: NDArray  # (v, v), H
    gradient: NDArray  # (v,), g
    lower: NDArray  # (v,), l
    upper: NDArray  # (v,), u
    rows: NDArray  # (r, v), R
    least: NDArray  # (r,), of the rows
    most: NDArray  # (r,)

    def value(self, x: NDArray) -> float:
        """The cost at x (v,)."""
        return float(x @ self.hessian @ x / 2 + self.gradient @ x)

    def solved(self, solver: str) -> NDArray | None:
        """The x (v,) of the least cost, by one of `SOLVERS`; None where it finds none."""
        if solver == DAQP:
            return self._solved_by_daqp()
        program = MathematicalProgram()
        x = program.NewContinuousVariables(len(self.gradient), "x")
        program.AddQuadraticCost(self.hessian, self.gradient, x, is_convex=True)
        program.AddBoundingBoxConstraint(self.lower, self.upper, x)
        program.AddLinearConstraint(self.rows, self.least, self.most, x)
        result = _SOLVERS[solver]().Solve(program, None, _options())
        return result.GetSolution(x) if result.is_success() else None

    def _solved_by_daqp(self) -> NDArray | None:
        upper = np.concatenate([self.upper, self.most]).clip(max=_UNLIMITED)
        lower = np.concatenate([self.lower, self.least])
        kinds = np.zeros(len(upper), np.int32)
        given = np.ascontiguousarray(self.rows), upper, lower, kinds
        x, _, flag, _ = daqp.solve(self.hessian, self.gradient, *given)
        return x if flag == _IS_OPTIMAL else None


def _options() -> SolverOptions:
    """Options with which the solvers agree to eight digits."""
    options = SolverOptions()
    options.SetOption(SnoptSolver.id(), "Major optimality tolerance", 1e-9)
    options.SetOption(IpoptSolver.id(), "tol", 1e-11)
    options.SetOption(IpoptSolver.id(), "bound_relax_factor", 0.0)
    return options
