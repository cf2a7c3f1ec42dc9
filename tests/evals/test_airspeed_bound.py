"""Aircraft keep their airspeed and their limits in a wind that rises, as ξ and A follow it."""

import numpy as np
import pytest

from drake_nonstop import load_scenario
from drake_nonstop.mechanics.aircraft import stall_speed
from drake_nonstop.mechanics.signals import Parameters
from drake_nonstop.model.system import aircraft_in
from drake_nonstop.run.run_quantities import RunQuantities, load_errors
from drake_nonstop.run.simulate import simulate

NAME = "aircraft_transfer_rising_wind"
TURNING = "aircraft_co_rotating_rising_wind"
SHARE = 1.4  # of the stall speed


def test_the_layer_keeps_airspeed_lift_and_bank_in_a_rising_wind(fleet):
    scenario = load_scenario(NAME)
    run, metrics = fleet.evaluated(scenario)
    bound = SHARE * stall_speed(aircraft_in(scenario.system))
    assert RunQuantities(run).aircraft_state.airspeed.min() >= bound
    assert metrics["carriers"]["time_below_bound_s"] == 0
    saturation = run.steps["command_saturation"].reshape(len(run.steps["time"]), 3, -1)
    assert not (saturation[:, :2] > 0.5).any()  # C_L and bank
    assert np.mean(np.linalg.norm(load_errors(run)[0], axis=1)) <= 0.05
    # Nothing changes in little wind; then ξ and A grow.
    parameters = Parameters.view(run.signal("parameters"))
    little, full = run.time < 15, run.time > 70
    for values, nominal in ((parameters.frequency, 0.595), (parameters.amplitude, 1.0)):
        np.testing.assert_allclose(values[little], nominal, rtol=1e-3)
        assert values[full].mean() > 1.002 * nominal
    assert metrics["optimizer"]["relaxed"] == metrics["optimizer"]["held"] == 0


@pytest.mark.nightly("flights")
def test_a_load_turns_faster_as_the_wind_rises(fleet):
    run, metrics = fleet.evaluated(load_scenario(TURNING))
    bound = 1.5 * stall_speed(aircraft_in(run.scenario.system))
    assert RunQuantities(run).aircraft_state.airspeed.min() >= bound
    assert metrics["optimizer"]["relaxed"] == metrics["optimizer"]["held"] == 0
    rates = Parameters.view(run.signal("parameters")).frequency
    assert rates[run.time < 10].max() == 0.28
    assert rates[-1, 0] > 1.1 * 0.28


@pytest.mark.nightly("flights")
def test_a_load_that_turns_at_a_fixed_rate_misses_the_bound():
    fixed = [
        "optimization_layer=!ConstantParameters {frequency: 0.28, amplitude: 0.0}",
        "load_trajectory=!SteadyTurn {yaw_rate: 0.28}",
        *("simulation_duration=6", "wind.start_time=0", "wind.rise_time=0"),
    ]
    run = simulate(load_scenario(TURNING, fixed))
    bound = 1.5 * stall_speed(aircraft_in(run.scenario.system))
    assert RunQuantities(run).aircraft_state.airspeed.min() < 0.86 * bound


@pytest.mark.nightly("flights")
def test_without_the_layer_the_bound_is_missed():
    """By a tenth, at the end of the way in the full wind with the ξ and A of calm air."""
    at_end = [
        "optimization_layer=ConstantParameters",
        "simulation_duration=12",
        "load_trajectory.displacement=[0, 0, 0]",
        "wind.start_time=0",
        "wind.rise_time=0",
    ]
    run = simulate(load_scenario(NAME, at_end))
    bound = SHARE * stall_speed(aircraft_in(run.scenario.system))
    assert RunQuantities(run).aircraft_state.airspeed.min() < 0.93 * bound
