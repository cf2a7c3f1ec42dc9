"""Loops from constructors and `Connect`: they start as `make_nonstop`'s, and say what is wrong."""

import functools

import numpy as np
import pytest
from helpers import Ports, output
from pydrake.systems.framework import DiagramBuilder

from drake_nonstop import (
    ScenarioError,
    load_scenario,
    make_blocks,
    make_nonstop,
    set_default_equilibrium,
    set_equilibrium,
)

STATES = ("load_state", "carrier_state", "aircraft_state")
FLAT, NESTED = 0, 2  # Diagrams around the blocks
LINE, CONTINUOUS, AIRCRAFT = ("line", 0.01), ("line", 0.0), ("aircraft_transfer", 0.01)


@functools.cache
def figure(name, period):
    """A scenario, and its loop."""
    layer = "optimization_layer=ConstantParameters"
    scenario = load_scenario(name, [f"control_period={period}", layer])
    return scenario, make_nonstop(scenario)


def by_hand(loop=LINE, *, around=FLAT, names=False):
    """A diagram that exports nothing, with the wires that the figure has, and its blocks."""
    scenario, of_figure = figure(*loop)
    blocks, builder = make_blocks(scenario), DiagramBuilder()
    for name, block in blocks.items():
        builder.AddNamedSystem(name, block) if names else builder.AddSystem(block)
    for (reader, i), (maker, k) in of_figure.connection_map().items():
        source, target = blocks[maker.get_name()], blocks[reader.get_name()]
        builder.Connect(source.get_output_port(k), target.get_input_port(i))
    for _ in range(around):
        inner, builder = builder.Build(), DiagramBuilder()
        builder.AddNamedSystem("inner", inner) if names else builder.AddSystem(inner)
    return builder.Build(), blocks


def shown(diagram, context):
    """Load and carriers, wherever in the diagram they are made."""
    found = {}
    for part in diagram.GetSystems():
        own = diagram.GetSubsystemContext(part, context)
        if hasattr(part, "GetSystems"):
            found |= shown(part, own)
        found |= {name: output(part, own, name) for name in STATES if part.HasOutputPort(name)}
    return found


AROUND = pytest.mark.parametrize("around", [FLAT, NESTED])
NAMED = pytest.mark.parametrize("names", [False, True])


@AROUND
@NAMED
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("loop", [LINE, CONTINUOUS, AIRCRAFT])
def test_a_loop_that_exports_nothing_starts_as_the_figure(loop, names, around):
    """By `set_equilibrium`, and by default after `set_default_equilibrium`; aircraft trimmed."""
    diagram, _ = by_hand(loop, around=around, names=names)
    assert diagram.num_output_ports() == 0
    of_figure = figure(*loop)[1]
    expected = shown(of_figure, of_figure.CreateDefaultContext())
    context = diagram.CreateDefaultContext()
    set_equilibrium(diagram, context)
    set_default_equilibrium(diagram)
    for start in (context, diagram.CreateDefaultContext()):
        values = shown(diagram, start)
        assert values.keys() == expected.keys()
        for name, value in expected.items():
            np.testing.assert_array_equal(values[name], value)


@AROUND
def test_two_makers_of_a_signal_are_named(around):
    builder = DiagramBuilder()
    builder.AddNamedSystem("mine", by_hand(around=around, names=True)[0])
    builder.AddNamedSystem("camera", Ports({}, {"load_state": 13}))
    diagram = builder.Build()
    plant = ".".join(["mine", *(["inner"] * around), "load_plant"])
    said = f"^set_equilibrium = Diagram where {plant} and camera make load_state: export the loop's"
    with pytest.raises(ScenarioError, match=said):
        set_equilibrium(diagram, diagram.CreateDefaultContext())
    with pytest.raises(ScenarioError, match=said):
        set_default_equilibrium(diagram)


@NAMED
@AROUND
@pytest.mark.parametrize("name", ["cables", "wrench_controller"])
def test_a_parameter_that_is_no_number_is_blamed_on_its_block(name, around, names):
    diagram, blocks = by_hand(around=around, names=names)
    context = diagram.CreateDefaultContext()
    own = blocks[name].GetMyMutableContextFromRoot(context).get_mutable_numeric_parameter(0)
    own.SetFromVector(np.full(own.size(), np.nan))
    called = ".".join([*["inner"] * around, name]) if names else type(blocks[name]).__name__
    with pytest.raises(ScenarioError) as error:
        set_equilibrium(diagram, context)
    assert str(error.value).startswith(f"start = {called}: it makes a value that is not finite")
