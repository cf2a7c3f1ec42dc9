"""The nonstop problem: predicted carrier speeds and the cost of changing ξ and A.

Eqs. 22-26, with the carriers' motion predicted over the interval to the next update
instead of at the sample instant only.
"""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.mechanics.grasp import cable_forces_and_rates
from drake_nonstop.mechanics.internal_force import internal_force
from drake_nonstop.mechanics.rotation import cross, quaternion_rate, rotation_matrix


def phase_of(parameters: NDArray, previous: NDArray, phase: NDArray) -> NDArray:
    """θ (1,), rad, once ξ changes from `previous` to `parameters`, both [ξ, A].

    `phase` (2,) is [θ, ∂θ/∂ξ]: the slope is 0 for an accumulated phase and t for ξ t.
    """
    return phase[:1] + (parameters[:1] - previous[:1]) * phase[1:]


def advance(state: NDArray, angular: NDArray, translational: NDArray, time: float) -> NDArray:
    """A load state (13,) carried on for `time` (s) at constant accelerations (3,), in W.

    First order in the quaternion, which `rotation_matrix` normalizes; second order in
    the position.
    """
    quaternion, position = state[:4], state[4:7]
    angular_velocity, velocity = state[7:10], state[10:13]
    return np.concatenate(
        [
            quaternion + time * quaternion_rate(quaternion, angular_velocity + time / 2 * angular),
            position + time * (velocity + time / 2 * translational),
            angular_velocity + time * angular,
            velocity + time * translational,
        ]
    )


def cable_forces_and_rates_ahead(
    load_state: NDArray,
    wrench: NDArray,
    wrench_rate: NDArray,
    wrench_second_rate: NDArray,
    internal_force: NDArray,
    *,
    time: float,
    pseudo_inverse: NDArray,
    basis: NDArray,
    offset: NDArray,
) -> tuple[NDArray, NDArray]:
    """`grasp.cable_forces_and_rates` with a wrench that has gone on for `time` (s)."""
    return cable_forces_and_rates(
        load_state,
        wrench + time * (wrench_rate + time / 2 * wrench_second_rate),
        wrench_rate + time * wrench_second_rate,
        internal_force,
        pseudo_inverse=pseudo_inverse,
        basis=basis,
        offset=offset,
    )


def carrier_velocities(
    parameters: NDArray,
    previous: NDArray,
    phase: NDArray,
    load_state: NDArray,
    load_motion: NDArray,
    wrench: NDArray,
    wrench_rate: NDArray,
    wrench_second_rate: NDArray,
    *,
    time: float,
    phases: NDArray,
    pseudo_inverse: NDArray,
    basis: NDArray,
    offset: NDArray,
    attachments: NDArray,
    rest_length: float,
    compliance: float,
) -> NDArray:
    """Carrier velocities (n, 3), in W, `time` (s) ahead, for the parameters [ξ, A] (eq. 22).

    `load_state` turns the load-frame forces, `load_motion` is what the carriers move
    with (the measured state, as printed, or the reference, as commanded); both (13,) and
    already `time` ahead. The wrench and its first two rates (6,) are now's, in W, and
    carry the wrench on; the phase goes on at ξ.
    """
    angle = phase_of(parameters, previous, phase) + parameters[:1] * time
    forces, rates = cable_forces_and_rates_ahead(
        load_state,
        wrench,
        wrench_rate,
        wrench_second_rate,
        np.concatenate(internal_force(parameters, angle, phases=phases)),
        time=time,
        pseudo_inverse=pseudo_inverse,
        basis=basis,
        offset=offset,
    )
    _, velocities = carrier_motion(
        load_motion,
        forces,
        rates,
        attachments=attachments,
        rest_length=rest_length,
        compliance=compliance,
    )
    return velocities


def change_cost(
    parameters: NDArray,
    previous: NDArray,
    phase: NDArray,
    *,
    phases: NDArray,
    internal_force_weight: float,
    internal_force_rate_weight: float,
) -> NDArray:
    """J (1,), the cost of the step from `previous` to `parameters`, both [ξ, A] (eq. 26).

    J = Δξ² + ΔA² + w_pos ‖Δλ‖² + w_vel ‖Δλ̇‖², the units of its terms left out as in the
    paper.
    """
    change = parameters - previous
    before = internal_force(previous, phase[:1], phases=phases)
    after = internal_force(parameters, phase_of(parameters, previous, phase), phases=phases)
    jump, rate_jump = after[0] - before[0], after[1] - before[1]
    return (
        (change * change).sum(keepdims=True)
        + internal_force_weight * (jump * jump).sum(keepdims=True)
        + internal_force_rate_weight * (rate_jump * rate_jump).sum(keepdims=True)
    )


def speed_terms(
    angle: NDArray,
    load_state: NDArray,
    load_motion: NDArray,
    wrench: NDArray,
    wrench_rate: NDArray,
    wrench_second_rate: NDArray,
    *,
    time: float,
    phases: NDArray,
    pseudo_inverse: NDArray,
    basis: NDArray,
    offset: NDArray,
    attachments: NDArray,
) -> tuple[NDArray, ...]:
    """The arguments of `speed_squares`, six arrays (n, 3) in W, at the phase `angle` (1,).

    The other arguments as in `carrier_velocities`.
    """
    angles = angle + phases
    nothing = 0 * angles

    def forces(force: NDArray, rate: NDArray) -> tuple[NDArray, NDArray]:
        return cable_forces_and_rates_ahead(
            load_state,
            wrench,
            wrench_rate,
            wrench_second_rate,
            np.concatenate([force, rate]),
            time=time,
            pseudo_inverse=pseudo_inverse,
            basis=basis,
            offset=offset,
        )

    force, rate = forces(nothing, nothing)
    cosine_force, cosine_rate = forces(np.cos(angles), nothing)
    _, sine_rate = forces(nothing, -np.sin(angles))
    levers = attachments @ rotation_matrix(load_motion[:4]).T
    velocities = load_motion[10:13] + cross(load_motion[7:10], levers)
    return force, rate, cosine_force - force, cosine_rate - rate, sine_rate - rate, velocities


def turned_speed_terms(
    terms: NDArray, quarter_turn_on: NDArray, turns: NDArray
) -> tuple[NDArray, ...]:
    """The `speed_terms` with the phase turned on by each of k `turns` (rad), (k p, 3) each.

    `terms` and `quarter_turn_on` (6, p, 3) are the stacked terms at some phase and at a
    quarter of a turn later. They are affine in the phase's cosine and sine, and what does
    not depend on it (f₀, e₀ and the load's velocities) stays: own derivation.
    """
    cosine, sine = np.cos(turns)[:, None, None], np.sin(turns)[:, None, None]
    is_turning = [False, False, True, True, True, False]
    return tuple(
        (cosine * now + sine * later if turning else now + 0 * cosine).reshape(-1, 3)
        for now, later, turning in zip(terms, quarter_turn_on, is_turning, strict=True)
    )


def speed_squares(
    amplitude: NDArray,
    forces: NDArray,
    force_rates: NDArray,
    cosine_forces: NDArray,
    cosine_force_rates: NDArray,
    sine_force_rates: NDArray,
    load_velocities: NDArray,
    *,
    rest_length: float,
    compliance: float,
) -> tuple[NDArray, NDArray, NDArray]:
    """(c, b, a), each (k, p), with ‖v‖² = c + 2 b s + a s² for s = A ξ, at k amplitudes.

    At a given phase a cable's force is f = f₀ + A f_c and its rate ḟ = e₀ + A e_c + s e_s;
    `forces` f₀, `force_rates` e₀, `cosine_forces` f_c, `cosine_force_rates` e_c and
    `sine_force_rates` e_s are (p, 3) for p carriers (or carriers at several instants), as
    are the `load_velocities` of their attachments; `amplitude` is (k,). The velocity of
    eq. 22 is then affine in s: own derivation.
    """
    A = amplitude[:, None, None]
    force = forces + A * cosine_forces
    rate = force_rates + A * cosine_force_rates
    tension_squared = (force * force).sum(axis=2, keepdims=True)
    swing = rest_length / np.sqrt(tension_squared) + compliance  # ℓ/T
    along = (compliance - swing) / tension_squared
    still = (
        load_velocities + swing * rate + along * (force * rate).sum(axis=2, keepdims=True) * force
    )
    moving = (
        swing * sine_force_rates
        + along * (force * sine_force_rates).sum(axis=2, keepdims=True) * force
    )
    return (
        (still * still).sum(axis=2),
        (still * moving).sum(axis=2),
        (moving * moving).sum(axis=2),
    )
