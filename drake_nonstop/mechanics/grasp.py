"""The grasp matrix and the distribution of a load wrench over the cables (eqs. 7-9).

The paper stacks a wrench as [force; torque]; Drake, and every array here, stacks it as
[torque; force]. Only `grasp_matrix` exchanges the two.
"""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rotation import cross, rotation_matrix, skew
from drake_nonstop.mechanics.signals import InternalForce, LoadState, Wrench

# Of the tensions that a null space can change; squared, and relative to the largest. Below it rates
# would be those of a division by nearly zero, as where carriers start symmetrically.
_DEPENDENT = 1e-8


def grasp_matrix(attachments: NDArray) -> NDArray:
    """G₀ (6, 3n) in L: stacked cable forces (3n,) to the wrench [torque; force] (6,).

    Eq. 8 with R = I and its two row blocks exchanged; `attachments` (n, 3) are the b_i
    in L. In the load frame the matrix is constant, so that neither its pseudo-inverse
    nor its null space has to be differentiated along the motion.
    """
    return np.concatenate(
        [
            np.concatenate([skew(b) for b in attachments], axis=1),
            np.concatenate([np.eye(3)] * len(attachments), axis=1),
        ]
    )


def in_load_frame(
    load_state: NDArray, wrench: NDArray, wrench_rate: NDArray
) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """R_LW (3, 3), ω (3,) in L, and a wrench and its rate (6,) in W as seen from L.

    `load_state` (13,) is in W. The rate is that of the components in L:
    d(Rᵀτ)/dt = Rᵀτ̇ − ω × Rᵀτ, and likewise of the force.
    """
    load, rate = LoadState.view(load_state), Wrench.view(wrench_rate)
    R_LW = rotation_matrix(load.quaternion).T
    angular_velocity = R_LW @ load.angular_velocity
    torque, force = (R_LW @ part for part in Wrench.view(wrench))
    wrench_rate_L = np.concatenate(
        [
            R_LW @ rate.torque - cross(angular_velocity, torque),
            R_LW @ rate.force - cross(angular_velocity, force),
        ]
    )
    return R_LW, angular_velocity, np.concatenate([torque, force]), wrench_rate_L


def cable_forces_and_rates(
    load_state: NDArray,
    wrench: NDArray,
    wrench_rate: NDArray,
    internal_force: NDArray,
    *,
    pseudo_inverse: NDArray,
    basis: NDArray,
    offset: NDArray,
) -> tuple[NDArray, NDArray]:
    """Desired cable forces f and their rates ḟ, each (n, 3) in W (eqs. 9, 16, 19-21).

    `load_state` (13,), `wrench` and `wrench_rate` (6,) are in W, `internal_force` (2m,)
    is [λ; λ̇]; `pseudo_inverse` (3n, 6), `basis` N₀ (3n, m) and `offset` f̃⁰ (3n,) are
    constants in L. With everything constant in the load frame,

        ᴸf = G₀† [ᴸτ; Rᵀf] + f̃⁰ + N₀ λ,   f_i = R ᴸf_i,   ḟ_i = R (ᴸḟ_i + ω × ᴸf_i),

    exact, with ω in L. Own derivation, equal to Ġ†w + G†ẇ + Ṅλ + Nλ̇ of the paper.
    """
    R_LW, angular_velocity, wrench_L, wrench_rate_L = in_load_frame(load_state, wrench, wrench_rate)
    internal = InternalForce.view(internal_force)
    forces_L = pseudo_inverse @ wrench_L + offset + basis @ internal.values
    rates_L = pseudo_inverse @ wrench_rate_L + basis @ internal.rates
    forces_L, rates_L = forces_L.reshape(-1, 3), rates_L.reshape(-1, 3)
    return forces_L @ R_LW, (rates_L + cross(angular_velocity, forces_L)) @ R_LW


def null_space_correction(
    directions: NDArray,
    direction_rates: NDArray,
    shortfalls: NDArray,
    shortfall_rates: NDArray,
    null_space: NDArray,
) -> tuple[NDArray, NDArray]:
    """The smallest forces (n, 3) without a wrench that correct some tensions, and their rates.

    Of all y, the least with q_iᵀ(Z y)_i = s_i for the k cables in question, and its exact rate
    while these stay the same: y = Aᵀμ and ẏ = Ȧᵀμ + Aᵀμ̇ with A Aᵀ μ = s. Own derivation.

    Args:
        directions: q (k, n, 3), the unit direction of a cable in its row i and zero elsewhere.
        direction_rates: q̇, of the same shape.
        shortfalls: s (k,), N, missing tensions along the directions.
        shortfall_rates: ṡ (k,), N/s.
        null_space: Z (3n, 3n − 6), an orthonormal basis of the null space of the grasp matrix.
    """
    count = len(directions)
    rows = directions.reshape(count, -1) @ null_space
    row_rates = direction_rates.reshape(count, -1) @ null_space
    inverse = np.linalg.pinv(rows @ rows.T, rcond=_DEPENDENT)
    multipliers = inverse @ shortfalls
    change = row_rates @ rows.T
    multiplier_rates = inverse @ (shortfall_rates - (change + change.T) @ multipliers)
    step = rows.T @ multipliers
    rate = row_rates.T @ multipliers + rows.T @ multiplier_rates
    return (null_space @ step).reshape(-1, 3), (null_space @ rate).reshape(-1, 3)
