"""The hold that is added to a builder is that of the figure, with the figure's wires."""

import numpy as np
import pytest
from helpers import output, vector_outputs
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder

from drake_nonstop import (
    Model,
    add_sample_and_hold,
    connect_remaining,
    load_scenario,
    make_blocks,
    make_nonstop,
    set_default_equilibrium,
)

# Overrides, and whether the wind that the controllers believe in may change, and is held.
SCENARIOS = {
    "still air": ([], False),
    "gusts": (["wind=GustyWind"], True),
    "steady wind": (["wind=SteadyWind"], False),
    "wind by a sampled observer": (["wind=GustyWind", "wind_estimator=WindObserver"], False),
    "feedback of the reference": (["load_feedback=DesiredStateFeedback"], False),
    "paper": (["wrench_controller=PaperWrenchController"], False),
}


def wires(diagram, called):
    """The wires of a diagram, by names of blocks."""
    return {
        f"{called[source.get_name()]}.{source.get_output_port(k).get_name()} -> "
        f"{called[reader.get_name()]}.{reader.get_input_port(i).get_name()}"
        for (reader, i), (source, k) in diagram.connection_map().items()
    }


@pytest.mark.parametrize("names", [False, True])
@pytest.mark.parametrize(("overrides", "holds_wind"), SCENARIOS.values(), ids=SCENARIOS)
def test_a_loop_with_an_added_hold_has_the_figures_wires_and_flies_as_it(
    overrides, holds_wind, names
):
    layer = "optimization_layer=ConstantParameters"
    scenario = load_scenario("line", ["control_period=0.01", layer, *overrides])
    blocks, builder = make_blocks(scenario), DiagramBuilder()
    of_figure = blocks.pop("sample_and_hold")
    for name, block in blocks.items():
        builder.AddNamedSystem(name, block) if names else builder.AddSystem(block)
    called = {block.get_name(): name for name, block in blocks.items()}
    system = Model(scenario.system, scenario.pattern, scenario.control_period)
    hold = add_sample_and_hold(builder, system)
    assert hold.get_name() == "sample_and_hold"
    assert hold.HasInputPort("wind_estimate") is holds_wind
    own, other = hold.CreateDefaultContext(), of_figure.CreateDefaultContext()
    for name in vector_outputs(hold):
        np.testing.assert_array_equal(output(hold, own, name), output(of_figure, other, name))
    connect_remaining(builder)
    diagram, figure = builder.Build(), make_nonstop(scenario)
    of_the_figure = {block.get_name(): block.get_name() for block in figure.GetSystems()}
    expected = wires(figure, of_the_figure)
    assert wires(diagram, called | {"sample_and_hold": "sample_and_hold"}) == expected
    if "wind_estimator=WindObserver" in overrides:  # by its wires alone
        return
    set_default_equilibrium(diagram)
    values = []
    for flown in (diagram, figure):
        simulator = Simulator(flown)
        ApplySimulatorConfig(scenario.simulator_config, simulator)
        simulator.AdvanceTo(0.053)
        values.append(output(flown, simulator.get_context(), "load_state"))
    np.testing.assert_array_equal(*values)
