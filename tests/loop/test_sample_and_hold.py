"""The hold that is added to a builder is that of the figure, with the figure's wires."""

import numpy as np
import pytest
from helpers import Ports, model, output
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
from drake_nonstop.systems.wiring import input_names, output_names, wires

PERIOD = 0.01  # s
SCENARIOS = {
    "still air": [],
    "gusts": ["wind=GustyWind"],
    "steady wind": ["wind=SteadyWind"],
    "feedback of the reference": ["load_feedback=DesiredStateFeedback"],
    "paper": ["wrench_controller=PaperWrenchController"],
}


def scenario(overrides=()):
    layer = "optimization_layer=ConstantParameters"
    return load_scenario("line", [f"control_period={PERIOD}", layer, *overrides])


def of_controllers(made):
    return Model(made.system, made.pattern, made.control_period)


def unsampled(made):
    """The blocks of a scenario but for the hold, and a builder that has them."""
    blocks, builder = make_blocks(made), DiagramBuilder()
    hold = blocks.pop("sample_and_hold")
    return blocks, hold, builder


@pytest.mark.parametrize("names", [False, True])
@pytest.mark.parametrize("overrides", SCENARIOS.values(), ids=SCENARIOS)
def test_wires_of_the_hold_and_of_what_remains_are_the_figures(overrides, names):
    made = scenario(overrides)
    blocks, of_figure, builder = unsampled(made)
    expected = ["{}.{} -> {}.{}".format(*w) for w in wires(blocks | {"sample_and_hold": of_figure})]
    for name, block in blocks.items():
        builder.AddNamedSystem(name, block) if names else builder.AddSystem(block)
    called = {block.get_name(): name for name, block in blocks.items()}
    hold = add_sample_and_hold(builder, of_controllers(made))
    assert hold.get_name() == "sample_and_hold"
    assert input_names(hold) == input_names(of_figure)
    first = {wire for wire in expected if "sample_and_hold" in wire}
    assert found(builder, called) == first
    connect_remaining(builder)
    assert found(builder, called) == {*expected}
    own, other = hold.CreateDefaultContext(), of_figure.CreateDefaultContext()
    for name in output_names(hold):
        np.testing.assert_array_equal(output(hold, own, name), output(of_figure, other, name))


def found(builder, called):
    """The wires of a builder, by the names of the figure."""
    called = called | {"sample_and_hold": "sample_and_hold"}
    return {
        f"{called[source.get_name()]}.{source.get_output_port(k).get_name()} -> "
        f"{called[reader.get_name()]}.{reader.get_input_port(i).get_name()}"
        for (reader, i), (source, k) in builder.connection_map().items()
    }


def test_a_loop_wired_by_hand_flies_as_the_figure():
    made = scenario(["wind=GustyWind"])
    blocks, _, builder = unsampled(made)
    for block in blocks.values():
        builder.AddSystem(block)
    add_sample_and_hold(builder, of_controllers(made))
    connect_remaining(builder)
    builder.ExportOutput(blocks["load_plant"].GetOutputPort("load_state"), "load_state")
    values = []
    diagram = builder.Build()
    set_default_equilibrium(diagram)
    for flown in (diagram, make_nonstop(made)):
        simulator = Simulator(flown)
        ApplySimulatorConfig(made.simulator_config, simulator)
        simulator.AdvanceTo(0.053)
        values.append(output(flown, simulator.get_context(), "load_state"))
    np.testing.assert_array_equal(*values)


def controllers():
    """A trajectory, feedback and two controllers, of which one reads the time of the sample."""
    return {
        "trajectory": Ports({}, {"reference": 22}),
        "feedback": Ports({"reference": 22}, {"measured_load_state": 13}),
        "controller": Ports({"measured_load_state": 13, "reference": 22}, {"wrench": 6}),
        "layer": Ports({"reference": 22, "sample_time": 1}, {"parameters": 2}),
    }


def added(blocks):
    builder = DiagramBuilder()
    for name, block in blocks.items():
        builder.AddNamedSystem(name, block)
    return builder


def test_the_wind_is_held_where_it_may_change():
    for ports, is_sampled, is_held in (
        (None, False, False),
        (({"wind_estimate": 3}, {}), False, True),
        (({}, {"wind_estimate": 3}), False, True),
        (({}, {"wind_estimate": 3}), True, False),
    ):
        blocks = controllers()
        if ports:
            blocks["other"] = Ports(*ports)
            blocks["other"].is_sampled = is_sampled
        hold = add_sample_and_hold(added(blocks), model(4, PERIOD))
        assert hold.HasInputPort("wind_estimate") is is_held
