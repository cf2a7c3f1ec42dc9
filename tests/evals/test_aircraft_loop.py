"""Closed loops of aircraft: they hold the load; without limits they fly as point carriers do."""

import numpy as np
import pytest

from drake_nonstop import load_scenario, simulate
from drake_nonstop.run.run_quantities import RunQuantities

UNLIMITED = [
    *("system.aircraft.max_lift=100", "system.aircraft.max_roll_rate=1e4"),
    *("system.aircraft.max_thrust=[1e4,0,0]", "system.aircraft.min_thrust=[-1e4,0,0]"),
    *(f"system.aircraft.{name}_lag=0.002" for name in ("lift", "bank", "thrust")),
    *("carrier_controller.max_bank=1.5", "carrier_controller.observer=0"),
]


def flown(*changes):
    run = simulate(load_scenario("aircraft_rest", ["simulation_duration=1.0", *changes]))
    return run.signal("load_state")[:, 4:7], run.signal("carrier_state")[:, :12]


@pytest.mark.nightly("flights")
def test_aircraft_without_limits_fly_as_double_integrators_do():
    """Both keep their references; only the aircraft feel by how much a cable's force is off."""
    move = [
        *("control_period=0", "carrier_controller.frequency=10"),
        *("load_trajectory.displacement=[1,0,0]", "load_trajectory.move_time=10"),
    ]
    found = flown(*move, *UNLIMITED, "simulator_config.max_step_size=0.0025")
    points = ["carrier_dynamics=CarrierDynamics", "carrier_controller=TunedFeedforwardCarrierPid"]
    ideal = flown(*points, *move)
    assert np.ptp(ideal[1], axis=0).max() > 10  # m
    np.testing.assert_allclose(np.hstack(found), np.hstack(ideal), atol=5e-3)


@pytest.mark.nightly("flights")
def test_references_keep_a_load_on_shorter_cables_in_its_place():
    """Cables 0.4 m shorter than believed."""
    changes = ["simulated.cable_length=149.6", "simulation_duration=20"]
    off = ["carrier_trajectory.correction_rates=[0, 0, 0, 0]"]
    kept, lifted = (
        RunQuantities(simulate(load_scenario("aircraft_rest", [*changes, *own]))).position_error
        for own in ([], off)
    )
    assert kept.max() < 0.02
    assert lifted.max() > 0.35


@pytest.mark.nightly("flights")
@pytest.mark.parametrize("scenario", ["aircraft_rest", "aircraft_transfer"])
def test_aircraft_fly_on_a_noisy_late_position(scenario):
    """2 cm of noise and 40 ms of delay, at the controllers' rate; attitude as desired."""
    feedback = "!NoisyFeedback {measures_attitude: false, position_noise: 0.02, delay: 0.04, "
    run = simulate(load_scenario(scenario, [f"load_feedback={feedback}period: 0.04}}"]))
    error = RunQuantities(run).position_error
    assert error.mean() < 0.05
    assert error.max() < 0.15
