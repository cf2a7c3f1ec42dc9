"""Checks of plans: those in C and in Python, and the programs of their steps by all solvers."""

from unittest.mock import patch

import numpy as np
import pytest

from drake_nonstop.optimization.compiled_plan import compiled_solver
from drake_nonstop.optimization.horizon_solver import HorizonSolver
from drake_nonstop.optimization.step_program import SOLVERS, StepProgram


def drawn_start(problem):
    return 1 + 0.05 * np.random.default_rng(3).normal(size=(2, problem.count))


def require_equal_plans(problem, data):
    """A plan in C is the one in Python."""
    assert compiled_solver() is not None
    in_c, in_python = (
        HorizonSolver(problem, compiles=compiles).solve(
            data, drawn_start(problem), max_iterations=4
        )
        for compiles in (True, False)
    )
    assert in_c.iterations == in_python.iterations > 1
    assert in_c.scale == in_python.scale
    np.testing.assert_allclose(in_c.coefficients, in_python.coefficients, rtol=0, atol=1e-9)
    np.testing.assert_allclose(in_c.margins, in_python.margins, rtol=1e-9, atol=1e-9)
    assert in_c.cost == pytest.approx(in_python.cost, rel=1e-9)
    assert in_c.slack == pytest.approx(in_python.slack, abs=1e-9)
    assert in_c.slowest == pytest.approx(in_python.slowest, rel=1e-9)


def require_equal_steps(problem, data):
    """All solvers find the same steps: of recorded programs cost and constraints are equal."""
    programs: list[StepProgram] = []
    solved = StepProgram.solved

    def recorded(program, solver):
        programs.append(program)
        return solved(program, solver)

    with patch.object(StepProgram, "solved", recorded):
        solver = HorizonSolver(problem, compiles=False)
        solver.solve(data, drawn_start(problem), max_iterations=4)
    assert len(programs) > 3
    for program in programs:
        found = {solver: solved(program, solver) for solver in SOLVERS}
        best = min(program.value(x) for x in found.values())
        for x in found.values():
            assert program.value(x) == pytest.approx(best, rel=1e-8, abs=1e-8)
            rows = program.rows @ x
            parts = x - program.lower, program.upper - x, rows - program.least, program.most - rows
            assert min(part.min() for part in parts) > -1e-8
