"""The figure as listed, as built, and with other blocks in its boxes."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from helpers import connections, nightly_beyond, output, regular, sizes_of, sizes_of_ports
from helpers import with_ports as ports
from pydrake.systems.analysis import Simulator
from registries import BOXES, CONFIGS, VARIANTS

from drake_nonstop import (
    ConstantParametersConfig,
    Scenario,
    ScenarioError,
    SystemParameters,
    changed,
    dump_scenario,
    load_scenario,
    make_nonstop,
)
from drake_nonstop.blocks.carrier_controller import CarrierPidConfig
from drake_nonstop.blocks.load_trajectory import RestToRestConfig
from drake_nonstop.diagrams.nonstop import figure_wires

build = partial(make_nonstop, at_equilibrium=False)  # of which wires do not depend
MAY_BE_OPEN = {"optimization_layer.speed_bound_command", "phase.plan"}


def plain(period=0.0, **fields):
    """A scenario without the optimizer, whose problem takes the longest to build."""
    fields = {"optimization_layer": ConstantParametersConfig()} | fields
    return Scenario(control_period=period, **fields)


def types_of(diagram):
    return {block.get_name(): type(block) for block in diagram.GetSystems()}


def held_wires():
    """The figure's wires where controllers read what is held."""
    held = {
        f"{maker}.{signal}": f"sample_and_hold.held_{signal}"
        for maker, signal in (
            ("load_feedback", "measured_load_state"),
            ("load_feedback", "measured_attitude"),
            ("load_trajectory", "reference"),
            ("load_trajectory", "reference_higher_rates"),
        )
    }
    timed = {"wrench_controller", "optimization_layer", "carrier_trajectory"}
    readers = timed | {"force_distribution"}
    found = {f"{source} -> sample_and_hold.{source.split('.')[1]}" for source in held}
    for wire in figure_wires():
        source, target = wire.split(" -> ")
        target = target.replace("measured_attitude", "held_measured_attitude")
        is_held = target.split(".")[0] in readers
        found.add(f"{held.get(source, source) if is_held else source} -> {target}")
    found |= {f"sample_and_hold.sample_time -> {reader}.sample_time" for reader in timed}
    state = "carrier_state"
    found.add(f"carrier_dynamics.{state} -> sample_and_hold.{state}")
    found.add(f"sample_and_hold.held_{state} -> optimization_layer.held_{state}")
    return found


@pytest.mark.parametrize(("period", "n"), [(0.0, 4), (0.0, 3), (0.01, 4)])
def test_the_figure_as_listed_is_the_figure_as_built(period, n):
    system = SystemParameters(attachments=regular(n).tolist())
    diagram = build(Scenario(control_period=period, system=system))
    hold = ["sample_and_hold"] if period else []
    assert [*types_of(diagram)] == [*BOXES, *hold]
    for name, box in BOXES.items():
        assert types_of(diagram)[name] is box.variants[0]
    wires = connections(diagram)
    assert {*wires} == (held_wires() if period else figure_wires())
    # No input is left open, and every output is exported.
    assert diagram.num_input_ports() == 0
    read, signals = {wire.split(" -> ")[1] for wire in wires} | MAY_BE_OPEN, []
    for block in diagram.GetSystems():
        assert {f"{block.get_name()}.{port}" for port in sizes_of_ports(block, "input")} <= read
        signals += sizes_of_ports(block)
    assert sorted(signals) == sorted(sizes_of_ports(diagram))
    assert diagram.GetOutputPort("tensions").size() == n


def test_sampled_signals_and_commands_stand_still_between_samples():
    move = RestToRestConfig(displacement=[1.0, 0, 0])
    diagram = make_nonstop(plain(0.01, load_trajectory=move))
    simulator, then = Simulator(diagram), diagram.CreateDefaultContext()
    held = ("reference", "reference_higher_rates")
    commands = ("wrench", "internal_force", "desired_cable_forces", "phase")

    def signals(time):
        """Commands; what is held is that of the sample's time."""
        simulator.AdvanceTo(time)
        context = simulator.get_context()
        sampled = float(output(diagram, context, "sample_time")[0])
        assert sampled == pytest.approx(0.01 * int(time / 0.01), abs=1e-12)
        then.SetTime(sampled)
        for name in held:
            expected = output(diagram, then, name)
            np.testing.assert_array_equal(output(diagram, context, f"held_{name}"), expected)
        return [output(diagram, context, name) for name in commands]

    for first, same, following in zip(*map(signals, (0.0411, 0.0489, 0.0511)), strict=True):
        np.testing.assert_array_equal(first, same)
        assert not np.array_equal(first, following)


def optional_inputs(block):
    return {f"{block.get_name()}.{name}" for name in getattr(block, "optional_inputs", ())}


@pytest.mark.parametrize("box", list(BOXES))
def test_signals_that_others_need_have_to_be_made_in_their_sizes(box, scenario_and_diagram):
    _, diagram = scenario_and_diagram
    optional = set().union(*map(optional_inputs, diagram.GetSystems()))
    pairs = [wire.split(" -> ") for wire in connections(diagram)]
    made = {source for source, target in pairs if target not in optional}
    needed = {source.split(".")[1] for source in made if source.startswith(f"{box}.")}
    sizes = {name: n for name, n in sizes_of(BOXES[box], 4, 4).items() if n is not None}
    build(plain(), **{box: ports({}, sizes)})
    for signal in needed - {"wrench_rate"}:
        others = {name: size for name, size in sizes.items() if name != signal}
        with pytest.raises(ScenarioError, match=f"{box} makes {signal} "):
            build(plain(), **{box: ports({}, others | {signal: sizes[signal] + 1})})
        with pytest.raises(ScenarioError, match=f"{signal}, (which {box} = Ports does n|of wh)"):
            build(plain(), **{box: ports({}, others)})


@pytest.fixture(scope="module", params=nightly_beyond(1, "engines", [0.01, 0.0]))
def scenario_and_diagram(request):
    """A scenario without the optimizer, and its diagram; nothing changes either."""
    scenario = plain(request.param)
    return scenario, build(scenario)


OF_AIRCRAFT = ("FixedWing", "TurnRate")  # which come with each other
ALONE = [row for row in VARIANTS if not row.split("-")[1].startswith(OF_AIRCRAFT)]


@pytest.mark.parametrize("row", ALONE)
def test_each_block_alone_can_be_swapped_in(row, scenario_and_diagram):
    """It is in its box, reads the signals it names and is read, and nothing else changes."""
    name, block = VARIANTS[row]
    (scenario, before), config = scenario_and_diagram, CONFIGS[block]()
    if block.__name__ == "MeasuredCarrierTrajectory":  # without accelerations, that this reads
        with pytest.raises(ScenarioError, match=r"or carrier_controller=CarrierPid$"):
            build(scenario, **{name: config})
        scenario = dataclasses.replace(scenario, carrier_controller=CarrierPidConfig())
        before = build(scenario)
    text, diagram = dump_scenario(scenario), build(scenario, **{name: config})
    assert types_of(diagram) == types_of(before) | {name: block}
    assert dump_scenario(scenario) == text
    assert diagram.num_input_ports() == 0

    pairs = [wire.split(" -> ") for wire in connections(diagram)]
    needed = {wire.split(" -> ")[0] for wire in connections(before)}
    needed = {source for source in needed if source.startswith(f"{name}.")}
    assert needed
    assert needed <= {source for source, target in pairs if not target.startswith(f"{name}.")}
    sources = dict(reversed(pair) for pair in pairs)
    swapped = diagram.GetSubsystemByName(name)
    for port in (f"{name}.{port}" for port in sizes_of_ports(swapped, "input")):
        if port in sources or port not in optional_inputs(swapped):
            read, source = (each.split(".")[1] for each in (port, sources[port]))
            assert source.removeprefix("held_") == read.removeprefix("held_")


def test_only_the_plant_takes_the_simulated_system():
    models, plant = {}, ("carrier_dynamics", "cables", "load_plant")

    def recorder(name):
        def make(model):
            models[name] = model
            return BOXES[name].variants[0](model)

        return make

    own = ["simulated.load_mass=1.3", "simulated.carrier_mass=0.2", "simulated.load_drag=0"]
    scenario = changed(load_scenario("quintic"), [*own, "optimization_layer=ConstantParameters"])
    build(scenario, **{name: recorder(name) for name in BOXES})
    found = {name: (m.load_mass, m.carrier_mass, m.load.drag) for name, m in models.items()}
    believed, simulated = (1.0, 0.1, 0.7), (1.3, 0.2, 0.0)
    assert found == {name: simulated if name in plant else believed for name in BOXES}
