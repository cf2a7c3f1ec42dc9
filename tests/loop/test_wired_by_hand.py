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

CONSTANT = "optimization_layer=ConstantParameters"
STATES = ("load_state", "carrier_state", "aircraft_state")
PLANT = ("carrier_dynamics", "cables", "load_plant")
CONTROLLER = ("wrench_controller", "force_distribution")
AIRCRAFT = (0.01, "aircraft_transfer")


@functools.cache
def figure(period=0.01, name="line"):
    """A scenario, its loop, and the wires [maker, its port, reader, its port] that this has."""
    scenario = load_scenario(name, [f"control_period={period}", CONSTANT])
    loop = make_nonstop(scenario)
    return (
        scenario,
        loop,
        [
            (maker.get_name(), k, reader.get_name(), i)
            for (reader, i), (maker, k) in loop.connection_map().items()
        ],
    )


def wired(blocks, wires, *, group=(), names=False):
    """A diagram that exports nothing.

    A group of its blocks is one Diagram beside the others, with what they read and make of each
    other as its ports, and all of it is inside of another Diagram.
    """
    builder, inner = DiagramBuilder(), DiagramBuilder()
    for name, block in blocks.items():
        own = inner if name in group else builder
        own.AddNamedSystem(name, block) if names else own.AddSystem(block)
    ports = [
        (blocks[maker].get_output_port(k), blocks[reader].get_input_port(i), maker, reader)
        for maker, k, reader, i in wires
    ]
    read = {}
    for source, target, maker, reader in ports:
        if maker in group and reader in group:
            inner.Connect(source, target)
        elif reader in group and source.get_name() in read:
            inner.ConnectInput(source.get_name(), target)
        elif reader in group:
            read[source.get_name()] = inner.ExportInput(target, source.get_name())
    for name in group:
        for k in range(blocks[name].num_output_ports()):
            port = blocks[name].get_output_port(k)
            inner.ExportOutput(port, port.get_name())
    if group:
        part = (
            builder.AddNamedSystem("part", inner.Build())
            if names
            else (builder.AddSystem(inner.Build()))
        )
    for source, target, maker, reader in ports:
        if reader not in group:
            port = part.GetOutputPort(source.get_name()) if maker in group else source
            builder.Connect(port, target)
    for name, source in {s.get_name(): s for s, _, _, reader in ports if reader in group}.items():
        if name in read:
            builder.Connect(source, part.GetInputPort(name))
    if not group:
        return builder.Build()
    outer = DiagramBuilder()
    outer.AddNamedSystem("inner", builder.Build()) if names else outer.AddSystem(builder.Build())
    return outer.Build()


def by_hand(*arguments, group=(), names=False):
    scenario, _, wires = figure(*arguments)
    blocks = make_blocks(scenario)
    return wired(blocks, wires, group=group, names=names), blocks


def shown(diagram, context):
    """Load and carriers, wherever in the diagram they are made."""
    found = {}
    for part in diagram.GetSystems():
        own = diagram.GetSubsystemContext(part, context)
        if hasattr(part, "GetSystems"):
            found |= shown(part, own)
        found |= {name: output(part, own, name) for name in STATES if part.HasOutputPort(name)}
    return found


BOTH = pytest.mark.parametrize("group", [(), PLANT])
NAMED = pytest.mark.parametrize("names", [False, True])


@BOTH
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("names", "arguments"),
    [(False, (0.0,)), (True, (0.0,)), (False, (0.01,)), (True, (0.01,)), (False, AIRCRAFT)],
)
def test_a_loop_that_exports_nothing_starts_as_the_figure(names, arguments, group):
    """By `set_equilibrium`, and by default after `set_default_equilibrium`; aircraft trimmed."""
    diagram, _ = by_hand(*arguments, group=group, names=names)
    assert diagram.num_output_ports() == 0
    loop = figure(*arguments)[1]
    of_figure = loop.CreateDefaultContext()
    expected = {n: output(loop, of_figure, n) for n in STATES if loop.HasOutputPort(n)}
    context = diagram.CreateDefaultContext()
    set_equilibrium(diagram, context)
    set_default_equilibrium(diagram)
    for start in (context, diagram.CreateDefaultContext()):
        values = shown(diagram, start)
        assert values.keys() == expected.keys()
        for name, value in expected.items():
            np.testing.assert_array_equal(values[name], value)


@BOTH
def test_two_makers_of_a_signal_are_named(group):
    builder = DiagramBuilder()
    builder.AddNamedSystem("mine", by_hand(group=group, names=True)[0])
    builder.AddNamedSystem("camera", Ports({}, {"load_state": 13}))
    diagram = builder.Build()
    plant = "mine.inner.part" if group else "mine.load_plant"
    said = f"^set_equilibrium = Diagram where {plant} and camera make load_state: export the loop's"
    with pytest.raises(ScenarioError, match=said):
        set_equilibrium(diagram, diagram.CreateDefaultContext())
    with pytest.raises(ScenarioError, match=said):
        set_default_equilibrium(diagram)


@NAMED
@pytest.mark.parametrize("group", [(), PLANT, CONTROLLER])
@pytest.mark.parametrize("name", ["cables", "wrench_controller"])
def test_a_parameter_that_is_no_number_is_blamed_on_its_block(name, group, names):
    diagram, blocks = by_hand(group=group, names=names)
    context = diagram.CreateDefaultContext()
    block = blocks[name]
    own = block.GetMyMutableContextFromRoot(context).get_mutable_numeric_parameter(0)
    own.SetFromVector(np.full(own.size(), np.nan))
    path = ["inner"] * bool(group) + ["part"] * (name in group) + [name]
    called = ".".join(path) if names else type(block).__name__
    with pytest.raises(ScenarioError) as error:
        set_equilibrium(diagram, context)
    assert str(error.value).startswith(f"start = {called}: it makes a value that is not finite")
