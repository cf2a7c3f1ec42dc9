"""The metrics and the figure of aircraft, on an orbit whose figures a prototype has published."""

import numpy as np
import pytest
from aircraft_runs import FREQUENCY, aircraft_run

from drake_nonstop.blocks.optimization_layer import ConstantParametersConfig
from drake_nonstop.mechanics.signals import AircraftState
from drake_nonstop.run.metrics import METRICS, compute_metrics, flattened, metrics_table
from drake_nonstop.run.run_quantities import RunQuantities
from drake_nonstop.view.run_figures import figure_names

PATHS = {metric.path for metric in METRICS if metric.path.startswith("aircraft.")}
TURN = 2 * np.pi / FREQUENCY


@pytest.fixture
def run():
    return aircraft_run(TURN)


def test_an_orbit_has_the_published_figures(run):
    """150 m cables, 10 kg, four aircraft of 6 kg: as an independent prototype found them."""
    metrics = compute_metrics(run)
    aircraft = metrics["aircraft"]
    assert aircraft["lift_share_max"] == pytest.approx(0.56, abs=0.005)
    assert aircraft["airspeed_min_m_s"] == pytest.approx(13.6, abs=0.05)
    assert aircraft["airspeed_over_stall_min"] == pytest.approx(13.6 / 8.4, abs=0.02)
    assert np.degrees(aircraft["bank_max_rad"]) == pytest.approx(33, abs=0.5)
    assert aircraft["thrust_min_N"] == pytest.approx(4.5, abs=0.25)  # its cables stretch
    assert aircraft["thrust_max_N"] == pytest.approx(23, abs=0.5)
    assert aircraft["power_mean_W"] == pytest.approx(225, abs=1)
    assert aircraft["energy_Wh_per_kg_km"] is None  # nothing is moved
    assert aircraft["saturated_share"] == 0
    assert metrics["carriers"]["separation_min_m"] == pytest.approx(20.7, abs=0.15)


def test_the_energy_is_that_of_all_batteries_per_mass_and_distance():
    moving = compute_metrics(aircraft_run(TURN, velocity=(0.75, 1.0, 0.0)))["aircraft"]
    per_kg_m = 4 * moving["power_mean_W"] / (0.65 * 10 * 1.25)  # J, of the battery
    assert moving["energy_Wh_per_kg_km"] == pytest.approx(1e3 * per_kg_m / 3600, rel=1e-12)
    assert moving["energy_Wh_per_kg_km"] == pytest.approx(30, abs=2)  # published
    run = aircraft_run(TURN, velocity=(0.75, 1.0, 0.0))
    rests = run.time > TURN / 2
    run.signal("load_trajectory.reference")[rests, 10:13] = 0
    AircraftState.view(run.signal("aircraft_state")).thrust[rests] = 1e3  # does not count
    half = compute_metrics(run)["aircraft"]["energy_Wh_per_kg_km"]
    assert half == pytest.approx(moving["energy_Wh_per_kg_km"], rel=0.02)


def test_a_windmilling_propeller_gives_no_power_back(run):
    AircraftState.view(run.signal("aircraft_state")).thrust[:] = -5.0
    assert compute_metrics(run)["aircraft"]["power_mean_W"] == 0


def test_the_bound_is_that_of_the_airspeed():
    run = aircraft_run(TURN, wind=(2.0, 0.0, 0.0))
    run.scenario.optimization_layer = ConstantParametersConfig(speed_bound="1.45 V_s")
    metrics = compute_metrics(run)
    least = metrics["aircraft"]["airspeed_min_m_s"]
    bound = 1.45 * np.sqrt(2 * 6 * 9.81 / (1.225 * 0.98 * 1.4))
    airspeeds = AircraftState.view(run.steps["aircraft_state"]).airspeed
    below = np.mean(np.any(airspeeds < bound, axis=1)) * TURN
    assert 0 < metrics["carriers"]["time_below_bound_s"] == pytest.approx(below, abs=0.03)
    assert metrics["carriers"]["speed_min_m_s"] != pytest.approx(least, abs=0.3)


def test_the_saturated_share_is_the_time_with_any_flag(run):
    flags, time = run.steps["command_saturation"], run.steps["time"]
    flags[(time > 2) & (time < 3), 5] = 1
    flags[(time > 2.5) & (time < 4), 11] = 1
    share = compute_metrics(run)["aircraft"]["saturated_share"]
    assert share == pytest.approx(2 / TURN, abs=2e-3)
    del run.steps["command_saturation"]
    assert compute_metrics(run)["aircraft"]["saturated_share"] is None


def test_runs_without_aircraft_have_no_such_group(run):
    assert {path for path in flattened(compute_metrics(run)) if "aircraft" in path} == PATHS
    run.scenario.system.aircraft = None
    assert not RunQuantities(run).has_aircraft
    metrics = compute_metrics(run)
    assert "aircraft" not in metrics
    assert "aircraft" not in metrics_table(metrics)
    assert "aircraft" not in figure_names(run)
