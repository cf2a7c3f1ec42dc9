"""Distances and pulls of cables along a plan, against flights and known motions."""

import math

import pytest
from helpers import regular

from drake_nonstop.analysis.planned_motion import PlannedMotion, find_motion_remedies
from drake_nonstop.analysis.task import task_of
from drake_nonstop.analysis.task_check import check_task, task_dictionary, task_table
from drake_nonstop.run.run_quantities import RunQuantities
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario

REST = "load_trajectory=!RestToRest {move_time: 1}"
CONSTANT = "optimization_layer=!ConstantParameters {frequency: 2, amplitude: 1.2}"
# Cables that are longer than the load is wide, on the paper's cycle: carriers meet at each turn.
MEETING = [REST, CONSTANT, "system.cable_length=2", "pattern=!HamiltonianCycle {phases: []}"]
# One cable of three carries little, and its wave takes more.
PUSHING = [
    "system.attachments=[[0.8624, 0.0896, 0.1021], [-0.0462, 0.8659, -0.009], "
    "[0.0492, -0.8657, -0.2228]]",
    "system.load_mass=2.79",
    "system.cable_length=0.97",
    "pattern=!HamiltonianCycle {phases: []}",
    "optimization_layer.frequency=1.85",
    "optimization_layer.amplitude=4.2",
    "optimization_layer.speed_bound=0.5",
]


def planned(*overrides):
    scenario = load_scenario("quintic", overrides)
    return scenario, task_of(scenario)


@pytest.mark.parametrize("pattern", ["HamiltonianCycle", "!SpreadCarousel {spread: 2}"])
def test_distances_and_pulls_are_those_of_a_flight_with_constant_parameters(pattern):
    scenario, task = planned(CONSTANT, f"pattern={pattern}", "simulation_duration=4")
    motion = PlannedMotion(scenario, task)
    run = RunQuantities(simulate(scenario))
    assert motion.carrier_separation == pytest.approx(run.carrier_separation, rel=2e-3)
    for own, flown in zip(
        motion.closest_cables_for_attachments, run.closest_cables_for_attachments, strict=True
    ):
        assert own == pytest.approx(flown, rel=2e-3)
    assert motion.least_load.tension >= run.tensions.min() * (1 - 1e-3)
    assert motion.reach == run.reach


def test_cables_of_a_carousel_that_cross_are_no_sound_task_and_a_spread_parts_them():
    overrides = [
        REST,
        "pattern=Carousel",
        "simulation_duration=4",
        CONSTANT,
        "system.cable_length=3",
    ]
    scenario, task = planned(*overrides)
    found = check_task(scenario)
    assert found.speeds.is_feasible
    assert found.formation.is_stable
    assert not found.is_sound
    verdict = found.verdicts[2]
    assert verdict.startswith("planned motion = too close: two cables came within ")
    assert "limits.cable_distance" in verdict
    (remedy,) = (text for text in found.motion_remedies if text.startswith("pattern="))
    assert remedy in verdict
    changed, parted = planned(*overrides, remedy)
    assert PlannedMotion(changed, parted).is_flyable
    report = task_dictionary(found)["distances"]
    assert not report["are_apart"]
    assert report["cables_min_m"] < 0.05 * report["attachments_of_these_cables_m"]
    assert "least distance of two cables" in task_table(found)
    # Without a limit nothing collides.
    free, task = planned(*overrides, "limits.cable_distance=0", "limits.carrier_distance=0")
    assert PlannedMotion(free, task).collisions == []


def test_a_cable_that_would_have_to_push_is_told():
    scenario, _ = planned(*PUSHING, "simulation_duration=4")
    found = check_task(scenario, tries_remedies=False)
    assert not found.is_stable
    assert not found.is_sound
    least = found.motion.least_load
    assert least.share < 0
    assert least.elevation < 0
    verdict = found.verdicts[1]
    assert verdict.startswith(f"formation = slack: cable 1 carries {least.share:.2g} of an equal ")
    assert f"t = {least.time:.2f} s" in verdict
    assert f"{abs(math.degrees(least.elevation)):.1f} deg below the horizontal" in verdict
    report = task_dictionary(found)
    assert not report["formation"]["is_stable"]
    assert report["distances"]["least_share"] == least.share


@pytest.mark.nightly("studies")
def test_what_makes_a_cable_pull_is_named():
    scenario, _ = planned(*PUSHING, "simulation_duration=4")
    found = check_task(scenario)
    (amplitude,) = (text for text in found.formation_remedies if "amplitude" in text)
    changed, task = planned(*PUSHING, "simulation_duration=4", amplitude)
    assert PlannedMotion(changed, task).least_load.pulls_up


def test_a_load_on_even_cables_has_known_shares():
    weight, amplitude = 2.0 * 9.81, 1.3
    scenario, task = planned(
        REST,
        "pattern=Carousel",
        f"system.attachments={regular(5, 1.0).tolist()}",
        "system.load_mass=2.0",
        "optimization_layer=!ConstantParameters {frequency: 2, amplitude: 1.3}",
    )
    least = PlannedMotion(scenario, task).least_load
    assert least.share == pytest.approx(1)
    assert least.tension == pytest.approx(math.hypot(weight / 5, amplitude))
    assert least.elevation == pytest.approx(math.atan2(weight / 5, amplitude))


def test_where_nothing_helps_nothing_is_named():
    scenario, task = planned(*MEETING, "limits.carrier_distance=1.9", "simulation_duration=2")
    assert PlannedMotion(scenario, task).collisions[0].startswith("two carriers came within ")
    assert find_motion_remedies(scenario, task) == []


@pytest.mark.parametrize(
    ("obstacle", "top", "lift"),
    [
        ("!Ground {height: -0.1}", -0.1, 1.01 * 0.2),
        # Of what is missing inside, 0.1 m and the clearance, twice as much leads above it.
        ("!Box {size: [0.2, 0.2, 1]}", 0.5, 1.01 * 0.8),
    ],
)
def test_a_path_that_clears_an_obstacle_is_named_and_does(obstacle, top, lift):
    overrides = [REST, CONSTANT, "simulation_duration=1", "limits.clearance=0.3"]
    overrides.append(f"obstacles=[{obstacle}]")
    scenario, task = planned(*overrides)
    (remedy,) = find_motion_remedies(scenario, task)
    assert remedy == f"a load_trajectory that is {lift:g} m higher all the way"
    higher = f"load_trajectory.start_position=[0, 0, {lift}]"
    changed, lifted = planned(*overrides, higher)
    motion = PlannedMotion(changed, lifted)
    assert motion.is_flyable
    assert motion.obstacle_distance() == pytest.approx(lift - top, rel=1e-4)
