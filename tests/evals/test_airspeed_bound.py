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
RATES = {NAME: 0.595, TURNING: 0.28}  # rad/s, nominal ones


def least_share(run):
    """The least airspeed of a run in units of its bound."""
    bound = SHARES[run.scenario.name] * stall_speed(aircraft_in(run.scenario.system))
    return RunQuantities(run).aircraft_state.airspeed.min() / bound


@pytest.mark.parametrize(
    "name", [NAME, pytest.param(TURNING, marks=pytest.mark.nightly("flights"))]
)
def test_the_layer_keeps_the_airspeed_in_a_rising_wind(fleet, name):
    run, metrics = fleet.evaluated(name)
    assert least_share(run) >= 1
    assert metrics["optimizer"]["relaxed"] == metrics["optimizer"]["held"] == 0
    # Nothing changes in little wind; then the orbits are flown faster.
    rates = Parameters.view(run.signal("parameters")).frequency
    np.testing.assert_allclose(rates[run.time < 10], RATES[name], rtol=1e-3)
    assert rates[-1].mean() > 1.002 * RATES[name]


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
