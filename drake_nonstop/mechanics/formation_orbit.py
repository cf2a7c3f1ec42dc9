"""The orbits of n like carriers above a load that is level, moves without turning, or co-rotates.

The attachments are a regular polygon about the load's centre of mass. Then a force on the load
shares out evenly over the cables, and the motion of each carrier follows from its azimuth and its
phase alone, without the grasp matrix.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.planned_orbit import (
    FlightTerms,
    OrbitMotion,
    PlannedOrbit,
    flight_terms,
    orbit_directions,
    orbit_motion,
)
from drake_nonstop.mechanics.signals import POSE_SIZE

_UP = np.array([0.0, 0.0, 1.0])
_NONE = np.zeros(3)


class FormationShape(NamedTuple):
    """Variables of a formation: the sizes of its forces, its rates, and the cables' length.

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
) -> OrbitMotion:
    """The motion (k, 3) of carriers at azimuths ψ and phases φ (k,) each, rad, in W's axes.

    With the outward r = (cos ψ, sin ψ, 0) and the tangential t = e₃ × r, of ψ̇ = Ω and φ̇, a cable
    pulls with

        f = F/n + (C + A_r cos φ) r + A_t sin φ t − B cos φ e₃,
        F = M (g e₃ + p̈_L) + B_L (ṗ_L − w),

    where F changes with the load's acceleration, jerk and snap, in a constant wind. The rest has no
    wrench where φ_i = θ + κ β_i with a κ that suits n, see `EllipticCarouselConfig`; carrier i is
    at ψ = β_i = 2π i/n + Ω t.

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
    count, cosine, sine = len(azimuths), np.cos(azimuths)[:, None], np.sin(azimuths)[:, None]
    zero = 0 * cosine
    outward = np.concatenate([cosine, sine, zero], axis=1)
    onward = np.concatenate([-sine, cosine, zero], axis=1)
    pulls = (
        load.mass * (load.gravity * _UP + acceleration) + load.drag * air_velocity,
        load.mass * jerk + load.drag * acceleration,
        load.mass * snap + load.drag * jerk,
    )
    level, omega = np.eye(POSE_SIZE)[0], shape.yaw_rate * _UP
    motion = np.concatenate([level, omega, air_velocity, _NONE, acceleration, jerk])
    even = np.hstack([np.zeros((3, 3)), np.eye(3) / load.carriers])
    terms = flight_terms(
        motion,
        motion,
        *(np.concatenate([_NONE, pull]) for pull in pulls),
        pseudo_inverse=np.tile(even, (count, 1)),
        offset=(shape.spread * outward).ravel(),
        attachments=load.radius * outward,
    )
    axes = shape.radial * outward - shape.vertical * _UP, shape.tangential * onward
    of_each = orbit_directions((axes[0][:, None], axes[1][:, None]), phases)
    u, along, bending = (direction.swapaxes(0, 1) for direction in of_each)
    found = orbit_motion(
        FlightTerms(*(part[None] for part in terms)),
        (u, along, bending),
        PlannedOrbit.constant(np.zeros(1), shape.frequency, 1.0),
        rest_length=shape.cable_length,
        compliance=load.compliance,
    )
    return OrbitMotion(*(part[0] for part in found))
