import dataclasses

import numpy as np
import pytest
from helpers import output, regular
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem

from drake_nonstop import wiring
from drake_nonstop.blocks.carrier_dynamics import CarrierDynamicsConfig
from drake_nonstop.blocks.constant_parameters import (
    ConstantParameters,
    ConstantParametersConfig,
)
from drake_nonstop.blocks.desired_state_feedback import (
    DesiredStateFeedback,
    DesiredStateFeedbackConfig,
)
from drake_nonstop.blocks.load_trajectory import ConstantVelocityMoveConfig, RestToRestConfig
from drake_nonstop.blocks.printed_phase import PrintedPhase
from drake_nonstop.blocks.sample_and_hold import SampleAndHold
from drake_nonstop.diagrams import nonstop
from drake_nonstop.diagrams.nonstop import (
    BLOCKS,
    PLANT,
    block_class,
    figure_wires,
    make_nonstop,
)
from drake_nonstop.scenario import Scenario
from drake_nonstop.system import System, SystemOverrides
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
    assert len(figure_wires()) == 25


def test_every_box_is_there_under_its_name_with_its_default_block(figure):
    assert block_names(figure) == list(BLOCKS)
    for name, blocks in BLOCKS.items():
        assert type(figure.GetSubsystemByName(name)) is blocks[0]
    assert set(PLANT) < set(BLOCKS)


@pytest.mark.parametrize("name", ["figure", "sampled_figure"])
def test_no_input_is_left_open_and_every_output_is_exported(name, request):
    diagram = request.getfixturevalue(name)
    assert diagram.num_input_ports() == 0
    wired = {wire.split(" -> ")[1] for wire in wiring.connections(diagram)}
    signals = []
    for block in diagram.GetSystems():
        assert {f"{block.get_name()}.{p}" for p in wiring.input_names(block)} <= wired
        signals += wiring.output_names(block)
    assert sorted(signals) == sorted(wiring.output_names(diagram))
    assert len(set(signals)) == len(signals)


def test_every_signal_is_read_but_those_that_only_report(figure):
    read = {wire.split(" -> ")[0].split(".")[1] for wire in wiring.connections(figure)}
    unread = set(wiring.output_names(figure)) - read
    assert unread == {"tracking_error", "diagnostics", "solve_time", "speed_bound", "tensions"}


def test_wire_that_differs_from_the_list_is_an_error(monkeypatch):
    removed = nonstop.WIRES.replace("cables.cable_forces -> load_plant.cable_forces\n", "")
    monkeypatch.setattr(nonstop, "WIRES", removed)
    with pytest.raises(wiring.WiringError, match=r"cables\.cable_forces -> load_plant"):
        make_nonstop(continuous())


CONTROLLERS = {
    "wrench_controller",
    "optimization_layer",
    "force_distribution",
    "carrier_trajectory",
}


def test_sampled_controllers_read_the_held_signals(sampled_figure):
    diagram = sampled_figure
    assert block_names(diagram) == [*BLOCKS, "sample_and_hold"]
    assert type(diagram.GetSubsystemByName("sample_and_hold")) is SampleAndHold
    pairs = [wire.split(" -> ") for wire in wiring.connections(diagram)]
    expected = {
        ("load_feedback.measured_load_state", "sample_and_hold.measured_load_state"),
        ("load_trajectory.reference", "sample_and_hold.reference"),
        ("sample_and_hold.sample_time", "carrier_trajectory.sample_time"),
    }
    for wire in figure_wires():
        source, target = wire.split(" -> ")
        if target.split(".")[0] in CONTROLLERS and source in (
            "load_feedback.measured_load_state",
            "load_trajectory.reference",
        ):
            source = f"sample_and_hold.held_{source.split('.')[1]}"
        expected.add((source, target))
    assert {tuple(pair) for pair in pairs} == expected


def test_open_loop_feedback_is_sampled_once():
    diagram = make_nonstop(plain(0.01), load_feedback=DesiredStateFeedback)
    built = wiring.connections(diagram)
    assert "load_trajectory.reference -> load_feedback.reference" in built
    assert "load_feedback.measured_load_state -> sample_and_hold.measured_load_state" in built


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


class Kite(LeafSystem):
    """A disturbance that asks for two signals which the default block does not read."""

    def __init__(self, model):
        super().__init__()
        self._tensions = self.DeclareVectorInputPort("tensions", model.n)
        self._carrier_state = self.DeclareVectorInputPort("carrier_state", 6 * model.n)
        self.DeclareVectorOutputPort("disturbance_wrench", 6, self._calc)

    def _calc(self, context, wrench):
        wrench.SetFromVector(
            np.concatenate(
                [self._tensions.Eval(context)[:3], self._carrier_state.Eval(context)[:3]]
            )
        )


def test_swapped_in_block_gets_the_signals_that_it_names():
    diagram = make_nonstop(plain(), load_disturbance=Kite)
    added = set(wiring.connections(diagram)) - figure_wires()
    assert added == {
        "cables.tensions -> load_disturbance.tensions",
        "carrier_dynamics.carrier_state -> load_disturbance.carrier_state",
    }
    context = diagram.CreateDefaultContext()
    carriers = diagram.GetSubsystemByName("carrier_dynamics")
    state = np.concatenate([(regular(4) + np.array([0, 0, 2.0])).ravel(), np.zeros(12)])
    carriers.GetMyMutableContextFromRoot(context).SetContinuousState(state)
    wrench = output(diagram, context, "disturbance_wrench")
    expected = [*output(diagram, context, "tensions")[:3], *state[:3]]
    np.testing.assert_array_equal(wrench, expected)
    assert wrench[0] > 1


class Misspelt(LeafSystem):
    def __init__(self, model):
        super().__init__()
        self.DeclareVectorInputPort("tension", model.n)
        self.DeclareVectorOutputPort("disturbance_wrench", 6, lambda c, o: None)


def test_misspelt_port_of_a_swapped_in_block_is_told_the_signals():
    with pytest.raises(
        wiring.WiringError, match=r"load_disturbance\.tension = .*tensions.*wrench_rate"
    ):
        make_nonstop(plain(), load_disturbance=Misspelt)


class Silent(LeafSystem):
    def __init__(self, model):
        super().__init__()
        self.DeclareVectorOutputPort("nothing", 6, lambda c, o: None)


def test_block_that_does_not_make_its_signal_leaves_a_reader_unconnected():
    with pytest.raises(wiring.WiringError, match=r"load_plant\.disturbance_wrench"):
        make_nonstop(plain(), load_disturbance=Silent)


def test_box_can_be_replaced_by_a_config_and_by_a_class():
    diagram = make_nonstop(
        plain(),
        optimization_layer=ConstantParametersConfig(frequency=3.0),
        phase=PrintedPhase,
        load_feedback=lambda model: DesiredStateFeedback(model),
    )
    assert type(diagram.GetSubsystemByName("optimization_layer")) is ConstantParameters
    assert type(diagram.GetSubsystemByName("phase")) is PrintedPhase
    assert type(diagram.GetSubsystemByName("load_feedback")) is DesiredStateFeedback
    context = diagram.CreateDefaultContext()
    np.testing.assert_array_equal(output(diagram, context, "parameters"), [3.0, 1.2])


@pytest.mark.parametrize("period", [0.0, 0.01])
@pytest.mark.parametrize(("name", "block"), [(n, b) for n, bs in BLOCKS.items() for b in bs[1:]])
def test_every_alternative_block_builds_a_complete_diagram(name, block, period):
    diagram = make_nonstop(plain(period), **{name: block})
    assert type(diagram.GetSubsystemByName(name)) is block
    assert diagram.num_input_ports() == 0


def test_only_the_plant_takes_the_simulated_system():
    models = {}

    def recorder(name):
        def make(model):
            models[name] = model
            return BLOCKS[name][0](model)

        return make

    scenario = plain(simulated=SystemOverrides(load_mass=1.3, carrier_mass=0.2))
    make_nonstop(scenario, **{name: recorder(name) for name in BLOCKS})
    masses = {name: (model.load_mass, model.carrier_mass) for name, model in models.items()}
    assert masses == {name: (1.3, 0.2) if name in PLANT else (1.0, 0.1) for name in BLOCKS}


def test_unknown_box_is_told_the_boxes():
    with pytest.raises(ScenarioError, match=r"replacement = plant: give one of load_trajectory"):
        make_nonstop(plain(), plant=ConstantParameters)


@pytest.mark.parametrize("entry", [3.0, "PrintedPhase"])
def test_replacement_that_is_no_block_is_named(entry):
    with pytest.raises(ScenarioError, match=f"replacement phase = {entry}: give"):
        make_nonstop(plain(), phase=entry)


def test_config_of_another_box_is_told_the_choices():
    config = CarrierDynamicsConfig()
    with pytest.raises(
        ScenarioError, match="phase = CarrierDynamics: give one of AccumulatedPhase, PrintedPhase"
    ):
        make_nonstop(plain(), phase=config)


def test_simulated_load_needs_as_many_attachments():
    overrides = SystemOverrides(attachments=regular(3).tolist())
    with pytest.raises(ScenarioError, match=r"simulated\.attachments = .*as many .* 4$"):
        make_nonstop(plain(simulated=overrides))


def test_error_in_the_simulated_system_names_it():
    with pytest.raises(ScenarioError, match=r"simulated\.load_mass = -1\.0"):
        make_nonstop(plain(simulated=SystemOverrides(load_mass=-1.0)))


def test_block_of_a_config():
    assert block_class("load_feedback", DesiredStateFeedbackConfig()) is DesiredStateFeedback
    name = type(ConstantVelocityMoveConfig()).__name__
    assert block_class("load_trajectory", ConstantVelocityMoveConfig()).__name__ + "Config" == name


@pytest.mark.parametrize("n", [3])
def test_figure_is_the_same_for_any_number_of_carriers(n):
    scenario = continuous(system=System(attachments=regular(n).tolist()))
    diagram = make_nonstop(scenario)
    assert set(wiring.connections(diagram)) == figure_wires()
    assert diagram.GetOutputPort("tensions").size() == n


def test_scenario_is_left_as_it_was():
    scenario = plain(0.01)
    before = dataclasses.asdict(scenario)
    make_nonstop(scenario, phase=PrintedPhase)
    after = dataclasses.asdict(scenario)
    for key in before:
        if key != "simulator":
            assert after[key] == before[key], key


@pytest.mark.parametrize("control_period", [0.0, 0.01])
def test_a_missing_line_of_the_written_figure_is_noticed(monkeypatch, control_period):
    lines = nonstop.WIRES.splitlines()
    lines.remove("phase.phase -> internal_force.phase")
    monkeypatch.setattr(nonstop, "WIRES", "\n".join(lines))
    with pytest.raises(wiring.WiringError, match=r"phase\.phase -> internal_force\.phase"):
        make_nonstop(Scenario(control_period=control_period))
