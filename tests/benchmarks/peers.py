"""Solvers of other libraries on the same problems, for comparison."""

from collections.abc import Callable

import casadi
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from drake_nonstop.optimization.update_data import UpdateData
from drake_nonstop.optimization.update_solver import UpdateSolver

Solve = Callable[[UpdateData], NDArray]


def casadi_ipopt(updates: UpdateSolver) -> Solve:
    """CasADi's IPOPT, with the exact Hessian of the traced problem, from [ξ⁻, A⁻] on."""
    x, data = casadi.MX.sym("x", 2), casadi.MX.sym("data", updates.data_size)
    cost, margins = (function.expressions(x, data)[0] for function in updates.functions())
    options = {
        "print_time": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": 100,
        "ipopt.constr_viol_tol": 1e-7,
    }
    problem = {"x": x, "p": data, "f": cost, "g": margins}
    solver = casadi.nlpsol("solver", "ipopt", problem, options)

    def solve(data: UpdateData) -> NDArray:
        update = updates.problem(data)
        lower, upper = update.bounds
        found = solver(x0=update.previous, p=update.vector, lbx=lower, ubx=upper, lbg=0, ubg=np.inf)
        return np.clip(np.array(found["x"])[:, 0], lower, upper)

    return solve


def scipy_slsqp(updates: UpdateSolver) -> Solve:
    """SciPy's SLSQP with traced values and exact gradients, from [ξ⁻, A⁻] on."""
    cost, margins = updates.functions(with_gradients=True)

    def solve(data: UpdateData) -> NDArray:
        update = updates.problem(data)
        lower, upper = update.bounds

        def value_and_gradient(x: NDArray) -> tuple[float, NDArray]:
            value, gradient = cost(x, update.vector)
            return float(value[0]), gradient[0].copy()

        found = minimize(
            value_and_gradient,
            update.previous,
            jac=True,
            method="SLSQP",
            bounds=list(zip(lower, upper, strict=True)),
            constraints={
                "type": "ineq",
                "fun": lambda x: margins(x, update.vector)[0].copy(),
                "jac": lambda x: margins(x, update.vector)[1].copy(),
            },
            options={"maxiter": 100, "ftol": 1e-9},
        )
        return np.clip(found.x, lower, upper)

    return solve
