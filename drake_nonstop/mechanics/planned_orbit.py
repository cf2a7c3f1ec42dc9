"""The carriers' speeds while ξ and A change smoothly, and their gradients.

As in `mechanics.nonstop`, with the rate of A: the internal force A u(θ) has the rate
Ȧ u + A ξ u', with u = p cos θ + q sin θ and u' = ∂u/∂θ.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.nonstop import orbit_ahead
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.rotation import cross
from drake_nonstop.mechanics.signals import LOAD_STATE_SIZE, WRENCH_SIZE
from drake_nonstop.mechanics.wrench import wrench_and_rate

_NO_FEEDBACK: dict[str, Any] = dict.fromkeys(
    (
        "position_gain",
        "velocity_gain",
        "position_integral_gain",
        "orientation_gain",
        "angular_velocity_gain",
        "orientation_integral_gain",
    ),
    0.0,
)


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
    *,
    pseudo_inverse: NDArray,
    offset: NDArray,
    attachments: NDArray,
) -> NDArray:
    """The flat `OrbitTerms` (9n + 3,) of a load on its `reference` (22,), in still air.

    The wrench is that which moves the load along its reference, whose angular jerk is taken as
    zero. `pseudo_inverse` (3n, 6), `offset` (3n,) in N and `attachments` (n, 3) are in L.
    """
    state = reference[:LOAD_STATE_SIZE]
    wrench, wrench_rate = wrench_and_rate(
        load, state, reference, np.zeros(WRENCH_SIZE), feedforward=1.0, **_NO_FEEDBACK
    )
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

    def dot(a: NDArray, b: NDArray) -> NDArray:
        return (a * b).sum(axis=-1)

    p, q = axes
    cosine, sine = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    u, along = cosine * p + sine * q, cosine * q - sine * p
    A, xi, rate = amplitude[:, None], frequency[:, None], amplitude_rate[:, None]
    omega = terms.angular_velocity[:, None, :]
    f = terms.forces + A[..., None] * u
    r = terms.rates + cross(omega, f) + rate[..., None] * u + (A * xi)[..., None] * along
    tension_squared = dot(f, f)
    swing = rest_length / np.sqrt(tension_squared)  # L₀/T
    shrink = swing / tension_squared  # L₀/T³
    f_r = dot(f, r)
    v = terms.velocities + (swing + compliance)[..., None] * r - (shrink * f_r)[..., None] * f
    f_v, v_r = dot(f, v), dot(v, r)
    by_r = (swing + compliance)[..., None] * v - (shrink * f_v)[..., None] * f
    by_f = (
        (shrink * (3 * f_v * f_r / tension_squared - v_r))[..., None] * f
        - (shrink * f_r)[..., None] * v
        - (shrink * f_v)[..., None] * r
        + cross(by_r, omega)
    )
    r_u, r_along = dot(by_r, u), dot(by_r, along)
    gradients = np.stack(
        [
            A * dot(by_f, along) + rate * r_along - A * xi * r_u,
            A * r_along,
            dot(by_f, u) + xi * r_along,
            r_u,
        ]
    )
    tension_gradients = np.stack([A * dot(f, along), dot(f, u)])
    return PlannedSpeeds(dot(v, v), 2 * gradients, tension_squared, 2 * tension_gradients)
