"""Programs of steps that have no solution; others are in the tests of plans."""

import numpy as np

from drake_nonstop.planning.step_program import SOLVERS, StepProgram


def test_a_program_without_a_solution_has_none():
    one = np.ones((1, 1))
    apart = StepProgram(one, one[0], -one[0], one[0], one, 3 * one[0], 4 * one[0])
    assert [apart.solved(solver) for solver in SOLVERS] == [None] * len(SOLVERS)
