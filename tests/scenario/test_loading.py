"""Scenario files: what they hold, how they are changed, and what they refuse."""

import math

import numpy as np
import pytest
from helpers import GAINS

from drake_nonstop import (
    ScenarioError,
    dump_scenario,
    load_scenario,
    make_nonstop,
    parse_scenario,
    scenario_names,
)
from drake_nonstop.blocks.optimization_layer import PaperLayerConfig


@pytest.mark.parametrize("name", scenario_names())
def test_a_resolved_scenario_reads_back_to_itself(name):
    scenario = load_scenario(name)
    text = dump_scenario(scenario)
    again = parse_scenario(text)
    assert dump_scenario(again) == text
    assert again.optimization_layer == scenario.optimization_layer
    assert again.system == scenario.system
    assert again.simulated == scenario.simulated


def test_the_paper_scenarios_are_as_printed():
    for name in ("paper_line", "paper_quintic"):
        scenario = load_scenario(name)
        assert math.isinf(scenario.system.cable_stiffness)  # L_i = L_0 for the controllers
        assert scenario.simulated.cable_stiffness == 500.0
        assert type(scenario.phase).__name__ == "PaperPhaseConfig"
        assert vars(scenario.wrench_controller) == GAINS | {"feedforward": 0.0}
        assert scenario.carrier_controller.velocity_gain == 1.5
        assert type(scenario.optimization_layer) is PaperLayerConfig
        assert scenario.optimization_layer.tightening == 0.0
        assert scenario.optimization_layer.solver == "snopt"


def test_a_setting_changes_one_field_and_keeps_the_rest():
    plain = load_scenario("quintic")
    changed = load_scenario("quintic", ["system.load_mass=1.2", "simulation_duration=2"])
    assert changed.system.load_mass == 1.2
    assert changed.simulation_duration == 2.0
    assert changed.optimization_layer == plain.optimization_layer


def test_a_setting_swaps_a_block_with_or_without_braces():
    for text in ("phase=!PaperPhase {}", "phase=!PaperPhase"):
        scenario = load_scenario("quintic", [text])
        assert type(scenario.phase).__name__ == "PaperPhaseConfig"


def test_a_setting_that_swaps_a_block_keeps_only_what_the_new_one_calls_the_same():
    settings = ["load_trajectory.start_position=[1, 2, 3]", "load_trajectory=Waypoints"]
    way = load_scenario("quintic", settings).load_trajectory
    assert way.start_position == [1.0, 2.0, 3.0]
    assert way.roll_pitch_yaw == []  # a change of the angles before, and a list of them now


def test_a_file_with_defaults_only_needs_no_more_than_its_name(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("mine:\n")
    assert load_scenario(path).name == "mine"


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("system.attachments=[[1,0,0],[0,1,0]]", ["system.attachments", "3 or more"]),
        ("system.attachments=[[1,0,0],[0,1]]", ["system.attachments", "n x 3"]),
        ("system.attachments=3", ["system.attachments = 3", "list"]),
        ("system.load_mass=-1", ["system.load_mass = -1", "greater than zero"]),
        ("system.load_mass=.nan", ["system.load_mass = .nan", "finite"]),
        ("system.load_mass=.inf", ["system.load_mass = inf", "finite"]),
        ("system.load_mass='1'", ["system.load_mass = '1'", "without quotes"]),
        ("system.load_mass=heavy", ["system.load_mass = heavy", "a number"]),
        ("system.load_mass=true", ["system.load_mass = True", "a number"]),
        ("system.cable_stiffness=-5", ["system.cable_stiffness = -5", "greater than zero"]),
        ("system.cable_stiffness=.inf", ["simulated.cable_stiffness = inf", "finite"]),
        ("load_mass=2", ["--set = load_mass", "did you mean system.load_mass?"]),
        ("speed_bound=2", ["did you mean optimization_layer.speed_bound?"]),
        ("system.loadmass=1", ["system.loadmass = 1", "did you mean load_mass"]),
        ("sytem.load_mass=1", ["sytem", "did you mean system"]),
        ("pattern.phases=[0,0,1,2]", ["pattern.phases", "swings in a plane"]),
        ("pattern.phases=[0,1]", ["pattern.phases = [0.0, 1.0]", "4 finite numbers"]),
        (
            "optimization_layer=!NlpLayer {period: 0.004}",
            ["period = 0.004", "multiple of the control period"],
        ),
        ("optimization_layer.speed_bound=-0.1", ["speed_bound = -0.1", "0 (no bound)"]),
        (
            "optimization_layer=!NlpLayer {solver: gurobi}",
            ["solver = gurobi", "snopt, ipopt"],
        ),
        (
            "optimization_layer=!NlpLayer {orbit_points: 1.5}",
            ["orbit_points = 1.5", "whole number"],
        ),
        ("optimization_layer.knot_spacing=0.004", ["knot_spacing = 0.004", "control period"]),
        ("optimization_layer.instants=1.5", ["instants = 1.5", "whole number"]),
        ("optimization_layer.period=0.02", ["period = 0.02", "one of PaperLayer"]),
        ("phase=!Phase {}", ["phase = !Phase", "!AccumulatedPhase, !PaperPhase"]),
        ("control_period=-1", ["control_period = -1", "0 for continuous"]),
        ("simulation_duration=1:30", ["simulation_duration = 1:30", "plain digits"]),
        ("simulator_config.start_time=5", ["simulator_config.start_time = 5", "give 0"]),
        ("optimization_layer.speed_bound=1e-9", ["speed_bound = 1e-09", "no bound"]),
        ("simulation_duration=0", ["simulation_duration = 0", "greater than zero"]),
        ("duration", ["--set = duration", "path=value"]),
        ("simulated.attachments=[[1,0,0],[0,1,0],[-1,-1,0]]", ["simulated.attachments", "4"]),
        (
            "wind.velocity=[2, 0, 0]",
            ["wind.velocity = [2, 0, 0]", "StillAir has none", "SteadyWind, GustyWind"],
        ),
    ],
)
def test_a_bad_setting_ends_with_the_field_the_value_and_the_remedy(setting, words):
    with pytest.raises(ScenarioError) as caught:
        make_nonstop(load_scenario("quintic", [setting]))
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: {system: {load_mass: 1, load_mass: 2}}", ["a.system.load_mass", "give it once"]),
        ("a: {nonsense: 1}", ["nonsense = 1", "there is no nonsense"]),
        ("a: {system: {load_mass: '2'}}", ["load_mass = '2'", "without quotes"]),
        ("a: {system: {load_mass: .nan}}", ["load_mass = .nan", "finite"]),
        ("a: 1", ["a = 1", "fields below its name"]),
        ("a: {}\nb: {}", ["exactly one scenario"]),
        ("", ["exactly one scenario"]),
        ("a: [1", ["line 2", "valid YAML"]),
        ("a: &x {system: *x}", ["anchor x: write the value out"]),
        ("../evil: {}", ["../evil", "letters"]),
        ("a: {phase: 3}", ["phase = 3", "!ShapedPhase"]),
    ],
)
def test_a_bad_file_ends_with_one_sentence(text, words):
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(text)
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_a_trajectory_from_a_file_is_in_the_resolved_scenario(tmp_path):
    path = tmp_path / "way.csv"
    path.write_text("t,x,y,z\n0,0,0,1\n4,0.25,0,1\n9,1,0,1e-1\n")
    setting = f"load_trajectory=!SampledTrajectory {{file: '{path}'}}"
    scenario = load_scenario("quintic", [setting, "optimization_layer=ConstantParameters"])
    path.unlink()
    way = scenario.load_trajectory
    assert way.file == ""
    assert way.samples == [[0, 0, 0, 1], [4, 0.25, 0, 1], [9, 1, 0, 0.1]]
    again = parse_scenario(dump_scenario(scenario))
    assert again.load_trajectory == way
    nonstop = make_nonstop(again)
    context = nonstop.CreateDefaultContext()
    context.SetTime(4.0)
    reference = nonstop.GetOutputPort("reference").Eval(context)
    np.testing.assert_allclose(reference[4:7], [0.25, 0, 1], rtol=0, atol=1e-14)
    with pytest.raises(ScenarioError, match=r"load_trajectory\.file = .*way\.csv: give"):
        load_scenario("quintic", [setting])


def test_a_replacement_may_be_a_config_or_a_class():
    from drake_nonstop import ConstantParameters, ConstantParametersConfig

    scenario = load_scenario("quintic")
    for replacement in (ConstantParameters, ConstantParametersConfig(amplitude=0.9)):
        diagram = make_nonstop(scenario, optimization_layer=replacement)
        block = diagram.GetSubsystemByName("optimization_layer")
        assert isinstance(block, ConstantParameters)
    context = diagram.CreateDefaultContext()
    assert np.array_equal(diagram.GetOutputPort("parameters").Eval(context), [2.0, 0.9])
