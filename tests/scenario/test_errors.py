"""Errors that a scenario states as data: sets and mappings, drawn into its plant and blocks."""

import dataclasses

import numpy as np
import pytest

from drake_nonstop import (
    SerialExecutor,
    check_scenario,
    dump_scenario,
    load_scenario,
    parse_scenario,
    scenario_names,
    study,
)

MAPPING = (
    "errors={simulated.load_mass: !Uniform {min: 0.9, max: 1.1}, simulated: {cable_length: "
    "[0.8, 0.8, !Uniform {min: 0.79, max: 0.81}, 0.8]}, wind: !SteadyWind {velocity: [0.5, 0, 0]}}"
)


# As the page has them: shares of the load's mass, of its width, of it for each attachment, of
# cables' lengths and stiffness; the wind, the noise of a position and with aircraft, the delay.
SIZES = {
    "light": (0.05, 0.01, 0.005, 0.002, 0.1, 0.5, 0.0005, 0.02, 0.04),
    "rough": (0.15, 0.03, 0.015, 0.006, 0.3, 1.0, 0.0015, 0.06, 0.12),
}


@pytest.mark.parametrize("errors", SIZES)
@pytest.mark.parametrize("name", ["quintic", "three_carriers", "aircraft_rest_cables"])
def test_a_set_is_drawn_within_its_sizes(errors, name):
    share, centre, places, length, cable, wind, noise, of_aircraft, delay = SIZES[errors]
    scenario = load_scenario(name, [f"errors={errors}"])
    system, drawn = scenario.system, []
    for k in range(8):
        plant = dataclasses.replace(scenario, random_seed=k).sampled()
        assert plant.errors == "none"
        assert plant.sampled() is plant
        simulated, width = plant.simulated, np.ptp(system.attachments, axis=0).max()
        mass = simulated.load_mass / system.load_mass - 1
        lengths = np.array(simulated.cable_length) / system.cable_length - 1
        stiffness = simulated.cable_stiffness / system.cable_stiffness - 1
        off = np.array(simulated.attachments) - system.attachments
        assert abs(mass) <= share
        assert np.all(np.abs(lengths) <= length)
        assert 0 < abs(stiffness) <= cable
        assert 0 < np.abs(off[:, :2]).max() < 2 * (centre + places) * width
        assert np.linalg.norm(plant.wind.velocity) == pytest.approx(wind)
        is_aircraft = system.aircraft is not None
        assert plant.load_feedback.position_noise == (of_aircraft if is_aircraft else noise)
        assert plant.load_feedback.delay == pytest.approx(delay * is_aircraft)
        drawn.append([mass, *lengths, *off.ravel()])
    assert len({*map(tuple, drawn)}) == 8
    assert scenario.sampled() == scenario.sampled()


@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_takes_every_set(name):
    for errors in SIZES:
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
    assert scenario.simulated.load_mass is None


@pytest.mark.slow
def test_check_flies_them_in_seeds_and_once_without_them():
    short = ["simulation_duration=1", "optimization_layer=ConstantParameters"]
    scenario = load_scenario("quintic", [*short, "errors=light"])
    found = check_scenario(scenario, seeds=2, tries_remedies=False)
    assert [flight.name for flight in found.flights] == ["as stated", "seed +1"]
    assert found.nominal.scenario.simulated == load_scenario("quintic").simulated
    values = [flight.margins[0].value for flight in (*found.flights, found.nominal)]
    assert len({*values}) == 3


@pytest.mark.slow
def test_a_study_takes_them_as_a_factor():
    short = ["simulation_duration=0.5", "optimization_layer=ConstantParameters"]
    factors = {"errors": ["none", "light", "rough"]}
    done = study(load_scenario("line", short), factors, [0, 1], executor=SerialExecutor())
    assert [*done.table["errors"]] == ["none"] * 2 + ["light"] * 2 + ["rough"] * 2
    mass = done.table["errors.load_mass"]
    assert mass[:2].isna().all()
    assert mass[4:].to_numpy() == pytest.approx(3 * mass[2:4].to_numpy())
