"""Linear functions as Drake's systems."""

import numpy as np
import pytest
from helpers import outputs
from pydrake.systems.framework import DiagramBuilder

from drake_nonstop.systems.linear_block import AdjustableLinear, LinearBlock
from drake_nonstop.systems.parameters import NumericParameters

SIZES = {"force": 4, "torque": 3}


def matrix(rng, shape):
    """A matrix with zeros, as many in one row as in another or not."""
    values = rng.normal(size=shape)
    return np.where(rng.uniform(size=shape) < 0.6, 0.0, values)


@pytest.mark.parametrize("dense", [False, True])
def test_output_is_the_product(rng, dense):
    draw = rng.normal(size=(5, 7)) if dense else matrix(rng, (5, 7))
    force, torque = rng.normal(size=4), rng.normal(size=3)
    got = outputs(LinearBlock(draw, SIZES), force=force, torque=torque)
    expected = draw @ np.concatenate([force, torque])
    np.testing.assert_allclose(got["output"], expected, rtol=0, atol=1e-14)


def test_products_of_a_row_are_summed_in_the_order_of_the_inputs():
    """0.1 + 0.2 + 0.3 depends on the order in its last bit."""
    block = LinearBlock(np.array([[0.1, 0.2, 0.3]]), {"a": 2, "b": 1})
    expected = 0.1 + 0.2 + 0.3
    assert expected != 0.1 + (0.2 + 0.3)
    assert outputs(block, a=np.ones(2), b=np.ones(1))["output"] == expected


@pytest.mark.parametrize("function", [np.cos, lambda a: a + 1, lambda a: a * a, lambda a: a / 0])
def test_functions_that_are_not_linear_are_refused(function):
    with np.errstate(all="ignore"), pytest.raises(ValueError, match="give one that is linear"):
        AdjustableLinear(
            DiagramBuilder(), function, inputs={"a": 2}, size=2, parameters=NumericParameters({})
        )
