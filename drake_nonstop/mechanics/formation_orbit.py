"""The orbits of n like carriers above a load that is level, moves without turning, or co-rotates.

The attachments are a regular polygon about the load's centre of mass. Then a force on the load
shares out evenly over the cables, and the motion of each carrier follows from its azimuth and its
phase alone, without the grasp matrix.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.load_motion import LoadMotion
from drake_nonstop.mechanics.planned_orbit import FlightTerms, OrbitMotion, orbit_motion
from drake_nonstop.mechanics.taylor import Taylor

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
    """The motion (k, 3) through the air of carriers at azimuths ψ and phases φ (k,) each, rad.

    In W's axes, from the load's centre of mass on.

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
    cosine, sine = np.cos(azimuths)[:, None], np.sin(azimuths)[:, None]
    zero = 0 * cosine
    outward = np.concatenate([cosine, sine, zero], axis=1)
    onward = np.concatenate([-sine, cosine, zero], axis=1)
    velocity = Taylor.of_rates(air_velocity, acceleration, jerk, snap)
    turn = Taylor([shape.yaw_rate * _UP, _NONE])
    motion = LoadMotion.of(np.eye(4)[0], velocity.integral(_NONE), turn)
    pull = load.mass * (velocity.rate() + load.gravity * _UP) + load.drag * velocity
    shared = np.hstack([np.zeros((3, 3)), np.eye(3)]) / load.carriers
    terms = FlightTerms(
        motion,
        0.0 * pull,
        pull,
        np.tile(shared, (len(azimuths), 1)),
        (shape.spread * outward).ravel(),
    )
    phase = Taylor([phases[:, None], shape.frequency + zero, zero])
    swing = np.cos(phase) * (shape.radial * outward - shape.vertical * _UP)
    swing = swing + np.sin(phase) * (shape.tangential * onward)
    cables = {"rest_length": shape.cable_length, "compliance": load.compliance}
    return orbit_motion(terms, swing, attachments=load.radius * outward, **cables)
