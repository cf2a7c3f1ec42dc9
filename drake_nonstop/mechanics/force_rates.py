"""Second and third rates of the desired cable forces, of a load that moves along its reference."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.internal_force import (
    internal_force_acceleration,
    internal_force_jerk,
)
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.rotation import cross, rotation_matrix, skew
from drake_nonstop.mechanics.signals import LoadReference


def second_and_third_force_rates(
    load: RigidLoad,
    reference: NDArray,
    forces: NDArray,
    rates: NDArray,
    internal_force: NDArray,
    parameters: NDArray,
    *,
    pseudo_inverse: NDArray,
    basis: NDArray,
    orders: float | NDArray = 1,
) -> tuple[NDArray, NDArray]:
    """f̈ and f⃛ (n, 3) each, in W, of the desired cable forces on a load along its reference.

    `load` is the controllers' model and `reference` (22,) its motion; `forces` and `rates` are f
    and ḟ (n, 3) in W, `internal_force` (2m,) is [λ; λ̇] and `parameters` (2,) are [ξ, A];
    `pseudo_inverse` (3n, 6) and `basis` N₀ (3n, m) are constants in L, `orders` h (m,) those of
    the pattern's harmonics. With f_i = R ᴸf_i,

        d²ᴸf/dt² = G₀† d²ᴸw/dt² + N₀ λ̈,   λ̈ = −(h ξ)² λ,
        d³ᴸf/dt³ = G₀† d³ᴸw/dt³ + N₀ λ⃛,   λ⃛ = −(h ξ)² λ̇,

    exact for constant ξ and A, where w is the wrench that moves the load along its reference. What
    the reference does not tell is taken as zero: its snap and its angular jerk, in W, and their
    rates. So are the second and third rates of what the feedback adds to w. Own derivation.
    """
    desired = LoadReference.view(reference)
    R_WL = rotation_matrix(desired.quaternion)
    # R_LW and ω in L, and their rates: d(R_LW)/dt = −S(ω) R_LW, and ω̇ is constant in W.
    turns, omegas = [R_WL.T], [R_WL.T @ desired.angular_velocity]
    for order in range(3):
        spins = [-skew(omega) for omega in omegas]
        omegas.append(turns[order] @ desired.angular_acceleration)
        turns.append(_product_rate(np.matmul, spins, turns, order))
    omegas.append(turns[3] @ desired.angular_acceleration)

    drag = load.drag
    weight = load.mass * load.gravity * np.array([0.0, 0.0, 1.0])
    force_rates = [
        load.mass * desired.acceleration + weight + drag * desired.velocity,
        load.mass * desired.jerk + drag * desired.acceleration,
        drag * desired.jerk,
        0 * desired.jerk,
    ]
    momenta = [load.inertia @ omega for omega in omegas]

    def wrench_rate(order: int) -> NDArray:
        """That of the wrench's components in L, [torque; force]."""
        torque = (
            momenta[order + 1]
            + _product_rate(cross, omegas, momenta, order)
            + load.angular_drag * omegas[order]
        )
        return np.concatenate([torque, _product_rate(np.matmul, turns, force_rates, order)])

    forces_L = forces @ R_WL
    rates_L = rates @ R_WL - cross(omegas[0], forces_L)
    second_L, third_L = (
        (pseudo_inverse @ wrench_rate(order) + basis @ internal_rate).reshape(-1, 3)
        for order, internal_rate in (
            (2, internal_force_acceleration(parameters, internal_force, orders=orders)),
            (3, internal_force_jerk(parameters, internal_force, orders=orders)),
        )
    )
    of_forces = [forces_L, rates_L, second_L, third_L]
    return (
        _product_rate(np.matmul, of_forces, turns, 2),
        _product_rate(np.matmul, of_forces, turns, 3),
    )


def second_force_rates_of_steady_wrench(
    reference: NDArray,
    forces: NDArray,
    rates: NDArray,
    internal_force: NDArray,
    parameters: NDArray,
    *,
    basis: NDArray,
    orders: float | NDArray = 1,
) -> NDArray:
    """f̈ (n, 3), in W, of the desired cable forces where the wrench is constant in L.

    Arguments as of `second_and_third_force_rates`. With ω and ω̇ of the reference,

        f̈ = R N₀ λ̈ + 2 ω × (ḟ − ω × f) + ω̇ × f + ω × (ω × f).
    """
    desired = LoadReference.view(reference)
    R_WL = rotation_matrix(desired.quaternion)
    omega = desired.angular_velocity
    second_rates = internal_force_acceleration(parameters, internal_force, orders=orders)
    turning = cross(omega, forces)
    return (
        (basis @ second_rates).reshape(-1, 3) @ R_WL.T
        + 2 * cross(omega, rates - turning)
        + cross(desired.angular_acceleration, forces)
        + cross(omega, turning)
    )


def _product_rate(
    product: Callable, first: Sequence[NDArray], second: Sequence[NDArray], order: int
) -> NDArray:
    """The rate of that order of a bilinear product, of the factors and their rates in order."""
    terms = [math.comb(order, i) * product(first[i], second[order - i]) for i in range(order + 1)]
    return sum(terms[1:], terms[0])
