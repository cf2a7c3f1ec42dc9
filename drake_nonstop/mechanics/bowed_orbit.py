"""Carriers at the upper ends of bowed cables along an orbit that is planned for straight ones."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.bowed_line import TimeWindow, bowed_lines, motion_over_window
from drake_nonstop.mechanics.cable import beside_vectors
from drake_nonstop.mechanics.lumped_cable import CableMaterial
from drake_nonstop.mechanics.planned_orbit import FlightTerms, OrbitMotion


class CableShape(NamedTuple):
    """Bowed cables as references resolve them; see `mechanics.bowed_line`."""

    nodes: int  # of each cable
    window: TimeWindow  # in which their motion counts
    cable: CableMaterial

    def of_length(self, rest_length: Any, compliance: Any) -> "CableShape":
        """The same cables with another length in m, and compliance in m/N."""
        own = {"rest_length": rest_length, "stiffness": 1 / compliance}
        columns = {name: beside_vectors(number) for name, number in own.items()}
        return self._replace(cable=self.cable._replace(**columns))


class BowedMotion(NamedTuple):
    """Carriers at the upper ends of bowed cables, and these, at k instants, in W."""

    motion: OrbitMotion  # its forces are those that carriers pull with
    nodes: NDArray  # (N, k, n, 3), m
    ends: NDArray  # (k, n, 3), m, where the cables are attached to the load
    at_load: NDArray  # (k, n, 3), N, the forces on the load

    @property
    def chords(self) -> NDArray:
        """From the attachments to the carriers (k, n, 3), m."""
        return self.motion.positions - self.ends

    @property
    def bows(self) -> NDArray:
        """The largest distances (k, n), m, of nodes from the line between a cable's ends."""
        apart = np.linalg.norm(np.cross(self.nodes - self.ends, self.chords), axis=-1).max(axis=0)
        return apart / np.linalg.norm(self.chords, axis=-1)


def bowed_motion(
    terms: FlightTerms,
    pattern: Callable[..., NDArray],
    planned: NDArray,
    shape: CableShape,
    wind: NDArray,
    gusts: Any = 0.0,
    *,
    attachments: NDArray,
) -> BowedMotion:
    """The carriers' motion where `BowedCarrierTrajectory` has them, at k instants.

    Args:
        terms: at k instants, or at one.
        pattern: the forces (..., n, 3) of the pattern, N, in L, at θ and A (..., 1).
        planned: (k, 8), `PlannedParameters` at the instants.
        shape: of the cables.
        wind: (k, 3) or what broadcasts to it, m/s, in W, at the load.
        gusts: (k, n, 3), m/s, in W, of the carriers beyond that, less and less towards the load.
        attachments: (n, 3), m, in L.
    """
    window, now = shape.window, len(shape.window.times) // 2
    forces, ends = motion_over_window(terms, pattern, planned, window, attachments)
    ends = np.broadcast_to(ends, forces.shape)
    size = forces.shape[1:]

    def of_each(vectors: Any) -> NDArray:
        return np.broadcast_to(vectors, size).reshape(-1, 3)

    lines = bowed_lines(
        forces.reshape(len(forces), -1, 3),
        ends.reshape(len(forces), -1, 3),
        of_each(wind[..., None, :]),
        window,
        cable=shape.cable.repeated(size[0]),
        nodes=shape.nodes,
        gusts=of_each(gusts),
    )
    motion = [rate.reshape(size) for rate in window.at_present(lines.ends)[:3]]
    pulls, nodes = lines.forces[now].reshape(size), lines.nodes[:, now].reshape(-1, *size)
    return BowedMotion(OrbitMotion(pulls, *motion), nodes, ends[now], forces[now])
