"""The carriers: their desired motion, their controllers and their dynamics."""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.cable import positive_part
from drake_nonstop.mechanics.rotation import cross, norm, rotation_matrix
from drake_nonstop.mechanics.signals import LoadReference, LoadState


def carrier_motion(
    load_state: NDArray,
    forces: NDArray,
    rates: NDArray,
    *,
    attachments: NDArray,
    rest_length: float | NDArray,
    compliance: float | NDArray,
) -> tuple[NDArray, NDArray]:
    """Positions and velocities (n, 3) each, in W, of carriers that pull with f_i (eqs. 1, 22).

    `load_state` (13,) gives the load's pose and twist in W; any longer array that begins
    in the same way will do, such as a reference. `forces` and `rates` are f and ḟ (n, 3)
    in W, `attachments` (n, 3) in L, `compliance` is 1/K_c (m/N). With q = f/‖f‖,
    T = ‖f‖, Π = I − q qᵀ and the stretched length ℓ = L₀ + T/K_c,

        p = p_L + R b + ℓ q,   v = ṗ_L + ω × R b + (ℓ/T) Π ḟ + (qᵀḟ/K_c) q.

    With compliance 0 these are the paper's equations; the last term, of a cable that stretches,
    is an own derivation.
    """
    load = LoadState.view(load_state)
    levers = attachments @ rotation_matrix(load.quaternion).T
    tension = norm(forces)
    direction = forces / tension
    length = rest_length + compliance * tension
    tension_rate = (direction * rates).sum(axis=1, keepdims=True)
    swing = length / tension * (rates - tension_rate * direction)
    return (
        load.position + levers + length * direction,
        load.velocity
        + cross(load.angular_velocity, levers)
        + swing
        + compliance * tension_rate * direction,
    )


def carrier_acceleration(
    reference: NDArray,
    forces: NDArray,
    rates: NDArray,
    second_rates: NDArray,
    *,
    attachments: NDArray,
    rest_length: float | NDArray,
    compliance: float | NDArray,
) -> NDArray:
    """Accelerations (n, 3), in W, of the motion of `carrier_motion`.

    `reference` (22,) is the load's, `forces`, `rates` and `second_rates` are f, ḟ and f̈ (n, 3),
    all in W; the others as there. With T = ‖f‖, a = f·ḟ/T² and b = (ḟ·ḟ + f·f̈)/T² − 3 a²,

        p̈ = p̈_L + ω̇ × R b + ω × (ω × R b) + (L₀/T) (f̈ − 2 a ḟ − b f) + f̈/K_c.

    Own derivation.
    """
    load = LoadReference.view(reference)
    levers = attachments @ rotation_matrix(load.quaternion).T
    tension = norm(forces)
    squared = tension * tension
    shrinking = (forces * rates).sum(axis=1, keepdims=True) / squared
    both = (rates * rates + forces * second_rates).sum(axis=1, keepdims=True) / squared
    bending = both - 3 * shrinking * shrinking
    swing = second_rates - 2 * shrinking * rates - bending * forces
    return (
        load.acceleration
        + cross(load.angular_acceleration, levers)
        + cross(load.angular_velocity, cross(load.angular_velocity, levers))
        + rest_length / tension * swing
        + compliance * second_rates
    )


def carrier_jerk(
    reference: NDArray,
    forces: NDArray,
    rates: NDArray,
    second_rates: NDArray,
    third_rates: NDArray,
    *,
    attachments: NDArray,
    rest_length: float | NDArray,
    compliance: float | NDArray,
) -> NDArray:
    """Jerks (n, 3), in W, of the motion of `carrier_motion`; the load's angular jerk is zero.

    Arguments as of `carrier_acceleration`, and `third_rates` f⃛ (n, 3) in W. With T, a and b as
    there, c = (3 ḟ·f̈ + f·f⃛)/T² and r = R b_i,

        p⃛ = p⃛_L + 2 ω̇ × (ω × r) + ω × (ω̇ × r) + ω × (ω × (ω × r))
             + (L₀/T) (f⃛ − 3 a f̈ − 3 b ḟ − (c − 9 a b − 12 a³) f) + f⃛/K_c.

    Own derivation.
    """
    load = LoadReference.view(reference)
    levers = attachments @ rotation_matrix(load.quaternion).T
    turning = cross(load.angular_velocity, levers)
    tension = norm(forces)
    squared = tension * tension
    a = (forces * rates).sum(axis=1, keepdims=True) / squared
    b = (rates * rates + forces * second_rates).sum(axis=1, keepdims=True) / squared - 3 * a * a
    c = (3 * rates * second_rates + forces * third_rates).sum(axis=1, keepdims=True) / squared
    swing = third_rates - 3 * a * second_rates - 3 * b * rates
    swing = swing - (c - 9 * a * b - 12 * a * a * a) * forces
    return (
        load.jerk
        + 2 * cross(load.angular_acceleration, turning)
        + cross(load.angular_velocity, cross(load.angular_acceleration, levers))
        + cross(load.angular_velocity, cross(load.angular_velocity, turning))
        + rest_length / tension * swing
        + compliance * third_rates
    )


def motion_after(
    motion: NDArray, time: NDArray, acceleration: NDArray | None = None, jerk: NDArray | None = None
) -> NDArray:
    """[positions, velocities] (6n,) of carriers a `time` (1,) after `motion` (6n,), SI.

    p + τ v + τ² a/2 + τ³ j/6 and v + τ a + τ² j/2 of an `acceleration` (3n,) at `motion` that has
    a constant `jerk` (3n,), each zero where it is not given.
    """
    positions, velocities = np.split(motion, 2)
    if acceleration is None:
        return np.concatenate([positions + time * velocities, velocities])
    change = time * acceleration
    half = change / 2
    if jerk is not None:
        of_jerk = time * time * jerk / 2
        half, change = half + of_jerk / 3, change + of_jerk
    return np.concatenate([positions + time * (velocities + half), velocities + change])


def pid_forces(
    error: NDArray,
    integral: NDArray,
    *,
    position_gain: float | NDArray,
    velocity_gain: float | NDArray,
    integral_gain: float | NDArray,
) -> NDArray:
    """Forces (3n,) on the carriers, in W, that pull them to their references.

    `error` (6n,) is the reference minus the state, [positions, velocities] in W, `integral`
    (3n,) that of its positions. The forces are linear in both.
    """
    position, velocity = np.split(error, 2)
    return position_gain * position + velocity_gain * velocity + integral_gain * integral


def double_integrator_rate(
    carrier_state: NDArray, forces: NDArray, *, mass: float | NDArray
) -> NDArray:
    """The rate (6n,) of [positions, velocities] of free masses under forces (3n,), in W.

    It is linear in both arguments.
    """
    _, velocities = np.split(carrier_state, 2)
    return np.concatenate([velocities, forces / mass])


def carriers_kinetic_energy(carrier_state: NDArray, *, mass: float | NDArray) -> NDArray:
    """½ m Σ ‖v_i‖² (1,), J, of [positions, velocities] (6n,) in W."""
    _, velocities = np.split(carrier_state, 2)
    return mass * (velocities * velocities).sum(keepdims=True) / 2


def carriers_potential_energy(
    carrier_state: NDArray, *, mass: float | NDArray, gravity: float | NDArray
) -> NDArray:
    """Of the weights, m g Σ z_i (1,), J, of [positions, velocities] (6n,) in W: zero at z = 0."""
    positions, _ = np.split(carrier_state, 2)
    return mass * gravity * positions[2::3].sum(keepdims=True)


def loaded_pid_forces(
    carrier_reference: NDArray,
    carrier_state: NDArray,
    desired_cable_forces: NDArray,
    *,
    position_gain: float | NDArray,
    velocity_gain: float | NDArray,
    mass: float | NDArray,
    gravity: float | NDArray,
) -> NDArray:
    """Forces (3n,), in W, on carriers with weight and cable tension.

    PD on [positions, velocities] (6n,), plus the weight and the desired cable forces (3n,),
    both in W.
    """
    size = len(desired_cable_forces)
    feedback = pid_forces(
        carrier_reference - carrier_state,
        np.zeros(size),
        position_gain=position_gain,
        velocity_gain=velocity_gain,
        integral_gain=0.0,
    )
    return feedback + mass * gravity * np.tile([0.0, 0.0, 1.0], size // 3) + desired_cable_forces


def loaded_carrier_rate(
    carrier_state: NDArray,
    forces: NDArray,
    cable_forces: NDArray,
    *,
    mass: float | NDArray,
    gravity: float | NDArray,
    max_force: float | NDArray | None,
) -> NDArray:
    """The rate (6n,) of [positions, velocities] of carriers under weight and cable, in W.

    `cable_forces` (3n,) are those on the load; each of the `forces` (3n,), with u its norm,
    is limited to `max_force`, u_max: sat(u) = u u_max / (u_max + max(‖u‖ − u_max, 0)); None:
    there is no limit.
    """
    applied = forces.reshape(-1, 3)
    if max_force is not None:
        excess = positive_part(norm(applied) - max_force)
        applied = applied * max_force / (max_force + excess)
    acceleration = (applied - cable_forces.reshape(-1, 3)) / mass - gravity * np.array(
        [0.0, 0.0, 1.0]
    )
    _, velocities = np.split(carrier_state, 2)
    return np.concatenate([velocities, acceleration.ravel()])
