"""Carriers along an orbit: their motion, and what aircraft need for it.

The orbit above a moving load is flown at a phase θ, with ξ and A that change. In two steps, each
usable alone and of numbers or symbols:

- `FlightTerms.along` (a load's motion given), `flight_terms` (and a wrench) or `turning_terms`:
  what carriers depend on besides phase, ξ and A;
- `orbit_motion`: with these and the series of the pattern's forces, see `internal_force`, the
  carriers' motion and their cables' forces; then `squared_gaps` and `needs_of_motion`.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import Aircraft, FlightNeeds, flight_needs, needed_force
from drake_nonstop.mechanics.carrier import carrier_positions
from drake_nonstop.mechanics.load_motion import LoadMotion, in_axes, torque_and_force
from drake_nonstop.mechanics.rigid_load import STILL_AIR, RigidLoad
from drake_nonstop.mechanics.rotation import quaternion_product, rotation_matrix
from drake_nonstop.mechanics.signals import LoadReference, Wrench
from drake_nonstop.mechanics.taylor import Quantity, Taylor

_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class FlightTerms:
    """What carriers depend on besides θ, ξ and A: series, or arrays of values."""

    motion: LoadMotion  # of the load
    torque: Quantity  # (..., 3), N m, that moves it, in L
    force: Quantity  # (..., 3), N, in W
    pseudo_inverse: NDArray  # (3n, 6), in L
    offset: NDArray  # (3n,), N, of the pattern, in L

    @classmethod
    def along(
        cls, load: RigidLoad, motion: LoadMotion, wind: NDArray = STILL_AIR, **distribution: NDArray
    ) -> "FlightTerms":
        """The terms of a load that moves so, in a steady wind (..., 3), m/s, in W.

        With the `pseudo_inverse` and the `offset`.
        """
        return cls(motion, *torque_and_force(load, motion, wind), **distribution)

    @cached_property
    def forces(self) -> Quantity:
        """The cables' forces without λ (..., n, 3), N, in L."""
        force = in_axes(self.force, self.motion.axes)
        stacked = np.concatenate([self.torque, force], axis=-1) @ self.pseudo_inverse.T
        return (stacked + self.offset).reshape(*stacked.shape[:-1], -1, 3)

    def over(self, times: NDArray) -> "FlightTerms":
        """The terms at times (k,), s, from the present on: arrays (k, ...) in place of series."""
        values = self.motion.over(times), self.torque.over(times), self.force.over(times)
        return FlightTerms(*values, self.pseudo_inverse, self.offset)


class OrbitMotion(NamedTuple):
    """The motion of n carriers at k instants, (k, n, 3) each, in W."""

    forces: NDArray  # N, of the cables on the load
    positions: NDArray  # m
    velocities: NDArray  # m/s
    accelerations: NDArray  # m/s²


def flight_terms(
    reference: NDArray, wrench: NDArray, wrench_rate: NDArray, **distribution: NDArray
) -> FlightTerms:
    """The terms of a load with a given motion and wrench, at one instant or more.

    Args:
        reference: (..., 22), the motion with its accelerations.
        wrench: (..., 6), in W, and its rate, which stays.
        wrench_rate: (..., 6).
        **distribution: `pseudo_inverse` and `offset` of `FlightTerms`.
    """
    motion, none = LoadMotion.along(reference), 0 * wrench_rate[..., :3]
    vectors = zip(*map(Wrench.view, (wrench, wrench_rate)), strict=True)
    torque, force = (Taylor([value, rate, none]) for value, rate in vectors)
    return FlightTerms(motion, in_axes(torque, motion.axes), force, **distribution)


def turning_terms(
    motion: NDArray,
    wrench: NDArray,
    wrench_rate: NDArray,
    rates: NDArray,
    angles: NDArray,
    **distribution: NDArray,
) -> FlightTerms:
    """The terms of a load that turns about the vertical with its carriers, at k rates and angles.

    They are `flight_terms` of the motion with another yaw and yaw rate, at a constant force in W
    but for its rate, and a constant torque in L. With A = 0, which does not count, the motion
    then is that of aircraft that keep their places above the load; the squared airspeed is
    quadratic in the rate. Own derivation.

    Args:
        motion: (22,), of the load, such as a reference.
        wrench: (6,), in W.
        wrench_rate: (6,), of which that of the force counts.
        rates: (k,), rad/s, of the turn.
        angles: (k,), rad, by which the load has turned on from its present yaw.
        **distribution: `pseudo_inverse` and `offset` of `FlightTerms`.
    """
    moving = LoadMotion.along(turned_motions(motion, rates, angles))
    R_LW = rotation_matrix(LoadReference.view(motion).quaternion).T
    (torque, force), (_, force_rate) = map(Wrench.view, (wrench, wrench_rate))
    along = np.ones((len(rates), 1))
    kept, none = along * (R_LW @ torque), 0 * along * torque
    pull = Taylor([along * force, along * force_rate, none])
    return FlightTerms(moving, Taylor([kept, none, none]), pull, **distribution)


def turned_motions(motion: NDArray, rates: NDArray, angles: NDArray) -> NDArray:
    """The motions (k, 22) of a load at other yaws that turns steadily about the vertical."""
    half, zero = angles[:, None] / 2, np.zeros((len(angles), 1))
    moved = np.tile(motion, (len(angles), 1))
    own = LoadReference.view(moved)
    turn = np.concatenate([np.cos(half), zero, zero, np.sin(half)], axis=1)
    own.quaternion[:] = quaternion_product(turn, own.quaternion)
    own.angular_velocity[:], own.angular_acceleration[:] = rates[:, None] * _UP, 0.0
    return moved


def orbit_motion(
    terms: FlightTerms,
    pattern: Quantity,
    *,
    attachments: NDArray,
    rest_length: Any,
    compliance: Any,
) -> OrbitMotion:
    """The carriers' motion at k instants, of numbers or symbols.

    Args:
        terms: at k instants, or at one.
        pattern: series of the forces (k, n, 3) of the pattern, N, in L; 0: there are none.
        attachments: (n, 3), m, in L.
        rest_length: L₀, m, one for all or (n,).
        compliance: 1/K_c, m/N, likewise.
    """
    forces = terms.forces + pattern
    cables = {"rest_length": rest_length, "compliance": compliance, "attachments": attachments}
    positions = carrier_positions(terms.motion, forces, **cables)
    at_load = forces.coefficients[0] @ terms.motion.axes.coefficients[0]
    return OrbitMotion(at_load, *positions.truncated(2).rates)


def squared_gaps(places: NDArray, pairs: NDArray) -> NDArray:
    """The squared distances (..., m), m², between `places` (..., n, 3), m, of `pairs` (2, m)."""
    first, second = pairs
    gaps = places[..., first, :] - places[..., second, :]
    return (gaps * gaps).sum(axis=-1)


def needs_of_motion(
    aircraft: Aircraft, motion: OrbitMotion, wind: NDArray | float = 0.0
) -> FlightNeeds:
    """Needs of aircraft for this motion in a wind (..., 3), m/s, in W."""
    force = needed_force(aircraft, motion.accelerations, motion.forces)
    return flight_needs(aircraft, force, motion.velocities - wind)
