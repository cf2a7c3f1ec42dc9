"""Cables: massless, tension-only spring-dampers between load and carriers."""

from numpy.typing import NDArray

from drake_nonstop.mechanics.rotation import absolute, cross, norm, rotation_matrix
from drake_nonstop.mechanics.signals import CarrierStates, LoadState


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
    `attachments` (n, 3) in L; lengths, stiffnesses and dampings are one for all or (n, 1).
    With s = max(ℓ − L₀, 0),

        T = min( max(K_c s + B_c ℓ̇, 0), 2 K_c s ):

    a linear spring-damper whose damper never outweighs its spring. The paper's model
    wherever the cable is taut; as it goes slack the tension falls to zero without a
    jump, which a damper that switches off at s = 0 would leave behind.
    """
    load, carriers = LoadState.view(load_state), CarrierStates.view(carrier_state)
    levers = attachments @ rotation_matrix(load.quaternion).T
    stretch = carriers.positions - load.position - levers
    stretch_rate = carriers.velocities - load.velocity - cross(load.angular_velocity, levers)
    length = norm(stretch)
    direction = stretch / length
    length_rate = (direction * stretch_rate).sum(axis=1, keepdims=True)
    spring = stiffness * positive_part(length - rest_length)
    damped = positive_part(spring + damping * length_rate)
    tension = damped - positive_part(damped - 2 * spring)
    return tension * direction, tension[:, 0]


def cables_elastic_energy(
    load_state: NDArray,
    carrier_state: NDArray,
    *,
    attachments: NDArray,
    rest_length: float | NDArray,
    stiffness: float | NDArray,
) -> NDArray:
    """Σ ½ K_c max(ℓ_i − L₀, 0)² (1,), J; arguments as of `cable_forces_and_tensions`."""
    load, carriers = LoadState.view(load_state), CarrierStates.view(carrier_state)
    levers = attachments @ rotation_matrix(load.quaternion).T
    stretch = positive_part(norm(carriers.positions - load.position - levers) - rest_length)
    return (stiffness * stretch * stretch).sum(axis=0) / 2
