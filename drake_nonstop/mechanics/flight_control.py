"""Control of fixed-wing aircraft along a reference: inverse, lead, disturbance observer, limits.

The needed force is inverted to the lift coefficient, bank and thrust that make it, see
`mechanics.aircraft`. They are followed with first-order lags: the command of each channel u
is u + τ u̇, with the rate along the reference.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import (
    Aircraft,
    AirFrame,
    air_force,
    air_frame,
    flight_needs,
    limited_thrust,
    needed_force,
    stall_speed,
)
from drake_nonstop.mechanics.cable import positive_part, within
from drake_nonstop.mechanics.rotation import components
from drake_nonstop.mechanics.signal_layouts import SignalParts, part
from drake_nonstop.mechanics.signals import AircraftCommand, AircraftState, CarrierStates

_STEP = 1e-3  # s, of the central differences along the reference
_LEAST = 1e-12  # beside squares of coefficients, which may vanish
_ROUNDING = 1e-6  # in the units of a command, that counts as none


class FlightSignals(NamedTuple):
    """What the controller of n aircraft reads, in W; what is desired is that of the references."""

    reference: NDArray  # [p_d, v_d] (6n,), m and m/s
    acceleration: NDArray  # a_d (3n,), m/s²
    jerk: NDArray  # ȧ_d (3n,), m/s³
    state: NDArray  # [p, v] (6n,), as measured
    aircraft_state: NDArray  # `AircraftState` (4n,), as measured
    cable_forces: NDArray  # f_d (3n,), N, on the load
    cable_force_rates: NDArray  # ḟ_d (3n,), N/s
    wind: NDArray  # (3,), m/s, as believed
    measured_acceleration: NDArray  # v̇ (3n,), m/s²


def flight_command(
    aircraft: Aircraft,
    signals: FlightSignals,
    disturbance: NDArray,
    *,
    position_gain: float | NDArray,
    velocity_gain: float | NDArray,
    lead: float | NDArray,
) -> NDArray:
    """`AircraftCommand` (3n,), without limits, of aircraft that follow their references.

    With the errors e = p_d − p and ė, the desired cable force f_d and the disturbance d̂,

        F = m (a_d + K_v ė + K_p e) + m g e₃ + f_d − d̂

    is inverted at the velocity through the believed wind. Each channel gets τ u̇ more, times
    `lead`: u̇ is the rate of the inverse along the reference, of F without errors, by central
    differences. The disturbance turns with the flight through the air.

    Args:
        aircraft: the controller's parameters.
        signals: of the aircraft and their references.
        disturbance: d̂ (n, 3), N, on the aircraft, [forward, right, up] of each `AirFrame`.
        position_gain: K_p, 1/s².
        velocity_gain: K_v, 1/s.
        lead: weight of the lead, 1: exact along the reference.
    """
    reference, state = map(CarrierStates.view, (signals.reference, signals.state))
    acceleration, jerk = (part.reshape(-1, 3) for part in (signals.acceleration, signals.jerk))
    forces, rates = signals.cable_forces.reshape(-1, 3), signals.cable_force_rates.reshape(-1, 3)
    wind = signals.wind

    def undisturbed(force: NDArray, velocities: NDArray) -> AircraftCommand:
        frame = air_frame(velocities - wind)
        own = force - _in_world(frame, disturbance)
        return flight_needs(aircraft, own, velocities - wind).command

    feedback = position_gain * (reference.positions - state.positions) + velocity_gain * (
        reference.velocities - state.velocities
    )
    feedforward = needed_force(aircraft, acceleration, forces)
    command = undisturbed(feedforward + aircraft.mass * feedback, state.velocities)
    force_rate = aircraft.mass * jerk + rates
    later, earlier = (
        undisturbed(feedforward + step * force_rate, reference.velocities + step * acceleration)
        for step in (_STEP, -_STEP)
    )
    lags = (aircraft.lift_lag, aircraft.bank_lag, aircraft.thrust_lag)
    gains = (aircraft.lift_gain, 1.0, aircraft.thrust_gain)
    return np.concatenate(
        [
            (told + lead * lag * (after - before) / (2 * _STEP)) / gain
            for told, lag, gain, after, before in zip(
                command, lags, gains, later, earlier, strict=True
            )
        ]
    )


def limited_command(
    aircraft: Aircraft,
    command: NDArray,
    airspeed: NDArray,
    *,
    lift_share: float | NDArray,
    max_bank: float | NDArray,
    speed_share: float | NDArray,
    speed_gain: float | NDArray,
) -> tuple[NDArray, NDArray]:
    """`AircraftCommand` (3n,) within limits, and 1 for each channel (3n,) that they change, else 0.

    In this order: the lift coefficient is at most `lift_share` C_Lmax, which a first-order lag
    cannot overshoot; its vertical part is kept as far as that goes, and the bank is cut; the bank
    is within ±`max_bank`; below `speed_share` V_s, the stall speed without a cable, thrust m k per
    m/s is added; the thrust is within its limits at the airspeed.

    Args:
        aircraft: the controller's parameters.
        command: `AircraftCommand` (3n,).
        airspeed: V (n,), m/s, as measured.
        lift_share: of C_Lmax.
        max_bank: rad.
        speed_share: of V_s.
        speed_gain: k, 1/s.
    """
    told = AircraftCommand.view(command)
    most = lift_share * aircraft.max_lift
    lift = within(told.lift, -most, most)
    upward, sideward = told.lift * np.cos(told.bank), told.lift * np.sin(told.bank)
    left = np.sqrt(positive_part(lift * lift - upward * upward) + _LEAST)
    sideward = within(sideward, -left, left)
    size = np.sqrt(upward * upward + sideward * sideward + _LEAST)
    bank = within(2 * np.arctan(sideward / (size + upward + _LEAST)), -max_bank, max_bank)
    slow = positive_part(speed_share * stall_speed(aircraft) - airspeed)
    thrust = told.thrust + aircraft.mass * speed_gain * slow
    thrust = limited_thrust(aircraft, thrust, airspeed)
    limited = np.concatenate(AircraftCommand(lift, bank, thrust))
    change = (limited - command) * (limited - command)
    return limited, change / (change + _ROUNDING**2)


class ObserverStates(SignalParts):
    """State of the controller of n aircraft."""

    disturbance: NDArray = part("3n", "N", "", "on the aircraft, in the axes of each `AirFrame`")
    lift: NDArray = part("n", "", "", "C_L by its lag behind the command")
    thrust: NDArray = part("n", "N", "", "by its lag behind the command")


def observer_rate(
    aircraft: Aircraft,
    states: NDArray,
    command: NDArray,
    signals: FlightSignals,
    *,
    observer_time: float | NDArray,
    period: float,
) -> NDArray:
    """The rate (5n,) of `ObserverStates`, each a low-pass; with a period that of its step over it.

    The disturbance follows m (v̇ + g e₃) + f_d − F_a, what the model of the aircraft does not
    explain, in the axes of flight through the air, in which errors of lift and thrust do not turn.
    F_a is `air_force` in the believed wind, of the measured bank, and of the C_L and thrust
    that follow from the commands: what gusts and errors of the model add to these is part of the
    disturbance. A step has the share 1 − exp(−h/τ), exact for inputs that stay.

    Args:
        aircraft: the controller's parameters.
        states: `ObserverStates` (5n,).
        command: `AircraftCommand` (3n,), as given to the aircraft.
        signals: of the aircraft.
        observer_time: τ of the disturbance, s; C_L and thrust have the lags of the aircraft.
        period: h, s; 0: the states are continuous.
    """
    own, told = ObserverStates.view(states), AircraftCommand.view(command)
    air_velocities = CarrierStates.view(signals.state).velocities - signals.wind
    bank = AircraftState.view(signals.aircraft_state).bank
    force = air_force(aircraft, air_velocities, own.lift, bank, own.thrust)
    parts = (signals.measured_acceleration, signals.cable_forces)
    unexplained = needed_force(aircraft, *(part.reshape(-1, 3) for part in parts)) - force
    inputs = ObserverStates(
        _in_air(air_frame(air_velocities), unexplained),
        aircraft.lift_gain * told.lift,
        aircraft.thrust_gain * told.thrust,
    )
    times = (observer_time, aircraft.lift_lag, aircraft.thrust_lag)
    return ObserverStates(
        *(
            ((1 - np.exp(-period / time)) / period if period > 0 else 1 / time) * (after - before)
            for before, after, time in zip(own, inputs, times, strict=True)
        )
    ).flat()


def _in_air(frame: AirFrame, vectors: NDArray) -> NDArray:
    """The parts (n, 3) of vectors (n, 3) along the axes forward, right and up."""
    axes = (frame.forward, frame.right, frame.up)
    return np.stack([(vectors * axis).sum(axis=-1) for axis in axes], axis=-1)


def _in_world(frame: AirFrame, parts: NDArray) -> NDArray:
    """The vectors (n, 3) of parts (n, 3) along the axes forward, right and up."""
    forward, right, up = components(parts)
    return forward * frame.forward + right * frame.right + up * frame.up
