"""Errors that a scenario states as data: sets and mappings, drawn into its plant and blocks."""

import dataclasses
import json

import numpy as np
import pytest

from drake_nonstop import ScenarioError, dump_scenario, load_scenario, parse_scenario, study
from drake_nonstop.analysis.stated_errors import with_seed, without_errors
from drake_nonstop.analysis.verdict import check_scenario
from drake_nonstop.cli.main import main
from drake_nonstop.scenario.errors import SETS
from drake_nonstop.scenario.loading import scenario_names
from drake_nonstop.studies.workers import SerialExecutor

MAPPING = (
    "errors={simulated.load_mass: !Uniform {min: 0.9, max: 1.1}, simulated: {cable_length: "
    "[0.8, 0.8, !Uniform {min: 0.79, max: 0.81}, 0.8]}, wind: !SteadyWind {velocity: [0.5, 0, 0]}}"
)


@pytest.mark.parametrize("errors", SETS)
@pytest.mark.parametrize("name", ["quintic", "three_carriers", "aircraft_rest_cables"])
def test_a_set_is_drawn_within_its_sizes(errors, name):
    sizes, scenario = SETS[errors], load_scenario(name, [f"errors={errors}"])
    system, drawn = scenario.system, []
    for k in range(8):
        plant = with_seed(scenario, k).sampled()
        assert plant.errors == "none"
        assert plant.sampled() is plant
        simulated, width = plant.simulated, np.ptp(system.attachments, axis=0).max()
        mass = simulated.load_mass / system.load_mass - 1
        lengths = np.array(simulated.cable_length) / system.cable_length - 1
        off = np.array(simulated.attachments) - system.attachments
        assert abs(mass) <= sizes.load_mass
        assert np.all(np.abs(lengths) <= sizes.cable_length)
        assert 0 < np.abs(off[:, :2]).max() < 2 * (sizes.centre + sizes.attachments) * width
        assert np.linalg.norm(plant.wind.velocity) == pytest.approx(sizes.wind)
        noise = plant.load_feedback.position_noise
        is_aircraft = system.aircraft is not None
        assert noise == (sizes.aircraft_position_noise if is_aircraft else sizes.position_noise)
        assert plant.load_feedback.delay == pytest.approx(sizes.aircraft_delay * is_aircraft)
        drawn.append([mass, *lengths, *off.ravel()])
        assert plant.load_feedback.seed == k
    assert len({*map(tuple, drawn)}) == 8
    assert scenario.sampled() == scenario.sampled()
    assert without_errors(scenario) == load_scenario(name)


@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_takes_every_set(name):
    for errors in SETS:
        assert load_scenario(name, [f"errors={errors}"]).sampled().simulated.load_mass is not None


def test_a_set_comes_on_top_of_what_the_scenario_states():
    changes = [
        "simulated.load_mass=!Uniform {min: 2, max: 3}",
        "wind=!SteadyWind {velocity: [5, 0, 0]}",
        "load_feedback=!NoisyFeedback {position_noise: 0.1, delay: 0.02}",
    ]
    plant = load_scenario("quintic", [*changes, "errors=light"]).sampled()
    assert 1.9 < plant.simulated.load_mass < 3.15
    assert 4.5 <= plant.wind.velocity[0] <= 5.5
    feedback = plant.load_feedback
    assert (feedback.position_noise, feedback.velocity_noise, feedback.delay) == (0.1, 0.002, 0.02)


def test_a_mapping_changes_the_fields_that_it_has():
    scenario = load_scenario("quintic", [MAPPING])
    assert parse_scenario(dump_scenario(scenario)) == scenario
    plant = scenario.sampled()
    assert 0.9 < plant.simulated.load_mass < 1.1
    assert 0.79 < plant.simulated.cable_length[2] < 0.81
    assert plant.wind.velocity == [0.5, 0.0, 0.0]
    assert dataclasses.replace(plant, errors=scenario.errors, simulated=scenario.simulated) != plant
    assert scenario.simulated.load_mass is None


@pytest.mark.parametrize(
    ("errors", "field", "value", "remedy"),
    [
        ("medium", "errors", "medium", "light"),
        ("3", "errors", "3", "text"),
        ("[1]", "errors", "[1]", "text"),
        ("{system.load_mass: 1}", "errors.system.load_mass", "1", "simulated"),
        ("{simulated.load_mas: 1}", "simulated.load_mas", "1", "did you mean load_mass"),
        ("{simulated.load_mass: -1}", "simulated.load_mass", "-1", "greater than zero"),
        ("{simulated.load_mass: [1, 2]}", "simulated.load_mass", "[1, 2]", "a number"),
        ("{simulated.load_mass: !Uniform {min: 2, max: 1}}", "load_mass.min", "2", "at most max"),
        ("{simulated.load_mass: !Uniform {min: -1, max: 3}}", "load_mass", "-1", "greater"),
        ("{simulated.load_mass: !Gaussian {mean: 1, stddev: -1}}", "stddev", "-1", "from 0 on"),
        ("{load_feedback.position_noise: 0.1}", "load_feedback", "0.1", "NoisyFeedback"),
        ("{wind.velocity: [1, 0, 0]}", "wind.velocity", "[1, 0, 0]", "SteadyWind"),
        ("{1: 2}", "errors.1", "2", "simulated"),
        ("!Foo {}", "errors", "_tag", "simulated.load_mass"),
    ],
)
def test_what_is_no_error_of_the_plant_is_refused(errors, field, value, remedy):
    with pytest.raises(ScenarioError) as error:
        load_scenario("quintic", [f"errors={errors}"])
    for word in (field, value, remedy):
        assert word in str(error.value)
    assert "\n" not in str(error.value)


def test_check_flies_them_in_seeds_and_once_without_them():
    short = ["simulation_duration=1", "optimization_layer=ConstantParameters"]
    scenario = load_scenario("quintic", [*short, "errors=light"])
    found = check_scenario(scenario, seeds=2, tries_remedies=False)
    assert [flight.name for flight in found.flights] == ["as stated", "seed +1"]
    assert found.nominal is not None
    values = [flight.margins[0].value for flight in (*found.flights, found.nominal)]
    assert len({*values}) == 3


@pytest.mark.slow
def test_the_command_flies_what_is_drawn_in_each_seed(tmp_path, capsys):
    short = ["simulation_duration=0.5", "optimization_layer=ConstantParameters"]
    arguments = ["check", "quintic", "--seeds", "3", "--out", str(tmp_path), "--set", *short]
    main([*arguments, "errors=rough", "optimization_layer.speed_bound=3"])
    told = json.loads((tmp_path / "check.json").read_text())
    assert len({flight["margins"][0]["value"] for flight in told["flights"]}) == 4
    assert load_scenario(tmp_path / "scenario.yaml").errors == "rough"


@pytest.mark.slow
def test_a_study_takes_them_as_a_factor():
    short = ["simulation_duration=0.5", "optimization_layer=ConstantParameters"]
    factors = {"errors": ["none", "light", "rough"]}
    done = study(load_scenario("line", short), factors, [0, 1], executor=SerialExecutor())
    assert [*done.table["errors"]] == ["none"] * 2 + ["light"] * 2 + ["rough"] * 2
    mass = done.table["errors.load_mass"]
    assert mass[:2].isna().all()
    assert mass[4:].to_numpy() == pytest.approx(3 * mass[2:4].to_numpy())
