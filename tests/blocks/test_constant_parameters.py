"""The optimization layer without optimization: constant parameters."""

import numpy as np
import pytest
from helpers import fix, model, output

from drake_nonstop.blocks.optimization_layer import ConstantParameters, ConstantParametersConfig
from drake_nonstop.systems.tracing import NotFiniteError
from drake_nonstop.validation import ScenarioError


def test_constant_parameters():
    block = ConstantParameters(model(), ConstantParametersConfig(frequency=1.5, amplitude=0.7))
    parameters = output(block, block.CreateDefaultContext(), "parameters")
    np.testing.assert_array_equal(parameters, [1.5, 0.7])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("frequency", 0.0),
        ("frequency", np.nan),
        ("amplitude", -1.0),
        ("amplitude", np.inf),
        ("speed_bound", -0.1),
    ],
)
def test_bad_constant_parameter_is_named(field, value):
    with pytest.raises(ScenarioError, match=f"optimization_layer.{field} = {value}: give"):
        ConstantParameters(model(), ConstantParametersConfig(**{field: value}))


def test_a_commanded_bound_is_reported_in_place_of_the_one_that_is_set():
    block = ConstantParameters(model())
    context = block.CreateDefaultContext()
    block.set_speed_bound(context, 0.3)
    np.testing.assert_array_equal(output(block, context, "speed_bound"), [0.3])
    fix(block, context, speed_bound_command=np.array([0.4]))
    np.testing.assert_array_equal(output(block, context, "speed_bound"), [0.4])
    with pytest.raises(ScenarioError, match=r"speed_bound = 0.5: the signal speed_bound_command"):
        block.set_speed_bound(context, 0.5)
    fix(block, context, speed_bound_command=np.zeros(1))
    np.testing.assert_array_equal(output(block, context, "speed_bound"), [0.0])
    for command, said in ((np.nan, "was given"), (-0.1, "made")):
        fix(block, context, speed_bound_command=np.array([command]))
        with pytest.raises(NotFiniteError, match=f"{said} a value that is not finite"):
            output(block, context, "speed_bound")
