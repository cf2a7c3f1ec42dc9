import dataclasses
from functools import partial

import numpy as np
import pytest
from helpers import nightly_beyond, output, regular, sizes_of, with_ports
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem

from drake_nonstop.blocks.carrier_controller import CarrierPidConfig
from drake_nonstop.blocks.carrier_trajectory import MeasuredCarrierTrajectory
from drake_nonstop.blocks.load_feedback import (
    DesiredStateFeedback,
)
from drake_nonstop.blocks.load_trajectory import RestToRestConfig
from drake_nonstop.blocks.optimization_layer import (
    ConstantParameters,
    ConstantParametersConfig,
    NlpLayerConfig,
)
from drake_nonstop.blocks.phase import PaperPhase
from drake_nonstop.blocks.sample_and_hold import SampleAndHold
from drake_nonstop.blocks.turn_rate_optimizer import TurnRateOptimizer
from drake_nonstop.diagrams.nonstop import BOXES, figure_wires, make_nonstop
from drake_nonstop.loop.box import config_class
from drake_nonstop.model.system import SystemOverrides, SystemParameters
from drake_nonstop.scenario.loading import dump_scenario
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems import wiring
from drake_nonstop.validation import ScenarioError


def continuous(**fields):
    return Scenario(control_period=0.0, **fields)


def plain(period=0.0, **fields):
    """A scenario without the optimizer, whose problem takes the longest to build."""
    fields = {"optimization_layer": ConstantParametersConfig()} | fields
    return Scenario(control_period=period, **fields)


@pytest.fixture(scope="module")
def figure():
    """The default diagram with continuous controllers."""
    return make_nonstop(continuous())


@pytest.fixture(scope="module")
def sampled_figure():
    """The default diagram with sampled controllers."""
    return make_nonstop(Scenario(control_period=0.01))


def block_names(diagram):
    return [block.get_name() for block in diagram.GetSystems()]


def test_figure_as_listed_is_the_figure_as_built(figure):
    assert set(wiring.connections(figure)) == figure_wires()
    assert len(figure_wires()) == 30


def test_every_box_is_there_under_its_name_with_its_default_block(figure):
    assert block_names(figure) == list(BOXES)
    for name, box in BOXES.items():
        assert type(figure.GetSubsystemByName(name)) is box.variants[0]


@pytest.mark.parametrize("name", ["figure", "sampled_figure"])
def test_no_input_is_left_open_and_every_output_is_exported(name, request):
    diagram = request.getfixturevalue(name)
    assert diagram.num_input_ports() == 0
    wired = {wire.split(" -> ")[1] for wire in wiring.connections(diagram)}
    # Which may be left unconnected.
    wired |= {"optimization_layer.speed_bound_command", "phase.plan"}
    signals = []
    for block in diagram.GetSystems():
        assert {f"{block.get_name()}.{p}" for p in wiring.input_names(block)} <= wired
        signals += wiring.output_names(block)
    assert sorted(signals) == sorted(wiring.output_names(diagram))
    assert len(set(signals)) == len(signals)


CONTROLLERS = {
    "wrench_controller",
    "optimization_layer",
    "force_distribution",
    "carrier_trajectory",
}


def test_sampled_controllers_read_the_held_signals(sampled_figure):
    diagram = sampled_figure
    assert block_names(diagram) == [*BOXES, "sample_and_hold"]
    assert type(diagram.GetSubsystemByName("sample_and_hold")) is SampleAndHold
    pairs = [wire.split(" -> ") for wire in wiring.connections(diagram)]
    expected = {
        ("carrier_dynamics.carrier_state", "sample_and_hold.carrier_state"),
        ("sample_and_hold.held_carrier_state", "optimization_layer.held_carrier_state"),
        ("load_feedback.measured_load_state", "sample_and_hold.measured_load_state"),
        ("load_trajectory.reference", "sample_and_hold.reference"),
        ("load_trajectory.reference_higher_rates", "sample_and_hold.reference_higher_rates"),
        ("sample_and_hold.sample_time", "wrench_controller.sample_time"),
        ("sample_and_hold.sample_time", "carrier_trajectory.sample_time"),
        ("sample_and_hold.sample_time", "optimization_layer.sample_time"),
    }
    for wire in figure_wires():
        source, target = wire.split(" -> ")
        if target.split(".")[0] in CONTROLLERS and source in (
            "load_feedback.measured_load_state",
            "load_trajectory.reference",
            "load_trajectory.reference_higher_rates",
        ):
            source = f"sample_and_hold.held_{source.split('.')[1]}"
        expected.add((source, target))
    assert {tuple(pair) for pair in pairs} == expected


def test_sampled_commands_stand_still_between_samples_but_for_the_carriers_motion():
    diagram = make_nonstop(plain(0.01, load_trajectory=RestToRestConfig(displacement=[1.0, 0, 0])))
    simulator = Simulator(diagram)
    names = ("wrench", "internal_force", "desired_cable_forces", "phase")

    def signals(time):
        simulator.AdvanceTo(time)
        return {name: output(diagram, simulator.get_context(), name) for name in names}

    first, same, next_sample = signals(0.0411), signals(0.0489), signals(0.0511)
    for name in names:
        np.testing.assert_array_equal(first[name], same[name], err_msg=name)
        assert not np.array_equal(first[name], next_sample[name]), name


class CommandingDisturbance(LeafSystem):
    """No disturbance, and a speed bound that rises with the time."""

    def __init__(self, model):
        super().__init__()
        self.DeclareVectorOutputPort(
            "disturbance_wrench", 6, lambda context, output: output.SetFromVector(np.zeros(6))
        )
        self.DeclareVectorOutputPort(
            "speed_bound_command",
            1,
            lambda context, output: output.SetFromVector([0.3 + 0.01 * context.get_time()]),
        )


@pytest.mark.parametrize("layer", [NlpLayerConfig(), ConstantParametersConfig()])
def test_speed_bound_command_of_a_block_is_the_bound(layer):
    scenario = Scenario(optimization_layer=layer)
    diagram = make_nonstop(scenario, at_equilibrium=False, load_disturbance=CommandingDisturbance)
    wire = "load_disturbance.speed_bound_command -> optimization_layer.speed_bound_command"
    assert wire in wiring.connections(diagram)
    context = diagram.CreateDefaultContext()
    context.SetTime(2.0)
    np.testing.assert_array_equal(output(diagram, context, "speed_bound"), [0.32])


@pytest.mark.parametrize("box", list(BOXES))
def test_signals_that_others_need_have_to_be_made_in_their_sizes(box, scenario_and_diagram):
    blocks = {block.get_name(): block for block in scenario_and_diagram[1].GetSystems()}
    needed = {
        wire.signal
        for wire in wiring.wires(blocks)
        if wire.maker == box and wire.port not in wiring.optional_inputs(blocks[wire.reader])
    }
    sizes = sizes_of(BOXES[box], 4, 4)
    build = partial(make_nonstop, plain(), at_equilibrium=False)  # which these blocks do not hold
    vectors = {name: size for name, size in sizes.items() if size is not None}
    build(**{box: with_ports({}, vectors)})
    for signal in needed - {"wrench_rate"}:
        others = {name: size for name, size in vectors.items() if name != signal}
        with pytest.raises(ScenarioError, match=f"{box} makes {signal} "):
            build(**{box: with_ports({}, others | {signal: sizes[signal] + 1})})
        with pytest.raises(ScenarioError, match=f"{signal}, (which {box} = Ports does n|of wh)"):
            build(**{box: with_ports({}, others)})


def test_box_can_be_replaced_by_a_config_and_by_a_class():
    diagram = make_nonstop(
        plain(),
        optimization_layer=ConstantParametersConfig(frequency=3.0),
        phase=PaperPhase,
        load_feedback=lambda model: DesiredStateFeedback(model),
    )
    assert type(diagram.GetSubsystemByName("optimization_layer")) is ConstantParameters
    assert type(diagram.GetSubsystemByName("phase")) is PaperPhase
    assert type(diagram.GetSubsystemByName("load_feedback")) is DesiredStateFeedback
    context = diagram.CreateDefaultContext()
    np.testing.assert_array_equal(output(diagram, context, "parameters"), [3.0, 1.2])


def others_than(name, diagram):
    blocks = {block.get_name(): type(block) for block in diagram.GetSystems()}
    del blocks[name]
    return blocks


@pytest.fixture(scope="module", params=nightly_beyond(1, "engines", [0.01, 0.0]))
def scenario_and_diagram(request):
    """A scenario without the optimizer, and its diagram; nothing changes either."""
    scenario = plain(request.param)
    return scenario, make_nonstop(scenario, at_equilibrium=False)


@pytest.mark.parametrize(
    ("name", "block"),
    [
        (name, block)
        for name, box in BOXES.items()
        for block in box.variants
        if not block.__name__.startswith("FixedWing")  # they come in pairs
        and block is not TurnRateOptimizer  # of aircraft
    ],
    ids=lambda value: value if isinstance(value, str) else value.__name__,
)
def test_each_block_alone_can_be_swapped_in(name, block, scenario_and_diagram):
    """It is in its box, reads the signals it names and is read, and nothing else changes."""
    build = partial(make_nonstop, at_equilibrium=False)  # of which wires do not depend
    scenario, before = scenario_and_diagram
    text = dump_scenario(scenario)
    if block is MeasuredCarrierTrajectory:  # which makes no accelerations, that this reads
        with pytest.raises(ScenarioError, match=r"or carrier_controller=CarrierPid$"):
            build(scenario, **{name: config_class(block)()})
        scenario = dataclasses.replace(scenario, carrier_controller=CarrierPidConfig())
        before, text = build(scenario), dump_scenario(scenario)
    diagram = build(scenario, **{name: config_class(block)()})
    swapped = diagram.GetSubsystemByName(name)
    assert type(swapped) is block
    assert others_than(name, diagram) == others_than(name, before)
    assert dump_scenario(scenario) == text
    assert diagram.num_input_ports() == 0

    wires = [wire.split(" -> ") for wire in wiring.connections(diagram)]
    read = {source for source, target in wires if target.split(".")[0] != name}
    written = {wire.split(" -> ")[0] for wire in wiring.connections(before)}
    needed = {source for source in written if source.startswith(f"{name}.")}
    assert needed
    assert needed <= read
    sources = dict(reversed(wire) for wire in wires)
    for port in wiring.input_names(swapped):
        if port in wiring.optional_inputs(swapped) and f"{name}.{port}" not in sources:
            continue
        source = sources[f"{name}.{port}"].split(".")[1]
        assert source.removeprefix("held_") == port.removeprefix("held_")


def test_only_the_plant_takes_the_simulated_system():
    models, plant = {}, ("carrier_dynamics", "cables", "load_plant")

    def recorder(name):
        def make(model):
            models[name] = model
            return BOXES[name].variants[0](model)

        return make

    scenario = plain(simulated=SystemOverrides(load_mass=1.3, carrier_mass=0.2))
    make_nonstop(scenario, **{name: recorder(name) for name in BOXES})
    masses = {name: (model.load_mass, model.carrier_mass) for name, model in models.items()}
    assert masses == {name: (1.3, 0.2) if name in plant else (1.0, 0.1) for name in BOXES}


def test_figure_is_the_same_for_another_number_of_carriers():
    scenario = continuous(system=SystemParameters(attachments=regular(3).tolist()))
    diagram = make_nonstop(scenario, at_equilibrium=False)
    assert set(wiring.connections(diagram)) == figure_wires()
    assert diagram.GetOutputPort("tensions").size() == 3
