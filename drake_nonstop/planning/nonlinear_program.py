"""A small nonlinear program, solved by one of Drake's solvers from a start."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.solvers import IpoptSolver, MathematicalProgram, SnoptSolver, SolverOptions

from drake_nonstop.planning.constraints import FEASIBILITY_TOLERANCE
from drake_nonstop.systems.tracing import TracedFunction
from drake_nonstop.validation import require

SOLVERS = {"snopt": SnoptSolver, "ipopt": IpoptSolver}


def check_solver(field: str, name: str) -> None:
    """Raises ScenarioError for a solver that does not exist, or that this Drake does not have."""
    require(name in SOLVERS, field, name, f"give one of {', '.join(SOLVERS)}")
    others = [other for other, solver in SOLVERS.items() if solver().available()]
    remedy = f"this build of Drake is without it; give {' or '.join(others)}"
    require(name in others, field, name, remedy)


def solved_program(
    solver: str,
    cost: TracedFunction,
    constraints: TracedFunction,
    data: NDArray,
    start: NDArray,
    bounds: NDArray,
) -> NDArray:
    """The x (k,) of the least cost with constraints ≥ 0 that a solver finds from a start.

    Args:
        solver: a name of `SOLVERS`.
        cost: of x and the data, with its Jacobian by x as its last output.
        constraints: likewise.
        data: a vector.
        start: (k,).
        bounds: (2, k), the least and the largest x.

    Raises:
        NotFiniteError: cost or constraints are not finite at an x that the solver tries.
    """
    program = MathematicalProgram()
    x = program.NewContinuousVariables(len(start), "x")
    program.AddBoundingBoxConstraint(*bounds, x)
    program.AddCost(lambda x: evaluated(lambda v: cost(v, data), x)[0], vars=x)
    (count,) = constraints.output_sizes
    least, most = np.zeros(count), np.full(count, np.inf)
    program.AddConstraint(
        lambda x: evaluated(lambda v: constraints(v, data), x), least, most, vars=x
    )
    found = SOLVERS[solver]().Solve(program, start, _options()).get_x_val()
    # IPOPT ends up to 1e-8 outside of the bounds.
    return np.clip(found, *bounds) if np.all(np.isfinite(found)) else start


def evaluated(function: Callable[[NDArray], Sequence[NDArray]], x: NDArray) -> Any:
    """The values of a function of numbers, of the scalar type of x: floats or AutoDiffXd.

    The function returns values (m,) and their Jacobian.
    """
    if x.dtype == float:
        return function(x)[0].copy()
    values, jacobian = function(ExtractValue(x)[:, 0])
    return InitializeAutoDiff(values, jacobian @ ExtractGradient(x))[:, 0]


def _options() -> SolverOptions:
    """Options that keep the solvers quiet, fast and exact on two variables."""
    options, tolerance = SolverOptions(), 0.1 * FEASIBILITY_TOLERANCE
    snopt, ipopt = SnoptSolver.id(), IpoptSolver.id()
    options.SetOption(snopt, "Major iterations limit", 50)
    options.SetOption(snopt, "Major feasibility tolerance", tolerance)
    options.SetOption(snopt, "Scale option", 0)
    options.SetOption(ipopt, "max_iter", 100)
    options.SetOption(ipopt, "constr_viol_tol", tolerance)
    options.SetOption(ipopt, "print_level", 0)
    return options
