"""The load wrench controller: PID on the pose error, feedforward, and its rate.

Eqs. 10-13 (errors), 14-15 (PID). Two departures from the paper: e_ω = ω − RᵀR_d ω_d has
the opposite sign, since the paper's with −K_ω is anti-damping, and the feedforward of the
desired motion is added with the weight `feedforward` (0: as in the paper).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rigid_load import STILL_AIR, RigidLoad, load_acceleration
from drake_nonstop.mechanics.rotation import cross, rotation_matrix, vee
from drake_nonstop.mechanics.signals import (
    LOAD_STATE_SIZE,
    WRENCH_SIZE,
    LoadReference,
    LoadState,
    TrackingError,
    Wrench,
)

# The gains of `wrench_and_rate` but for the feedforward, and what they are without feedback.
FEEDBACK_GAINS = (
    "position_gain",
    "velocity_gain",
    "position_integral_gain",
    "orientation_gain",
    "angular_velocity_gain",
    "orientation_integral_gain",
)
NO_FEEDBACK: dict[str, Any] = dict.fromkeys(FEEDBACK_GAINS, 0.0)


def tracking_error(load_state: NDArray, reference: NDArray) -> NDArray:
    """[e_R, e_p, e_ω, e_v] (12,): orientation and angular velocity in L, the rest in W.

    `load_state` (13,) and `reference` (22,) = [quaternion, position, angular velocity,
    velocity, angular acceleration, acceleration, jerk], all in W.
    e_R = ½ (R_dᵀR − RᵀR_d)^∨ (rad for small angles), e_ω = ω − RᵀR_d ω_d.
    """
    state, desired = LoadState.view(load_state), LoadReference.view(reference)
    R_WL = rotation_matrix(state.quaternion)
    R_LD = R_WL.T @ rotation_matrix(desired.quaternion)
    return np.concatenate(
        [
            vee(R_LD.T - R_LD) / 2,
            state.position - desired.position,
            R_WL.T @ (state.angular_velocity - desired.angular_velocity),
            state.velocity - desired.velocity,
        ]
    )


def wrench_and_rate(
    load: RigidLoad,
    load_state: NDArray,
    reference: NDArray,
    integrals: NDArray,
    wind: NDArray = STILL_AIR,
    *,
    position_gain: float | NDArray,
    velocity_gain: float | NDArray,
    position_integral_gain: float | NDArray,
    orientation_gain: float | NDArray,
    angular_velocity_gain: float | NDArray,
    orientation_integral_gain: float | NDArray,
    feedforward: float | NDArray,
) -> tuple[NDArray, NDArray]:
    """w_d and ẇ_d, each (6,) [torque; force] in W.

    `load` is the controller's model. `integrals` (6,) is [∫e_R, ∫e_p]; `wind` (3,) is w in m/s, in
    W, whose rate is taken as zero; gains are numbers or (1,), the orientation's also (3, 3), in L.
    With k = `feedforward`,

        f_d  = m g e₃ − K_p e_p − K_v e_v − K_i ∫e_p + k (m p̈_d + B_L (ṗ_d − w))
        ᴸτ_d = ω × J ω − K_R e_R − K_ω e_ω − K_iR ∫e_R + k (J d(RᵀR_d ω_d)/dt + C_L RᵀR_d ω_d)

    The rates are exact where the load moves as the model does under w_d (no numerical
    differentiation); only the reference's angular jerk is taken as zero. Own derivation:
    ė_R = ½ (tr(RᵀR_d) I − RᵀR_d) e_ω, and the world torque's rate is R (ᴸτ̇ + ω × ᴸτ).
    """
    state, desired = LoadState.view(load_state), LoadReference.view(reference)
    R_WL = rotation_matrix(state.quaternion)
    R_LW = R_WL.T
    R_LD = R_LW @ rotation_matrix(desired.quaternion)
    omega = R_LW @ state.angular_velocity
    desired_omega = R_LW @ desired.angular_velocity
    desired_alpha = R_LW @ desired.angular_acceleration
    e_R, e_p, e_omega, e_v = TrackingError.view(tracking_error(load_state, reference))
    integral = Wrench.view(integrals)  # ∫e_R for the torque, ∫e_p for the force
    momentum = load.inertia @ omega

    # d(Rᵀω_d)/dt, with ω_d in W: the desired angular acceleration as the load sees it.
    desired_omega_rate = desired_alpha - cross(omega, desired_omega)
    force = (
        load.mass * load.gravity * np.array([0.0, 0.0, 1.0])
        - position_gain * e_p
        - velocity_gain * e_v
        - position_integral_gain * integral.force
        + feedforward * (load.mass * desired.acceleration + load.drag * (desired.velocity - wind))
    )
    torque = (
        cross(omega, momentum)
        - _times(orientation_gain, e_R)
        - _times(angular_velocity_gain, e_omega)
        - _times(orientation_integral_gain, integral.torque)
        + feedforward * (load.inertia @ desired_omega_rate + load.angular_drag * desired_omega)
    )
    wrench = np.concatenate([R_WL @ torque, force])

    angular, translational = load_acceleration(load, load_state, wrench, wind)
    omega_rate = R_LW @ angular
    trace = (R_LD * np.eye(3)).sum(keepdims=True).reshape(1)
    e_R_rate = (trace * e_omega - R_LD @ e_omega) / 2
    desired_omega_second_rate = (
        -cross(omega, desired_alpha)
        - cross(omega_rate, desired_omega)
        - cross(omega, desired_omega_rate)
    )
    force_rate = (
        -position_gain * e_v
        - velocity_gain * (translational - desired.acceleration)
        - position_integral_gain * e_p
        + feedforward * (load.mass * desired.jerk + load.drag * desired.acceleration)
    )
    torque_rate = (
        cross(omega_rate, momentum)
        + cross(omega, load.inertia @ omega_rate)
        - _times(orientation_gain, e_R_rate)
        - _times(angular_velocity_gain, omega_rate - desired_omega_rate)
        - _times(orientation_integral_gain, e_R)
        + feedforward
        * (load.inertia @ desired_omega_second_rate + load.angular_drag * desired_omega_rate)
    )
    return wrench, np.concatenate([R_WL @ (torque_rate + cross(omega, torque)), force_rate])


def feedforward_wrench(
    load: RigidLoad, reference: NDArray, wind: NDArray = STILL_AIR
) -> tuple[NDArray, NDArray]:
    """Wrench and rate of a load that is on its reference (22,), by feedforward alone."""
    state, none = reference[:LOAD_STATE_SIZE], np.zeros(WRENCH_SIZE)
    return wrench_and_rate(load, state, reference, none, wind, feedforward=1.0, **NO_FEEDBACK)


def _times(gain: float | NDArray, vector: NDArray) -> NDArray:
    """A vector (3,) times a gain, a number, (1,) or (3, 3)."""
    return gain @ vector if np.ndim(gain) == 2 else gain * vector
