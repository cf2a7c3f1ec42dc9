"""The orbits of n like carriers above a load that is level, moves without turning, or co-rotates.

The attachments are a regular polygon about the load's centre of mass. Then a force on the load
shares out evenly over the cables, and the motion of each carrier follows from its azimuth and its
phase alone: in closed form, without the grasp matrix.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.carrier import carrier_acceleration, carrier_motion
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

    and with its two rates `carrier_motion` and `carrier_acceleration` follow: F changes with the
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
    rate, turn = shape.frequency, shape.yaw_rate

    along, along_rate = shape.spread + shape.radial * cosine, -rate * shape.radial * sine
    across, across_rate = shape.tangential * sine, rate * shape.tangential * cosine
    along_second, across_second = -rate * rate * shape.radial * cosine, -rate * rate * across
    lift = shape.vertical * cosine
    held = load.mass * (load.gravity * _UP + acceleration) + load.drag * air_velocity
    held_rate = load.mass * jerk + load.drag * acceleration
    held_second = load.mass * snap + load.drag * jerk
    forces = held / load.carriers + along * outward + across * onward - lift * _UP
    rates = (
        held_rate / load.carriers
        + (along_rate - turn * across) * outward
        + (across_rate + turn * along) * onward
        + rate * shape.vertical * sine * _UP
    )
    second_rates = (
        held_second / load.carriers
        + (along_second - 2 * turn * across_rate - turn * turn * along) * outward
        + (across_second + 2 * turn * along_rate - turn * turn * across) * onward
        + rate * rate * lift * _UP
    )
    still = np.eye(POSE_SIZE)[0]
    rest = np.zeros(LOAD_REFERENCE_SIZE - POSE_SIZE - 3)
    reference = np.concatenate([still, turn * _UP, rest])
    cables: dict[str, Any] = {
        "attachments": load.radius * outward,
        "rest_length": shape.cable_length,
        "compliance": load.compliance,
    }
    positions, velocities = carrier_motion(reference, forces, rates, **cables)
    own = carrier_acceleration(reference, forces, rates, second_rates, **cables)
    return CarrierMotion(positions, velocities, own + acceleration, forces)
