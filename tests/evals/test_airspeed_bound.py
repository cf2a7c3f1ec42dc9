"""Aircraft keep their airspeed and their limits in a wind that rises, as ξ and A follow it."""

import numpy as np
import pytest

from drake_nonstop import load_scenario, simulate
from drake_nonstop.mechanics.aircraft import stall_speed
from drake_nonstop.mechanics.signals import Parameters
from drake_nonstop.model.system import aircraft_in
from drake_nonstop.run.run_quantities import RunQuantities

NAME, TURNING = "aircraft_transfer_rising_wind", "aircraft_co_rotating_rising_wind"
SHARES = {NAME: 1.4, TURNING: 1.5}  # of the stall speed


def least_share(run):
    """The least airspeed of a run in units of its bound."""
    bound = SHARES[run.scenario.name] * stall_speed(aircraft_in(run.scenario.system))
    return RunQuantities(run).aircraft_state.airspeed.min() / bound


def test_the_layer_keeps_airspeed_lift_and_bank_in_a_rising_wind(fleet):
    run, metrics = fleet.evaluated(NAME)
    assert least_share(run) >= 1
    assert metrics["carriers"]["time_below_bound_s"] == 0
    saturation = run.steps["command_saturation"].reshape(len(run.steps["time"]), 3, -1)
    assert not (saturation[:, :2] > 0.5).any()  # C_L and bank
    assert metrics["load"]["position_error_mean_m"] <= 0.05
    # Nothing changes in little wind; then ξ and A grow.
    parameters = Parameters.view(run.signal("parameters"))
    little, full = run.time < 15, run.time > 70
    for values, nominal in ((parameters.frequency, 0.595), (parameters.amplitude, 1.0)):
        np.testing.assert_allclose(values[little], nominal, rtol=1e-3)
        assert values[full].mean() > 1.002 * nominal
    assert metrics["optimizer"]["relaxed"] == metrics["optimizer"]["held"] == 0


@pytest.mark.nightly("flights")
def test_a_load_turns_faster_as_the_wind_rises(fleet):
    run, metrics = fleet.evaluated(TURNING)
    assert least_share(run) >= 1
    assert metrics["optimizer"]["relaxed"] == metrics["optimizer"]["held"] == 0
    rates = Parameters.view(run.signal("parameters")).frequency
    assert rates[run.time < 10].max() == 0.28
    assert rates[-1, 0] > 1.1 * 0.28


AT_FIXED_RATE = [
    "optimization_layer=!ConstantParameters {frequency: 0.28, amplitude: 0.0}",
    "load_trajectory=!SteadyTurn {yaw_rate: 0.28}",
    "simulation_duration=6",
]
IN_CALM = [
    *("optimization_layer=ConstantParameters", "simulation_duration=12"),
    "load_trajectory.displacement=[0, 0, 0]",
]


@pytest.mark.nightly("flights")
@pytest.mark.parametrize(
    ("name", "changes", "most"), [(TURNING, AT_FIXED_RATE, 0.86), (NAME, IN_CALM, 0.93)]
)
def test_in_the_full_wind_the_bound_is_missed_by_what_flies_in_calm_air(name, changes, most):
    run = simulate(load_scenario(name, [*changes, "wind.start_time=0", "wind.rise_time=0"]))
    assert least_share(run) < most
