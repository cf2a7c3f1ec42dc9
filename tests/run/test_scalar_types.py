"""The closed loop in automatic differentiation: linearized by Drake, and its fastest mode."""

import numpy as np
import pytest
from helpers import difference
from pydrake.systems.primitives import FirstOrderTaylorApproximation

from drake_nonstop import load_scenario, make_nonstop
from drake_nonstop.loop.step import largest_step


def test_a_loop_is_linearized_with_all_its_states_and_its_fastest_mode():
    overrides = ["control_period=0", "optimization_layer=ConstantParameters"]
    loop = make_nonstop(load_scenario("quintic", overrides))
    context = loop.CreateDefaultContext()
    matrix = FirstOrderTaylorApproximation(loop, context).A()
    assert matrix.shape == (51, 51)
    fastest = np.max(np.abs(np.linalg.eigvals(matrix)))
    assert largest_step(loop, context) == pytest.approx(1.6 / fastest, rel=1e-4)
    state = context.get_continuous_state_vector().CopyToVector()

    def rate_at(values):
        context.SetContinuousState(values)
        return loop.EvalTimeDerivatives(context).CopyToVector()

    columns = [
        difference(lambda step, unit=unit: rate_at(state + step * unit), 0.0, 1e-4)
        for unit in np.eye(51)
    ]
    scale = np.maximum(1.0, np.abs(matrix))
    np.testing.assert_array_less(np.abs(np.stack(columns, axis=1) - matrix) / scale, 1e-6)
