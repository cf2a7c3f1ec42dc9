"""Numbers of a loop are set in the contexts of all blocks that take them."""

from functools import cache

import numpy as np
import pytest
from helpers import GAINS, output
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.framework import DiagramBuilder

from drake_nonstop import (
    CompiledLoop,
    ScenarioError,
    get_parameter,
    load_scenario,
    make_nonstop,
    set_parameter,
)

CONSTANT = "optimization_layer=ConstantParameters"
GIVEN = {
    "system.load_mass": 1.1,
    "simulated.load_mass": 1.2,
    "simulated.load_inertia": np.diag([0.011, 0.012, 0.013]).tolist(),
    "carrier_controller.position_gain": 800.0,
    "wrench_controller.position_gain": 6.0,
    "optimization_layer.frequency": 2.1,
    "optimization_layer.amplitude": 1.1,
}


@cache
def quintic(*overrides):
    return make_nonstop(load_scenario("quintic", [CONSTANT, *overrides]))


def test_a_loop_set_to_numbers_flies_as_the_one_built_for_them_without_another_trace():
    gains = [f"wrench_controller.{name}={value}" for name, value in GAINS.items()]  # none is "auto"
    loop, built = quintic(*gains), quintic(*gains, *(f"{k}={v}" for k, v in GIVEN.items()))
    fly, other = (
        CompiledLoop(each, load_scenario("quintic").simulator_config, 0.01, compiles=False)
        for each in (loop, built)
    )
    context, expected = loop.CreateDefaultContext(), built.CreateDefaultContext()
    for name, value in GIVEN.items():
        set_parameter(loop, context, name, value)
        np.testing.assert_array_equal(get_parameter(loop, context, name), value)
    fly.write_state(context, other.state_of(expected))
    for name in ("load_state", "carrier_state", "tensions", "wrench"):
        np.testing.assert_allclose(
            output(loop, context, name), output(built, expected, name), rtol=1e-12, atol=1e-12
        )
    flown, signals = fly.run(context, 0.2)[1], other.run(expected, 0.2)[1]
    for name, values in signals.items():
        np.testing.assert_allclose(flown[name], values, rtol=1e-9, atol=1e-9, err_msg=name)


def test_numbers_are_set_inside_of_a_bigger_diagram_and_with_derivatives():
    builder = DiagramBuilder()
    loop = builder.AddSystem(make_nonstop(load_scenario("quintic", [CONSTANT])))
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    set_parameter(diagram, context, "optimization_layer.frequency", 2.2)
    own = loop.GetMyContextFromRoot(context)
    assert output(loop, own, "parameters")[0] == 2.2
    converted = diagram.ToAutoDiffXd()
    context = converted.CreateDefaultContext()
    set_parameter(diagram, context, "optimization_layer.frequency", AutoDiffXd(2.1, [1.0]))
    groups = map(context.get_numeric_parameter, range(context.num_numeric_parameter_groups()))
    numbers = np.concatenate([group.CopyToVector() for group in groups])
    assert [each.value() for each in numbers if each.derivatives().any()] == [2.1]


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("system.load_mas", 1.0, "did you mean system.load_mass"),
        (7, 1.0, "there is no 7"),
        ("system.load_mass", "heavy", "give finite numbers"),
        ("system.load_mass", np.nan, "finite number"),
        ("system.load_mass", AutoDiffXd(1.1, [1.0]), "finite number"),
        ("system.load_inertia", [[1.0], [1.0, 2.0]], "give 3 x 3 finite numbers"),
    ],
)
def test_what_cannot_be_set_is_said_and_nothing_changes(name, value, said):
    loop = quintic()
    context = loop.CreateDefaultContext()
    with pytest.raises(ScenarioError, match=said):
        set_parameter(loop, context, name, value)
    assert get_parameter(loop, context, "system.load_mass") == 1.0
