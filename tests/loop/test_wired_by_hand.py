"""Loops from constructors and `Connect`: they start as `make_nonstop`'s, and say what is wrong."""

import functools

import numpy as np
import pytest
from helpers import Ports, output
from pydrake.systems.framework import DiagramBuilder

from drake_nonstop import (
    load_scenario,
    make_blocks,
    make_nonstop,
    set_default_equilibrium,
    set_equilibrium,
)
from drake_nonstop.systems.wiring import input_names, output_names, wires
from drake_nonstop.validation import ScenarioError

CONSTANT = "optimization_layer=ConstantParameters"
STATES = ("load_state", "carrier_state", "aircraft_state")
PLANT = ("carrier_dynamics", "cables", "load_plant")
CONTROLLER = ("wrench_controller", "force_distribution")
AIRCRAFT = (0.01, "aircraft_transfer")


@functools.cache
def scenario(period=0.01, name="line", overrides=()):
    return load_scenario(name, [f"control_period={period}", CONSTANT, *overrides])


@functools.cache
def expected(*arguments):
    """The signals of the loop of `make_nonstop` in its default context."""
    loop = make_nonstop(scenario(*arguments))
    context = loop.CreateDefaultContext()
    return {name: output(loop, context, name) for name in STATES if loop.HasOutputPort(name)}


def connect(builder, blocks):
    """Wires blocks of a builder, which may have no names, by Drake's own calls."""
    for source, signal, reader, port in wires(blocks):
        ports = blocks[source].GetOutputPort(signal), blocks[reader].GetInputPort(port)
        builder.Connect(*ports)


def wired(blocks, *, names=False):
    """A diagram that exports nothing."""
    builder = DiagramBuilder()
    for name, block in blocks.items():
        builder.AddNamedSystem(name, block) if names else builder.AddSystem(block)
    connect(builder, blocks)
    return builder.Build()


def grouped(blocks, *, names=False, left_open=()):
    """Some of the blocks as one: inputs that the others make, and the signals that they read."""
    builder = DiagramBuilder()
    for name, block in blocks.items():
        builder.AddNamedSystem(name, block) if names else builder.AddSystem(block)
    makers = {port: block for block in blocks.values() for port in output_names(block)}
    open_inputs = {}
    for block in blocks.values():
        for port in (port for port in input_names(block) if port not in left_open):
            reader = block.GetInputPort(port)
            if port in makers:
                builder.Connect(makers[port].GetOutputPort(port), reader)
            elif port in open_inputs:
                builder.ConnectInput(port, reader)
            else:
                open_inputs[port] = builder.ExportInput(reader, port)
    for port, block in makers.items():
        builder.ExportOutput(block.GetOutputPort(port), port)
    return builder.Build()


def nested(blocks, *, group=PLANT, **options):
    """Some of the blocks as one Diagram beside the others, and all of it inside of another one."""
    part = grouped({name: blocks[name] for name in group}, **options)
    others = {name: block for name, block in blocks.items() if name not in group}
    builder = DiagramBuilder()
    loop = wired(others | {"part": part}, **options)
    builder.AddNamedSystem("inner", loop) if options.get("names") else builder.AddSystem(loop)
    return builder.Build()


def shown(diagram, context):
    """Load and carriers, wherever in the diagram they are made."""
    found = {}
    for part in diagram.GetSystems():
        own = diagram.GetSubsystemContext(part, context)
        if hasattr(part, "GetSystems"):
            found |= shown(part, own)
        found |= {name: output(part, own, name) for name in STATES if part.HasOutputPort(name)}
    return found


BOTH = pytest.mark.parametrize("make", [wired, nested])
NAMED = pytest.mark.parametrize("names", [False, True])


def assert_starts_as_the_figure(diagram, *arguments):
    """By `set_equilibrium`, and by default after `set_default_equilibrium`."""
    context = diagram.CreateDefaultContext()
    set_equilibrium(diagram, context)
    set_default_equilibrium(diagram)
    for start in (context, diagram.CreateDefaultContext()):
        values = shown(diagram, start)
        assert values.keys() == expected(*arguments).keys()
        for name, value in expected(*arguments).items():
            np.testing.assert_array_equal(values[name], value)


@BOTH
@NAMED
@pytest.mark.parametrize("period", [0.0, 0.01])
def test_a_loop_that_exports_nothing_starts_as_the_figure(make, names, period):
    diagram = make(make_blocks(scenario(period)), names=names)
    assert diagram.num_output_ports() == 0
    assert_starts_as_the_figure(diagram, period)


@BOTH
@pytest.mark.filterwarnings("error")
def test_aircraft_are_trimmed_wherever_they_are(make):
    assert_starts_as_the_figure(make(make_blocks(scenario(*AIRCRAFT))), *AIRCRAFT)


@BOTH
def test_two_makers_of_a_signal_are_named(make):
    builder = DiagramBuilder()
    builder.AddNamedSystem("mine", make(make_blocks(scenario()), names=True))
    builder.AddNamedSystem("camera", Ports({}, {"load_state": 13}))
    diagram = builder.Build()
    plant = "mine.load_plant" if make is wired else "mine.inner.part"
    with pytest.raises(ScenarioError) as error:
        set_equilibrium(diagram, diagram.CreateDefaultContext())
    assert str(error.value) == (
        f"set_equilibrium = Diagram where {plant} and camera make load_state: export the loop's by "
        "this name, rename the port of the other, or give the diagram with one of them"
    )
    with pytest.raises(ScenarioError, match=f"^set_equilibrium = Diagram where {plant} and camera"):
        set_default_equilibrium(diagram)


@NAMED
@pytest.mark.parametrize("group", [None, PLANT, CONTROLLER])
@pytest.mark.parametrize("name", ["cables", "wrench_controller"])
def test_a_parameter_that_is_no_number_is_blamed_on_its_block(name, group, names):
    blocks = make_blocks(scenario())
    make = functools.partial(nested, group=group) if group else wired
    diagram = make(blocks, names=names)
    context = diagram.CreateDefaultContext()
    block = blocks[name]
    own = block.GetMyMutableContextFromRoot(context).get_mutable_numeric_parameter(0)
    own.SetFromVector(np.full(own.size(), np.nan))
    path = ["inner"] * bool(group) + ["part"] * (name in (group or ())) + [name]
    called = ".".join(path) if names else type(block).__name__
    with pytest.raises(ScenarioError) as error:
        set_equilibrium(diagram, context)
    assert str(error.value).startswith(f"start = {called}: it makes a value that is not finite")
