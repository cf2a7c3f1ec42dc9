"""Carriers along an orbit: their speeds and distances, and what aircraft need.

The orbit above a moving load is flown at a phase θ, with ξ and A that change. All vectors are
components in the load's frame L, in which the pattern is constant; wind enters by the velocity
through the air alone, v_b − Rᵀw. In steps, each usable alone and most of numbers or symbols:

- `flight_terms` (wrench and load motion given), `turning_terms` or `flight_along_reference`: what
  carriers depend on besides phase, ξ and A, a `FlightTerms`; `orbit_along_reference`: what counts
  of it for speeds and distances, an `OrbitTerms`;
- `orbit_motion`: with these and a `PlannedOrbit`, the carriers' motion and their cables' forces;
- `planned_speeds`, `planned_gaps` and `planned_needs`: what of it is bounded;
- `speed_polynomials`, `speed_squares`: speeds at constant ξ and A by polynomials in A.

With u = p cos θ + q sin θ, p and q from `orbit_axes`, or any other u(θ), and u′ = ∂u/∂θ,

    f = f₀ + A u,   ᴸḟ = d + Ȧ u + A ξ u′,   ᴸf̈ = d₂ + Ä u + (2 Ȧ ξ + A ξ̇) u′ + A ξ² u″,
    r = ᴸḟ + ω × f,   s = ᴸf̈ + ω × ᴸḟ + α × f + ω × r

are the cables' forces and their rates; of f, r and s follow by `cable_vectors` the rates of the
vectors from the attachments to the carriers. Own derivation.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import Aircraft, FlightNeeds, flight_needs, needed_force
from drake_nonstop.mechanics.carrier import cable_vectors
from drake_nonstop.mechanics.grasp import wrenches_along
from drake_nonstop.mechanics.internal_force import internal_force
from drake_nonstop.mechanics.rigid_load import STILL_AIR, RigidLoad
from drake_nonstop.mechanics.rotation import cross, quaternion_product, rotation_matrix
from drake_nonstop.mechanics.signals import (
    PLANNED_SIZE,
    LoadReference,
    PlannedParameters,
    Wrench,
)

_UP = np.array([0.0, 0.0, 1.0])
Axes = tuple[NDArray, NDArray]  # p and q (n, 3), of `orbit_axes`
Vectors = tuple[NDArray, NDArray, NDArray]
Directions = Vectors  # u, u′ and u″ (k, n, 3)


class OrbitTerms(NamedTuple):
    """Terms of the speeds of n carriers besides θ, ξ and A, in L."""

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
    def of_flight(self) -> "FlightTerms":
        """These with zeros for those that do not count for speeds."""
        none = np.zeros((1, 1, 3))
        return FlightTerms(*self[:2], none, self.velocities, none, self[3], none[0], none[0])


class FlightTerms(NamedTuple):
    """Terms of the flight of n aircraft besides the `PlannedOrbit`, in L."""

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
        """Terms that count for speeds."""
        return OrbitTerms(self.forces, self.rates, self.velocities, self.angular_velocity)


def term_columns(n: int, of_carriers: int = 3, of_load: int = 1) -> NDArray:
    """Where in flat terms those of each of n carriers are, (3 (of_carriers + of_load), n).

    The vectors of carriers come first, n of each kind, and then those of the load; by default those
    of `OrbitTerms`.
    """
    own = np.arange(3 * of_carriers * n).reshape(of_carriers, n, 3)
    shared = 3 * of_carriers * n + np.arange(3 * of_load)
    return np.vstack([own.transpose(0, 2, 1).reshape(-1, n), np.tile(shared[:, None], n)])


class PlannedOrbit(NamedTuple):
    """Phase, ξ and A with their rates at k instants."""

    angle: NDArray  # (k,), rad, θ
    frequency: NDArray  # (k,), rad/s, ξ
    frequency_rate: NDArray  # (k,), rad/s², ξ̇
    amplitude: NDArray  # (k,), N, A
    amplitude_rate: NDArray  # (k,), N/s, Ȧ
    amplitude_second_rate: NDArray  # (k,), N/s², Ä

    @classmethod
    def of_planned(cls, values: NDArray) -> "PlannedOrbit":
        """That of the plan's values (k, 8), as of the signal `planned`."""
        parts = PlannedParameters.view(values)
        return cls(*(getattr(parts, name)[:, 0] for name in cls._fields))

    @property
    def planned(self) -> NDArray:
        """The values (k, 8) of the signal `planned`, of which those that are not known are zero."""
        values = np.zeros((len(self.angle), PLANNED_SIZE))
        for name, own in self._asdict().items():
            getattr(PlannedParameters.view(values), name)[:, 0] = own
        return values

    @classmethod
    def constant(cls, angle: NDArray, frequency: Any, amplitude: Any) -> "PlannedOrbit":
        """The orbits of constant ξ and A, numbers or (k,)."""
        one, zero = np.ones(angle.shape), np.zeros(angle.shape)
        return cls(angle, frequency * one, zero, amplitude * one, zero, zero)


class OrbitMotion(NamedTuple):
    """The motion of n carriers at k instants, (k, n, 3) each, in L."""

    forces: NDArray  # N, of the cables on the load
    cables: NDArray  # m, from the attachments to the carriers
    velocities: NDArray  # m/s, through the air
    accelerations: NDArray  # m/s²


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
    """The terms of a load with a given motion and wrench, at one instant or more.

    Args:
        state: of the load (..., 13), or what begins with one; turns the load-frame forces.
        motion: (..., 22), with the accelerations, that the carriers follow, such as a reference.
        wrench: (..., 6), in W, and its first two rates.
        wrench_rate: (..., 6).
        wrench_second_rate: (..., 6).
        wind: w (3,), m/s, in W.
        pseudo_inverse: (3n, 6), in L.
        offset: (3n,), N, in L.
        attachments: (n, 3), m, in L.
    """
    own, moving = LoadReference.view(state), LoadReference.view(motion)
    R_WL = rotation_matrix(own.quaternion)
    omega = _rotated(own.angular_velocity, R_WL)
    alpha = _rotated(moving.angular_acceleration, R_WL)
    parts = []
    for vectors in zip(*map(Wrench.view, (wrench, wrench_rate, wrench_second_rate)), strict=True):
        value, rate, second_rate = (_rotated(vector, R_WL) for vector in vectors)
        own_rate = rate - cross(omega, value)
        second_rate = second_rate - cross(omega, rate) - cross(omega, own_rate)
        parts.append((value, own_rate, second_rate - cross(alpha, value)))
    wrenches = [np.concatenate(part, axis=-1) for part in zip(*parts, strict=True)]
    return _terms(R_WL, omega, moving, wrenches, wind, pseudo_inverse, offset, attachments)


def _terms(
    R_WL: NDArray,
    omega: NDArray,
    moving: LoadReference,
    wrenches: Sequence[NDArray],
    wind: NDArray,
    pseudo_inverse: NDArray,
    offset: NDArray,
    attachments: NDArray,
) -> FlightTerms:
    """The terms of a wrench (..., 6), in L, and the first two rates of these components."""
    alpha, turning = (
        _rotated(vector, R_WL) for vector in (moving.angular_acceleration, moving.angular_velocity)
    )
    forces, rates, second_rates = (
        (part @ pseudo_inverse.T + constant).reshape(*part.shape[:-1], -1, 3)
        for part, constant in zip(wrenches, (offset, 0.0, 0.0), strict=True)
    )
    levers = attachments @ (rotation_matrix(moving.quaternion).swapaxes(-1, -2) @ R_WL)
    omega_b, alpha_b = turning[..., None, :], alpha[..., None, :]
    swing = cross(omega_b, levers)
    return FlightTerms(
        forces,
        rates,
        second_rates,
        _rotated(moving.velocity - wind, R_WL)[..., None, :] + swing,
        _rotated(moving.acceleration, R_WL)[..., None, :]
        + cross(alpha_b, levers)
        + cross(omega_b, swing),
        omega,
        alpha,
        _rotated(_UP, R_WL),
    )


def _rotated(vector: NDArray, R_WL: NDArray) -> NDArray:
    """A vector (..., 3) in W, in L."""
    return (vector[..., None, :] @ R_WL)[..., 0, :]


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

    The wrench is that which moves the load along its reference in the steady `wind` (3,), m/s, in
    W; the velocities are those through this air. The reference's angular jerk and snap are taken as
    zero. Others as of `flight_terms`.
    """
    moving = LoadReference.view(reference)
    R_WL = rotation_matrix(moving.quaternion)
    omega = _rotated(moving.angular_velocity, R_WL)
    wrenches = wrenches_along(load, reference, wind)
    return _terms(R_WL, omega, moving, wrenches, wind, pseudo_inverse, offset, attachments).flat


def orbit_along_reference(*args: NDArray | RigidLoad, **geometry: NDArray) -> NDArray:
    """The flat `OrbitTerms` (9n + 3,) of what `flight_along_reference` is given."""
    terms = FlightTerms.view(flight_along_reference(*args, **geometry))  # type: ignore[arg-type]
    return np.concatenate([part.ravel() for part in terms.of_speeds])


def turning_terms(
    motion: NDArray,
    wrench: NDArray,
    wrench_rate: NDArray,
    wind: NDArray,
    rates: NDArray,
    angles: NDArray,
    **geometry: NDArray,
) -> FlightTerms:
    """The terms of a load that turns about the vertical with its carriers, at k rates and angles.

    They are `flight_terms` of the motion with another yaw and yaw rate, at a constant force in W
    but for its rate, and a constant torque in L. With A = 0, which does not count, the motion
    then is that of aircraft that keep their places above the load; the squared airspeed is
    quadratic in the rate. Own derivation.

    Args:
        motion: (22,), of the load, such as a reference.
        wrench: (6,), in W.
        wrench_rate: (6,), of which that of the force counts.
        wind: w (3,), m/s, in W.
        rates: (k,), rad/s, of the turn.
        angles: (k,), rad, by which the load has turned on from its present yaw.
        **geometry: as of `flight_terms`.
    """
    moved = turned_motions(motion, rates, angles)
    omega = LoadReference.view(moved).angular_velocity
    R_WL = rotation_matrix(LoadReference.view(motion).quaternion)
    torque_L = _rotated(Wrench.view(wrench).torque, R_WL)
    torque = (rotation_matrix(LoadReference.view(moved).quaternion) @ torque_L[:, None])[..., 0]
    torque_rate, none = cross(omega, torque), 0 * torque
    wrenches = [
        np.concatenate([part, force + none], axis=1)
        for part, force in (
            (torque, Wrench.view(wrench).force),
            (torque_rate, Wrench.view(wrench_rate).force),
            (cross(omega, torque_rate), none),
        )
    ]
    value, rate, second_rate = wrenches
    return flight_terms(moved, moved, value, rate, second_rate, wind, **geometry)


def turned_motions(motion: NDArray, rates: NDArray, angles: NDArray) -> NDArray:
    """The motions (k, 22) of a load at other yaws that turns steadily about the vertical."""
    half, zero = angles[:, None] / 2, np.zeros((len(angles), 1))
    moved = np.tile(motion, (len(angles), 1))
    own = LoadReference.view(moved)
    turn = np.concatenate([np.cos(half), zero, zero, np.sin(half)], axis=1)
    own.quaternion[:] = quaternion_product(turn, own.quaternion)
    own.angular_velocity[:], own.angular_acceleration[:] = rates[:, None] * _UP, 0.0
    return moved


def orbit_directions(axes: Axes, angle: NDArray) -> Directions:
    """u, u′ and u″ at phases (k,), rad."""
    p, q = axes
    cosine, sine = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    u = cosine * p + sine * q
    return u, cosine * q - sine * p, -u


def pattern_directions(
    basis: NDArray, phases: NDArray, orders: NDArray, angle: NDArray
) -> Directions:
    """u, u′ and u″ at phases (k,), rad, of a pattern N₀ (3n, m), φ (m,), h (m,) of any orders."""
    rates = internal_force(np.ones(2), angle[:, None], phases=phases, orders=orders)
    u, along, bending = ((rate @ basis.T).reshape(len(angle), -1, 3) for rate in rates[:3])
    return u, along, bending


def rates_of_forces(terms: FlightTerms, directions: Directions, orbit: PlannedOrbit) -> Vectors:
    """The cables' forces and their first two rates, f, r and s (k, n, 3), see `orbit_motion`."""
    _, xi, xi_rate, A, A_rate, A_second = (values[:, None, None] for values in orbit)
    u, along, bending = directions
    omega, alpha = terms.angular_velocity[:, None], terms.angular_acceleration[:, None]
    force = terms.forces + A * u
    rate = terms.rates + A_rate * u + (A * xi) * along
    second_rate = terms.second_rates + A_second * u + (2 * A_rate * xi + A * xi_rate) * along
    second_rate = second_rate + (A * xi * xi) * bending
    r = rate + cross(omega, force)
    s = second_rate + cross(omega, rate) + cross(alpha, force) + cross(omega, r)
    return force, r, s


def orbit_motion(
    terms: FlightTerms,
    directions: Directions,
    orbit: PlannedOrbit,
    *,
    rest_length: Any,
    compliance: Any,
) -> OrbitMotion:
    """The carriers' motion at k instants, of numbers or symbols.

    Args:
        terms: at k instants, or at one (1, ...).
        directions: at the instants.
        orbit: at the instants.
        rest_length: L₀, m.
        compliance: 1/K_c, m/N.
    """
    force, r, s = rates_of_forces(terms, directions, orbit)
    cables = cable_vectors([force, r, s], rest_length=rest_length, compliance=compliance)
    return OrbitMotion(
        force, cables[0], terms.velocities + cables[1], terms.accelerations + cables[2]
    )


def planned_speeds(
    terms: OrbitTerms, axes: Axes, orbit: PlannedOrbit, *, rest_length: Any, compliance: Any
) -> tuple[NDArray, NDArray]:
    """The carriers' squared speeds, m²/s², and tensions, N², (k, n) each; see `orbit_motion`.

    Neither depends on the second rates of ξ and A.
    """
    cables = {"rest_length": rest_length, "compliance": compliance}
    motion = orbit_motion(terms.of_flight, orbit_directions(axes, orbit.angle), orbit, **cables)
    return (
        (motion.velocities * motion.velocities).sum(axis=-1),
        (motion.forces * motion.forces).sum(axis=-1),
    )


def planned_gaps(
    forces: NDArray,
    axes: Axes,
    orbit: PlannedOrbit,
    *,
    attachments: NDArray,
    pairs: NDArray,
    rest_length: Any,
    compliance: Any,
) -> NDArray:
    """The squared distances (k, m), m², between the carriers of `pairs` (2, m) at k instants.

    Of the `forces` (k, n, 3) of `OrbitTerms`; others as of `orbit_motion` and `flight_terms`.
    """
    force = forces + orbit.amplitude[:, None, None] * orbit_directions(axes, orbit.angle)[0]
    (cables,) = cable_vectors([force], rest_length=rest_length, compliance=compliance)
    return squared_gaps(attachments + cables, pairs)


def squared_gaps(places: NDArray, pairs: NDArray) -> NDArray:
    """The squared distances (k, m), m², between the `places` (k, n, 3), m, of `pairs` (2, m)."""
    first, second = pairs
    gaps = places[:, first] - places[:, second]
    return (gaps * gaps).sum(axis=-1)


def needs_of_motion(aircraft: Aircraft, motion: OrbitMotion, up: NDArray = _UP) -> FlightNeeds:
    """Needs of aircraft for this motion, with `up` e₃ (..., 3) in its frame."""
    force = needed_force(aircraft, motion.accelerations, motion.forces, up)
    return flight_needs(aircraft, force, motion.velocities, up)


def planned_needs(
    aircraft: Aircraft,
    terms: FlightTerms,
    axes: Axes,
    orbit: PlannedOrbit,
    *,
    rest_length: Any,
    compliance: Any,
) -> FlightNeeds:
    """Needs of aircraft (k, n) at k instants, of numbers or symbols; see `orbit_motion`."""
    cables = {"rest_length": rest_length, "compliance": compliance}
    motion = orbit_motion(terms, orbit_directions(axes, orbit.angle), orbit, **cables)
    return needs_of_motion(aircraft, motion, terms.up[:, None])
