"""Cables: massless, straight, tension-only spring-dampers between load and carriers."""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rotation import absolute, cross, norm, rotation_matrix, skew
from drake_nonstop.mechanics.signals import CarrierStates, LoadState


def beside_vectors(number: float | NDArray) -> float | NDArray:
    """A number of all cables, or the numbers (n,) of each as (n, 1), beside vectors (..., n, 3)."""
    return number[:, None] if isinstance(number, np.ndarray) and number.ndim == 1 else number


def positive_part(a: NDArray) -> NDArray:
    """max(a, 0), exact, for any scalar type and without a branch."""
    return (a + absolute(a)) / 2


def within(a: NDArray, least: float | NDArray, most: float | NDArray) -> NDArray:
    """The entries within their limits, exact, for any scalar type and without a branch."""
    raised = a + positive_part(least - a)
    return raised - positive_part(raised - most)


def compliance_of(stiffness: NDArray) -> NDArray:
    """1/K_c (m/N) of a stiffness K_c (N/m), 0 where it is infinite.

    Exact, and written so that CasADi does not turn T · (1/K_c) into T/K_c, which rounds otherwise.
    """
    return 2 / stiffness * 0.5


def ends_of_cables(
    load_state: NDArray, carrier_state: NDArray, attachments: NDArray
) -> tuple[tuple[NDArray, NDArray], tuple[NDArray, NDArray]]:
    """Positions and velocities of the attachments and of the carriers, each (n, 3)."""
    load, carriers = LoadState.view(load_state), CarrierStates.view(carrier_state)
    levers = attachments @ rotation_matrix(load.quaternion).T
    moving = load.velocity + cross(load.angular_velocity, levers)
    return (load.position + levers, carriers.positions), (moving, carriers.velocities)


def cable_forces_and_tensions(
    load_state: NDArray,
    carrier_state: NDArray,
    *,
    attachments: NDArray,
    rest_length: float | NDArray,
    stiffness: float | NDArray,
    damping: float | NDArray,
) -> tuple[NDArray, NDArray]:
    """Cable forces on the load (n, 3), in W, and tensions (n,) (eq. 4).

    `load_state` (13,) and `carrier_state` (6n,) = [p_1 … p_n, v_1 … v_n] are in W;
    `attachments` (n, 3) in L; lengths, stiffnesses and dampings are one for all or (n,).
    With s = max(ℓ − L₀, 0),

        T = min( max(K_c s + B_c ℓ̇, 0), 2 K_c s ):

    a linear spring-damper whose damper never outweighs its spring. The paper's model
    wherever the cable is taut; as it goes slack the tension falls to zero without a
    jump, which a damper that switches off at s = 0 would leave behind.
    """
    ends, velocities = ends_of_cables(load_state, carrier_state, attachments)
    stretch, stretch_rate = (high - low for low, high in (ends, velocities))
    tension, direction = tensions_and_directions(
        stretch,
        stretch_rate,
        rest_length=beside_vectors(rest_length),
        stiffness=beside_vectors(stiffness),
        damping=beside_vectors(damping),
    )
    return tension * direction, tension[:, 0]


def tensions_and_directions(
    stretch: NDArray,
    stretch_rate: NDArray,
    *,
    rest_length: float | NDArray,
    stiffness: float | NDArray,
    damping: float | NDArray,
) -> tuple[NDArray, NDArray]:
    """Tensions T (..., 1), N, and directions (..., 3) of spring-dampers from end to end (..., 3).

    `stretch_rate` is the rate of `stretch`; T is that of `cable_forces_and_tensions`.
    """
    length = norm(stretch)
    direction = stretch / length
    length_rate = (direction * stretch_rate).sum(axis=-1, keepdims=True)
    spring = stiffness * positive_part(length - rest_length)
    damped = positive_part(spring + damping * length_rate)
    return damped - positive_part(damped - 2 * spring), direction


def forces_under_other_wrench(
    forces: NDArray,
    levers: NDArray,
    wrench: NDArray,
    *,
    rest_length: float | NDArray,
    stiffness: float | NDArray,
) -> NDArray:
    """Cable forces (k, n, 3), N, where a load has another wrench than its carriers pull for.

    The carriers stay where they are, and the load moves and turns by the small δp and δφ at which
    the cables hold it. With q = f/T of each cable, to first order,

        δf = −(K_c q qᵀ + (T/ℓ)(I − q qᵀ)) (δp + δφ × r),   ℓ = L₀ + T/K_c,
        Σ (f + δf) = F,   Σ (r × (f + δf) + (δφ × r) × f) = τ.

    Own derivation.

    Args:
        forces: f (k, n, 3), N, that the carriers pull with, on the load, as all in one frame.
        levers: r (k, n, 3) or (n, 3), m, from the load's centre of mass to the attachments.
        wrench: [τ; F] (k, 6), which the cables have to make about the centre of mass.
        rest_length: L₀, m, one for all or (n,).
        stiffness: K_c, N/m, likewise; inf: the cables do not stretch, and the forces stay as they
            are.
    """
    if not np.all(np.isfinite(stiffness)):
        return forces
    rest_length, stiffness = (np.reshape(number, (-1, 1, 1)) for number in (rest_length, stiffness))
    levers = np.broadcast_to(levers, forces.shape)
    tensions = np.linalg.norm(forces, axis=-1, keepdims=True)[..., None]
    along = forces[..., :, None] * forces[..., None, :] / tensions**2
    across = np.eye(3) - along
    lengths = rest_length + tensions / stiffness
    springs = stiffness * along + tensions / lengths * across  # (k, n, 3, 3)
    # How an attachment moves with [δφ; δp], (k, n, 3, 6); transposed, what wrench a force has.
    moving = np.concatenate([-skew(levers), np.broadcast_to(np.eye(3), springs.shape)], axis=-1)
    present = wrenches_of(forces, levers)
    restoring = np.einsum("kiab,kiac,kicd->kbd", moving, springs, moving)
    restoring[:, :3, :3] -= np.einsum("kiab,kibc->kac", skew(forces), skew(levers))
    moved = np.linalg.solve(restoring, (present - wrench)[..., None])
    return forces - (springs @ moving @ moved[:, None])[..., 0]


def wrenches_of(forces: NDArray, levers: NDArray) -> NDArray:
    """The wrenches [τ; F] (..., 6) of forces (..., n, 3) at levers of that shape, in one frame."""
    torques = np.cross(levers, forces).sum(axis=-2)
    return np.concatenate([torques, forces.sum(axis=-2)], axis=-1)
