"""Carriers at the upper ends of bowed cables along an orbit that is planned for straight ones."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.bowed_line import TimeWindow, bowed_lines
from drake_nonstop.mechanics.lumped_cable import CableMaterial
from drake_nonstop.mechanics.planned_orbit import (
    Directions,
    FlightTerms,
    OrbitMotion,
)
from drake_nonstop.mechanics.rotation import cross, rotate_quaternion, rotation_matrix
from drake_nonstop.mechanics.signals import PlannedParameters

_UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])


class CableShape(NamedTuple):
    """Bowed cables as references resolve them; see `mechanics.bowed_line`."""

    nodes: int  # of each cable
    window: TimeWindow  # in which their motion counts
    cable: CableMaterial

    def of_length(self, rest_length: float, compliance: float) -> "CableShape":
        """The same cables with another length in m, and compliance in m/N."""
        cable = self.cable._replace(rest_length=rest_length, stiffness=1 / compliance)
        return self._replace(cable=cable)


class BowedMotion(NamedTuple):
    """Carriers at the upper ends of bowed cables, and these, at k instants, in L."""

    motion: OrbitMotion  # its forces are those that carriers pull with
    nodes: NDArray  # (N, k, n, 3), m, from the attachments
    at_load: NDArray  # (k, n, 3), N, the forces on the load

    @property
    def bows(self) -> NDArray:
        """The largest distances (k, n), m, of nodes from the line between a cable's ends."""
        chords = self.motion.cables
        apart = np.linalg.norm(np.cross(self.nodes, chords), axis=-1).max(axis=0)
        return apart / np.linalg.norm(chords, axis=-1)


def bowed_motion(
    terms: FlightTerms,
    directions: Callable[[NDArray], Directions],
    planned: NDArray,
    shape: CableShape,
    wind: Any = 0.0,
    gusts: Any = 0.0,
    *,
    attachments: NDArray,
    offset: NDArray,
) -> BowedMotion:
    """The carriers' motion where `BowedCarrierTrajectory` has them, at k instants.

    Over the window about each instant the load turns, and what the pattern adds to the forces turns
    with it; all else has two rates, those of the terms, and no third one: the jerk of the load is
    taken as zero. The velocities are through the same air as those of the terms. Own derivation.

    Args:
        terms: at k instants.
        directions: u, u′ and u″ (k, n, 3) at phases (k,), rad.
        planned: (k, 8), `PlannedParameters` at the instants.
        shape: of the cables.
        wind: (k, 1, 3) or what broadcasts to it, m/s, in L, at the load, beyond that of the terms.
        gusts: (k, n, 3), m/s, in L, of the carriers beyond that, less and less towards the load.
        attachments: (n, 3), m, in L.
        offset: (3n,), N, in L, of the pattern.
    """
    times = shape.window.times[:, None]
    plan = PlannedParameters.view(planned[..., None, :])
    count, n, now = len(planned), terms.forces.shape[1], len(times) // 2

    def series(*rates: NDArray) -> NDArray:
        """A value (w, k, ...) over the window that has these rates (k, ...) now, in order."""
        t = times.reshape(-1, *np.ones(rates[0].ndim, int))
        later = (rate * (t**k / math.factorial(k)) for k, rate in enumerate(rates[1:], 1))
        return sum(later, rates[0])

    angle = series(plan.angle, plan.frequency, plan.frequency_rate, plan.frequency_second_rate)
    rates = plan.amplitude_rate, plan.amplitude_second_rate, plan.amplitude_third_rate
    amplitude = series(plan.amplitude, *rates)
    u = directions(angle.ravel())[0].reshape(len(times), count, n, 3)
    omega, alpha = terms.angular_velocity[:, None], terms.angular_acceleration[:, None]
    turn = series(0 * terms.up, terms.angular_velocity, terms.angular_acceleration)
    R_LB = rotation_matrix(rotate_quaternion(_UNTURNED, turn))  # B: L at another instant
    turning = offset.reshape(-1, 3) + amplitude * u
    steady, change = terms.forces - offset.reshape(-1, 3), terms.rates
    steady_rate = change + cross(omega, steady)
    steady_second = terms.second_rates + cross(omega, change + steady_rate) + cross(alpha, steady)
    forces = series(steady, steady_rate, steady_second) + turning @ R_LB.swapaxes(-1, -2)
    swing = cross(omega, attachments)
    velocity = terms.velocities - swing
    acceleration = terms.accelerations - cross(alpha, attachments) - cross(omega, swing)
    levers = attachments @ R_LB.swapaxes(-1, -2) - attachments
    ends = series(0 * velocity, velocity, acceleration) + levers

    def of_each(vectors: Any) -> NDArray:
        return np.broadcast_to(vectors, (count, n, 3)).reshape(-1, 3)

    lines = bowed_lines(
        forces.reshape(len(times), -1, 3),
        ends.reshape(len(times), -1, 3),
        of_each(wind),
        shape.window,
        cable=shape.cable,
        nodes=shape.nodes,
        gusts=of_each(gusts),
        up=of_each(terms.up[:, None]),
    )
    size = count, n, 3
    cables, velocities, accelerations = (
        rate.reshape(size) for rate in shape.window.at_present(lines.ends)[:3]
    )
    pulls, nodes = lines.forces[now].reshape(size), lines.nodes[:, now].reshape(-1, *size)
    return BowedMotion(OrbitMotion(pulls, cables, velocities, accelerations), nodes, forces[now])
