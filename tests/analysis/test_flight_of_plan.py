"""What aircraft need along a plan, against the resting orbit and against flights."""

import dataclasses
import functools
import re

import numpy as np
import pytest
from drawn_tasks import aircraft_task
from helpers import nightly_beyond

from drake_nonstop import load_scenario
from drake_nonstop.analysis.aircraft_margins import aircraft_margins
from drake_nonstop.analysis.flight_envelope import FlightEnvelope, flight_envelope_of
from drake_nonstop.analysis.sampled_growth import SampledGrowth
from drake_nonstop.analysis.speed_check import check_speeds
from drake_nonstop.analysis.task import task_of
from drake_nonstop.analysis.task_check import check_task, flight_of_plan
from drake_nonstop.mechanics.aircraft import stall_speed
from drake_nonstop.mechanics.signals import AircraftState
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.overrides import changed

# One whose aircraft need more lift than they have at the end of the way, of a layer that does not
# know of it.
BEYOND = 4148
AT_REST = ["load_trajectory.start_time=1000", "simulation_duration=22"]  # two turns
BLIND = ["optimization_layer.max_lift_share=.inf", "optimization_layer.max_bank=.inf"]


@functools.cache
def check_at_rest():
    return check_task(load_scenario("aircraft_rest", AT_REST))


def flight(scenario):
    task = task_of(scenario)
    return flight_of_plan(task, check_speeds(task), flight_envelope_of(scenario))


TURNING = ["simulation_duration=16"]
ANOTHER_PLANT = [
    *("simulated.load_mass=8", "simulated.load_drag=1", "simulated.cable_stiffness=90"),
    "wind=!SteadyWind {velocity: [1, 0, 0]}",
]


@pytest.mark.parametrize(
    ("name", "overrides"),
    nightly_beyond(
        2,
        "flights",
        [
            ("aircraft_rest", AT_REST),
            ("aircraft_rest", [*AT_REST, *ANOTHER_PLANT]),
            ("aircraft_co_rotating", TURNING),
            ("aircraft_co_rotating", [*TURNING, *ANOTHER_PLANT]),
        ],
    ),
)
def test_at_rest_the_needs_are_those_of_the_resting_orbit(name, overrides):
    scenario = load_scenario(name, overrides)
    found = check_at_rest().flight if overrides is AT_REST else flight(scenario)
    expected = aircraft_margins(scenario)
    for margin, resting in zip(found.margins, expected.margins, strict=False):
        assert margin.name == resting.name
        assert margin.value == pytest.approx(resting.value, rel=2e-3, abs=1e-3)
        assert margin.limit == pytest.approx(resting.limit, rel=5e-3)


def test_a_load_that_turns_at_a_planned_rate_turns_steadily_until_its_layer_changes_it():
    """To the rounding of a sum of angles."""
    planned = load_scenario("aircraft_co_rotating_rising_wind", ["simulation_duration=8"])
    steady = load_scenario("aircraft_co_rotating", ["load_trajectory.yaw_rate=0.28"])
    of_planned, of_steady = (task_of(scenario).reference(7.0) for scenario in (planned, steady))
    np.testing.assert_allclose(of_planned, of_steady, rtol=0, atol=1e-13)
    assert flight(planned).is_flyable


def test_the_needs_on_the_way_are_those_that_are_flown(fleet):
    """C_L, bank and airspeed within 1 %, thrust 4 %."""
    found = flight(load_scenario("aircraft_transfer", ["simulation_duration=20"]))
    assert_flown(found, fleet.run("aircraft_transfer"), 0.01)


@pytest.mark.nightly("flights")
@pytest.mark.parametrize("mass", [8, 13])
def test_so_they_are_of_a_load_that_the_controllers_do_not_know(mass):
    """C_L, bank and airspeed within 2 %, thrust 4 %."""
    overrides = ["simulation_duration=30", f"simulated.load_mass={mass}"]
    scenario = load_scenario("aircraft_transfer", overrides)
    run = simulate(scenario, engine="compiled")
    assert_flown(flight(scenario), run, 0.02)


def assert_flown(found, run, tolerance):
    """Each limit's needs are flown at its tightest instant."""
    state = AircraftState.view(run.signal("aircraft_state"))
    aircraft = task_of(run.scenario).flown.aircraft
    flown = {
        "C_L / C_Lmax": state.lift / aircraft.max_lift,
        "airspeed / stall speed": state.airspeed / stall_speed(aircraft),
        "bank": np.abs(state.bank),
        "thrust": state.thrust,
    }
    for margin, time in zip(found.margins, found.times, strict=True):
        if margin.name in flown:
            at = np.argmin(np.abs(run.time - time))
            value = flown[margin.name][at, margin.carriers[0] - 1]
            share = 0.04 * margin.limit if margin.name == "thrust" else tolerance * margin.value
            assert margin.value == pytest.approx(value, abs=abs(share)), margin.name


def assert_beyond(blind):
    assert not blind.is_flyable
    assert "C_L / C_Lmax 1.00 (at most 0.90) at t = 30.8 s, carrier 4" in blind.verdict


def test_limits_that_are_missed_are_told_with_where_and_by_whom():
    found = check_at_rest()
    task = task_of(load_scenario("aircraft_co_rotating", ["simulation_duration=6"]))
    missed = flight_of_plan(task, check_speeds(task), FlightEnvelope(lift_share=0.3))
    assert not missed.is_flyable
    assert re.search(
        r"C_L / C_Lmax 0\.\d\d \(at most 0\.30\) at t = \d\.\d s, carrier \d", missed.verdict
    )
    assert found.flight.is_flyable


def test_what_is_missed_for_a_short_time_is_in_doubt():
    task = task_of(load_scenario("aircraft_rest", AT_REST))
    speeds = check_speeds(task)
    (bank,) = (each for each in check_at_rest().flight.margins if each.name == "bank")
    short = FlightEnvelope(bank=0.9998 * bank.value)
    told = flight_of_plan(task, speeds, short)
    assert told.is_flyable
    assert told.is_in_doubt
    assert not check_at_rest().flight.is_in_doubt
    assert 0 < told.missed_share < short.saturated_share
    assert re.search(
        r"need more than their limits for \d\S* % of the time: bank .*; whether feedback",
        told.verdict,
    )
    assert not flight_of_plan(task, speeds, short._replace(saturated_share=0.0)).is_flyable
    little = told._replace(missed_share=0.3 * short.saturated_share)
    assert (little.is_flyable, little.is_in_doubt) == (True, False)
    assert little.verdict.endswith("; feedback makes up for so little")
    gusty = told._replace(missed_share=0.0, gust=1.5)
    assert gusty.is_in_doubt
    assert gusty.verdict.endswith("in gusts of 1.5 m/s a flight alone tells")
    assert not flight_of_plan(task, speeds, FlightEnvelope(bank=0.8 * bank.value)).is_flyable
    assert not told._replace(
        ranges=told.ranges._replace(lift_share=(0.5, 1.0))
    ).is_flyable  # stalls


@pytest.mark.nightly("studies")
def test_a_way_beyond_the_aircraft_is_told_of_the_whole_task_and_the_layer_may_avoid_it():
    scenario = aircraft_task(BEYOND)
    assert_beyond(flight(changed(scenario, BLIND)))
    lift = flight(scenario).margins[0]
    assert lift.name == "C_L / C_Lmax"
    assert 0.8 < lift.value <= 0.9


def test_a_check_is_not_sound_where_the_way_cannot_be_flown():
    found = check_at_rest()
    assert found.is_sound
    assert found.verdicts[-1] == found.flight.verdict
    beyond = found.flight._replace(missed_share=0.2)
    assert not dataclasses.replace(found, flight=beyond).is_sound
    unknown = found.formation._replace(sampled=SampledGrowth())  # with a block of one's own
    _, of_formation, *_ = dataclasses.replace(found, formation=unknown).verdicts
    assert "the formation is stable" not in of_formation
    assert "may make the loop unstable" in of_formation
