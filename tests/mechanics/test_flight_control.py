"""Flight control: against the flown force, exact motions in time, lags by hand, and limits."""

import numpy as np
import pytest
from mechanics.test_aircraft import RASCAL

from drake_nonstop.mechanics.aircraft import (
    air_force,
    air_frame,
    flight_needs,
    thrust_limits,
)
from drake_nonstop.mechanics.flight_control import (
    FlightSignals,
    flight_command,
    limited_command,
    observer_rate,
)
from drake_nonstop.mechanics.signals import AircraftCommand, AircraftState, CarrierStates

GRAVITY = np.array([0.0, 0.0, 9.81])
WIND = np.array([2.0, -1.0, 0.0])
GAINS = {"position_gain": 2.25, "velocity_gain": 2.7}
LIMITS = {"lift_share": 0.9, "max_bank": 0.87, "speed_share": 1.2, "speed_gain": 2.7}


class Orbits:
    """Two aircraft on leaning ellipses, with cable forces that turn with them."""

    rate, phases = 0.6, np.array([0.3, 2.0])

    def _turned(self, time, order, cosine, sine):
        angle = self.rate * time + self.phases + order * np.pi / 2
        waves = np.cos(angle)[:, None] * cosine + np.sin(angle)[:, None] * sine
        return self.rate**order * waves

    def motion(self, time, order):
        return self._turned(time, order, np.array([30.0, 0, 3.0]), np.array([0, 25.0, 0]))

    def force(self, time, order=0):
        turned = self._turned(time, order, np.array([7.0, 0, 4.0]), np.array([1.0, 6.0, 0]))
        return turned + (order == 0) * np.array([1.0, 0, 24.0])

    def needed(self, time):
        return RASCAL.mass * (self.motion(time, 2) + GRAVITY) + self.force(time)

    def command(self, time, carrier_state=None, lead=0.0, disturbance=0.0):
        reference = np.concatenate([self.motion(time, k).ravel() for k in (0, 1)])
        signals = FlightSignals(
            reference,
            self.motion(time, 2).ravel(),
            self.motion(time, 3).ravel(),
            reference if carrier_state is None else carrier_state,
            np.zeros(8),
            self.force(time).ravel(),
            self.force(time, 1).ravel(),
            WIND,
            np.zeros(6),
        )
        return flight_command(RASCAL, signals, np.full((2, 3), disturbance), **GAINS, lead=lead)


def flown(command, velocities):
    told = AircraftCommand.view(command)
    return air_force(RASCAL, velocities - WIND, told.lift, told.bank, told.thrust)


def test_the_command_flies_the_needed_force_less_the_disturbance():
    orbits = Orbits()
    command = orbits.command(0.7, disturbance=3.0)
    frame = air_frame(orbits.motion(0.7, 1) - WIND)
    expected = orbits.needed(0.7) - 3.0 * (frame.forward + frame.right + frame.up)
    np.testing.assert_allclose(flown(command, orbits.motion(0.7, 1)), expected, atol=1e-9)


def test_errors_are_corrected_as_by_a_spring_and_a_damper(rng):
    orbits = Orbits()
    errors = rng.uniform(-1, 1, (2, 2, 3))
    state = CarrierStates(*(orbits.motion(0.7, k) - errors[k] for k in (0, 1)))
    command = orbits.command(0.7, state.flat())
    expected = orbits.needed(0.7) + RASCAL.mass * (2.25 * errors[0] + 2.7 * errors[1])
    np.testing.assert_allclose(flown(command, state.velocities), expected, atol=1e-9)


def test_the_lead_is_each_lag_times_the_rate_of_the_command_along_the_reference():
    orbits = Orbits()

    def exact(time):
        needs = flight_needs(RASCAL, orbits.needed(time), orbits.motion(time, 1) - WIND)
        return np.concatenate(needs.command)

    rate = (exact(0.7 + 1e-4) - exact(0.7 - 1e-4)) / 2e-4
    lags = np.repeat([RASCAL.lift_lag, RASCAL.bank_lag, RASCAL.thrust_lag], 2)
    lead = orbits.command(0.7, lead=1.0) - orbits.command(0.7)
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
