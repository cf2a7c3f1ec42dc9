"""Solvers of other libraries on the same problems, for comparison."""

from collections.abc import Callable

import casadi
import numpy as np
from numpy.typing import NDArray

from drake_nonstop.optimization.speed_program import DATA_SIZE, SpeedProgram

Solve = Callable[[NDArray], NDArray]


def casadi_ipopt(program: SpeedProgram) -> Solve:
    """CasADi's IPOPT, with the exact Hessian of the traced problem, from [ξ⁻, A⁻] on."""
    x, data = casadi.MX.sym("x", 2), casadi.MX.sym("data", DATA_SIZE)
    cost, margins = (function.expressions(x, data)[0] for function in program.functions())
    options = {
        "print_time": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": 100,
        "ipopt.constr_viol_tol": 1e-7,
    }
    problem = {"x": x, "p": data, "f": cost, "g": margins}
    solver = casadi.nlpsol("solver", "ipopt", problem, options)

    def solve(data: NDArray) -> NDArray:
        lower, upper = program.bounds(data[:2])
        found = solver(x0=data[:2], p=data, lbx=lower, ubx=upper, lbg=0, ubg=np.inf)
        return np.clip(np.array(found["x"])[:, 0], lower, upper)

    return solve


def scipy_slsqp(program: SpeedProgram) -> Solve:
    """SciPy's SLSQP with traced values and exact gradients, from [ξ⁻, A⁻] on.

    Raises:
        ModuleNotFoundError: SciPy is not installed.
    """
    from scipy.optimize import minimize

    cost, margins = program.functions(with_gradients=True)

    def solve(data: NDArray) -> NDArray:
        lower, upper = program.bounds(data[:2])

        def value_and_gradient(x: NDArray) -> tuple[float, NDArray]:
            value, gradient = cost(x, data)
            return float(value[0]), gradient[0].copy()

        found = minimize(
            value_and_gradient,
            data[:2],
            jac=True,
            method="SLSQP",
            bounds=list(zip(lower, upper, strict=True)),
            constraints={
                "type": "ineq",
                "fun": lambda x: margins(x, data)[0].copy(),
                "jac": lambda x: margins(x, data)[1].copy(),
            },
            options={"maxiter": 100, "ftol": 1e-9},
        )
        return np.clip(found.x, lower, upper)

    return solve
