"""Fixed-wing aircraft on cables: point masses with lift, bank and thrust.

The 3-DoF model of coordinated flight. With the velocity through the air V_a = v − w, V = ‖V_a‖,

    x = V_a/V,   z′ = unit(e₃ − (e₃·x) x),   y = x × z′,   l = cos μ z′ + sin μ y,   q = ½ ρ V²,

forward, up, right, and the direction of the lift at a bank μ, an aircraft of mass m moves by

    m v̇ = q S C_L l + T (cos α x + sin α l) − q S C_D x − m g e₃ − f,
    C_L = C_L0 + C_Lα α,   C_D = C_D0 + k C_L² + C_Dc d L_c/(4 S),

where f is the cable's force on the load. The last term of C_D is the drag of a cable of the
diameter d, whose velocity grows linearly from the load to the aircraft. C_L, μ and T follow their
commands with first-order lags.

Arrays of vectors are (..., 3), those of numbers (...,), of any leading axes that broadcast, and
of symbols with at least one. All are in W and SI. Coefficients are those of the wing area S.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.cable import positive_part, within
from drake_nonstop.mechanics.rotation import clipped, cross
from drake_nonstop.mechanics.signal_layouts import SignalParts, part
from drake_nonstop.mechanics.signals import AircraftCommand, AircraftState, CarrierStates

_UP = np.array([0.0, 0.0, 1.0])
_LEAST = 1e-12  # beside squares of speeds and of direction vectors, which may vanish
_ROUNDING = 1e-9  # of a limit
LARGEST_ANGLE = 0.6  # rad, of attack, far beyond stall, that a command is looked for within
_ITERATIONS = 2  # of Newton's method: to 2e-13 rad in flight; each multiplies an Expression by 11


class Aircraft(NamedTuple):
    """The parameters of an aircraft; numbers may be arrays (1,), also of symbols."""

    mass: float | NDArray  # kg
    wing_area: float | NDArray  # m²
    wing_span: float | NDArray  # m
    lift_at_zero_angle: float | NDArray  # C_L0
    lift_slope: float | NDArray  # C_Lα, 1/rad
    max_lift: float | NDArray  # C_Lmax
    zero_lift_drag: float | NDArray  # C_D0
    induced_drag: float | NDArray  # k, of C_L²
    max_thrust: NDArray  # (3,), N, N s/m, N s²/m²: T_max = a + b V + c V²
    min_thrust: NDArray  # (3,), likewise
    lift_lag: float | NDArray  # s
    bank_lag: float | NDArray  # s
    thrust_lag: float | NDArray  # s
    max_roll_rate: float | NDArray  # rad/s
    gust_time: float | NDArray  # s, after which the autopilot has taken out a gust's angle
    efficiency: float | NDArray  # of propeller and motor
    air_density: float | NDArray  # kg/m³
    cable_diameter: float | NDArray  # m
    cable_drag: float | NDArray  # C_Dc, of the cable's diameter
    cable_length: float | NDArray  # m
    gravity: float | NDArray  # m/s²
    lift_gain: float | NDArray = 1.0  # C_L that is flown, over the commanded one
    thrust_gain: float | NDArray = 1.0  # likewise of the thrust

    @property
    def cable_drag_share(self) -> float | NDArray:
        """The cable's part of C_D: C_Dc d L_c/(4 S)."""
        return self.cable_drag * self.cable_diameter * self.cable_length / (4 * self.wing_area)


def flown_aircraft(aircraft: Aircraft, bears_cable_drag: bool) -> Aircraft:
    """The aircraft, without its share of the drag of a cable that has drag of its own."""
    return aircraft if bears_cable_drag else aircraft._replace(cable_drag=0.0)


class AirFrame(NamedTuple):
    """The directions of flight through the air."""

    airspeed: NDArray  # (..., 1), V, m/s
    forward: NDArray  # (..., 3), x
    right: NDArray  # (..., 3), y
    up: NDArray  # (..., 3), z′

    def lift_direction(self, bank: NDArray) -> NDArray:
        """The lift's l (..., 3) at banks (...,), rad."""
        angle = bank[..., None]
        return np.cos(angle) * self.up + np.sin(angle) * self.right


class FlightNeeds(NamedTuple):
    """Needs of aircraft; of any one shape."""

    airspeed: NDArray  # m/s
    force: NDArray  # N, ‖F‖
    lift: NDArray  # C_L
    bank: NDArray  # rad, positive to the right
    climb: NDArray  # rad, of the path through the air
    thrust: NDArray  # N

    @property
    def command(self) -> AircraftCommand:
        """Lift, bank and thrust that make the force."""
        return AircraftCommand(self.lift, self.bank, self.thrust)


def air_frame(air_velocity: NDArray) -> AirFrame:
    """The directions of a velocity through the air V_a = v − w (..., 3), m/s, in W.

    Of one that is zero, or vertical, `forward`, or `up` and `right`, are zero.
    """
    airspeed = np.sqrt((air_velocity * air_velocity).sum(axis=-1, keepdims=True) + _LEAST)
    forward = air_velocity / airspeed
    upward = _UP - forward[..., 2:] * forward
    upward = upward / np.sqrt((upward * upward).sum(axis=-1, keepdims=True) + _LEAST)
    return AirFrame(airspeed, forward, cross(forward, upward), upward)


def pressure_force(aircraft: Aircraft, airspeed: NDArray) -> NDArray:
    """The force q S (...,), N, at airspeeds (...,), m/s."""
    return aircraft.air_density / 2 * airspeed * airspeed * aircraft.wing_area


def angle_of_attack(aircraft: Aircraft, lift: NDArray) -> NDArray:
    """α (...,), rad, of lift coefficients."""
    return (lift - aircraft.lift_at_zero_angle) / aircraft.lift_slope


def drag_coefficient(aircraft: Aircraft, lift: NDArray) -> NDArray:
    """C_D (...,), with the cable's, of lift coefficients."""
    own = aircraft.zero_lift_drag + aircraft.induced_drag * lift * lift
    return own + aircraft.cable_drag_share


def air_force(
    aircraft: Aircraft, air_velocity: NDArray, lift: NDArray, bank: NDArray, thrust: NDArray
) -> NDArray:
    """Lift, drag and thrust in one (..., 3), N, in W.

    Args:
        aircraft: the parameters.
        air_velocity: v − w (..., 3), m/s, in W.
        lift: C_L (...,), with the gusts' part.
        bank: μ (...,), rad, positive to the right.
        thrust: T (...,), N.
    """
    frame = air_frame(air_velocity)
    pressure = pressure_force(aircraft, frame.airspeed[..., 0])
    angle = angle_of_attack(aircraft, lift)
    along = thrust * np.cos(angle) - pressure * drag_coefficient(aircraft, lift)
    across = thrust * np.sin(angle) + pressure * lift
    return along[..., None] * frame.forward + across[..., None] * frame.lift_direction(bank)


def needed_force(
    aircraft: Aircraft, acceleration: NDArray, cable_force: NDArray, up: NDArray = _UP
) -> NDArray:
    """Force (..., 3), N, that lift, drag and thrust sum up to: m (v̇ + g e₃) + f."""
    return aircraft.mass * (acceleration + aircraft.gravity * up) + cable_force


def flight_needs(
    aircraft: Aircraft, force: NDArray, air_velocity: NDArray, up: NDArray = _UP
) -> FlightNeeds:
    """Needs of aircraft for a given `air_force`: its inverse.

    With F_x = F·x and N = ‖F − F_x x‖ the bank is atan2(F·y, F·z′), and

        N = q S C_L + T sin α,   F_x = T cos α − q S C_D

    are solved for C_L by a fixed number of iterations of Newton's method, from the solution for
    sin α = α. Limits are not applied; a force that needs an angle of attack beyond ±0.6 rad, far
    beyond stall, gives the lift and thrust at that angle.

    Args:
        aircraft: the parameters.
        force: F (..., 3), N, see `needed_force`.
        air_velocity: V_a (..., 3), m/s.
        up: e₃ (..., 3), in the frame of both.
    """
    airspeed = np.sqrt((air_velocity * air_velocity).sum(axis=-1) + _LEAST)
    climb_sine = (air_velocity * up).sum(axis=-1) / airspeed
    climb_cosine = np.sqrt(1 - climb_sine * climb_sine + _LEAST)
    along = (force * air_velocity).sum(axis=-1) / airspeed
    sideward = (cross(force, air_velocity) * up).sum(axis=-1) / (airspeed * climb_cosine)
    upward = ((force * up).sum(axis=-1) - climb_sine * along) / climb_cosine
    across = np.sqrt(sideward * sideward + upward * upward + _LEAST)
    pressure = pressure_force(aircraft, airspeed)
    slope = aircraft.lift_slope
    without_thrust = angle_of_attack(aircraft, across / pressure)
    lift = aircraft.lift_at_zero_angle + slope * clipped(without_thrust, LARGEST_ANGLE)
    drag = drag_coefficient(aircraft, lift)
    angle = without_thrust * slope / (slope + drag + along / pressure)
    angle = clipped(angle, LARGEST_ANGLE)
    for _ in range(_ITERATIONS):
        lift = aircraft.lift_at_zero_angle + slope * angle
        forward_thrust = along + pressure * drag_coefficient(aircraft, lift)
        tangent = np.tan(angle)
        residual = pressure * lift + forward_thrust * tangent - across
        drag_slope = 2 * aircraft.induced_drag * lift * slope
        derivative = pressure * (slope + drag_slope * tangent)
        derivative = derivative + forward_thrust * (1 + tangent * tangent)
        angle = angle - residual / derivative
    angle = clipped(angle, LARGEST_ANGLE)
    lift = aircraft.lift_at_zero_angle + slope * angle
    thrust = (along + pressure * drag_coefficient(aircraft, lift)) / np.cos(angle)
    return FlightNeeds(
        airspeed,
        np.sqrt((force * force).sum(axis=-1) + _LEAST),
        lift,
        2 * np.arctan(sideward / (across + upward + _LEAST)),
        np.arctan(climb_sine / climb_cosine),
        thrust,
    )


def thrust_limits(aircraft: Aircraft, airspeed: NDArray) -> tuple[NDArray, NDArray]:
    """T_min and T_max, each (...,), N, at airspeeds (...,), m/s."""
    least, most = aircraft.min_thrust, aircraft.max_thrust
    return (
        least[0:1] + least[1:2] * airspeed + least[2:3] * airspeed * airspeed,
        most[0:1] + most[1:2] * airspeed + most[2:3] * airspeed * airspeed,
    )


def thrust_share(aircraft: Aircraft, thrust: NDArray, airspeed: NDArray) -> NDArray:
    """T/T_max (...,) of T (...,), N, at airspeeds (...,), m/s; floats.

    It is negative where the propeller brakes, and 1 where the airspeed leaves no thrust at all.
    """
    _, most = thrust_limits(aircraft, airspeed)
    return np.divide(thrust, most, out=np.ones(np.shape(thrust)), where=most > _ROUNDING)


def stall_speed(aircraft: Aircraft) -> NDArray | float:
    """V_s = √(2 m g/(ρ S C_Lmax)), m/s, without a cable's force."""
    weight = aircraft.mass * aircraft.gravity
    return np.sqrt(2 * weight / (aircraft.air_density * aircraft.wing_area * aircraft.max_lift))


def stall_factor(aircraft: Aircraft, lift_share: float) -> float | NDArray:
    """κ_s = ½ ρ S s C_Lmax (N s²/m²): ‖F‖ ≤ κ_s V² keeps C_L within a share s of C_Lmax.

    Within some percent: ‖F‖ holds all of the thrust less the drag, and C_L not that part of the
    thrust which lifts.
    """
    return aircraft.air_density / 2 * aircraft.wing_area * lift_share * aircraft.max_lift


def airspeed_over_loaded_stall(
    aircraft: Aircraft, airspeed: NDArray, lift: NDArray, thrust: NDArray
) -> NDArray:
    """V/(V_s √n) (...,): the airspeed over the stall speed at the present load factor n; floats.

    n = (q S C_L + T sin α)/(m g) is the force across the flight through the air over the weight. It
    counts what the cable pulls, and what the bank takes. Where nothing is carried the ratio is
    large, and finite.

    Args:
        aircraft: the parameters.
        airspeed: V (...,), m/s.
        lift: C_L (...,).
        thrust: T (...,), N.
    """
    angle = angle_of_attack(aircraft, lift)
    across = pressure_force(aircraft, airspeed) * lift + thrust * np.sin(angle)
    load_factor = across / (aircraft.mass * aircraft.gravity)
    return airspeed / (stall_speed(aircraft) * np.sqrt(np.maximum(load_factor, _LEAST)))


def is_stalled(aircraft: Aircraft, aircraft_state: NDArray) -> NDArray:
    """Whether aircraft are stalled (..., n), of `AircraftState` (..., 4n); floats only.

    The effective C_L is C_Lmax, or the airspeed below the stall speed without a cable.
    """
    shown = AircraftState.view(aircraft_state)
    is_at_limit = shown.lift >= aircraft.max_lift * (1 - _ROUNDING)
    return is_at_limit | (shown.airspeed < stall_speed(aircraft) * (1 - _ROUNDING))


def thrust_power(thrust: NDArray, airspeed: NDArray) -> NDArray:
    """max(T, 0) V (...,), W, of T (...,), N, and V (...,), m/s: a braking propeller gives none."""
    return positive_part(thrust) * airspeed


def drawn_power(aircraft: Aircraft, thrust: NDArray, airspeed: NDArray) -> NDArray:
    """`thrust_power` over η (...,), W: what is drawn from the battery."""
    return thrust_power(thrust, airspeed) / aircraft.efficiency


def limited_lift(aircraft: Aircraft, lift: NDArray) -> NDArray:
    """min(C_L, C_Lmax), exact, for any scalar type: that of a stalled wing is the largest."""
    return lift - positive_part(lift - aircraft.max_lift)


def limited_thrust(aircraft: Aircraft, thrust: NDArray, airspeed: NDArray) -> NDArray:
    """T (...,), N, within `thrust_limits` at airspeeds (...,), m/s."""
    return within(thrust, *thrust_limits(aircraft, airspeed))


class FlightStates(SignalParts):
    """The states of n aircraft."""

    positions: NDArray = part("3n", "m", "W")
    velocities: NDArray = part("3n", "m/s", "W")
    lift: NDArray = part("n", "", "", "C_L without the gusts' part")
    bank: NDArray = part("n", "rad", "", "positive to the right")
    thrust: NDArray = part("n", "N")
    slow_wind: NDArray = part("3n", "m/s", "W", "the wind that the autopilot has taken out")


def shown_state(aircraft: Aircraft, states: NDArray, wind: NDArray) -> NDArray:
    """`AircraftState` (4n,) of `FlightStates` (12n,) in winds (3n,), m/s, in W."""
    own, air_velocity, lift = _in_gusts(aircraft, states, wind)
    airspeed = air_frame(air_velocity).airspeed[..., 0]
    return np.concatenate(AircraftState(lift, own.bank, own.thrust, airspeed))


def flight_acceleration(
    aircraft: Aircraft, states: NDArray, cable_forces: NDArray, wind: NDArray
) -> NDArray:
    """Accelerations (3n,), m/s², of `FlightStates` (12n,); see `flight_rate`."""
    own, air_velocity, lift = _in_gusts(aircraft, states, wind)
    force = air_force(aircraft, air_velocity, lift, own.bank, own.thrust)
    force = force - cable_forces.reshape(-1, 3)
    return (force / aircraft.mass - aircraft.gravity * _UP).ravel()


def flight_rate(
    aircraft: Aircraft, states: NDArray, command: NDArray, cable_forces: NDArray, wind: NDArray
) -> NDArray:
    """The rate (12n,) of `FlightStates` (12n,), with the lags of the commands.

        Ċ_L = (k_L C_Lc − C_L)/τ_L,   μ̇ = sat((μ_c − μ)/τ_μ, p_max),   Ṫ = (sat(k_T T_c) − T)/τ_T,

    with the gains k_L and k_T of an aircraft that does not meet its commands, and the thrust within
    its limits at that airspeed. Gusts change the angle of attack at once, and the autopilot takes
    their slow part out again: with the wind w and the slow wind w_s, ẇ_s = (w − w_s)/τ_w, the
    effective C_L is min(C_L + C_Lα (w − w_s)·l/V, C_Lmax). The gusts' part is therefore zero in a
    wind that does not change, also for an aircraft that turns.

    Args:
        aircraft: the parameters.
        states: `FlightStates` (12n,).
        command: `AircraftCommand` (3n,).
        cable_forces: f (3n,), N, on the load, in W.
        wind: w (3n,), m/s, in W.
    """
    own, told = FlightStates.view(states), AircraftCommand.view(command)
    air = wind.reshape(-1, 3)
    airspeed = air_frame(own.velocities - air).airspeed[..., 0]
    thrust = limited_thrust(aircraft, aircraft.thrust_gain * told.thrust, airspeed)
    roll_rate = clipped((told.bank - own.bank) / aircraft.bank_lag, aircraft.max_roll_rate)
    return FlightStates(
        own.velocities,
        flight_acceleration(aircraft, states, cable_forces, wind).reshape(-1, 3),
        (aircraft.lift_gain * told.lift - own.lift) / aircraft.lift_lag,
        roll_rate,
        (thrust - own.thrust) / aircraft.thrust_lag,
        (air - own.slow_wind) / aircraft.gust_time,
    ).flat()


def trimmed_states(
    aircraft: Aircraft,
    carrier_state: NDArray,
    acceleration: NDArray,
    cable_forces: NDArray,
    wind: NDArray,
) -> NDArray:
    """`FlightStates` (12n,) of carriers (6n,) with these accelerations (3n,), m/s², in W.

    Thrust is within its limits, and the lift at most that of a stalled wing.
    """
    carriers, air = CarrierStates.view(carrier_state), wind.reshape(-1, 3)
    force = needed_force(aircraft, acceleration.reshape(-1, 3), cable_forces.reshape(-1, 3))
    needs = flight_needs(aircraft, force, carriers.velocities - air)
    thrust = limited_thrust(aircraft, needs.thrust, needs.airspeed)
    lift = limited_lift(aircraft, needs.lift)
    return FlightStates(*carriers, lift, needs.bank, thrust, air).flat()


def _in_gusts(
    aircraft: Aircraft, states: NDArray, wind: NDArray
) -> tuple[FlightStates, NDArray, NDArray]:
    """The states, velocities through the air, and C_L (n,) with that of fast gusts, C_Lα δα.

    δα = gust·l/V.
    """
    own, air = FlightStates.view(states), wind.reshape(-1, 3)
    air_velocity = own.velocities - air
    frame = air_frame(air_velocity)
    gust = air - own.slow_wind
    upwash = (gust * frame.lift_direction(own.bank)).sum(axis=-1)
    lift = own.lift + aircraft.lift_slope * upwash / frame.airspeed[..., 0]
    return own, air_velocity, limited_lift(aircraft, lift)
