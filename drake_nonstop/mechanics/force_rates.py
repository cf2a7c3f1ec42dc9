"""The wrench and the cable forces of a load that moves along its reference, and their rates."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rigid_load import STILL_AIR, RigidLoad
from drake_nonstop.mechanics.rotation import cross, rotation_matrix, skew
from drake_nonstop.mechanics.signals import (
    REFERENCE_HIGHER_RATES_SIZE,
    InternalForceHigherRates,
    LoadReference,
    ReferenceHigherRates,
)

_UNKNOWN = np.zeros(REFERENCE_HIGHER_RATES_SIZE)


class _Along(NamedTuple):
    """Rates of a motion along a reference, each a list by their order."""

    turns: list[NDArray]  # (3, 3), R_LW
    omegas: list[NDArray]  # (3,), the angular velocity's components in L
    wrenches: list[NDArray]  # (6,), the components in L of the wrench [torque; force]


def _along(load: RigidLoad, reference: NDArray, wind: NDArray, higher_rates: NDArray) -> _Along:
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
    return _Along(turns, omegas, wrenches)


def wrenches_along(
    load: RigidLoad, reference: NDArray, wind: NDArray = STILL_AIR
) -> tuple[NDArray, NDArray, NDArray]:
    """The wrench [torque; force] (6,), in L, that moves a load along its reference, and two rates.

    The rates are those of its components in L. Arguments, and what is taken as zero, as of
    `second_and_third_force_rates`.
    """
    first, second, third, _ = _along(load, reference, wind, _UNKNOWN).wrenches
    return first, second, third


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
    along = _along(load, reference, wind, reference_higher_rates)
    R_LW = along.turns[0]
    forces_L = forces @ R_LW.T
    rates_L = rates @ R_LW.T - cross(along.omegas[0], forces_L)
    internal = InternalForceHigherRates.view(internal_force_higher_rates)
    second_L, third_L = (
        (pseudo_inverse @ wrench + basis @ internal_rate).reshape(-1, 3)
        for wrench, internal_rate in zip(along.wrenches[2:], internal, strict=True)
    )
    of_forces = [forces_L, rates_L, second_L, third_L]
    return (
        _product_rate(np.matmul, of_forces, along.turns, 2),
        _product_rate(np.matmul, of_forces, along.turns, 3),
    )


def _product_rate(
    product: Callable, first: Sequence[NDArray], second: Sequence[NDArray], order: int
) -> NDArray:
    """The rate of that order of a bilinear product, of the factors and their rates in order."""
    terms = [math.comb(order, i) * product(first[i], second[order - i]) for i in range(order + 1)]
    return sum(terms[1:], terms[0])
