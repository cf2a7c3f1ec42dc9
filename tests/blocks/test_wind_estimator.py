"""What the controllers believe of the wind, and how far an observer's estimate is off."""

import numpy as np
import pytest
from helpers import fix, model, output
from pydrake.systems.analysis import Simulator

from drake_nonstop import load_scenario, simulate_many
from drake_nonstop.blocks.wind_estimator import (
    LoadAnemometer,
    LoadAnemometerConfig,
    WindObserver,
    WindObserverConfig,
)

PERIOD = 0.05  # s
QUIET = {"airspeed_noise": 0.0}


def test_each_carriers_wind_is_followed_beside_the_mean():
    """Of gusts (1 − exp(−t/T_i)) and of their mean (1 − exp(−t/T)), from calm air on."""
    block = WindObserver(
        model(3, PERIOD), WindObserverConfig(time_constant=4.0, carrier_time_constant=1.0, **QUIET)
    )
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    fix(block, context, wind=np.zeros(9))
    simulator.Initialize()
    winds = np.array([[3.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0]])
    fix(block, context, wind=winds.ravel())
    simulator.AdvanceTo(2.0)
    mean = (1 - np.exp(-2 / 4)) * winds.mean(axis=0)
    np.testing.assert_allclose(output(block, context, "wind_estimate"), mean, atol=0.02)
    gusts = output(block, context, "carrier_gust_estimate").reshape(3, 3)
    np.testing.assert_allclose(gusts, (1 - np.exp(-2)) * winds - mean, atol=0.03)


def test_an_anemometer_tells_the_wind_at_the_load_and_that_of_each_carrier_beyond_it():
    """(1 − exp(−t/T)) of the load's wind, (1 − exp(−t/T_i)) of each carrier's."""
    fields = {"time_constant": 2.0, "carrier_time_constant": 1.0, "noise": 0.0, **QUIET}
    block = LoadAnemometer(model(3, PERIOD), LoadAnemometerConfig(**fields))
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    fix(block, context, load_wind=np.zeros(3), wind=np.zeros(9))
    simulator.Initialize()
    winds, at_load = np.array([[3.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0]]), np.array([0.5, 1.0, -2.0])
    fix(block, context, wind=winds.ravel(), load_wind=at_load)
    simulator.AdvanceTo(2.0)
    expected = (1 - np.exp(-2 / 2)) * at_load
    np.testing.assert_allclose(output(block, context, "wind_estimate"), expected, atol=0.02)
    gusts = output(block, context, "carrier_gust_estimate").reshape(3, 3)
    np.testing.assert_allclose(gusts, (1 - np.exp(-2)) * winds - expected, atol=0.04)


@pytest.mark.slow
def test_noise_of_an_anemometer_passes_with_its_time_constant():
    """White noise ν held for samples of h leaves ν² h/(2 T), for h much below T (Lyapunov)."""
    fields = {"time_constant": 1.0, "noise": 0.5, "airspeed_noise": 0.0, "seed": 4}
    block = LoadAnemometer(model(4, PERIOD), LoadAnemometerConfig(**fields))
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    fix(block, context, load_wind=np.ones(3), wind=np.ones(12))
    simulator.Initialize()
    found = []
    for time in np.arange(5.0, 205.0, 1.0):
        simulator.AdvanceTo(time)
        found.append(output(block, context, "wind_estimate").copy())
    assert np.mean(found) == pytest.approx(1.0, abs=0.04)
    expected = 0.5 * np.sqrt(PERIOD / 2)
    assert np.std(found) == pytest.approx(expected, rel=0.15)


@pytest.mark.slow
def test_a_loop_starts_with_what_its_carriers_observe():
    """The estimate at t = 0 is the carriers' mean wind, and repeats to the bit."""
    overrides = ["wind_estimator=WindObserver", "simulation_duration=0.4"]
    scenario = load_scenario("aircraft_co_rotating_gusty", overrides)
    runs = simulate_many([scenario] * 2)
    estimate, wind = (runs[0].signal(name) for name in ("wind_estimate", "wind"))
    np.testing.assert_allclose(estimate[0], wind[0].reshape(4, 3).mean(axis=0), rtol=1e-12)
    np.testing.assert_array_equal(*(run.signal("wind_estimate") for run in runs))
    assert runs[0].engine.startswith("compiled")
