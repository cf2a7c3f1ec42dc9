"""The nonstop problem: predicted carrier speeds and the cost of changing ξ and A.

Eqs. 22-26, with the carriers' motion predicted over the interval to the next update
instead of at the sample instant only.
"""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.mechanics.grasp import cable_forces_and_rates
from drake_nonstop.mechanics.internal_force import internal_force
from drake_nonstop.mechanics.rotation import quaternion_rate


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
    forces, rates = cable_forces_and_rates(
        load_state,
        wrench + time * (wrench_rate + time / 2 * wrench_second_rate),
        wrench_rate + time * wrench_second_rate,
        np.concatenate(internal_force(parameters, angle, phases=phases)),
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
