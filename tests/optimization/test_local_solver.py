import numpy as np
import pytest
from nonstop_cases import AT_REST, moving, speed_bound_above, update_data, update_solver
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff

from drake_nonstop.blocks.optimization_layer import NonstopOptimizerConfig


def solved_once(inputs, **fields):
    """A local solver that has solved a problem, which its programs then know."""
    updates = update_solver(solver="snopt", **fields)
    updates.solve(update_data(inputs, speed_bound_above(inputs, 0.1), updates=updates))
    return updates._local


@pytest.mark.parametrize("which", ["_nearest", "_fastest"])
def test_solvers_get_values_and_gradients_that_are_differences(which):
    inputs = moving(3, 3.0)
    solver = solved_once(inputs)
    mathematical_program = getattr(solver, which)
    bindings = mathematical_program.GetAllCosts() + mathematical_program.generic_constraints()
    assert len(bindings) == 2
    size = mathematical_program.num_vars()
    x = np.array([2.1, 1.35, 0.2])[:size]
    for binding in bindings:
        evaluate = binding.evaluator().Eval
        result = evaluate(InitializeAutoDiff(x)[:, 0])
        gradient = ExtractGradient(result)
        h = 1e-6

        def value(y, evaluate=evaluate):
            return ExtractValue(evaluate(InitializeAutoDiff(y)[:, 0]))[:, 0]

        expected = np.column_stack(
            [(value(x + h * e) - value(x - h * e)) / (2 * h) for e in np.eye(size)]
        )
        np.testing.assert_allclose(gradient, expected, rtol=0, atol=2e-8)
        assert np.max(np.abs(expected)) > 0.1
        np.testing.assert_allclose(evaluate(x), ExtractValue(result)[:, 0], rtol=1e-14)


def test_solver_may_try_every_point_within_the_bounds():
    far = (0.01, 1000.0)
    solver = solved_once(AT_REST, amplitude_bounds=far)
    for frequency in NonstopOptimizerConfig().frequency_bounds:
        for amplitude in far:
            x = InitializeAutoDiff(np.array([frequency, amplitude]))[:, 0]
            for binding in solver._nearest.GetAllCosts() + solver._nearest.generic_constraints():
                values = ExtractValue(binding.evaluator().Eval(x))
                assert np.all(np.isfinite(values))
