"""The rigid load: Newton-Euler with linear drag (eqs. 5-6).

A load state (13,) is [quaternion w x y z, position, angular velocity, velocity], all in
W: the order of a free body in Drake's MultibodyPlant.
"""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rotation import cross, quaternion_rate, rotation_matrix


def gravity_wrench(mass: float, gravity: float) -> NDArray:
    """The wrench [torque; force] (6,), in W, that holds the load up against gravity."""
    return np.array([0.0, 0.0, 0.0, 0.0, 0.0, mass * gravity])


def load_acceleration(
    load_state: NDArray,
    wrench: NDArray,
    *,
    mass: float,
    inertia: NDArray,
    inertia_inverse: NDArray,
    drag: float,
    angular_drag: float = 0.0,
    gravity: float,
) -> tuple[NDArray, NDArray]:
    """Angular and translational acceleration (3,) each, in W, under a wrench (6,) in W.

    m p̈ = f − B_L ṗ − m g e₃ and J ω̇ = τ − C_L ω − ω × J ω in L. `inertia` (3, 3) is about the
    centre of mass, in L. The drag B_L stands in the paper's Table I only, and C_L nowhere in it.
    """
    R_WL = rotation_matrix(load_state[:4])
    angular_velocity = R_WL.T @ load_state[7:10]
    torque = (
        R_WL.T @ wrench[:3]
        - angular_drag * angular_velocity
        - cross(angular_velocity, inertia @ angular_velocity)
    )
    force = wrench[3:] - drag * load_state[10:13]
    return R_WL @ (inertia_inverse @ torque), force / mass - np.array([0.0, 0.0, gravity])


def load_state_rate(
    load_state: NDArray,
    cable_forces: NDArray,
    disturbance_wrench: NDArray,
    *,
    attachments: NDArray,
    mass: float,
    inertia: NDArray,
    inertia_inverse: NDArray,
    drag: float,
    angular_drag: float = 0.0,
    gravity: float,
) -> NDArray:
    """The rate (13,) of the load state under cable forces (3n,) at the attachments.

    `cable_forces` and `disturbance_wrench` (6,), at the centre of mass, are in W;
    `attachments` (n, 3) in L.
    """
    forces = cable_forces.reshape(-1, 3)
    levers = attachments @ rotation_matrix(load_state[:4]).T
    wrench = disturbance_wrench + np.concatenate(
        [cross(levers, forces).sum(axis=0), forces.sum(axis=0)]
    )
    angular, translational = load_acceleration(
        load_state,
        wrench,
        mass=mass,
        inertia=inertia,
        inertia_inverse=inertia_inverse,
        drag=drag,
        angular_drag=angular_drag,
        gravity=gravity,
    )
    return np.concatenate(
        [
            quaternion_rate(load_state[:4], load_state[7:10]),
            load_state[10:13],
            angular,
            translational,
        ]
    )
