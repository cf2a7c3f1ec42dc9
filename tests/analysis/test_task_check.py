"""The check of a task against its runs: what one refuses or misses the other does."""

import copy
import dataclasses

import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop import compute_metrics, load_scenario, simulate
from drake_nonstop.analysis import formation
from drake_nonstop.analysis.sampled_growth import SampledGrowth
from drake_nonstop.analysis.speed_check import check_speeds
from drake_nonstop.analysis.task import task_of
from drake_nonstop.analysis.task_check import check_task, task_dictionary, task_table
from drake_nonstop.mechanics.signals import Parameters
from drake_nonstop.planning.limits import LIMITS
from drake_nonstop.run.run_quantities import RunQuantities

# Beyond what any plan of so many seconds keeps, and what is within reach.
MISSED = {
    "min_tension": (0.5, 20.0, 2.0),  # that which takes least time is tried first
    "max_tension": (0.5, 2.45, 6.0),
    "max_speed": (3.0, 0.6, 1.5),
    "min_separation": (3.0, 1.9, 0.8),
}


def quintic(*overrides, duration=0.5):
    return load_scenario("quintic", [f"simulation_duration={duration}", *overrides])


@pytest.mark.parametrize("field", nightly_beyond(1, "studies", MISSED))
def test_a_limit_that_no_plan_keeps_is_not_sound(field):
    duration, beyond, within = MISSED[field]
    found = check_task(quintic(f"optimization_layer.{field}={beyond}", duration=duration))
    assert not found.is_sound
    assert found.speeds.is_feasible
    assert found.formation.is_stable
    (missed,) = found.speeds.missed
    assert missed.limit.field == field
    verdict = found.verdicts[-1]
    assert verdict.startswith(f"optimization_layer.{field} = {beyond:g}: it cannot be kept: ")
    assert missed.limit.field in task_table(found)
    assert not task_dictionary(found)["limits"]["are_kept"]
    # What helps, and a limit that does not bind, are sound.
    helps = verdict.split("; give ")[1]
    for override in (helps, f"optimization_layer.{field}={within}"):
        kept = check_speeds(task_of(quintic(override, duration=duration)))
        assert (kept.missed, len(kept.limits)) == ((), 1)


@pytest.mark.nightly("studies")
@pytest.mark.parametrize("field", MISSED)
def test_what_the_check_says_cannot_be_kept_is_missed_in_flight(field):
    duration, beyond, _ = MISSED[field]
    scenario = quintic(f"optimization_layer.{field}={beyond}", duration=duration)
    metrics = compute_metrics(simulate(scenario))
    assert metrics["outcome"] == "limit_missed"
    assert f"optimization_layer.{field}: {beyond:g}" in metrics["reasons"][0]


@pytest.fixture(scope="module")
def kept():
    return check_task(quintic("optimization_layer.max_speed=1.5", duration=2), tries_remedies=False)


def with_least(found, ratio):
    speeds = found.speeds
    ratios = speeds.ratios * (ratio / speeds.least)
    return dataclasses.replace(found, speeds=speeds._replace(ratios=ratios))


def with_growth(found, growth):
    formation = found.formation._replace(sampled=SampledGrowth(growth, 0.0, 1.0))
    return dataclasses.replace(found, formation=formation)


def with_share(found, share):
    motion = copy.copy(found.motion)
    vars(motion)["least_load"] = motion.least_load._replace(share=share)
    return dataclasses.replace(found, motion=motion)


def with_limit(found, stated):
    (limit,) = found.speeds.limits
    limits = (limit._replace(stated=limit.worst * stated),)
    return dataclasses.replace(found, speeds=found.speeds._replace(limits=limits))


@pytest.mark.parametrize(
    ("change", "sound", "in_doubt", "neither", "verdict"),
    [
        (with_least, 1.015, 1.013, 0.999, 0),
        (with_growth, 4.4, 8.0, 12.0, 1),
        (with_share, 0.01, -0.01, -0.03, 1),
        (with_limit, 1.001, 0.98, 0.95, -1),
    ],
)
def test_what_is_missed_by_little_is_in_doubt(kept, change, sound, in_doubt, neither, verdict):
    assert (kept.is_sound, kept.is_in_doubt) == (True, False)
    found = change(kept, sound)
    assert (found.is_sound, found.is_in_doubt) == (True, False)
    doubted = change(kept, in_doubt)
    assert doubted.is_in_doubt
    assert "a flight alone tells" in doubted.verdicts[verdict]
    found = change(kept, neither)
    assert (found.is_sound, found.is_in_doubt) == (False, False)
    assert "a flight alone tells" not in found.verdicts[verdict]
    # What is missed by more, besides, leaves no doubt.
    assert not with_growth(doubted, 20.0).is_in_doubt


def test_growth_in_samples_is_looked_at_more_closely(monkeypatch):
    def grows(*arguments, phases=24):
        return SampledGrowth(5.0 if phases == 24 else 4.0, 0.0, 1.0)

    monkeypatch.setattr(formation, "growth_on_the_way", grows)
    found = formation.find_formation(task_of(quintic()), count=2)
    assert found.sampled.growth == 4.0
    assert found.is_stable


def test_limits_of_aircraft_are_judged_along_the_plan_too():
    given = ["simulation_duration=3", "optimization_layer.max_bank=0.2"]
    task = task_of(load_scenario("aircraft_transfer_rising_wind", given))
    found = check_speeds(task, is_quick=True)
    assert [each.limit.field for each in found.missed] == ["max_bank"]


@pytest.mark.nightly("studies")
def test_a_load_that_turns_with_its_aircraft_is_judged_at_the_rates_of_its_layer(fleet):
    scenario = load_scenario("aircraft_co_rotating_rising_wind")
    run, _ = fleet.evaluated(scenario)
    task = task_of(scenario)
    flown = Parameters.view(run.signal("parameters")).frequency[:, 0]
    predicted = [task.turn.planned(time)[1] for time in run.time]
    np.testing.assert_allclose(predicted, flown, rtol=5e-3)
    found = check_speeds(task)
    assert found.is_feasible
    least = RunQuantities(run).aircraft_state.airspeed.min()
    assert found.least * found.speed_bound == pytest.approx(least, rel=0.01)
    assert {each.limit.field for each in found.limits} > {"max_lift_share", "max_bank"}
    strict = dataclasses.replace(task, limits=dataclasses.replace(task.limits, max_bank=0.05))
    assert [each.limit.field for each in check_speeds(strict).missed] == ["max_bank"]


def test_a_layer_without_a_bound_has_a_plan_where_it_has_limits():
    without = check_speeds(task_of(quintic("optimization_layer.speed_bound=0")))
    assert (without.plan, without.limits) == (None, ())
    limited = ("optimization_layer.speed_bound=0", "optimization_layer.max_speed=0.9")
    found = check_speeds(task_of(quintic(*limited)))
    assert found.plan is not None
    assert not found.missed
    assert found.limits[0].worst <= 0.9


def test_every_limit_of_the_table_is_said_where_it_is_asked_for():
    assert {limit.field for limit in LIMITS if not limit.is_of_aircraft} == set(MISSED)
