"""A compiled loop is a system of Drake's."""

import numpy as np
import pytest
from pydrake.systems.analysis import InitializeParams, Simulator
from pydrake.systems.framework import DiagramBuilder, TriggerType
from pydrake.systems.primitives import LogVectorOutput

from drake_nonstop import CompiledLoop, CompiledSystem, ScenarioError, load_scenario, make_nonstop

DURATION = 0.6
PROGRAM = "optimization_layer=NlpLayer"


def loop_of(*overrides, **options):
    scenario = load_scenario("quintic", overrides)
    diagram = make_nonstop(scenario)
    return CompiledLoop(diagram, scenario.simulator_config, 0.01, compiles=False, **options)


@pytest.mark.parametrize("override", [PROGRAM, "optimization_layer=RecedingHorizonOptimizer"])
def test_a_simulator_runs_it_as_the_loop_flies_also_from_a_copy_of_its_context(override):
    loop = loop_of(override)
    system, builder = CompiledSystem(loop), DiagramBuilder()
    builder.AddNamedSystem("loop", system)
    port = system.GetOutputPort("load_state")
    log = LogVectorOutput(port, builder, {TriggerType.kPerStep}, 0.0)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(DURATION / 2)
    copied = simulator.get_context().Clone()
    simulator.AdvanceTo(DURATION)
    other = Simulator(diagram, copied)
    other.Initialize(InitializeParams(suppress_initialization_events=True))
    other.AdvanceTo(DURATION)
    _, signals = loop.run(loop.diagram.CreateDefaultContext(), DURATION)
    for root in (simulator.get_context(), copied):
        context = system.GetMyContextFromRoot(root)
        for name, values in signals.items():
            if name != "solve_time":  # by a clock
                # At the end the update is still to come.
                np.testing.assert_array_equal(system.GetOutputPort(name).Eval(context), values[-2])
    expected = signals["load_state"][[0, *range(60)]]
    np.testing.assert_array_equal(log.FindLog(simulator.get_context()).data().T, expected)


def test_a_loop_that_shows_signals_between_samples_is_named():
    with pytest.raises(ScenarioError, match=r"^loop.signal_period = 2: give signal_period=None"):
        CompiledSystem(loop_of(signal_period=0.005))
