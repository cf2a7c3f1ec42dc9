"""Whether a task's bound can be kept."""

import numpy as np
import pytest

from drake_nonstop.analysis import speed_check
from drake_nonstop.analysis.speed_check import (
    check_speeds,
    constant_speeds,
    feasible_speeds,
    find_speed_remedies,
    problem_of,
    set_over_time,
)
from drake_nonstop.analysis.task import task_of
from drake_nonstop.scenario.loading import load_scenario


def test_speeds_over_an_orbit_are_those_of_the_carriers_there():
    """The tables over all phases, and the carriers' motion itself, on a load that rests."""
    rest = ["load_trajectory.displacement=[0, 0, 0]", "load_trajectory.roll_pitch_yaw=[0, 0, 0]"]
    task = task_of(load_scenario("quintic", rest))
    turn = 2 * np.pi / task.limits.frequency
    least = constant_speeds(task, np.linspace(0, turn, 25)).min()
    times = np.zeros(1)
    found = feasible_speeds(
        problem_of(task), task, times, task.nominal[:1, None], task.nominal[1:, None]
    )
    assert found[0, 0, 0] == pytest.approx(least, rel=2e-3)


def test_a_wind_adds_its_square_to_the_mean_of_squared_airspeeds():
    """Above a load at rest, over a turn, over which carriers move on the average nowhere."""
    squares = []
    for wind in ([], ["wind=!SteadyWind {velocity: [2, -1, 0]}"]):
        given = ["system.load_drag=0", "optimization_layer=ConstantParameters", *wind]
        task = task_of(load_scenario("aircraft_rest", given))
        turn = 2 * np.pi / task.limits.frequency
        times = np.linspace(0, turn, 24, endpoint=False)
        squares.append((constant_speeds(task, times) ** 2).mean(axis=0))
    np.testing.assert_allclose(squares[1] - squares[0], 5.0, rtol=1e-6)


def test_a_wind_that_does_not_count_changes_no_speeds_over_ground():
    speeds = []
    for wind in ([], ["wind=!SteadyWind {velocity: [2, -1, 0]}"]):
        task = task_of(load_scenario("quintic", ["system.load_drag=0", *wind]))
        assert not task.counts_wind
        speeds.append(constant_speeds(task, np.linspace(0, task.duration, 5)))
    np.testing.assert_allclose(speeds[1], speeds[0], rtol=1e-12)


def test_the_set_over_time_is_shown_over_a_range_even_where_there_is_one_value():
    bounds = "optimization_layer.frequency_bounds=[2, 2]"
    task = task_of(load_scenario("quintic", [bounds, "simulation_duration=1"]))
    times, values, ratios = set_over_time(task, check_speeds(task, is_quick=True), 0, count=3)
    assert np.all(np.diff(values) > 0)
    assert ratios.shape == (len(times), len(values)) == (3, 3)


def test_a_bound_that_is_kept_and_one_out_of_reach():
    tight = [
        "optimization_layer.frequency_bounds=[0.1, 2.2]",
        "optimization_layer.amplitude_bounds=[0.1, 1.3]",
        "simulation_duration=6",
    ]
    kept = check_speeds(task_of(load_scenario("quintic", ["simulation_duration=6"])))
    assert kept.is_feasible
    assert len(kept.tight_times) == 0
    missed = check_speeds(
        task_of(load_scenario("quintic", [*tight, "optimization_layer.speed_bound=1.0"])),
        is_quick=True,
    )
    assert missed.least < 0.7
    assert len(missed.tight_times) > 0


@pytest.fixture
def coarse(monkeypatch):
    """Speeds of constant parameters every 0.05 s, of orbits of 3 s and more."""
    monkeypatch.setattr(speed_check, "_FINE", 0.05)


@pytest.mark.usefixtures("coarse")
def test_constant_parameters_miss_a_bound_and_slower_motion_keeps_it():
    fields = "speed_bound: 0.6, frequency: 2.0, amplitude: 1.2"
    given = [f"optimization_layer=!ConstantParameters {{{fields}}}", "simulation_duration=8"]
    task = task_of(load_scenario("quintic", given))
    found = check_speeds(task)
    assert not found.is_feasible
    assert found.plan is None
    assert check_speeds(task.slowed(4.0)).is_feasible


def test_a_task_without_a_bound_is_feasible():
    task = task_of(
        load_scenario("quintic", ["optimization_layer.speed_bound=0", "simulation_duration=6"])
    )
    assert check_speeds(task).is_feasible


def test_the_wind_of_a_check_is_the_mean_when_it_has_risen():
    rising = "{gust: 0.2, velocity: [4, 0, 0], start_time: 2, rise_time: 4}"
    settings = [f"wind=!GustyWind {rising}", "wind_estimator=NoWind"]
    scenario = load_scenario("aircraft_transfer", settings)
    task = task_of(scenario)
    np.testing.assert_allclose(task.wind, [4, 0, 0], rtol=1e-12)
    assert task.wind_at(1.0)[0] == 0
    assert task.wind_at(4.0)[0] == pytest.approx(2)
    assert task.wind_at(9.0)[0] == 4
    np.testing.assert_allclose(task.counted_wind(9.0), task.wind_at(9.0))
    np.testing.assert_allclose(task.planned_wind(9.0), [0, 0, 0])


@pytest.mark.usefixtures("coarse")
def test_where_a_layer_helps_bounds_that_it_has_are_not_named():
    fields = "speed_bound: 0.5, frequency: 1.6, amplitude: 1.2"
    given = [f"optimization_layer=!ConstantParameters {{{fields}}}", "simulation_duration=3"]
    task = task_of(load_scenario("three_carriers", given))
    found = check_speeds(task)
    assert not found.is_feasible
    first, *others = find_speed_remedies(task, found)
    assert "a layer that changes xi and A" in first.text
    assert others
    assert not any("bounds" in remedy.text for remedy in others)
