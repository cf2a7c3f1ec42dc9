"""A compiled loop is a system of Drake's."""

import numpy as np
import pytest
from pydrake.systems.analysis import InitializeParams, Simulator
from pydrake.systems.framework import DiagramBuilder, TriggerType
from pydrake.systems.primitives import LogVectorOutput

from drake_nonstop import ScenarioError, load_scenario, make_nonstop
from drake_nonstop.systems.compiled_loop import CompiledLoop
from drake_nonstop.systems.compiled_system import CompiledSystem

DURATION = 0.6
PROGRAM = "optimization_layer=NlpLayer"


def loop_of(*overrides, **options):
    scenario = load_scenario("quintic", overrides)
    diagram = make_nonstop(scenario)
    return CompiledLoop(diagram, scenario.simulator_config, 0.01, compiles=False, **options)


def logged(system, name):
    """A Simulator of the system with a log of one of its signals after every step."""
    builder = DiagramBuilder()
    builder.AddNamedSystem("loop", system)
    log = LogVectorOutput(system.GetOutputPort(name), builder, {TriggerType.kPerStep}, 0.0)
    return Simulator(builder.Build()), log


@pytest.mark.parametrize("override", [PROGRAM, "optimization_layer=RecedingHorizonOptimizer"])
def test_a_simulator_runs_it_as_the_loop_flies(override):
    loop = loop_of(override)
    system = CompiledSystem(loop)
    simulator, log = logged(system, "load_state")
    simulator.AdvanceTo(DURATION)
    _, signals = loop.run(loop.diagram.CreateDefaultContext(), DURATION)
    context = system.GetMyContextFromRoot(simulator.get_context())
    for name, values in signals.items():
        if name != "solve_time":
            # At the end the update is still to come.
            np.testing.assert_array_equal(system.GetOutputPort(name).Eval(context), values[-2])
    shown = log.FindLog(simulator.get_context()).data().T
    assert len(shown) == 61
    np.testing.assert_array_equal(shown[0], signals["load_state"][0])
    np.testing.assert_array_equal(shown[1:], signals["load_state"][:60])


def test_a_copy_of_a_context_goes_on_from_there():
    system = CompiledSystem(loop_of(PROGRAM))
    simulator = Simulator(system)
    simulator.AdvanceTo(0.3)
    copied = simulator.get_context().Clone()
    simulator.AdvanceTo(DURATION)
    expected = system.GetOutputPort("carrier_state").Eval(simulator.get_context()).copy()
    other = Simulator(system, copied)
    other.Initialize(InitializeParams(suppress_initialization_events=True))
    other.AdvanceTo(DURATION)
    np.testing.assert_array_equal(system.GetOutputPort("carrier_state").Eval(copied), expected)


def test_a_loop_that_shows_signals_between_samples_is_named():
    with pytest.raises(ScenarioError, match=r"^loop.signal_period = 2: give signal_period=None"):
        CompiledSystem(loop_of(signal_period=0.005))
