"""The longest stable step of a loop, alone and inside of a bigger diagram."""

import numpy as np
import pytest
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import FirstOrderTaylorApproximation, LinearSystem

from drake_nonstop import (
    ScenarioError,
    largest_step,
    load_scenario,
    make_nonstop,
    with_largest_step,
)

CONSTANT = "optimization_layer=ConstantParameters"
STIFF = "system.load_inertia=[[0.0015,0,0],[0,0.0015,0],[0,0,0.0015]]"


def loop_with(*overrides):
    scenario = load_scenario("quintic", [CONSTANT, *overrides])
    loop = make_nonstop(scenario)
    return scenario.simulator_config, loop, loop.CreateDefaultContext()


def test_it_follows_from_the_fastest_mode_of_drakes_linearization():
    """Which has all states, in automatic differentiation."""
    _, loop, context = loop_with("control_period=0")
    matrix = FirstOrderTaylorApproximation(loop, context).A()
    assert matrix.shape == (57, 57)
    fastest = np.max(np.abs(np.linalg.eigvals(matrix)))
    assert largest_step(loop, context) == pytest.approx(1.6 / fastest, rel=1e-4)


def test_states_around_the_loop_count_too():
    _, loop, context = loop_with()
    alone = largest_step(loop, context)
    for rate, expected in ((-10.0, alone), (-1e4, 1.6e-4)):
        builder = DiagramBuilder()
        builder.AddSystem(loop.Clone())
        beside = LinearSystem([[rate]], np.zeros((1, 0)), np.zeros((0, 1)), np.zeros((0, 0)))
        builder.AddSystem(beside)
        diagram = builder.Build()
        root = diagram.CreateDefaultContext()
        before = root.get_continuous_state_vector().CopyToVector()
        assert largest_step(diagram, root) == pytest.approx(expected, rel=1e-6)
        np.testing.assert_array_equal(root.get_continuous_state_vector().CopyToVector(), before)


def test_a_shorter_step_is_a_whole_part_of_the_signals_period_and_flies():
    config, loop, context = loop_with(STIFF)
    with pytest.warns(UserWarning, match="for the sake of the fastest mode"):
        taken = with_largest_step(config, loop, context)
    assert config.max_step_size == 0.005
    longest = largest_step(loop, context)
    assert longest / 2 < taken.max_step_size <= longest < 0.005
    assert 0.01 / taken.max_step_size == pytest.approx(round(0.01 / taken.max_step_size))
    simulator = Simulator(loop, context)
    ApplySimulatorConfig(taken, simulator)
    simulator.AdvanceTo(0.5)
    load, reference = (
        loop.GetOutputPort(each).Eval(simulator.get_context())
        for each in ("load_state", "reference")
    )
    np.testing.assert_allclose(load[4:7], reference[4:7], atol=0.01)


def test_a_block_that_makes_no_number_is_named():
    _, loop, context = loop_with()
    plant = loop.GetSubsystemByName("load_plant")
    state = np.zeros(13)  # its quaternion is none
    loop.GetMutableSubsystemContext(plant, context).SetContinuousState(state)
    with pytest.raises(ScenarioError, match=r"start = .*not finite"):
        largest_step(loop, context)
