"""The grasp matrix and the distribution of a load wrench over the cables (eqs. 7-9), with rates.

The paper stacks a wrench as [force; torque]; Drake, and every array here, stacks it as
[torque; force]. Only `grasp_matrix` exchanges the two.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rigid_load import STILL_AIR, RigidLoad
from drake_nonstop.mechanics.rotation import cross, rotation_matrix, skew
from drake_nonstop.mechanics.signals import (
    REFERENCE_HIGHER_RATES_SIZE,
    InternalForce,
    InternalForceHigherRates,
    LoadReference,
    LoadState,
    ReferenceHigherRates,
    Wrench,
)

# Of the tensions that a null space can change; squared, and relative to the largest. Below it rates
# would be those of a division by nearly zero, as where carriers start symmetrically.
_DEPENDENT = 1e-8
_UNKNOWN = np.zeros(REFERENCE_HIGHER_RATES_SIZE)


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


def _rates_along(
    load: RigidLoad, reference: NDArray, wind: NDArray, higher_rates: NDArray
) -> tuple[list[NDArray], list[NDArray], list[NDArray]]:
    """R_LW (3, 3), ω (3,) and the wrench (6,) in L along a reference, each with its rates."""
    desired = LoadReference.view(reference)
    R_WL = rotation_matrix(desired.quaternion)
    higher = ReferenceHigherRates.view(higher_rates)
    zero = 0 * desired.jerk
    # d(R_LW)/dt = −S(ω) R_LW, so that dᴸω/dt = R_LW ω̇.
    alphas = [desired.angular_acceleration, higher.angular_jerk, zero, zero]
    turns, omegas = [R_WL.T], [R_WL.T @ desired.angular_velocity]
    for order in range(3):
        spins = [-skew(omega) for omega in omegas]
        omegas.append(_product_rate(np.matmul, turns, alphas, order))
        turns.append(_product_rate(np.matmul, spins, turns, order))
    omegas.append(_product_rate(np.matmul, turns, alphas, 3))

    drag = load.drag
    weight = load.mass * load.gravity * np.array([0.0, 0.0, 1.0])
    force_rates = [
        load.mass * desired.acceleration + weight + drag * (desired.velocity - wind),
        load.mass * desired.jerk + drag * desired.acceleration,
        load.mass * higher.snap + drag * desired.jerk,
        drag * higher.snap,
    ]
    momenta = [load.inertia @ omega for omega in omegas]
    wrenches = []
    for order in range(4):
        torque = momenta[order + 1] + _product_rate(cross, omegas, momenta, order)
        torque = torque + load.angular_drag * omegas[order]
        force = _product_rate(np.matmul, turns, force_rates, order)
        wrenches.append(np.concatenate([torque, force]))
    return turns, omegas, wrenches


def wrenches_along(
    load: RigidLoad, reference: NDArray, wind: NDArray = STILL_AIR
) -> tuple[NDArray, NDArray, NDArray]:
    """The wrench [torque; force] (6,), in L, that moves a load along its reference, and two rates.

    The rates are those of its components in L. Arguments, and what is taken as zero, as of
    `second_and_third_force_rates`.
    """
    _, _, (value, rate, second_rate, _) = _rates_along(load, reference, wind, _UNKNOWN)
    return value, rate, second_rate


def second_and_third_force_rates(
    load: RigidLoad,
    reference: NDArray,
    forces: NDArray,
    rates: NDArray,
    internal_force_higher_rates: NDArray,
    wind: NDArray = STILL_AIR,
    reference_higher_rates: NDArray = _UNKNOWN,
    *,
    pseudo_inverse: NDArray,
    basis: NDArray,
) -> tuple[NDArray, NDArray]:
    """f̈ and f⃛ (n, 3) each, in W, of the desired cable forces on a load along its reference.

    `load` is the controllers' model and `reference` (22,) its motion; `forces` and `rates` are f
    and ḟ (n, 3) in W, `internal_force_higher_rates` (2m,) is [λ̈; λ⃛]; `wind` (3,) is in m/s, in
    W, and constant; `reference_higher_rates` (6,) is the reference's [angular jerk (rad/s³);
    snap (m/s⁴)] in W; `pseudo_inverse` (3n, 6) and `basis` N₀ (3n, m) are constants in L. With
    f_i = R ᴸf_i,

        d²ᴸf/dt² = G₀† d²ᴸw/dt² + N₀ λ̈,
        d³ᴸf/dt³ = G₀† d³ᴸw/dt³ + N₀ λ⃛,

    where w is the wrench that moves the load along its reference. What is not told of the reference
    is taken as zero: the rates of its snap and of its angular jerk, in W. So are the second and
    third rates of what the feedback adds to w. Without rotation f̈ then is exact. Own derivation.
    """
    turns, omegas, wrenches = _rates_along(load, reference, wind, reference_higher_rates)
    R_LW = turns[0]
    forces_L = forces @ R_LW.T
    rates_L = rates @ R_LW.T - cross(omegas[0], forces_L)
    internal = InternalForceHigherRates.view(internal_force_higher_rates)
    second_L, third_L = (
        (pseudo_inverse @ wrench + basis @ internal_rate).reshape(-1, 3)
        for wrench, internal_rate in zip(wrenches[2:], internal, strict=True)
    )
    of_forces = [forces_L, rates_L, second_L, third_L]
    return (
        _product_rate(np.matmul, of_forces, turns, 2),
        _product_rate(np.matmul, of_forces, turns, 3),
    )


def _product_rate(
    product: Callable, first: Sequence[NDArray], second: Sequence[NDArray], order: int
) -> NDArray:
    """The rate of that order of a bilinear product, of the factors and their rates in order."""
    terms = [math.comb(order, i) * product(first[i], second[order - i]) for i in range(order + 1)]
    return sum(terms[1:], terms[0])


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
