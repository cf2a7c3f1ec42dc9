"""Fixed-wing aircraft: closed forms of steady flight, an inverse, an integration by hand."""

import numpy as np
import pytest

from drake_nonstop.mechanics.aircraft import (
    Aircraft,
    FlightStates,
    air_force,
    air_frame,
    flight_needs,
    flight_rate,
    needed_force,
    shown_state,
    trimmed_states,
)
from drake_nonstop.mechanics.signals import AircraftCommand, AircraftState

# A Rascal 110 on a cable of 150 m, as in the sources of its figures.
RASCAL = Aircraft(
    mass=6.0,
    wing_area=0.98,
    wing_span=2.79,
    lift_at_zero_angle=0.25,
    lift_slope=5.0,
    max_lift=1.4,
    zero_lift_drag=0.027,
    induced_drag=0.055,
    max_thrust=np.array([58.0, -1.45, 0.0]),
    min_thrust=np.array([0.0, 0.0, -0.034]),
    lift_lag=0.15,
    bank_lag=0.4,
    thrust_lag=0.2,
    max_roll_rate=np.radians(70.0),
    gust_time=0.4,
    efficiency=0.65,
    air_density=1.225,
    cable_diameter=1e-3,
    cable_drag=1.1,
    cable_length=150.0,
    gravity=9.81,
)
FREE = RASCAL._replace(cable_diameter=0.0)  # of any cable
NO_PULL = np.zeros(3)


def steady(aircraft, velocity, acceleration=(0.0, 0.0, 0.0), pull=NO_PULL, wind=NO_PULL):
    force = needed_force(aircraft, np.array(acceleration), pull)
    return flight_needs(aircraft, force, np.asarray(velocity) - wind).command


def test_needs_are_the_inverse(rng):
    shape = (200,)
    velocity = rng.uniform(-5, 5, (*shape, 3)) + np.array([14.0, 0.0, 0.0])
    wind = rng.uniform(-3, 3, (*shape, 3))
    lift = rng.uniform(-0.3, 1.4, shape)
    bank = rng.uniform(-1.4, 1.4, shape)
    thrust = rng.uniform(-10, 45, shape)
    air = velocity - wind
    # The lift is across the path, upwards: N > 0.
    pressure = 0.5 * 1.225 * (air**2).sum(axis=-1) * 0.98
    across = pressure * lift + thrust * np.sin((lift - 0.25) / 5)
    keep = across > 0
    force = air_force(RASCAL, air, lift, bank, thrust)
    found = flight_needs(RASCAL, force, air)
    for name, given in (("lift", lift), ("bank", bank), ("thrust", thrust)):
        np.testing.assert_allclose(getattr(found, name)[keep], given[keep], atol=2e-9)
    assert keep.sum() > 100


def flown(aircraft, states, command, pull=None, wind=None, *, duration, step=0.002):
    """Runge and Kutta's method of fourth order; `command` and `wind` are functions of the time."""
    n = len(states) // 12
    pull = np.zeros(3 * n) if pull is None else pull
    wind = wind or (lambda time: np.zeros(3 * n))

    def rate(time, values):
        return flight_rate(aircraft, values, command(time), pull, wind(time))

    found = [states]
    for k in range(round(duration / step)):
        time, values = k * step, found[-1]
        first = rate(time, values)
        second = rate(time + step / 2, values + step / 2 * first)
        third = rate(time + step / 2, values + step / 2 * second)
        fourth = rate(time + step, values + step * third)
        found.append(values + step / 6 * (first + 2 * second + 2 * third + fourth))
    return np.array(found)


def at_trim(aircraft, speed, wind=NO_PULL):
    carrier = np.array([0.0, 0.0, 100.0, speed, 0.0, 0.0])
    states = trimmed_states(aircraft, carrier, np.zeros(3), NO_PULL, wind)
    own = FlightStates.view(states)
    return states, np.concatenate(AircraftCommand(own.lift, own.bank, own.thrust))


def test_phugoid():
    """Lanchester: the period of a slightly disturbed level flight is √2 π V/g without drag."""
    speed = 20.0
    aircraft = FREE._replace(zero_lift_drag=0.0, induced_drag=0.0)
    states, command = at_trim(aircraft, speed)
    states = states.copy()
    states[5] = 0.05  # m/s upwards
    height = flown(aircraft, states, lambda time: command, duration=30.0, step=0.05)[:, 5]
    rising = np.flatnonzero((height[:-1] < 0) & (height[1:] >= 0)) * 0.05
    period = np.mean(np.diff(rising))
    assert period == pytest.approx(np.sqrt(2) * np.pi * speed / 9.81, rel=0.01)


def test_lags_and_roll_rate():
    """First-order lags; the bank moves at p_max as long as (μ_c − μ)/τ_μ is more."""
    states, command = at_trim(RASCAL, 15.0)
    told = command + np.array([0.2, 1.0, 3.0])
    path = flown(RASCAL, states, lambda time: told, duration=0.6, step=0.005)
    time = np.arange(len(path)) * 0.005
    lift = command[0] + 0.2 * (1 - np.exp(-time / 0.15))
    thrust = command[2] + 3.0 * (1 - np.exp(-time / 0.2))
    np.testing.assert_allclose(path[:, 6], lift, atol=1e-8)
    np.testing.assert_allclose(path[:, 8], thrust, atol=1e-7)
    fastest = np.radians(70.0)
    until = (1.0 - 0.4 * fastest) / fastest  # s, where the lag takes over
    after = 1.0 - 0.4 * fastest * np.exp(-(time - until) / 0.4)
    expected = np.where(time < until, fastest * time, after)
    np.testing.assert_allclose(path[:, 7], expected, atol=1e-3)


def test_a_gust_acts_at_once_and_is_taken_out():
    """δα = (w − w_s)·l/V, and the lift of a step of wind decays with 0.4 s."""
    states, command = at_trim(RASCAL, 15.0)
    upwash = np.array([0.0, 0.0, 1.0])
    air = np.array([15.0, 0.0, -1.0])
    speed = np.sqrt(226.0)
    expected = states[6] + 5.0 * (15.0 / speed) / speed  # l leans with the path through the air
    shown = AircraftState.view(shown_state(RASCAL, states, upwash))
    np.testing.assert_allclose(shown.lift, expected, rtol=1e-9)
    np.testing.assert_allclose(shown.airspeed, speed, rtol=1e-12)
    assert np.allclose(air_frame(air).airspeed, speed)
    path = flown(
        RASCAL, states, lambda time: command, wind=lambda time: upwash, duration=0.4, step=0.02
    )
    np.testing.assert_allclose(path[-1, 9:], upwash * (1 - np.exp(-1.0)), atol=1e-6)
    settled = np.concatenate([states[:9], upwash * (1 - np.exp(-1.0))])
    later = AircraftState.view(shown_state(RASCAL, settled, upwash))
    np.testing.assert_allclose(later.lift - states[6], (expected - states[6]) / np.e, rtol=1e-9)


def test_flight_of_an_independent_integration():
    """The same aircraft, written out in angles: heading χ, climb γ and speed V, by Euler's method.

    m V̇ = T cos α − D − m g sin γ, m V γ̇ = (L + T sin α) cos μ − m g cos γ, and
    m V cos γ χ̇ = (L + T sin α) sin μ to the right, with lags and without cable or wind.
    """
    states, command = at_trim(FREE, 16.0)
    told = command + np.array([0.15, 0.4, 6.0])
    step = 5e-4
    (lift, bank, thrust) = states[6:9]
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
        place = place + step * speed * np.array(
            [
                np.cos(climb) * np.cos(heading),
                np.cos(climb) * np.sin(heading),
                np.sin(climb),
            ]
        )
        roll_rate = np.clip((told[1] - bank) / 0.4, -np.radians(70), np.radians(70))
        lift += step * (told[0] - lift) / 0.15
        bank += step * roll_rate
        thrust += step * (told[2] - thrust) / 0.2
        speed, climb, heading = (
            value + step * rate for value, rate in zip((speed, climb, heading), rates, strict=True)
        )
    end = flown(FREE, states, lambda time: told, duration=4.0, step=0.04)[-1]
    np.testing.assert_allclose(end[:3], place, atol=0.02)
    np.testing.assert_allclose(np.linalg.norm(end[3:6]), speed, rtol=2e-4)
