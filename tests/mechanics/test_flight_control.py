"""Flight control: against the flown force, exact motions in time, lags by hand, and limits."""

import numpy as np
import pytest
from mechanics.test_aircraft import RASCAL

from drake_nonstop.mechanics.aircraft import air_force, air_frame, flight_needs, thrust_limits
from drake_nonstop.mechanics.flight_control import (
    FlightSignals,
    flight_command,
    limited_command,
    observer_rate,
)
from drake_nonstop.mechanics.signals import AircraftCommand, AircraftState

GRAVITY = np.array([0.0, 0.0, 9.81])
WIND = np.array([2.0, -1.0, 0.0])
GAINS = {"position_gain": 2.25, "velocity_gain": 2.7}
LIMITS = {"lift_share": 0.9, "max_bank": 0.87, "speed_share": 1.2, "speed_gain": 2.7}


def turned(time, order, cosine, sine):
    """Of two aircraft at 0.6 rad/s on an ellipse, or its rate of that order (2, 3)."""
    angle = 0.6 * time + np.array([[0.3], [2.0]]) + order * np.pi / 2
    return 0.6**order * (np.cos(angle) * cosine + np.sin(angle) * sine)


def motion(time, order):
    return turned(time, order, np.array([30.0, 0, 3.0]), np.array([0, 25.0, 0]))


def pull(time, order=0):
    """The cables' forces, which turn with the aircraft, and their rates."""
    found = turned(time, order, np.array([7.0, 0, 4.0]), np.array([1.0, 6.0, 0]))
    return found + (order == 0) * np.array([1.0, 0, 24.0])


def needed(time):
    return RASCAL.mass * (motion(time, 2) + GRAVITY) + pull(time)


def command(time, errors=(0.0, 0.0), lead=0.0, disturbance=0.0):
    """Of aircraft that are behind their reference by these errors (2, 2, 3)."""
    reference, state = (
        np.concatenate([(motion(time, k) - by[k]).ravel() for k in (0, 1)])
        for by in ((0.0, 0.0), errors)
    )
    rates = motion(time, 2).ravel(), motion(time, 3).ravel()
    pulls = pull(time).ravel(), pull(time, 1).ravel()
    signals = FlightSignals(reference, *rates, state, np.zeros(8), *pulls, WIND, np.zeros(6))
    return flight_command(RASCAL, signals, np.full((2, 3), disturbance), **GAINS, lead=lead)


def test_the_command_flies_the_needed_force_with_springs_and_dampers_less_the_disturbance(rng):
    errors = rng.uniform(-1, 1, (2, 2, 3))
    told = AircraftCommand.view(command(0.7, errors, disturbance=3.0))
    air = motion(0.7, 1) - errors[1] - WIND
    frame = air_frame(air)
    expected = needed(0.7) + RASCAL.mass * (2.25 * errors[0] + 2.7 * errors[1])
    expected -= 3.0 * (frame.forward + frame.right + frame.up)
    found = air_force(RASCAL, air, told.lift, told.bank, told.thrust)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_the_lead_is_each_lag_times_the_rate_of_the_command_along_the_reference():
    def exact(time):
        needs = flight_needs(RASCAL, needed(time), motion(time, 1) - WIND)
        return np.concatenate(needs.command)

    rate = (exact(0.7 + 1e-4) - exact(0.7 - 1e-4)) / 2e-4
    lags = np.repeat([RASCAL.lift_lag, RASCAL.bank_lag, RASCAL.thrust_lag], 2)
    lead = command(0.7, lead=1.0) - command(0.7)
    assert np.all(np.abs(rate) > 1e-3)
    np.testing.assert_allclose(lead, lags * rate, atol=1e-6 * np.max(np.abs(lags * rate)))


def test_commands_are_within_their_limits_and_flagged_where_these_change_them(rng):
    for _ in range(200):
        told = AircraftCommand(
            rng.uniform(-0.2, 3.0, 3), rng.uniform(-1.4, 1.4, 3), rng.uniform(-30, 80, 3)
        )
        airspeed = rng.uniform(6, 25, 3)
        command = np.concatenate(told)
        limited, flags = limited_command(RASCAL, command, airspeed, **LIMITS)
        lift, bank, thrust = AircraftCommand.view(limited)
        least, most = thrust_limits(RASCAL, airspeed)
        assert np.all(lift <= 0.9 * 1.4 + 1e-12)
        assert np.all(np.abs(bank) <= 0.87 + 1e-12)
        assert np.all((thrust >= least - 1e-9) & (thrust <= most + 1e-9))
        np.testing.assert_array_equal(flags > 0.5, np.abs(limited - command) > 1e-6)


@pytest.mark.parametrize(("bank", "cut"), [(0.7, True), (-0.7, True), (0.2, False)])
def test_where_lift_is_short_the_vertical_part_is_kept_and_the_bank_is_cut(bank, cut):
    wanted = 1.5 if cut else 1.2
    command = np.array([wanted, bank, 10.0])
    (lift, less, _), flags = limited_command(RASCAL, command, np.array([15.0]), **LIMITS)
    np.testing.assert_allclose(lift * np.cos(less), wanted * np.cos(bank), rtol=1e-9)
    assert np.sign(less) == np.sign(bank)
    np.testing.assert_allclose(flags, [cut, cut, False], atol=1e-6)


def test_the_observer_tells_the_force_that_the_model_does_not_explain(rng):
    """Of one aircraft in straight flight at 15 m/s, with a bank of 0.2."""
    push, force, nothing = rng.uniform(-3, 3, 3), np.array([1.0, 2.0, 24.0]), np.zeros(3)
    shown = np.array([[0.6], [0.2], [9.0]])
    made = air_force(RASCAL, np.array([[15.0, 0, 0]]), *shown)[0]
    in_world = push * [1, -1, 1]  # in flight along x the right is at -y
    acceleration = (made + in_world - force) / 6.0 - GRAVITY
    carrier = np.array([0.0, 0, 0, 15.0, 0, 0])
    measured = np.concatenate(AircraftState(*np.array([[0.5], [0.2], [8.0], [15.0]])))
    parts = (carrier, nothing, nothing, carrier, measured, force, nothing, nothing, acceleration)
    states, command = np.array([0.0, 0.0, 0.0, 0.6, 9.0]), np.array([0.7, 0.3, 11.0])
    times = {"observer_time": 0.2, "period": 0.0}
    rate = observer_rate(RASCAL, states, command, FlightSignals(*parts), **times)
    lags = np.array([0.2, 0.2, 0.2, 0.15, 0.2])  # s
    np.testing.assert_allclose(states + lags * rate, [*push, 0.7, 11.0], atol=1e-12)
