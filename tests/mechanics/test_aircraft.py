"""Fixed-wing aircraft: closed forms of steady flight, an inverse, an integration by hand."""

import numpy as np
import pytest
from helpers import model
from scipy.integrate import solve_ivp

from drake_nonstop import AircraftParameters
from drake_nonstop.mechanics.aircraft import (
    FlightStates,
    air_force,
    flight_needs,
    flight_rate,
    is_stalled,
    shown_state,
    trimmed_states,
)
from drake_nonstop.mechanics.signals import AircraftCommand, AircraftState

# A Rascal 110 on a cable of 150 m; closed forms below have its figures by hand.
RASCAL = model(3, aircraft=AircraftParameters(model="rascal_110"), cable_length=150.0).aircraft
FREE = RASCAL._replace(cable_diameter=0.0)  # of any cable
NOTHING = np.zeros(3)


def test_needs_are_the_inverse(rng):
    air = rng.uniform(-8, 8, (200, 3)) + np.array([14.0, 0.0, 0.0])
    lift, bank, thrust = rng.uniform([[-0.3], [-1.4], [-10]], [[1.4], [1.4], [45]], (3, 200))
    # The lift is across the path, upwards: N > 0.
    pressure = 0.5 * 1.225 * (air**2).sum(axis=-1) * 0.98
    keep = pressure * lift + thrust * np.sin((lift - 0.25) / 5) > 0
    assert keep.sum() > 100
    found = flight_needs(RASCAL, air_force(RASCAL, air, lift, bank, thrust), air)
    for name, given in (("lift", lift), ("bank", bank), ("thrust", thrust)):
        np.testing.assert_allclose(getattr(found, name)[keep], given[keep], atol=2e-9)


def test_needs_are_finite_in_vertical_flight_and_at_rest():
    for climb in (0.0, 5.0, -5.0):
        needs = flight_needs(RASCAL, np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, climb]))
        assert np.all(np.isfinite(needs))


def test_an_aircraft_is_stalled_at_its_largest_lift_or_below_its_stall_speed():
    lift, speed_share = np.array([1.0, 1.3999, 1.4, 1.0]), np.array([1.001, 1.001, 1.1, 0.999])
    speed = speed_share * np.sqrt(2 * 6.0 * 9.81 / (1.225 * 0.98 * 1.4))
    state = np.concatenate(AircraftState(lift, 0 * lift, 0 * lift, speed))
    np.testing.assert_array_equal(is_stalled(RASCAL, state), [False, False, True, True])


def flown(aircraft, states, command, times, wind=NOTHING):
    """States at times, s, of one aircraft under a constant command, by SciPy."""

    def rate(time, states):
        return flight_rate(aircraft, states, command, NOTHING, wind)

    tight = {"rtol": 1e-9, "atol": 1e-9, "max_step": 0.05}
    return solve_ivp(rate, (0, times[-1]), states, t_eval=times, **tight).y.T


def at_trim(aircraft, speed):
    carrier = np.array([0.0, 0.0, 100.0, speed, 0.0, 0.0])
    states = trimmed_states(aircraft, carrier, NOTHING, NOTHING, NOTHING)
    own = FlightStates.view(states)
    return states, np.concatenate(AircraftCommand(own.lift, own.bank, own.thrust))


def test_lags_and_roll_rate():
    """First-order lags; the bank moves at p_max as long as (μ_c − μ)/τ_μ is more."""
    states, command = at_trim(RASCAL, 15.0)
    time = np.arange(0, 0.6, 0.005)
    path = flown(RASCAL, states, command + np.array([0.2, 1.0, 3.0]), time)
    np.testing.assert_allclose(path[:, 6], command[0] + 0.2 * (1 - np.exp(-time / 0.15)), atol=1e-7)
    np.testing.assert_allclose(path[:, 8], command[2] + 3.0 * (1 - np.exp(-time / 0.2)), atol=1e-7)
    fastest = np.radians(70.0)
    until = (1.0 - 0.4 * fastest) / fastest  # s, where the lag takes over
    after = 1.0 - 0.4 * fastest * np.exp(-(time - until) / 0.4)
    expected = np.where(time < until, fastest * time, after)
    np.testing.assert_allclose(path[:, 7], expected, atol=1e-3)


@pytest.mark.parametrize("bank", [0.0, 0.6])
def test_a_gust_acts_at_once_and_is_taken_out(bank):
    """δα = (w − w_s)·l/V, and the lift of a step of wind decays with 0.4 s."""
    states, command = at_trim(RASCAL, 15.0)
    states[7] = bank
    upwash, speed = np.array([0.0, 0.0, 1.0]), np.sqrt(226.0)
    # l leans with the path through the air, and with the bank.
    expected = states[6] + 5.0 * np.cos(bank) * (15.0 / speed) / speed
    shown = AircraftState.view(shown_state(RASCAL, states, upwash))
    np.testing.assert_allclose(shown.lift, expected, rtol=1e-9)
    np.testing.assert_allclose(shown.airspeed, speed, rtol=1e-12)
    settled = upwash * (1 - np.exp(-1.0))
    path = flown(RASCAL, states, command, [0.0, 0.4], upwash)
    np.testing.assert_allclose(path[-1, 9:], settled, atol=1e-6)
    later = AircraftState.view(shown_state(RASCAL, np.append(states[:9], settled), upwash))
    np.testing.assert_allclose(later.lift - states[6], (expected - states[6]) / np.e, rtol=1e-9)


def test_flight_of_an_independent_integration():
    """The same aircraft, written out in angles: heading χ, climb γ and speed V, by Euler's method.

    m V̇ = T cos α − D − m g sin γ, m V γ̇ = (L + T sin α) cos μ − m g cos γ, and
    m V cos γ χ̇ = (L + T sin α) sin μ to the right, with lags and without cable or wind.
    """
    states, command = at_trim(FREE, 16.0)
    told = command + np.array([0.15, 0.4, 6.0])
    step = 5e-4
    lift, bank, thrust = states[6:9]
    speed, climb, heading, place = 16.0, 0.0, 0.0, np.array([0.0, 0.0, 100.0])
    for _ in range(round(4.0 / step)):
        angle = (lift - 0.25) / 5.0
        pressure = 0.5 * 1.225 * speed**2 * 0.98
        across = pressure * lift + thrust * np.sin(angle)
        along = thrust * np.cos(angle) - pressure * (0.027 + 0.055 * lift**2)
        rates = (
            along / 6 - 9.81 * np.sin(climb),
            (across * np.cos(bank) / 6 - 9.81 * np.cos(climb)) / speed,
            -across * np.sin(bank) / (6 * speed * np.cos(climb)),
        )
        level = np.array([np.cos(heading), np.sin(heading), np.tan(climb)])
        place = place + step * speed * np.cos(climb) * level
        roll_rate = np.clip((told[1] - bank) / 0.4, -np.radians(70), np.radians(70))
        lift += step * (told[0] - lift) / 0.15
        bank += step * roll_rate
        thrust += step * (told[2] - thrust) / 0.2
        speed, climb, heading = (
            value + step * rate for value, rate in zip((speed, climb, heading), rates, strict=True)
        )
    end = flown(FREE, states, told, [4.0])[-1]
    np.testing.assert_allclose(end[:3], place, atol=0.02)
    np.testing.assert_allclose(np.linalg.norm(end[3:6]), speed, rtol=2e-4)
