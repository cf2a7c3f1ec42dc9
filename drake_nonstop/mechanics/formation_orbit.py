"""The orbits of n like carriers above a load that is level, moves without turning, or co-rotates.

The attachments are a regular polygon about the load's centre of mass. Then a force on the load
shares out evenly over the cables, and the motion of each carrier follows from its azimuth and its
phase alone: in closed form, without the grasp matrix.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.mechanics.rotation import components, cross
from drake_nonstop.mechanics.signals import LOAD_REFERENCE_SIZE, POSE_SIZE

_UP = np.array([0.0, 0.0, 1.0])
_NONE = np.zeros(3)


class FormationShape(NamedTuple):
    """What a formation can choose: the sizes of its forces, its rates, and the cables' length.

    Numbers may be arrays (1,), also of symbols.
    """

    spread: float | NDArray  # C, N
    radial: float | NDArray  # A_r, N
    tangential: float | NDArray  # A_t, N
    vertical: float | NDArray  # B, N
    frequency: float | NDArray  # φ̇, rad/s
    yaw_rate: float | NDArray  # Ω, rad/s, of a load that turns with its carriers
    cable_length: float | NDArray  # m, unstretched


class CarriedLoad(NamedTuple):
    """The load, and the cables between it and its n carriers; numbers may be arrays (1,)."""

    mass: float | NDArray  # kg
    drag: float | NDArray  # N s/m
    gravity: float | NDArray  # m/s²
    carriers: int  # n
    radius: float | NDArray  # b, m, of the attachments
    compliance: float | NDArray  # 1/K_c, m/N


class CarrierMotion(NamedTuple):
    """The motion of carriers at k pairs of azimuth and phase, in axes of W that move with the load.

    Velocities are those beside the load's; accelerations are whole.
    """

    positions: NDArray  # (k, 3), m
    velocities: NDArray  # (k, 3), m/s
    accelerations: NDArray  # (k, 3), m/s²
    cable_forces: NDArray  # (k, 3), N, on the load


def carrier_orbit(
    shape: FormationShape,
    load: CarriedLoad,
    azimuths: NDArray,
    phases: NDArray,
    *,
    air_velocity: NDArray,
    acceleration: NDArray,
    jerk: NDArray = _NONE,
    snap: NDArray = _NONE,
) -> CarrierMotion:
    """The carriers' motion at azimuths ψ and phases φ (k,) each, rad.

    With the outward r = (cos ψ, sin ψ, 0) and the tangential t = e₃ × r, of ψ̇ = Ω and φ̇, a cable
    pulls with

        f = F/n + (C + A_r cos φ) r + A_t sin φ t − B cos φ e₃,
        F = M (g e₃ + p̈_L) + B_L (ṗ_L − w),

    and with its two rates `carrier_motion` follows: F changes with the
    load's acceleration, jerk and snap, in a constant wind. The forces beside F/n have no wrench
    where φ_i = θ + κ β_i with a κ that suits n, see `EllipticCarouselConfig`; carrier i is at
    ψ = β_i = 2π i/n + Ω t.

    Args:
        shape: of the formation.
        load: the load.
        azimuths: ψ.
        phases: φ.
        air_velocity: ṗ_L − w (3,), m/s, in W.
        acceleration: p̈_L (3,), m/s², in W.
        jerk: of the load (3,), m/s³, in W.
        snap: of the load (3,), m/s⁴, in W.
    """
    cosine, sine = np.cos(azimuths)[:, None], np.sin(azimuths)[:, None]
    zero = 0 * cosine
    outward = np.concatenate([cosine, sine, zero], axis=1)
    onward = np.concatenate([-sine, cosine, zero], axis=1)
    cosine, sine = np.cos(phases)[:, None], np.sin(phases)[:, None]
    # The parts along r, t and e₃, and their rates as these turn.
    rate, omega = shape.frequency, shape.yaw_rate * _UP
    swing = np.concatenate(
        [shape.radial * cosine, shape.tangential * sine, -shape.vertical * cosine], axis=1
    )
    swing_rate = rate * np.concatenate(
        [-shape.radial * sine, shape.tangential * cosine, shape.vertical * sine], axis=1
    )
    pull = swing + shape.spread * np.array([1.0, 0.0, 0.0])
    pull_rate = swing_rate + cross(omega, pull)
    pull_second_rate = cross(omega, swing_rate) + cross(omega, pull_rate) - rate * rate * swing
    held = (
        load.mass * (load.gravity * _UP + acceleration) + load.drag * air_velocity,
        load.mass * jerk + load.drag * acceleration,
        load.mass * snap + load.drag * jerk,
    )
    forces = [
        part / load.carriers + x * outward + y * onward + z * _UP
        for part, (x, y, z) in zip(
            held, map(components, (pull, pull_rate, pull_second_rate)), strict=True
        )
    ]
    still = np.eye(POSE_SIZE)[0]
    rest = np.zeros(LOAD_REFERENCE_SIZE - POSE_SIZE - 3)
    positions, velocities, own = carrier_motion(
        np.concatenate([still, omega, rest]),
        *forces,
        attachments=load.radius * outward,
        rest_length=shape.cable_length,
        compliance=load.compliance,
    )
    return CarrierMotion(positions, velocities, own + acceleration, forces[0])
