"""Carriers along a planned orbit: their speeds and distances, and what aircraft need.

The orbit above a moving load is flown at a phase θ, with ξ and A that change. All vectors are
components in the load's frame L, in which the pattern is constant; wind enters by the velocity
through the air alone, v_b − Rᵀw. In steps, each usable alone and most of numbers or symbols:

- `orbit_along_reference`: of a load on its reference, what speeds and distances depend on besides
  phase, ξ and A, an `OrbitTerms`; `flight_terms` (wrench and load motion given) or
  `flight_along_reference` (both of a reference): what aircraft depend on, a `FlightTerms`;
- `planned_speeds` and `planned_gaps`: with these the squared speeds, tensions and distances;
- `flight_products`: with these and a `PlannedOrbit`, the six scalar products of the velocity
  through the air V_a, the needed force F = m (v̇ + g e₃) + f and the vertical that decide all needs,
  `FlightProducts`;
- `flight_needs`: airspeed, ‖F‖, C_L, bank, climb and thrust of such products, `FlightNeeds`, by the
  exact inverse `lift_and_thrust`. Stall alone needs ‖F‖ and V only, see `stall_factor`.

With u = p cos θ + q sin θ and u′ = ∂u/∂θ, p and q from `mechanics.nonstop.orbit_axes`,

    f = f₀ + A u,   ᴸḟ = d + Ȧ u + A ξ u′,   ᴸf̈ = d₂ + (Ä − A ξ²) u + (2 Ȧ ξ + A ξ̇) u′,
    r = ᴸḟ + ω × f,   s = ᴸf̈ + 2 ω × ᴸḟ + α × f + ω × (ω × f),

and a = f·r/T², b = (r·r + f·s)/T² − 3 a², T = ‖f‖,

    V_a = v_b + (L₀/T) (r − a f) + r/K_c,   v̇ = a_b + (L₀/T) (s − 2 a r − b f) + s/K_c,

as `carrier_motion` and `carrier_acceleration`. Own derivation.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import Aircraft, lift_and_thrust
from drake_nonstop.mechanics.force_rates import second_and_third_force_rates
from drake_nonstop.mechanics.rigid_load import STILL_AIR, RigidLoad
from drake_nonstop.mechanics.rotation import cross, rotation_matrix
from drake_nonstop.mechanics.signals import (
    LOAD_STATE_SIZE,
    WRENCH_SIZE,
    LoadReference,
    Wrench,
)
from drake_nonstop.mechanics.wrench import feedforward_wrench

_UP = np.array([0.0, 0.0, 1.0])
_LEAST = 1e-12  # beside squares that may vanish


class OrbitTerms(NamedTuple):
    """What the speeds of n carriers depend on besides θ, ξ and A, in L."""

    forces: NDArray  # (..., n, 3), N, f₀
    rates: NDArray  # (..., n, 3), N/s, d
    velocities: NDArray  # (..., n, 3), m/s, v_b
    angular_velocity: NDArray  # (..., 3), rad/s, ω

    @classmethod
    def view(cls, values: NDArray) -> "OrbitTerms":
        """The parts of an array (..., 9n + 3)."""
        lead = values.shape[:-1]
        parts = values[..., :-3].reshape(*lead, 3, -1, 3)
        return cls(parts[..., 0, :, :], parts[..., 1, :, :], parts[..., 2, :, :], values[..., -3:])

    @property
    def columns(self) -> NDArray:
        """For each carrier at k instants the terms of it alone, flat, (12, k, n)."""
        return _columns(self[:3], self[3:])


class FlightTerms(NamedTuple):
    """What the flight of n aircraft depends on besides the `PlannedOrbit`, in L."""

    forces: NDArray  # (..., n, 3), N, f₀
    rates: NDArray  # (..., n, 3), N/s, d, of the components in L, as the next
    second_rates: NDArray  # (..., n, 3), N/s², d₂
    velocities: NDArray  # (..., n, 3), m/s, v_b of the attachments, through the air
    accelerations: NDArray  # (..., n, 3), m/s², a_b of the attachments
    angular_velocity: NDArray  # (..., 3), rad/s, ω
    angular_acceleration: NDArray  # (..., 3), rad/s², α
    up: NDArray  # (..., 3), e₃

    @classmethod
    def view(cls, values: NDArray) -> "FlightTerms":
        """The parts of an array (..., 15n + 9)."""
        lead = values.shape[:-1]
        parts = values[..., :-9].reshape(*lead, 5, -1, 3)
        rest = values[..., -9:].reshape(*lead, 3, 3)
        return cls(*(parts[..., i, :, :] for i in range(5)), *(rest[..., i, :] for i in range(3)))

    @property
    def flat(self) -> NDArray:
        """The array (..., 15n + 9) of which these are the parts."""
        vectors, lead = self[:5], self.up.shape[:-1]
        return np.concatenate([*(v.reshape(*lead, -1) for v in vectors), *self[5:]], axis=-1)

    @property
    def of_speeds(self) -> OrbitTerms:
        """Those that count for speeds."""
        return OrbitTerms(self.forces, self.rates, self.velocities, self.angular_velocity)

    @property
    def columns(self) -> NDArray:
        """For each carrier at k instants the terms of it alone, flat, (24, k, n)."""
        return _columns(self[:5], self[5:])


class PlannedOrbit(NamedTuple):
    """Phase, ξ and A with their rates at k instants."""

    angle: NDArray  # (k,), rad, θ
    frequency: NDArray  # (k,), rad/s, ξ
    frequency_rate: NDArray  # (k,), rad/s², ξ̇
    amplitude: NDArray  # (k,), N, A
    amplitude_rate: NDArray  # (k,), N/s, Ȧ
    amplitude_second_rate: NDArray  # (k,), N/s², Ä


class FlightProducts(NamedTuple):
    """The products that decide what an aircraft needs; of any one shape."""

    v_v: NDArray  # V_a·V_a, m²/s², the squared airspeed
    f_f: NDArray  # F·F, N²
    f_v: NDArray  # F·V_a
    f_up: NDArray  # F·e₃
    v_up: NDArray  # V_a·e₃
    triple: NDArray  # e₃·(F × V_a)


class FlightNeeds(NamedTuple):
    """What aircraft need; of any one shape."""

    airspeed: NDArray  # m/s
    force: NDArray  # N, ‖F‖
    lift: NDArray  # C_L
    bank: NDArray  # rad, positive to the right
    climb: NDArray  # rad, of the path through the air
    thrust: NDArray  # N


def _terms_along_reference(
    load: RigidLoad, reference: NDArray, wind: NDArray, **constants: NDArray
) -> FlightTerms:
    """The terms of a load on its reference, with the wrench that moves it along."""
    state = reference[:LOAD_STATE_SIZE]
    wrenches = *feedforward_wrench(load, reference, wind), np.zeros(WRENCH_SIZE)
    return flight_terms(state, reference, *wrenches, wind, **constants)


def orbit_along_reference(
    load: RigidLoad,
    reference: NDArray,
    wind: NDArray = STILL_AIR,
    *,
    pseudo_inverse: NDArray,
    offset: NDArray,
    attachments: NDArray,
) -> NDArray:
    """The flat `OrbitTerms` (9n + 3,) of a load on its `reference` (22,), of numbers or symbols.

    The wrench is that which moves the load along its reference in the steady `wind` (3,), m/s, in
    W; the velocities are those through this air. The reference's angular jerk is taken as zero.
    `pseudo_inverse` (3n, 6), `offset` (3n,) in N and `attachments` (n, 3) are in L.
    """
    terms = _terms_along_reference(
        load,
        reference,
        wind,
        pseudo_inverse=pseudo_inverse,
        offset=offset,
        attachments=attachments,
    )
    return np.concatenate([part.ravel() for part in terms.of_speeds])


def flight_terms(
    state: NDArray,
    motion: NDArray,
    wrench: NDArray,
    wrench_rate: NDArray,
    wrench_second_rate: NDArray,
    wind: NDArray = STILL_AIR,
    *,
    pseudo_inverse: NDArray,
    offset: NDArray,
    attachments: NDArray,
) -> FlightTerms:
    """The terms of a load with a given motion and wrench, of numbers or symbols.

    Args:
        state: of the load (13,), or what begins with one; turns the load-frame forces.
        motion: (22,), with the accelerations, that the carriers follow, such as a reference.
        wrench: (6,), in W, and its first two rates.
        wrench_rate: (6,).
        wrench_second_rate: (6,).
        wind: w (3,), m/s, in W.
        pseudo_inverse: (3n, 6), in L.
        offset: (3n,), N, in L.
        attachments: (n, 3), m, in L.
    """
    own, moving = LoadReference.view(state), LoadReference.view(motion)
    R_LW = rotation_matrix(own.quaternion).T
    omega = R_LW @ own.angular_velocity
    alpha = R_LW @ moving.angular_acceleration

    def rotated(values: NDArray) -> tuple[NDArray, NDArray]:
        parts = Wrench.view(values)
        return R_LW @ parts.torque, R_LW @ parts.force

    parts = [rotated(values) for values in (wrench, wrench_rate, wrench_second_rate)]
    of_components: list[list[NDArray]] = [[], [], []]
    for value, rate, second_rate in zip(*parts, strict=True):
        own_rate = rate - cross(omega, value)
        own_second = second_rate - cross(omega, rate) - cross(omega, own_rate) - cross(alpha, value)
        for found, component in zip(of_components, (value, own_rate, own_second), strict=True):
            found.append(component)
    forces, rates, second_rates = (pseudo_inverse @ np.concatenate(c) for c in of_components)
    turn = R_LW @ rotation_matrix(moving.quaternion)
    levers = attachments @ turn.T
    turning = R_LW @ moving.angular_velocity
    swing = cross(turning, levers)
    velocities = R_LW @ (moving.velocity - wind) + swing
    accelerations = R_LW @ moving.acceleration + cross(alpha, levers) + cross(turning, swing)
    return FlightTerms(
        (forces + offset).reshape(-1, 3),
        rates.reshape(-1, 3),
        second_rates.reshape(-1, 3),
        velocities,
        accelerations,
        omega,
        alpha,
        R_LW @ _UP,
    )


def flight_along_reference(
    load: RigidLoad,
    reference: NDArray,
    wind: NDArray = STILL_AIR,
    *,
    pseudo_inverse: NDArray,
    offset: NDArray,
    attachments: NDArray,
) -> NDArray:
    """The flat `FlightTerms` (15n + 9,) of a load on its `reference` (22,), of numbers or symbols.

    The wrench is that which moves the load along its reference in the steady `wind` (3,), m/s,
    in W. The reference's angular jerk and snap are taken as zero. Others as of `flight_terms`.
    """
    terms = _terms_along_reference(
        load,
        reference,
        wind,
        pseudo_inverse=pseudo_inverse,
        offset=offset,
        attachments=attachments,
    )
    R_WL = rotation_matrix(LoadReference.view(reference).quaternion)
    omega, alpha = terms.angular_velocity, terms.angular_acceleration
    turning = cross(omega, terms.forces)
    seconds, _ = second_and_third_force_rates(
        load,
        reference,
        terms.forces @ R_WL.T,
        (terms.rates + turning) @ R_WL.T,
        np.zeros(2),
        wind,
        pseudo_inverse=pseudo_inverse,
        basis=np.zeros((len(pseudo_inverse), 1)),
    )
    of_turning = 2 * cross(omega, terms.rates) + cross(alpha, terms.forces) + cross(omega, turning)
    return terms._replace(second_rates=seconds @ R_WL - of_turning).flat


def turning_terms(
    motion: NDArray,
    wrench: NDArray,
    wrench_rate: NDArray,
    wind: NDArray,
    rates: NDArray,
    angles: NDArray,
    *,
    pseudo_inverse: NDArray,
    offset: NDArray,
    attachments: NDArray,
) -> FlightTerms:
    """The terms of a load that turns about the vertical with its carriers, at k rates and angles.

    They are `flight_terms` of the motion with another yaw and yaw rate, at a constant force in W
    but for its rate, and a constant torque in L. With A = 0, which does not count, the products
    then are those of aircraft that keep their places above the load; the squared airspeed is
    quadratic in the rate. Own derivation.

    Args:
        motion: (22,), of the load, such as a reference.
        wrench: (6,), in W.
        wrench_rate: (6,), of which that of the force counts.
        wind: w (3,), m/s, in W.
        rates: (k,), rad/s, of the turn.
        angles: (k,), rad, by which the load has turned on from its present yaw.
        pseudo_inverse: (3n, 6), in L.
        offset: (3n,), N, in L.
        attachments: (n, 3), m, in L.
    """
    own, n = LoadReference.view(motion), len(attachments)
    start = rotation_matrix(own.quaternion)
    cosine, sine, zero = np.cos(angles), np.sin(angles), 0 * angles
    turned = np.stack([cosine, -sine, zero, sine, cosine, zero, zero, zero, zero + 1], axis=-1)
    R_WL = turned.reshape(-1, 3, 3) @ start
    up = start.T @ _UP
    omega = rates[:, None] * up
    force, force_rate, velocity, acceleration = (
        vector @ R_WL
        for vector in (
            Wrench.view(wrench).force,
            Wrench.view(wrench_rate).force,
            own.velocity - wind,
            own.acceleration,
        )
    )
    own_rate = force_rate - cross(omega, force)
    own_second = -cross(omega, force_rate) - cross(omega, own_rate)
    torque = Wrench.view(wrench).torque @ start + 0 * force
    by_torque, by_force = pseudo_inverse[:, :3], pseudo_inverse[:, 3:]

    def in_cables(torque: NDArray, force: NDArray) -> NDArray:
        return (torque @ by_torque.T + force @ by_force.T).reshape(-1, n, 3)

    turning = omega[:, None]
    swing = cross(turning, attachments)
    return FlightTerms(
        in_cables(torque, force) + offset.reshape(n, 3),
        in_cables(0 * torque, own_rate),
        in_cables(0 * torque, own_second),
        velocity[:, None] + swing,
        acceleration[:, None] + cross(turning, swing),
        omega,
        0 * omega,
        up + 0 * omega,
    )


class PlannedSpeeds(NamedTuple):
    """Squared speeds and tensions at k instants."""

    squares: NDArray  # (k, n), m²/s²
    tension_squares: NDArray  # (k, n), N²


def planned_speeds(
    terms: OrbitTerms,
    axes: tuple[NDArray, NDArray],
    angle: NDArray,
    frequency: NDArray,
    amplitude: NDArray,
    amplitude_rate: NDArray,
    *,
    rest_length: Any,
    compliance: Any,
) -> PlannedSpeeds:
    """The carriers' squared speeds at k instants of a plan, of numbers or symbols.

    Args:
        terms: at k instants.
        axes: p and q (n, 3), in L, of `mechanics.nonstop.orbit_axes`.
        angle: θ (k,), rad.
        frequency: ξ (k,), rad/s.
        amplitude: A (k,), N.
        amplitude_rate: Ȧ (k,), N/s.
        rest_length: L₀, m.
        compliance: 1/K_c, m/N.
    """
    A, xi, rate = amplitude[:, None], frequency[:, None], amplitude_rate[:, None]
    f, u, along = _planned_forces(terms.forces, axes, angle, amplitude)
    rates, v_b = _by_component(terms.rates), _by_component(terms.velocities)
    omega = _instants_last(terms.angular_velocity)
    r = rates + _cross(omega, f) + rate * u + (A * xi) * along
    v, tension_square, *_ = _velocity(v_b, f, r, rest_length, compliance)
    return PlannedSpeeds(_dot(v, v), tension_square)


def planned_gaps(
    forces: NDArray,
    axes: tuple[NDArray, NDArray],
    angle: NDArray,
    amplitude: NDArray,
    *,
    attachments: NDArray,
    pairs: NDArray,
    rest_length: Any,
    compliance: Any,
) -> NDArray:
    """The squared distances (k, m), m², between carriers at k instants.

    A carrier is at its attachment plus (L₀/T + 1/K_c) f, see `planned_speeds`.

    Args:
        forces: f₀ (k, n, 3), N, of `OrbitTerms`.
        axes: as of `planned_speeds`, and so are the angle and the amplitude (k,).
        angle: θ, rad.
        amplitude: A, N.
        attachments: (n, 3), in L, m.
        pairs: (2, m), the numbers of the carriers.
        rest_length: L₀, m.
        compliance: 1/K_c, m/N.
    """
    f, _, _ = _planned_forces(forces, axes, angle, amplitude)
    places = (rest_length / np.sqrt(_dot(f, f)) + compliance) * f + attachments.T[:, None]
    first, second = pairs
    gaps = places[..., first] - places[..., second]
    return _dot(gaps, gaps)


def flight_products(
    aircraft: Aircraft,
    terms: FlightTerms,
    axes: tuple[NDArray, NDArray],
    orbit: PlannedOrbit,
    *,
    rest_length: Any,
    compliance: Any,
    cable_forces: Any = None,
) -> FlightProducts:
    """The products (k, n) at k instants, of numbers or symbols.

    Args:
        aircraft: its mass and gravity count.
        terms: at k instants, or at one (1, ...).
        axes: p and q (n, 3), in L, of `mechanics.nonstop.orbit_axes`.
        orbit: at the instants.
        rest_length: L₀, m.
        compliance: 1/K_c, m/N.
        cable_forces: (k, n, 3), N, in L, on the load, that pull at the aircraft in place of the
            planned ones; None: those.
    """
    _, xi, xi_rate, A, A_rate, A_second = (values[:, None] for values in orbit)
    force, u, along = _planned_forces(terms.forces, axes, orbit.angle, orbit.amplitude)
    d, d_2, v_b, a_b = (_by_component(vectors) for vectors in terms[1:5])
    omega, alpha, up = (_instants_last(vectors) for vectors in terms[5:])
    rate = d + A_rate * u + (A * xi) * along
    second_rate = d_2 + (A_second - A * xi * xi) * u + (2 * A_rate * xi + A * xi_rate) * along
    r, s = _turned(omega, alpha, force, rate, second_rate)
    velocity, square, swing, a = _velocity(v_b, force, r, rest_length, compliance)
    b = (_dot(r, r) + _dot(force, s)) / square - 3 * a * a
    acceleration = a_b + swing * (s - 2 * a * r - b * force) + compliance * s
    needed = aircraft.mass * (acceleration + aircraft.gravity * up) + force
    if cable_forces is not None:
        needed = needed + _by_component(cable_forces) - force
    return FlightProducts(
        _dot(velocity, velocity),
        _dot(needed, needed),
        _dot(needed, velocity),
        _dot(needed, up),
        _dot(velocity, up),
        _dot(_cross(needed, velocity), up),
    )


def planned_cable_forces(
    terms: FlightTerms, axes: tuple[NDArray, NDArray], orbit: PlannedOrbit
) -> NDArray:
    """The cables' f (k, n, 3), N, in L; arguments as of `flight_products`."""
    force, _, _ = _planned_forces(terms.forces, axes, orbit.angle, orbit.amplitude)
    return np.moveaxis(force, 0, -1)


def flight_needs(aircraft: Aircraft, products: FlightProducts) -> FlightNeeds:
    """What aircraft need, of products of numbers or symbols of one shape (...,).

    As `required_command` for the same F and V_a, to round-off.
    """
    airspeed = np.sqrt(products.v_v + _LEAST)
    force = np.sqrt(products.f_f + _LEAST)
    along = products.f_v / airspeed
    across = np.sqrt(products.f_f - along * along + _LEAST)
    climb_sine = products.v_up / airspeed
    climb_cosine = np.sqrt(1 - climb_sine * climb_sine + _LEAST)
    sideward = products.triple / (airspeed * climb_cosine)
    upward = (products.f_up - climb_sine * along) / climb_cosine
    lift, thrust = lift_and_thrust(aircraft, along, across, airspeed)
    return FlightNeeds(
        airspeed,
        force,
        lift,
        2 * np.arctan(sideward / (across + upward + _LEAST)),
        np.arctan(climb_sine / climb_cosine),
        thrust,
    )


def stall_factor(aircraft: Aircraft, lift_share: float) -> float | NDArray:
    """κ_s = ½ ρ S s C_Lmax (N s²/m²): ‖F‖ ≤ κ_s V² keeps C_L within a share s of C_Lmax.

    Within some percent: ‖F‖ holds all of the thrust less the drag, and C_L not that part of the
    thrust which lifts.
    """
    return aircraft.air_density / 2 * aircraft.wing_area * lift_share * aircraft.max_lift


def _planned_forces(
    forces: NDArray, axes: tuple[NDArray, NDArray], angle: NDArray, amplitude: NDArray
) -> tuple[NDArray, NDArray, NDArray]:
    """f, u and u' (3, k, n): sums over components are several times faster in this order."""
    p, q = (axis.T[:, None] for axis in axes)
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    u, along = cosine * p + sine * q, cosine * q - sine * p
    return _by_component(forces) + amplitude[:, None] * u, u, along


def _velocity(
    attachments: NDArray, force: NDArray, rate: NDArray, rest_length: Any, compliance: Any
) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Of carriers whose attachments have these velocities (3, k, n), with T², L₀/T and a (k, n)."""
    square = _dot(force, force)
    swing = rest_length / np.sqrt(square)
    a = _dot(force, rate) / square
    return attachments + (swing + compliance) * rate - (swing * a) * force, square, swing, a


def _turned(
    omega: NDArray, alpha: NDArray, force: NDArray, rate: NDArray, second_rate: NDArray
) -> tuple[NDArray, NDArray]:
    """The rates in W, in L, of a vector whose components in L have these (3, ...)."""
    turning = _cross(omega, force)
    second = second_rate + 2 * _cross(omega, rate) + _cross(alpha, force) + _cross(omega, turning)
    return rate + turning, second


def _columns(of_carriers: Sequence[NDArray], of_load: Sequence[NDArray]) -> NDArray:
    """Vectors (k, n, 3) of carriers and (k, 3) of the load, one below the other, (..., k, n)."""
    columns = [np.moveaxis(vectors, -1, 0) for vectors in of_carriers]
    shape = columns[0].shape
    columns += [np.broadcast_to(vectors.T[:, :, None], shape) for vectors in of_load]
    return np.concatenate(columns)


def _by_component(vectors: NDArray) -> NDArray:
    """Vectors (..., 3) with their components first, (3, ...)."""
    return np.ascontiguousarray(np.moveaxis(vectors, -1, 0))


def _instants_last(vectors: NDArray) -> NDArray:
    """Vectors (k, 3) as (3, k, 1), which broadcasts to (3, k, n)."""
    return vectors.T[:, :, None]


def _dot(a: NDArray, b: NDArray) -> NDArray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: NDArray, b: NDArray) -> NDArray:
    return np.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )
