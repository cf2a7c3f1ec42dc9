"""The carriers' speeds and distances while ξ and A change smoothly.

As in `mechanics.nonstop`, with the rate of A: the internal force A u(θ) has the rate
Ȧ u + A ξ u', with u = p cos θ + q sin θ and u' = ∂u/∂θ.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.nonstop import orbit_ahead
from drake_nonstop.mechanics.rigid_load import STILL_AIR, RigidLoad
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.signals import LOAD_STATE_SIZE, WRENCH_SIZE
from drake_nonstop.mechanics.wrench import feedforward_wrench


class OrbitTerms(NamedTuple):
    """What the speeds of n carriers depend on besides θ, ξ and A, in L; see `orbit_ahead`."""

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
        return carrier_columns(self[:3], self[3:])


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
    state = reference[:LOAD_STATE_SIZE]
    wrench, wrench_rate = feedforward_wrench(load, reference, wind)
    forces, rates, _, velocities, omega = orbit_ahead(
        state,
        state,
        wrench,
        wrench_rate,
        np.zeros(WRENCH_SIZE),
        time=0.0,
        pseudo_inverse=pseudo_inverse,
        offset=offset,
        attachments=attachments,
    )
    velocities = velocities - rotation_matrix(state[:4]).T @ wind
    return np.concatenate([forces.ravel(), rates.ravel(), velocities.ravel(), omega])


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

    With f = f₀ + A u, r = d + ω × f + Ȧ u + A ξ u' and T = ‖f‖,

        v = v_b + (L₀/T) (r − f (f·r)/T²) + r/K_c.

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
    omega = terms.angular_velocity.T[:, :, None]
    r = rates + _cross(omega, f) + rate * u + (A * xi) * along
    tension_squared = _dot(f, f)
    swing = rest_length / np.sqrt(tension_squared)  # L₀/T
    v = v_b + (swing + compliance) * r - (swing / tension_squared * _dot(f, r)) * f
    return PlannedSpeeds(_dot(v, v), tension_squared)


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
    """The squared distances (k, m), m², between carriers at k instants, of numbers or symbols.

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


def _planned_forces(
    forces: NDArray, axes: tuple[NDArray, NDArray], angle: NDArray, amplitude: NDArray
) -> tuple[NDArray, NDArray, NDArray]:
    """f, u and u' (3, k, n): sums over components are several times faster in this order."""
    p, q = (axis.T[:, None] for axis in axes)
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    u, along = cosine * p + sine * q, cosine * q - sine * p
    return _by_component(forces) + amplitude[:, None] * u, u, along


def carrier_columns(of_carriers: Sequence[NDArray], of_load: Sequence[NDArray]) -> NDArray:
    """Vectors (k, n, 3) of carriers and (k, 3) of the load, one below the other, (..., k, n)."""
    columns = [np.moveaxis(vectors, -1, 0) for vectors in of_carriers]
    shape = columns[0].shape
    columns += [np.broadcast_to(vectors.T[:, :, None], shape) for vectors in of_load]
    return np.concatenate(columns)


def _by_component(vectors: NDArray) -> NDArray:
    """Vectors (..., 3) with their components first, (3, ...)."""
    return np.ascontiguousarray(np.moveaxis(vectors, -1, 0))


def _dot(a: NDArray, b: NDArray) -> NDArray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: NDArray, b: NDArray) -> NDArray:
    return np.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )
