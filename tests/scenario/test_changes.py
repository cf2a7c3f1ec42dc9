"""Changes of a scenario: by overrides, by a file that is based on another one, and in Python."""

import math

import numpy as np
import pytest
from helpers import GAINS
from registries import VARIANTS

from drake_nonstop import (
    AircraftParameters,
    ScenarioError,
    dump_scenario,
    load_scenario,
    parse_scenario,
)
from drake_nonstop.blocks.optimization_layer import PaperLayerConfig
from drake_nonstop.diagrams.nonstop import replaced

FIVE = "[[1, 0, 0], [0.3, 1, 0], [-0.8, 0.6, 0], [-0.8, -0.6, 0], [0.3, -1, 0]]"
OF_AIRCRAFT = "x: {system: {aircraft: {model: rascal_110, mass: 6.2}}}"


def fields(scenario):
    """The scenario's fields, without its name and description."""
    return dump_scenario(scenario).splitlines()[2:]


@pytest.mark.parametrize(
    ("entries", "settings"),
    [
        ("", []),
        ("system: {load_mass: 1.2}, pattern: ", ["system.load_mass=1.2"]),
        ("optimization_layer: {tightening: 0.03}", ["optimization_layer={tightening: 0.03}"]),
        (
            f"system: {{attachments: {FIVE}}}, pattern: !HamiltonianCycle {{}}",
            [f"system.attachments={FIVE}", "pattern=!HamiltonianCycle {}"],
        ),
        (
            "optimization_layer: !ConstantParameters {frequency: 1.5}",
            ["optimization_layer=!ConstantParameters {frequency: 1.5}"],
        ),
        ("system: {load_mass: !Uniform {min: 1, max: 2}}", ["system.load_mass=!Uniform {max: 2, "
         "min: 1}"]),
        ("system: {aircraft: {model: ultrastick_25e}}", ["system.aircraft.model=ultrastick_25e"]),
    ],
)  # fmt: skip
def test_an_entry_means_the_same_in_a_file_and_by_an_override(entries, settings):
    in_file = parse_scenario(f"x: {{based_on: quintic, {entries}}}")
    assert (in_file.name, in_file.description) == ("x", "")
    assert fields(in_file) == fields(load_scenario("quintic", settings))


@pytest.mark.parametrize(
    ("settings", "path", "value"),
    [
        # Another block by its tag has its own defaults; by its name it takes what both call alike.
        (["optimization_layer=!ConstantParameters"], "optimization_layer.speed_bound", 0.2),
        (["optimization_layer=ConstantParameters"], "optimization_layer.speed_bound", 0.55),
        (
            ["load_trajectory.start_position=[1, 2, 3]", "load_trajectory=Waypoints"],
            "load_trajectory.start_position",
            [1.0, 2.0, 3.0],
        ),
        # A change of the angles before, and a list of them now.
        (["load_trajectory=Waypoints"], "load_trajectory.roll_pitch_yaw", []),
        (
            ["system.load_mass=!Uniform {min: 0.7, max: 1.3}", "system.load_mass.max=2"],
            "system.load_mass.max",
            2.0,
        ),
        (["simulated.aircraft.mass=6.5"], "simulated.aircraft", AircraftParameters(mass=6.5)),
        (np.array(["system.load_mass=1.2"]), "system.load_mass", 1.2),
    ],
)  # fmt: skip
def test_an_override_sets(settings, path, value):
    found = load_scenario("quintic", settings)
    for name in path.split("."):
        found = getattr(found, name)
    assert found == value


@pytest.mark.parametrize("entry", ["max_lift: 1.3", "model: ultrastick_25e"])
def test_a_file_changes_single_fields_of_its_aircraft_or_takes_another_model(tmp_path, entry):
    (tmp_path / "x.yaml").write_text(OF_AIRCRAFT)
    path = tmp_path / "y.yaml"
    path.write_text(f"y: {{based_on: x.yaml, system: {{aircraft: {{{entry}}}}}}}")
    aircraft = load_scenario(path).system.aircraft
    assert (aircraft.mass == 6.2) == entry.startswith("max_lift")


@pytest.mark.parametrize("name", VARIANTS)
def test_a_swap_in_python_is_that_of_the_command_line(name):
    """By a block, which takes what both call alike, and by its config."""
    box, block = VARIANTS[name]
    for scenario in ("quintic", "real_scale_spread"):
        swapped = getattr(load_scenario(scenario, [f"{box}={block.__name__}"]), box)
        for replacement in (block, type(swapped)):
            after, others = replaced(load_scenario(scenario), {box: replacement})
            assert not others
            assert getattr(after, box) == swapped


def test_a_chain_of_files_is_found_from_folder_to_folder(tmp_path):
    (tmp_path / "bases").mkdir()
    (tmp_path / "bases" / "a.yaml").write_text("a: {based_on: line, simulation_duration: 3.0}")
    (tmp_path / "bases" / "b.yaml").write_text("b: {based_on: a.yaml, system: {load_mass: 1.1}}")
    (tmp_path / "c.yaml").write_text("c: {based_on: bases/b.yaml, description: mine}")
    scenario = load_scenario(tmp_path / "c.yaml", ["system.load_drag=0.5"])
    settings = ["simulation_duration=3.0", "system.load_mass=1.1", "system.load_drag=0.5"]
    assert fields(scenario) == fields(load_scenario("line", settings))


def test_files_based_on_each_other_are_refused(tmp_path):
    for name, base in ("ab", "ba", "cc"):
        (tmp_path / f"{name}.yaml").write_text(f"{name}: {{based_on: {base}.yaml}}")
    for name in "abc":
        with pytest.raises(ScenarioError, match=r"based_on = .*: it is based on this scenario"):
            load_scenario(tmp_path / f"{name}.yaml")


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


STALL = math.sqrt(2 * 6.0 * 9.81 / (1.225 * 0.98 * 1.4))  # m/s
BOUND = "optimization_layer.speed_bound"


def test_a_bound_of_aircraft_may_be_a_multiple_of_the_stall_speed():
    scenario = load_scenario("aircraft_rest", [f"{BOUND}=1.4 V_s"])
    assert scenario.optimization_layer.speed_bound == "1.4 V_s"
    assert scenario.speed_bound == pytest.approx(1.4 * STALL)
    assert scenario.sampled().optimization_layer.speed_bound == pytest.approx(1.4 * STALL)
    heavier = load_scenario("aircraft_rest", [f"{BOUND}=1.4 V_s", "system.aircraft.mass=24"])
    assert heavier.speed_bound == pytest.approx(2 * 1.4 * STALL)


@pytest.mark.parametrize("text", ["V_s", "1.4V_s", "1.4 Vs", "-1 V_s", "nan V_s", "a b c", '""'])
def test_no_other_text_is_a_bound(text):
    with pytest.raises(ScenarioError, match=r'speed_bound = .*as "1\.4 V_s"$'):
        load_scenario("aircraft_rest", [f"{BOUND}={text}"]).sampled()
