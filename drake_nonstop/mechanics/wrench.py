"""The load wrench controller: PID on the pose error, feedforward, and its rate.

Eqs. 10-13 (errors), 14-15 (PID). Two departures from the paper: e_ω = ω − RᵀR_d ω_d has
the opposite sign, since the paper's with −K_ω is anti-damping, and the feedforward of the
desired motion is added with the weight `feedforward` (0: as in the paper).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.load_motion import NO_HIGHER_RATES, LoadMotion, in_axes
from drake_nonstop.mechanics.rigid_load import STILL_AIR, RigidLoad, load_acceleration
from drake_nonstop.mechanics.rotation import cross, vee
from drake_nonstop.mechanics.signals import (
    LOAD_STATE_SIZE,
    WRENCH_SIZE,
    LoadState,
    TrackingError,
    Wrench,
)
from drake_nonstop.mechanics.taylor import Quantity, Taylor

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
    errors, _ = _errors(LoadMotion.of_state(load_state), LoadMotion.along(reference))
    return np.concatenate([error.coefficients[0] for error in errors])


def _errors(motion: LoadMotion, desired: LoadMotion) -> tuple[Any, Quantity]:
    """Series of the parts of a `TrackingError`, and of RᵀR_d ω_d (3,), in L."""
    R_LD: Quantity = motion.axes @ desired.axes.T
    spin = in_axes(desired.spin, motion.axes)
    errors = (
        vee(R_LD.T - R_LD) / 2,
        motion.position - desired.position,
        motion.angular_velocity - spin,
        motion.position.rate() - desired.position.rate(),
    )
    return TrackingError(*errors), spin


def wrench_and_rate(
    load: RigidLoad,
    load_state: NDArray,
    reference: NDArray,
    integrals: NDArray,
    wind: NDArray = STILL_AIR,
    higher_rates: NDArray = NO_HIGHER_RATES,
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
    W, whose rate is taken as zero; `higher_rates` (6,) are those of the reference; gains are
    numbers or (1,), the orientation's also (3, 3), in L. With k = `feedforward`,

        f_d  = m g e₃ − K_p e_p − K_v e_v − K_i ∫e_p + k (m p̈_d + B_L (ṗ_d − w))
        ᴸτ_d = ω × J ω − K_R e_R − K_ω e_ω − K_iR ∫e_R + k (J d(RᵀR_d ω_d)/dt + C_L RᵀR_d ω_d)

    The rates are those where the load moves as the model does under w_d: exact, without numerical
    differentiation.
    """
    desired, integral = LoadMotion.along(reference, higher_rates), Wrench.view(integrals)
    velocity = desired.position.rate()
    needed = load.mass * velocity.rate() + load.drag * (velocity - wind)
    weight = load.mass * load.gravity * np.array([0.0, 0.0, 1.0])

    def commanded(motion: LoadMotion) -> tuple[NDArray, ...]:
        """The wrench in W, and as many rates as the motion has accelerations."""
        error, spin = _errors(motion, desired)
        omega: Quantity = motion.angular_velocity
        turned = error.orientation.integral(integral.torque)  # ∫e_R
        moved = error.position.integral(integral.force)
        force = (
            weight
            - position_gain * error.position
            - velocity_gain * error.velocity
            - position_integral_gain * moved
            + feedforward * needed
        )
        torque = (
            cross(omega, omega @ load.inertia.T)
            - _times(orientation_gain, error.orientation)
            - _times(angular_velocity_gain, error.angular_velocity)
            - _times(orientation_integral_gain, turned)
            + feedforward * (spin.rate() @ load.inertia.T + load.angular_drag * spin)
        )
        made: Quantity = np.concatenate([torque @ motion.axes, force])
        return made.rates

    state = LoadState.view(load_state)
    wrench, *_ = commanded(LoadMotion.of_state(load_state))
    angular, translational = load_acceleration(load, load_state, wrench, wind)
    position = Taylor.of_rates(state.position, state.velocity, translational)
    spin = Taylor([state.angular_velocity, angular])
    wrench, rate = commanded(LoadMotion.of(state.quaternion, position, spin))
    return wrench, rate


def feedforward_wrench(
    load: RigidLoad, reference: NDArray, wind: NDArray = STILL_AIR
) -> tuple[NDArray, NDArray]:
    """Wrench and rate of a load that is on its reference (22,), by feedforward alone."""
    state, none = reference[:LOAD_STATE_SIZE], np.zeros(WRENCH_SIZE)
    return wrench_and_rate(load, state, reference, none, wind, feedforward=1.0, **NO_FEEDBACK)


def _times(gain: float | NDArray, vector: Quantity) -> Quantity:
    """A vector (3,) times a gain, a number, (1,) or (3, 3)."""
    return gain @ vector if np.ndim(gain) == 2 else gain * vector
