"""The orbits of carriers above a load that rests, or turns about the vertical at a constant rate.

Position, velocity and acceleration are exact: all forces, and with them the carriers' motion, are
known functions of the time.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.carrier import carrier_acceleration, carrier_motion
from drake_nonstop.mechanics.internal_force import internal_force, internal_force_acceleration
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.rotation import cross, rotation_matrix
from drake_nonstop.mechanics.signals import LoadReference, Parameters, Pose, resting_reference


class CarrierOrbits(NamedTuple):
    """The motion of n carriers, and their cables, at k instants, in W."""

    positions: NDArray  # (k, n, 3), m
    velocities: NDArray  # (k, n, 3), m/s
    accelerations: NDArray  # (k, n, 3), m/s²
    cable_forces: NDArray  # (k, n, 3), N, of the cables on the load
    cable_ends: NDArray  # (k, n, 3), m, at the load


def resting_orbits(
    load: RigidLoad,
    pose: NDArray,
    times: NDArray,
    parameters: NDArray,
    *,
    yaw_rate: float,
    load_wind: NDArray,
    attachments: NDArray,
    pseudo_inverse: NDArray,
    basis: NDArray,
    phases: NDArray,
    orders: NDArray,
    offset: NDArray,
    rest_length: float,
    compliance: float,
) -> CarrierOrbits:
    """The carriers' motion at `times` (k,), s, with the phase θ = ξ t, above a resting load.

    The load turns about the vertical through its centre of mass at the constant rate Ω and rests
    otherwise, R = R_z(Ω t) R₀. With w the wind at the load, the cables hold it against its weight
    and the wind's drag, F = m g e₃ − B_L w in W, and in the load's frame, with ω = R₀ᵀ Ω e₃,

        ᴸf = G₀† [ω × J ω + C_L ω; RᵀF] + f̃⁰ + N₀ λ,   d(RᵀF)/dt = −ω × RᵀF,
        ḟ = ᴸḟ + ω × ᴸf,   f̈ = ᴸf̈ + 2 ω × ᴸḟ + ω × (ω × ᴸf).

    The carriers' motion follows by `carrier_motion` and `carrier_acceleration`. Own derivation.

    Args:
        load: the load.
        pose: of the load at t = 0 in W (7,), or what begins with one.
        times: s.
        parameters: [ξ (rad/s), A (N)] (2,).
        yaw_rate: Ω, rad/s.
        load_wind: w (3,), m/s, in W.
        attachments: b (n, 3), m, in L.
        pseudo_inverse: G₀† (3n, 6), in L.
        basis: N₀ (3n, m), in L.
        phases: φ (m,), rad.
        orders: h (m,), of the harmonics.
        offset: f̃⁰ (3n,), N, in L.
        rest_length: L₀ of the cables, m.
        compliance: 1/K_c of the cables, m/N.
    """
    count, n = len(times), len(attachments)
    start = rotation_matrix(Pose.view(pose).quaternion)
    cosine, sine, zero = np.cos(yaw_rate * times), np.sin(yaw_rate * times), 0 * times
    yawed = np.stack([cosine, -sine, zero, sine, cosine, zero, zero, zero, zero + 1], axis=-1)
    R_WL = yawed.reshape(count, 3, 3) @ start
    omega = start.T @ np.array([0.0, 0.0, yaw_rate])

    weight = load.mass * load.gravity * np.array([0.0, 0.0, 1.0])
    held = (weight - load.drag * load_wind) @ R_WL  # (k, 3), in L
    held_rate = -cross(omega, held)
    torque = cross(omega, load.inertia @ omega) + load.angular_drag * omega
    frequency = Parameters.view(parameters).frequency
    values, rates = internal_force(
        parameters, frequency * times[:, None], phases=phases, orders=orders
    )
    second_rates = internal_force_acceleration(
        parameters, np.concatenate([values, rates], axis=-1), orders=orders
    )

    def in_cables(torque: NDArray, force: NDArray, internal: NDArray) -> NDArray:
        """The forces (k, n, 3) in L, or their rates."""
        wrench = np.concatenate([np.broadcast_to(torque, force.shape), force], axis=-1)
        return (wrench @ pseudo_inverse.T + internal @ basis.T).reshape(count, n, 3)

    none = np.zeros(3)
    forces = in_cables(torque, held, values) + offset.reshape(n, 3)
    rates_L = in_cables(none, held_rate, rates)
    second_rates_L = in_cables(none, -cross(omega, held_rate), second_rates)
    turning = cross(omega, forces)
    force_rates = rates_L + turning
    force_second_rates = second_rates_L + 2 * cross(omega, rates_L) + cross(omega, turning)

    # In axes that coincide with the load's, all instants as so many carriers.
    motion = resting_reference()
    LoadReference.view(motion).angular_velocity[:] = omega
    cables: dict[str, Any] = {
        "attachments": np.tile(attachments, (count, 1)),
        "rest_length": rest_length,
        "compliance": compliance,
    }
    flat = [part.reshape(-1, 3) for part in (forces, force_rates, force_second_rates)]
    positions, velocities = carrier_motion(motion, *flat[:2], **cables)
    accelerations = carrier_acceleration(motion, *flat, **cables)

    def in_world(vectors: NDArray) -> NDArray:
        return vectors.reshape(count, n, 3) @ R_WL.swapaxes(1, 2)

    origin = Pose.view(pose).position
    return CarrierOrbits(
        positions=origin + in_world(positions),
        velocities=in_world(velocities),
        accelerations=in_world(accelerations),
        cable_forces=in_world(forces),
        cable_ends=origin + in_world(cables["attachments"]),
    )
