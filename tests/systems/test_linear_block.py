"""Linear functions as Drake's systems."""

import numpy as np
import pytest
from helpers import outputs

from drake_nonstop.systems.linear_block import LinearBlock


def matrix(rng, shape):
    """A matrix with zeros, as many in one row as in another or not."""
    values = rng.normal(size=shape)
    return np.where(rng.uniform(size=shape) < 0.6, 0.0, values)


@pytest.mark.parametrize("dense", [False, True])
def test_outputs_and_rate_are_those_of_the_function(rng, dense):
    sizes = {"force": 4, "torque": 3}
    draw = rng.normal(size=(5 + 2 + 3, 5 + 7)) if dense else matrix(rng, (10, 12))

    def function(state, force, torque):
        return tuple(np.split(draw @ np.concatenate([state, force, torque]), [5, 7]))

    block = LinearBlock(
        function, inputs=sizes, outputs={"first": 2, "second": 3}, state_size=5, state_port="shown"
    )
    state, force, torque = rng.normal(size=5), rng.normal(size=4), rng.normal(size=3)
    rate, first, second = function(state, force, torque)
    got = outputs(block, state, force=force, torque=torque)
    np.testing.assert_allclose(got["first"], first, rtol=0, atol=1e-14)
    np.testing.assert_allclose(got["second"], second, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(got["shown"], state)
    context = block.CreateDefaultContext()
    np.testing.assert_array_equal(context.get_continuous_state_vector().CopyToVector(), 0)
    context.SetContinuousState(state)
    for name, value in (("force", force), ("torque", torque)):
        block.GetInputPort(name).FixValue(context, value)
    np.testing.assert_allclose(
        block.EvalTimeDerivatives(context).CopyToVector(), rate, rtol=0, atol=1e-14
    )


def test_equations_are_the_function_and_its_ports(rng):
    block = LinearBlock(lambda a, b: 2 * a - b, inputs={"a": 3, "b": 3}, outputs={"c": 3})
    a, b = rng.normal(size=(2, 3))
    np.testing.assert_array_equal(block.equations.function(a, b), 2 * a - b)
    assert (block.equations.inputs, block.equations.outputs) == ({"a": 3, "b": 3}, {"c": 3})
    assert len(block.equations.initial_state) == 0
    np.testing.assert_array_equal(outputs(block, a=a, b=b)["c"], 2 * a - b)


def test_state_alone_shows_without_feedthrough():
    block = LinearBlock(
        lambda state, rate: 3 * rate, inputs={"rate": 2}, state_size=2, state_port="value"
    )
    assert not block.HasAnyDirectFeedthrough()


def test_products_of_a_row_are_summed_in_the_order_of_the_inputs():
    """0.1 + 0.2 + 0.3 depends on the order in its last bit; the state comes last."""
    block = LinearBlock(
        lambda state, a: (0 * state, 0.1 * a[:1] + 0.2 * a[1:] + 0.3 * state),
        inputs={"a": 2},
        outputs={"sum": 1},
        state_size=1,
    )
    expected = 0.1 + 0.2 + 0.3
    assert expected != 0.1 + (0.2 + 0.3)
    assert outputs(block, np.ones(1), a=np.ones(2))["sum"] == expected


@pytest.mark.parametrize("function", [np.cos, lambda a: a + 1, lambda a: a * a, lambda a: a / 0])
def test_functions_that_are_not_linear_are_refused(function):
    with np.errstate(all="ignore"), pytest.raises(ValueError, match="give one that is linear"):
        LinearBlock(function, inputs={"a": 2}, outputs={"b": 2})
