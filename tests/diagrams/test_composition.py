"""Loops put together in other ways: the same signals, to the bit, or one sentence."""

import functools

import numpy as np
import pytest
from helpers import connections, model, nightly_beyond, sizes_of_ports, vector_outputs, with_ports
from pydrake.common.value import Value
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Multiplexer

from drake_nonstop import (
    CompiledLoop,
    ConstantParametersConfig,
    LeafBlock,
    LogSignals,
    ReferencePreview,
    Run,
    ScenarioError,
    connect_by_name,
    get_parameter,
    load_scenario,
    make_blocks,
    make_nonstop,
    set_equilibrium,
    set_parameter,
)
from drake_nonstop.blocks.phase import PaperPhase

DURATION = 0.05  # s
HELD_MAKERS = {"load_trajectory", "load_feedback"}
ENDS = ["FirstOrder", "name with spaces", "Ω", "x"]


def scenario(period):
    overrides = ["optimization_layer=ConstantParameters", f"control_period={period}"]
    return load_scenario("line", overrides)


def flown(diagram, start, period):
    """All signals of the diagram at a few instants of a flight from that context."""
    simulator = Simulator(diagram, start)
    ApplySimulatorConfig(scenario(period).simulator_config, simulator)
    simulator.Initialize()
    values = {}
    for instant in (0.0, 0.013, DURATION):
        simulator.AdvanceTo(instant)
        for name in vector_outputs(diagram):
            values[name, instant] = diagram.GetOutputPort(name).Eval(start).tobytes()
    return values


@functools.cache
def reference(period):
    """The start of the loop of `make_nonstop`, contexts of its blocks there, and its flight."""
    nonstop = make_nonstop(scenario(period))
    start = nonstop.CreateDefaultContext()
    own = {block.get_name(): block.GetMyContextFromRoot(start) for block in nonstop.GetSystems()}
    return start, own, flown(nonstop, start.Clone(), period)


def assert_flies_like_the_figure(diagram, blocks, period):
    """From the same states of the blocks the signals are the same to the bit."""
    _, own, expected = reference(period)
    context = diagram.CreateDefaultContext()
    for name, block in blocks.items():
        state = block.GetMyMutableContextFromRoot(context)
        state.SetContinuousState(own[name].get_continuous_state_vector().CopyToVector())
        for i in range(state.num_discrete_state_groups()):
            state.SetDiscreteState(i, own[name].get_discrete_state(i).CopyToVector())
    values = flown(diagram, context, period)
    assert values.keys() == expected.keys()
    assert [key for key in expected if values[key] != expected[key]] == []


def one_block(parts):
    """The blocks as one: their inputs from elsewhere, and all their signals."""
    builder = DiagramBuilder()
    made = {name for block in parts.values() for name in sizes_of_ports(block)}
    read = {name for block in parts.values() for name in sizes_of_ports(block, "input")}
    connect_by_name(builder, parts, inputs=sorted(read - made))
    return builder.Build()


@pytest.mark.parametrize("period", [0.0, 0.01])
@pytest.mark.parametrize("seed", nightly_beyond(1, "studies", range(4)))
def test_blocks_renamed_reordered_and_merged_make_the_same_signals(seed, period):
    random = np.random.default_rng(seed)
    blocks = make_blocks(scenario(period))
    groups = []
    for name in random.permutation([*blocks]):
        # A controller beside the trajectory in one block would read from it past the hold.
        is_free = period == 0 or name not in HELD_MAKERS
        others = [g for g in groups if is_free and (period == 0 or not HELD_MAKERS & set(g))]
        if others and random.random() < 0.5:
            others[random.integers(len(others))].append(name)
        else:
            groups.append([name])
    wired = {}
    for i, group in enumerate(groups):
        parts = {name: blocks[name] for name in group}
        block = one_block(parts) if len(parts) > 1 else blocks[group[0]]
        wired[f"{random.choice(ENDS)} {i}"] = block
    builder = DiagramBuilder()
    connect_by_name(builder, wired)
    assert_flies_like_the_figure(builder.Build(), blocks, period)


def test_extra_blocks_read_and_make_signals_of_any_name():
    anemometer = with_ports({"load_state": 13, "sky": 2}, {"wind_speed": 3})
    display = with_ports({"wind_speed": 3, "reference": 22, "sky": 2}, {})
    extra = {"anemometer": anemometer, "display": display}
    nonstop = make_nonstop(scenario(0.01), extra=extra, inputs=["sky"])
    assert {*connections(nonstop)} >= {
        "load_plant.load_state -> anemometer.load_state",
        "anemometer.wind_speed -> display.wind_speed",
        "sample_and_hold.held_reference -> display.reference",
    }
    assert nonstop.GetOutputPort("wind_speed").size() == 3
    assert sizes_of_ports(nonstop, "input") == {"sky": 2}


class Ahead(LeafBlock):
    """Makes the reference that comes in 2 s, where there is a preview."""

    optional_inputs = ("reference_preview",)

    def __init__(self, model):
        super().__init__()
        self._preview = self.DeclareAbstractInputPort("reference_preview", Value[object]())
        self.DeclareVectorOutputPort("ahead", 22, self._calc)

    def _calc(self, context, output):
        output.SetFromVector(self._preview.Eval(context)(context.get_time() + 2.0))


@pytest.mark.parametrize("period", [0.0, 0.01])
def test_a_block_reads_a_preview_from_the_trajectory_and_not_held(period):
    loop = make_nonstop(scenario(period), extra={"foresight": Ahead})
    wires = connections(loop)
    assert "load_trajectory.reference_preview -> foresight.reference_preview" in wires
    assert not any("held_reference_preview" in wire for wire in wires)
    simulator, later = Simulator(loop), loop.CreateDefaultContext()
    simulator.AdvanceTo(0.5)
    later.SetTime(2.5)
    ahead = loop.GetOutputPort("ahead").Eval(simulator.get_context())
    np.testing.assert_array_equal(ahead, loop.GetOutputPort("reference").Eval(later))


class AtRest(LeafSystem):
    """A load at rest, without a preview."""

    def __init__(self, model):
        super().__init__()
        rest = np.eye(22)[0]
        self.DeclareVectorOutputPort("reference", 22, lambda c, output: output.SetFromVector(rest))


def test_a_preview_can_come_from_outside():
    others = {"extra": {"foresight": Ahead}, "inputs": ["reference_preview"]}
    loop = make_nonstop(scenario(0.01), load_trajectory=AtRest, at_equilibrium=False, **others)
    assert sizes_of_ports(loop, "input") == {"reference_preview": None}
    context = loop.CreateDefaultContext()
    preview = ReferencePreview(lambda time: time + np.arange(22))
    loop.GetInputPort("reference_preview").FixValue(context, preview)
    np.testing.assert_array_equal(loop.GetOutputPort("ahead").Eval(context), preview(2.0))


LOST = with_ports({"wind_speed": 3}, {})
NOT_SO = "it cannot be called so"
LAYER, REPLACED = "optimization_layer", "replacement phase = "
FITS = [
    ({"extra": {"phase": PaperPhase}}, "extra = phase", "a block of that name"),
    ({"extra": {"a.b": PaperPhase}}, "blocks = a.b", "a text without colons and dots"),
    ({"extra": [PaperPhase]}, "extra = ", "a mapping from names to blocks"),
    ({"extra": {"mine": 3.0}}, "extra mine = 3.0", "give a block's config, or a function"),
    ({"extra": {"mine": lambda model, other: None}}, "extra mine = <lambda>", NOT_SO),
    ({"extra": {"mine": lambda model: None}}, "extra mine = None", "return a LeafSystem or"),
    ({"phase": Multiplexer}, REPLACED + "Multiplexer", NOT_SO),
    ({"phase": "PaperPhase"}, REPLACED + "PaperPhase", "give"),
    ({"phase": ConstantParametersConfig()}, "phase = ConstantParameters", "one of ShapedPhase"),
    ({"plant": PaperPhase}, "replacement = plant", "give one of load_trajectory"),
    ({"extra": {"mine": LOST}}, "mine = Ports with input wind_speed (3)", "inputs=['wind_speed']"),
    ({"extra": {"mine": PaperPhase}}, "mine.phase = output: phase", "rename one of the two"),
    (
        {"load_feedback": None, "extra": {"mine": with_ports({}, {"measured_load_state": 7})}},
        "WrenchController with input measured_load_state (13): mine",
        "rename or resize one of the ports",
    ),
    (
        {LAYER: with_ports({}, {"parameter": 2})},
        "phase = ShapedPhase: it reads parameters",
        "give optimization_layer=RecedingHorizonOptimizer, or another block for phase",
    ),
    ({LAYER: with_ports({}, {"parameters": None})}, "with input parameters (2)", "resize"),
    ({"inputs": ["wind_speed"]}, "inputs = wind_speed", "a list of signals that blocks read"),
    ({"inputs": "reference"}, "inputs = reference", "a list of signals that blocks read"),
    ({"inputs": ["reference"]}, "load_trajectory.reference = output: inputs", "rename one"),
]


@pytest.mark.parametrize(("arguments", "told", "remedy"), FITS)
def test_what_does_not_fit_is_named_with_the_remedy(arguments, told, remedy):
    with pytest.raises(ScenarioError) as error:
        make_nonstop(scenario(0.0), **arguments)
    assert told in str(error.value)
    assert remedy in str(error.value).partition(told)[2]
    assert "\n" not in str(error.value)


def test_a_context_of_another_loop_is_refused_in_a_sentence():
    made = scenario(0.01)
    nonstop, outer, logged = make_nonstop(made), DiagramBuilder(), DiagramBuilder()
    outer.AddSystem(make_nonstop(made))
    loop = CompiledLoop(nonstop, made.simulator_config, made.control_period)
    logs = LogSignals.AddToBuilder(logged, logged.AddSystem(make_nonstop(made)))
    logged.Build()
    takers = [
        lambda context: set_equilibrium(nonstop, context),
        lambda context: get_parameter(nonstop, context, "system.load_mass"),
        lambda context: set_parameter(nonstop, context, "system.load_mass", 1.1),
        *(loop.state_of, loop.fly),
        lambda context: loop.run(context, 0.02),
        lambda context: loop.sensitivities(context, 0.02),
        lambda context: Run.from_logs(logs, context, made),
    ]
    others = [make_nonstop(made), outer.Build(), PaperPhase(model())]
    for context in (*(other.CreateDefaultContext() for other in others), None):
        for taker in takers:
            with pytest.raises(ScenarioError, match=r"^\w+ = \w.*: give (a|that)[^\n]*$"):
                taker(context)
