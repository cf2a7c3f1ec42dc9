"""The carriers' speeds while ξ and A change smoothly, and their gradients.

As in `mechanics.nonstop`, with the rate of A: the internal force A u(θ) has the rate
Ȧ u + A ξ u', with u = p cos θ + q sin θ and u' = ∂u/∂θ.
"""

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
    """Squared speeds and tensions at k instants, and the gradients of the former."""

    squares: NDArray  # (k, n), m²/s²
    gradients: NDArray  # (4, k, n), of the squares by θ, ξ, A and Ȧ
    tension_squares: NDArray  # (k, n), N²
    tension_gradients: NDArray  # (2, k, n), of the squared tensions by θ and A


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
    """The carriers' squared speeds at k instants of a plan.

    With f = f₀ + A u, r = d + ω × f + Ȧ u + A ξ u' and T = ‖f‖,

        v = v_b + (L₀/T) (r − f (f·r)/T²) + r/K_c.

    The gradients follow from that of ½ v² by r, g_r = v/K_c + (L₀/T) (v − f (f·v)/T²), and by the
    f in the factors of r. Own derivation.

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
    f, u, along = _planned_forces(terms, axes, angle, amplitude)
    rates, v_b = _by_component(terms.rates), _by_component(terms.velocities)
    omega = terms.angular_velocity.T[:, :, None]
    r = rates + _cross(omega, f) + rate * u + (A * xi) * along
    tension_squared = _dot(f, f)
    swing = rest_length / np.sqrt(tension_squared)  # L₀/T
    shrink = swing / tension_squared  # L₀/T³
    reach = swing + compliance
    f_r = _dot(f, r)
    v = v_b + reach * r - (shrink * f_r) * f
    f_v, v_r = _dot(f, v), _dot(v, r)
    shrink_v, shrink_r = shrink * f_v, shrink * f_r
    by_r = reach * v - shrink_v * f
    by_f = (
        (3 * f_v * shrink_r / tension_squared - shrink * v_r) * f
        - shrink_r * v
        - shrink_v * r
        + _cross(by_r, omega)
    )
    r_u, r_along = _dot(by_r, u), _dot(by_r, along)
    gradients = np.stack(
        [
            A * _dot(by_f, along) + rate * r_along - A * xi * r_u,
            A * r_along,
            _dot(by_f, u) + xi * r_along,
            r_u,
        ]
    )
    tension_gradients = np.stack([A * _dot(f, along), _dot(f, u)])
    return PlannedSpeeds(_dot(v, v), 2 * gradients, tension_squared, 2 * tension_gradients)


def planned_gaps(
    terms: OrbitTerms,
    axes: tuple[NDArray, NDArray],
    angle: NDArray,
    amplitude: NDArray,
    *,
    attachments: NDArray,
    pairs: NDArray,
    rest_length: Any,
    compliance: Any,
) -> tuple[NDArray, NDArray]:
    """The squared distances between carriers at k instants of a plan, and their gradients.

    A carrier is at its attachment plus (L₀/T + 1/K_c) f, see `planned_speeds`.

    Args:
        terms: at k instants.
        axes: as of `planned_speeds`, and so are the angle and the amplitude (k,).
        angle: θ, rad.
        amplitude: A, N.
        attachments: (n, 3), in L, m.
        pairs: (2, m), the numbers of the carriers.
        rest_length: L₀, m.
        compliance: 1/K_c, m/N.

    Returns:
        The squares (k, m), m², and their gradients (2, k, m) by θ and A.
    """
    f, u, along = _planned_forces(terms, axes, angle, amplitude)
    tension_squared = _dot(f, f)
    swing = rest_length / np.sqrt(tension_squared)
    shrink, reach = swing / tension_squared, swing + compliance
    first, second = pairs

    def between(values: NDArray) -> NDArray:
        return values[..., first] - values[..., second]

    gaps = between(reach * f + attachments.T[:, None])
    by_angle = between(amplitude[:, None] * (reach * along - (shrink * _dot(f, along)) * f))
    by_amplitude = between(reach * u - (shrink * _dot(f, u)) * f)
    return _dot(gaps, gaps), 2 * np.stack([_dot(gaps, by_angle), _dot(gaps, by_amplitude)])


def _planned_forces(
    terms: OrbitTerms, axes: tuple[NDArray, NDArray], angle: NDArray, amplitude: NDArray
) -> tuple[NDArray, NDArray, NDArray]:
    """f, u and u' (3, k, n): sums over components are several times faster in this order."""
    p, q = (axis.T[:, None] for axis in axes)
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    u, along = cosine * p + sine * q, cosine * q - sine * p
    return _by_component(terms.forces) + amplitude[:, None] * u, u, along


def _by_component(vectors: NDArray) -> NDArray:
    """Vectors (..., 3) with their components first, (3, ...)."""
    return np.ascontiguousarray(np.moveaxis(vectors, -1, 0))


def _dot(a: NDArray, b: NDArray) -> NDArray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: NDArray, b: NDArray) -> NDArray:
    return np.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )
