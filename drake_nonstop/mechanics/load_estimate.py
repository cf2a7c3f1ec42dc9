"""Estimates of a load's error beside its reference: carried on in time, corrected by measurements.

An error (12,) is [r, e_p, e_ω, e_v], in W: what the state is beyond the reference. The rotation r
is that of Rodrigues, 2 tan(φ/2) along the axis of R R_dᵀ, which is φ for small angles, and tells
the attitude exactly. The axes of r, and those of e_p, are estimated alike, each by [pose; rate]: a
covariance (6,) is that of [r; e_ω] and of [e_p; e_v], as [variance of the pose, covariance,
variance of the rate].
"""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rotation import norm, quaternion_conjugate, quaternion_product
from drake_nonstop.mechanics.signals import LoadState, TrackingError


def error_of(state: NDArray, reference: NDArray) -> NDArray:
    """The error (12,) of a load's state (13,) beside that of its reference (13,)."""
    seen, desired = LoadState.view(state), LoadState.view(reference)
    turn = quaternion_product(seen.quaternion, quaternion_conjugate(desired.quaternion))
    rates = seen.angular_velocity - desired.angular_velocity, seen.velocity - desired.velocity
    return np.concatenate([2 * turn[1:] / turn[:1], seen.position - desired.position, *rates])


def state_with_error(error: NDArray, reference: NDArray) -> NDArray:
    """The state (13,) that has this error (12,) beside its reference (13,)."""
    off, desired = TrackingError.view(error), LoadState.view(reference)
    turn = np.concatenate([np.ones(1), off.orientation / 2])
    quaternion = quaternion_product(turn / norm(turn), desired.quaternion)
    rates = desired.angular_velocity + off.angular_velocity, desired.velocity + off.velocity
    return np.concatenate([quaternion, desired.position + off.position, *rates])


def predicted_error(
    error: NDArray, covariance: NDArray, elapsed: NDArray, process: NDArray
) -> tuple[NDArray, NDArray]:
    """The error (12,) after a time (1,), s, at constant rates, and its covariance (6,).

    Meanwhile white accelerations of the spectral densities `process` (2,), rad²/s³ and m²/s³, of
    rotation and translation, act on it.
    """
    pose, rate = error[:6], error[6:]
    of_pose, both, of_rate = _entries(covariance)
    entries = (
        of_pose + 2 * elapsed * both + elapsed**2 * of_rate + process * elapsed**3 / 3,
        both + elapsed * of_rate + process * elapsed**2 / 2,
        of_rate + process * elapsed,
    )
    return np.concatenate([pose + elapsed * rate, rate]), np.stack(entries, axis=-1).ravel()


def corrected_error(
    error: NDArray, covariance: NDArray, measured: NDArray, noise: NDArray
) -> tuple[NDArray, NDArray]:
    """The error (12,) after a measurement (12,) of it, and its covariance (6,).

    x⁺ = x + K (y − x) with the gain K = P (P + R)⁻¹, and P⁺ = K R.

    Args:
        error: x, before.
        covariance: P, before.
        measured: y.
        noise: R (2, 2), variances of the measured [pose, rate] of rotation and translation.
    """
    of_pose, both, of_rate = _entries(covariance)
    pose_noise, rate_noise = noise.T
    determinant = of_pose * of_rate - both**2
    whole = determinant + of_pose * rate_noise + of_rate * pose_noise + pose_noise * rate_noise
    pose_gain = (determinant + of_pose * rate_noise) / whole
    rate_gain = (determinant + of_rate * pose_noise) / whole
    shared = both / whole
    entries = pose_noise * pose_gain, shared * pose_noise * rate_noise, rate_noise * rate_gain
    pose, rate = ((measured - error)[part].reshape(2, 3) for part in (slice(6), slice(6, 12)))

    def weighed(of_pose: NDArray, of_rate: NDArray) -> NDArray:
        return (of_pose[:, None] * pose + of_rate[:, None] * rate).ravel()

    change = weighed(pose_gain, shared * pose_noise), weighed(shared * rate_noise, rate_gain)
    return error + np.concatenate(change), np.stack(entries, axis=-1).ravel()


def _entries(covariance: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Variance of the pose, covariance, and variance of the rate, (2,) each."""
    of_pose, both, of_rate = covariance.reshape(2, 3).T
    return of_pose, both, of_rate
