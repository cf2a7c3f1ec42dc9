"""The carriers: their desired motion, their controllers and their dynamics."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.cable import positive_part
from drake_nonstop.mechanics.rotation import cross, norm, rotation_matrix
from drake_nonstop.mechanics.signals import LoadReference, LoadState


def cable_vectors(
    forces: Sequence[NDArray],
    *,
    rest_length: float | NDArray,
    compliance: float | NDArray,
    axis: int = -1,
) -> list[NDArray]:
    """The vectors from attachments to carriers that pull with f, and their rates.

    With T = ‖f‖, a = f·ḟ/T², b = (ḟ·ḟ + f·f̈)/T² − 3 a² and c = (3 ḟ·f̈ + f·f⃛)/T² they are

        ℓ q = (L₀/T) f + f/K_c,   of the stretched length ℓ = L₀ + T/K_c along q = f/T,
        (L₀/T) (ḟ − a f) + ḟ/K_c,   (L₀/T) (f̈ − 2 a ḟ − b f) + f̈/K_c,
        (L₀/T) (f⃛ − 3 a f̈ − 3 b ḟ − (c − 9 a b − 12 a³) f) + f⃛/K_c.

    With 1/K_c = 0 the first two are those of the paper (eqs. 1, 22); own derivation.

    Args:
        forces: f, N, and as many of its rates as are asked for, up to the third; of one shape.
        rest_length: L₀, m.
        compliance: 1/K_c, m/N.
        axis: of the components.
    """

    def dot(a: NDArray, b: NDArray) -> NDArray:
        return (a * b).sum(axis=axis, keepdims=True)

    f, *rates = forces
    square = dot(f, f)
    swings = [f]
    if len(rates) > 0:
        r = rates[0]
        a = dot(f, r) / square
        swings.append(r - a * f)
    if len(rates) > 1:
        s = rates[1]
        b = (dot(r, r) + dot(f, s)) / square - 3 * a * a
        swings.append(s - 2 * a * r - b * f)
    if len(rates) > 2:
        t = rates[2]
        c = (3 * dot(r, s) + dot(f, t)) / square
        swings.append(t - 3 * a * s - 3 * b * r - (c - 9 * a * b - 12 * a * a * a) * f)
    share = rest_length / np.sqrt(square)
    return [share * swing + compliance * pull for swing, pull in zip(swings, forces, strict=True)]


def carrier_motion(
    load_motion: NDArray,
    *forces: NDArray,
    attachments: NDArray,
    rest_length: float | NDArray,
    compliance: float | NDArray,
) -> list[NDArray]:
    """Positions (n, 3), in W, of carriers that pull with f_i, and as many rates as forces have.

    p = p_L + R b + ℓ q, see `cable_vectors`. The load's angular jerk is taken as zero.

    Args:
        load_motion: of the load in W, a reference (22,); for positions and velocities a state (13,)
            will do.
        *forces: f (n, 3), N, in W, and up to three of its rates.
        attachments: b (n, 3), m, in L.
        rest_length: L₀, m.
        compliance: 1/K_c, m/N.
    """
    load = LoadReference.view(load_motion)
    omega, alpha = load.angular_velocity, load.angular_acceleration
    levers = attachments @ rotation_matrix(load.quaternion).T
    turning = cross(omega, levers)
    of_load = [load.position + levers, load.velocity + turning]
    if len(forces) > 2:
        bending = cross(alpha, levers) + cross(omega, turning)
        of_load.append(load.acceleration + bending)
    if len(forces) > 3:
        of_load.append(load.jerk + 2 * cross(alpha, turning) + cross(omega, bending))
    cables = cable_vectors(forces, rest_length=rest_length, compliance=compliance)
    return [end + cable for end, cable in zip(of_load, cables, strict=False)]


def shifted_reference(
    reference: NDArray, shift: NDArray, load_state: NDArray, *, rates: NDArray
) -> tuple[NDArray, NDArray]:
    """A load's reference (22,) moved by s, at the velocity ṡ = −σ (p − p_d), and ṡ (3,), in W.

    Args:
        reference: of the load, with the desired position p_d.
        shift: s (3,), m.
        load_state: (13,), measured, with the position p.
        rates: σ (3,), rad/s, along the axes of W.
    """
    desired = LoadReference.view(reference)
    shift_rate = rates * (desired.position - LoadState.view(load_state).position)
    moved = desired._replace(
        position=desired.position + shift, velocity=desired.velocity + shift_rate
    )
    return np.concatenate(moved), shift_rate


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
