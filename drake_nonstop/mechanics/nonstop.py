"""The nonstop problem: its cost of changing ξ and A (eq. 26), and the motion a moment ahead."""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.internal_force import internal_force
from drake_nonstop.mechanics.rotation import quaternion_rate
from drake_nonstop.mechanics.signals import LoadReference, Parameters, Phase


def phase_of(parameters: NDArray, previous: NDArray, phase: NDArray) -> NDArray:
    """θ (1,), rad, once ξ changes from `previous` to `parameters`, both [ξ, A].

    `phase` (2,) is [θ, ∂θ/∂ξ]: the slope is 0 for an accumulated phase and t for ξ t.
    """
    angle, slope = Phase.view(phase)
    change = Parameters.view(parameters).frequency - Parameters.view(previous).frequency
    return angle + change * slope


def advanced_reference(reference: NDArray, time: float) -> NDArray:
    """A reference (22,) after `time` (s) at its present accelerations.

    First order in the quaternion, which `rotation_matrix` normalizes; second order in the position.
    """
    now = LoadReference.view(reference)
    middle = now.angular_velocity + time / 2 * now.angular_acceleration
    return np.concatenate(
        [
            now.quaternion + time * quaternion_rate(now.quaternion, middle),
            now.position + time * (now.velocity + time / 2 * now.acceleration),
            now.angular_velocity + time * now.angular_acceleration,
            now.velocity + time * now.acceleration,
            *now[4:],
        ]
    )


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

    J = Δξ² + ΔA² + w_pos ‖Δλ‖² + w_vel ‖Δλ̇‖², the units of its terms left out as in the paper.
    """
    change = parameters - previous
    before = internal_force(previous, Phase.view(phase).angle, phases=phases)
    after = internal_force(parameters, phase_of(parameters, previous, phase), phases=phases)
    jump, rate_jump = after[0] - before[0], after[1] - before[1]
    return (
        (change * change).sum(keepdims=True)
        + internal_force_weight * (jump * jump).sum(keepdims=True)
        + internal_force_rate_weight * (rate_jump * rate_jump).sum(keepdims=True)
    )
