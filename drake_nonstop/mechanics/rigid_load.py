"""The rigid load: Newton-Euler with linear drag (eqs. 5-6).

A load state (13,) is [quaternion w x y z, position, angular velocity, velocity], all in
W: the order of a free body in Drake's MultibodyPlant.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rotation import cross, quaternion_rate, rotation_matrix
from drake_nonstop.mechanics.signals import LoadState, Wrench

STILL_AIR = np.zeros(3)  # m/s


@dataclass(frozen=True, kw_only=True, eq=False)
class RigidLoad:
    """The parameters of the load; its frame L is at the centre of mass.

    Numbers may be arrays (1,), also of symbols.
    """

    mass: float | NDArray  # kg
    inertia: NDArray  # (3, 3), kg m², about the centre of mass, in L
    inertia_inverse: NDArray = field(init=False)  # (3, 3), 1/(kg m²)
    drag: float | NDArray  # N s/m
    angular_drag: float | NDArray = 0.0  # N m s/rad
    gravity: float | NDArray  # m/s²

    def __post_init__(self) -> None:
        object.__setattr__(self, "inertia_inverse", symmetric_inverse(self.inertia))


def symmetric_inverse(matrix: NDArray) -> NDArray:
    """The inverse of a symmetric (3, 3) matrix, of numbers or symbols, by its cofactors."""
    a, b, c = matrix
    cofactors = np.stack([cross(b, c), cross(c, a), cross(a, b)])
    return cofactors / (a * cofactors[0]).sum(keepdims=True)


def gravity_wrench(mass: float, gravity: float) -> NDArray:
    """The wrench [torque; force] (6,), in W, that holds the load up against gravity."""
    return mass * gravity * np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def load_acceleration(
    load: RigidLoad, load_state: NDArray, wrench: NDArray, wind: NDArray = STILL_AIR
) -> tuple[NDArray, NDArray]:
    """Angular and translational acceleration (3,) each, in W, under a wrench (6,) in W.

    m p̈ = f − B_L (ṗ − w) − m g e₃ and J ω̇ = τ − C_L ω − ω × J ω in L, in air that moves with w,
    the `wind` (3,) in m/s, in W. The drag B_L stands in the paper's Table I only, C_L and w nowhere
    in it.
    """
    state, applied = LoadState.view(load_state), Wrench.view(wrench)
    R_WL = rotation_matrix(state.quaternion)
    angular_velocity = R_WL.T @ state.angular_velocity
    torque = (
        R_WL.T @ applied.torque
        - load.angular_drag * angular_velocity
        - cross(angular_velocity, load.inertia @ angular_velocity)
    )
    force = applied.force - load.drag * (state.velocity - wind)
    return (
        R_WL @ (load.inertia_inverse @ torque),
        force / load.mass - load.gravity * np.array([0.0, 0.0, 1.0]),
    )


def load_state_rate(
    load: RigidLoad,
    load_state: NDArray,
    cable_forces: NDArray,
    disturbance_wrench: NDArray,
    wind: NDArray = STILL_AIR,
    *,
    attachments: NDArray,
) -> NDArray:
    """The rate (13,) of the load state under cable forces (3n,) at the attachments.

    `cable_forces`, `disturbance_wrench` (6,), at the centre of mass, and `wind` (3,), m/s, are in
    W; `attachments` (n, 3) in L.
    """
    state = LoadState.view(load_state)
    forces = cable_forces.reshape(-1, 3)
    levers = attachments @ rotation_matrix(state.quaternion).T
    wrench = disturbance_wrench + np.concatenate(
        [cross(levers, forces).sum(axis=0), forces.sum(axis=0)]
    )
    angular, translational = load_acceleration(load, load_state, wrench, wind)
    return np.concatenate(
        [
            quaternion_rate(state.quaternion, state.angular_velocity),
            state.velocity,
            angular,
            translational,
        ]
    )
