"""The nonstop problem: predicted carrier speeds and the cost of changing ξ and A.

Eqs. 22-26, with the carriers' motion predicted over the interval to the next update
instead of at the sample instant only.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.carrier import cable_vectors
from drake_nonstop.mechanics.internal_force import internal_force
from drake_nonstop.mechanics.planned_orbit import OrbitTerms
from drake_nonstop.mechanics.rotation import clipped, cross, quaternion_rate
from drake_nonstop.mechanics.signals import (
    LOAD_STATE_SIZE,
    LoadReference,
    LoadState,
    Parameters,
    Phase,
)


def phase_of(parameters: NDArray, previous: NDArray, phase: NDArray) -> NDArray:
    """θ (1,), rad, once ξ changes from `previous` to `parameters`, both [ξ, A].

    `phase` (2,) is [θ, ∂θ/∂ξ]: the slope is 0 for an accumulated phase and t for ξ t.
    """
    angle, slope = Phase.view(phase)
    change = Parameters.view(parameters).frequency - Parameters.view(previous).frequency
    return angle + change * slope


def advance(state: NDArray, angular: NDArray, translational: NDArray, time: float) -> NDArray:
    """A load state (13,) after `time` (s) at constant accelerations (3,), in W.

    First order in the quaternion, which `rotation_matrix` normalizes; second order in
    the position.
    """
    quaternion, position, angular_velocity, velocity = LoadState.view(state)
    return np.concatenate(
        [
            quaternion + time * quaternion_rate(quaternion, angular_velocity + time / 2 * angular),
            position + time * (velocity + time / 2 * translational),
            angular_velocity + time * angular,
            velocity + time * translational,
        ]
    )


def advanced_reference(reference: NDArray, time: float) -> NDArray:
    """A reference (22,) after `time` (s) at its present accelerations, see `advance`."""
    desired = LoadReference.view(reference)
    rates = desired.angular_acceleration, desired.acceleration
    return np.concatenate(
        [advance(reference[:LOAD_STATE_SIZE], *rates, time), *rates, desired.jerk]
    )


def change_cost(
    parameters: NDArray,
    previous: NDArray,
    phase: NDArray,
    *,
    phases: NDArray,
    internal_force_weight: float,
    internal_force_rate_weight: float,
    anchor_weight: Any,
    nominal: NDArray,
) -> NDArray:
    """J (1,), the cost of the step from `previous` to `parameters`, both [ξ, A] (eq. 26).

    J = Δξ² + ΔA² + w_pos ‖Δλ‖² + w_vel ‖Δλ̇‖² + w_anchor ‖x − x_nominal‖², the units of its
    terms left out as in the paper, which has no anchor.
    """
    change = parameters - previous
    away = parameters - nominal
    before = internal_force(previous, Phase.view(phase).angle, phases=phases)
    after = internal_force(parameters, phase_of(parameters, previous, phase), phases=phases)
    jump, rate_jump = after[0] - before[0], after[1] - before[1]
    return (
        (change * change).sum(keepdims=True)
        + anchor_weight * (away * away).sum(keepdims=True)
        + internal_force_weight * (jump * jump).sum(keepdims=True)
        + internal_force_rate_weight * (rate_jump * rate_jump).sum(keepdims=True)
    )


class QuadraticChangeCost(NamedTuple):
    """`change_cost` for phases that do not depend on ξ, by ξ, A and s = A ξ.

        J = (ξ − ξ⁻)² + w_A (A − A⁻)² + w_s (s − s⁻)² + w_anchor ((ξ − ξ_nom)² + (A − A_nom)²),

    in plain numbers, which for a single point are ten times faster than arrays. Own derivation:
    from λ_k = A cos(θ + φ_k) and its rate −s sin(θ + φ_k), with equal angles before and after,
    follow w_A = 1 + w_pos Σ cos² and w_s = w_vel Σ sin².
    """

    frequency: float  # ξ⁻, rad/s
    amplitude: float  # A⁻, N
    amplitude_weight: float  # w_A
    rate_weight: float  # w_s
    anchor_weight: float
    nominal_frequency: float  # rad/s
    nominal_amplitude: float  # N

    def value(self, frequency: float, amplitude: float, s: float) -> float:
        """J at ξ (rad/s), A (N) and their product s (N/s)."""
        cost = (
            (frequency - self.frequency) ** 2
            + self.amplitude_weight * (amplitude - self.amplitude) ** 2
            + self.rate_weight * (s - self.frequency * self.amplitude) ** 2
        )
        if self.anchor_weight > 0:
            cost += self.anchor_weight * (
                (frequency - self.nominal_frequency) ** 2
                + (amplitude - self.nominal_amplitude) ** 2
            )
        return cost

    def cheapest_s(self, amplitude: float) -> float:
        """The s (N/s) of the least J at A (N): J is a parabola in s."""
        return (
            (self.frequency + self.anchor_weight * self.nominal_frequency) / amplitude
            + self.rate_weight * (self.frequency * self.amplitude)
        ) / ((1 + self.anchor_weight) / (amplitude * amplitude) + self.rate_weight)


def quadratic_change_cost(
    previous: NDArray,
    angles: NDArray,
    *,
    internal_force_weight: float,
    internal_force_rate_weight: float,
    anchor_weight: float,
    nominal: NDArray,
) -> QuadraticChangeCost:
    """The quadratic form of the cost from `previous` = [ξ⁻, A⁻] at `angles` θ + φ_k (m,), rad."""
    cosines, sines = np.cos(angles), np.sin(angles)
    frequency, amplitude = previous.tolist()
    nominal_frequency, nominal_amplitude = nominal.tolist()
    return QuadraticChangeCost(
        frequency=frequency,
        amplitude=amplitude,
        amplitude_weight=1 + internal_force_weight * float(cosines @ cosines),
        rate_weight=internal_force_rate_weight * float(sines @ sines),
        anchor_weight=anchor_weight,
        nominal_frequency=nominal_frequency,
        nominal_amplitude=nominal_amplitude,
    )


TENSION = 0  # the number of the polynomial of T² among those of `speed_polynomials`
POLYNOMIALS_SHAPE = (10, 3, -1)  # of p flat `speed_polynomials`


def speed_polynomials(terms: OrbitTerms, directions: NDArray, direction_rates: NDArray) -> NDArray:
    """The coefficients (10, 3, …) of the arguments of `speed_squares`, as polynomials in A.

    `directions` u and `direction_rates` u′ = ∂u/∂θ (…, n, 3) are those of the phase; with the
    `terms` they broadcast. Of f = f₀ + A u, r = d + ω × f, u′ and v = v_b the polynomials are f·f,
    r·r, u′·u′, f·u′, f·v, f·r = f·d, r·u′, v·r, v·u′ and v·v; each has the coefficients of 1, A and
    A².
    """
    one = np.ones(np.broadcast_shapes(terms.forces.shape, directions.shape))
    omega, zero = terms.angular_velocity[..., None, :], 0.0 * one
    f = one * terms.forces, one * directions
    r = one * (terms.rates + cross(omega, terms.forces)), one * cross(omega, directions)
    u, v, d = ((one * part, zero) for part in (direction_rates, terms.velocities, terms.rates))

    def product(a: tuple[NDArray, NDArray], b: tuple[NDArray, NDArray]) -> NDArray:
        mixed = 2 * a[0] * a[1] if a is b else a[0] * b[1] + a[1] * b[0]
        coefficients = a[0] * b[0], mixed, a[1] * b[1]
        return np.stack([coefficient.sum(axis=-1) for coefficient in coefficients])

    pairs = [(f, f), (r, r), (u, u), (f, u), (f, v), (f, d), (r, u), (v, r), (v, u), (v, v)]
    return np.stack([product(a, b) for a, b in pairs])


def polynomial_values(polynomials: NDArray, amplitude: NDArray) -> NDArray:
    """The polynomials (10, 3, …) of `speed_polynomials` at amplitudes (…): (10, …)."""
    p0, p1, p2 = polynomials[:, 0], polynomials[:, 1], polynomials[:, 2]
    return p0 + amplitude * (p1 + amplitude * p2)


def speed_squares(values: Any, *, rest_length: Any, compliance: Any) -> tuple[Any, ...]:
    """c, b and a with ‖v‖² = c + 2 b s + a s² for s = A ξ, and the squared tension T².

    `values` (10, …) are those of the polynomials of `speed_polynomials` at A, and the results are
    of the shape of one of them: arrays, or plain numbers, which for a single speed are ten times
    faster. With g = ℓ/T and h = (1/K_c − g)/T², the velocity of eq. 22 is
    v_b + g (r + s u') + h f fᵀ(r + s u'): affine in s. Own derivation.
    """
    tension_squared, r_r, rate_rate, f_rate, f_v, f_r, r_rate, v_r, v_rate, v_v = values
    g = rest_length / tension_squared**0.5 + compliance
    h = (compliance - g) / tension_squared
    g_squared = g * g
    k = h * (compliance + g)  # of ‖f fᵀ·‖² and of the mixed terms, together
    h_v, k_r = h * f_v, k * f_r
    c = v_v + g_squared * r_r + 2 * (g * v_r + h_v * f_r) + k_r * f_r
    b = g * v_rate + g_squared * r_rate + (h_v + k_r) * f_rate
    a = g_squared * rate_rate + k * f_rate * f_rate
    return c, b, a, tension_squared


def orbit_positions(
    amplitude: Any,
    forces: NDArray,
    levers: NDArray,
    directions: NDArray,
    direction_rates: NDArray,
    *,
    rest_length: float,
    compliance: float,
) -> tuple[NDArray, NDArray]:
    """Carriers relative to the load at phases of their orbits, and their rates by the phase θ.

    Both (3, …) in L, m and m/rad: the components come first, and what follows broadcasts.
    `forces` f₀ (N) are those of `planned_orbit.OrbitTerms`, `levers` (m) of the attachments,
    `directions` u and `direction_rates` u' = ∂u/∂θ as in `planned_orbit`, `amplitude` is A (N).
    """
    pulls = forces + amplitude * directions, amplitude * direction_rates
    cables, rates = cable_vectors(pulls, rest_length=rest_length, compliance=compliance, axis=0)
    return levers + cables, rates


def nearest_squares(gaps: NDArray, gap_rates: NDArray, half_step: float) -> NDArray:
    """The least squared distances (…), m², within `half_step` (rad) of a phase.

    `gaps` (3, …) between two positions and `gap_rates` by the phase are those of
    `orbit_positions`. Each orbit is replaced by its tangent: a close encounter between two
    phases, a whole step apart, is not missed. Own derivation.
    """
    nearest = -(gaps * gap_rates).sum(axis=0) / ((gap_rates * gap_rates).sum(axis=0) + 1e-30)
    gaps = gaps + clipped(nearest, half_step) * gap_rates
    return (gaps * gaps).sum(axis=0)
