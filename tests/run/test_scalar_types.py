"""The closed loop in Drake's other scalar types: linearized, differentiated, printed, cloned."""

import numpy as np
import pytest
from helpers import difference
from pydrake.systems.analysis import Simulator
from pydrake.systems.primitives import FirstOrderTaylorApproximation

from drake_nonstop import load_scenario, make_nonstop, set_equilibrium
from drake_nonstop.loop.step import largest_step

CONSTANT = "optimization_layer=ConstantParameters"


def started(overrides, scenario="quintic"):
    """A scenario, its loop and a context at the start, after its initialization events."""
    config = load_scenario(scenario, overrides)
    loop = make_nonstop(config)
    context = loop.CreateDefaultContext()
    set_equilibrium(loop, context)
    Simulator(loop, context).Initialize()
    return config, loop, context


def rate(loop, context):
    return loop.EvalTimeDerivatives(context).CopyToVector()


@pytest.fixture(scope="module")
def linearized():
    """The loop with continuous controllers, its context at the start, and A of ẋ = A x."""
    _, loop, context = started(["control_period=0", CONSTANT])
    return loop, context, FirstOrderTaylorApproximation(loop, context).A().copy()


def test_linearization_has_all_states_and_equals_central_differences(linearized):
    loop, context, matrix = linearized
    state = context.get_continuous_state_vector().CopyToVector()
    assert matrix.shape == (51, 51)

    def rate_at(values):
        context.SetContinuousState(values)
        return rate(loop, context)

    columns = [
        difference(lambda step, unit=unit: rate_at(state + step * unit), 0.0, 1e-4)
        for unit in np.eye(51)
    ]
    context.SetContinuousState(state)
    scale = np.maximum(1.0, np.abs(matrix))
    np.testing.assert_array_less(np.abs(np.stack(columns, axis=1) - matrix) / scale, 1e-6)


def test_spectrum_has_the_fastest_mode(linearized):
    loop, context, matrix = linearized
    fastest = np.max(np.abs(np.linalg.eigvals(matrix)))
    assert largest_step(loop, context) == pytest.approx(1.6 / fastest, rel=1e-4)
