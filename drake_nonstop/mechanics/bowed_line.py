"""Bowed lines: where carriers have to be, and how they have to pull, on cables with mass and drag.

The paper's eq. 1 for the cables of `mechanics.lumped_cable`, as an initial value problem from the
load up. The lowest segment pulls with the desired force on the load; each node's balance gives the
pull of the segment above it, with the segment's share σ_k of the cable,

    p_k = p_{k−1} + σ_k (L₀ + ‖f_k‖/K) f_k/‖f_k‖,   f_{k+1} = f_k + m_k (p̈_k + g e₃) − d_k,

and where the last segment ends the carrier has to be, and pulls with its force. Without mass and
drag it is eq. 1. The nodes' velocities and accelerations are those of the shape itself, over a
short window of time: each node is known at a few instants, and derived as the polynomial through
these. So every node's motion is known before that of the next one, and nothing is iterated but the
direction of a segment in the drag of the node below it.

With drag this is a heat equation that is solved sideways: fast motion is amplified on its way up,
as exp √(ω b/(2 T)) per length with the frequency ω and the drag b per length and speed. A finer
window, or derivatives of what is not smooth, therefore does harm; a polynomial does not.

Own derivation.
"""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from drake_nonstop.mechanics.lumped_cable import CableMaterial, node_drag, segment_shares
from drake_nonstop.mechanics.planned_orbit import FlightTerms
from drake_nonstop.mechanics.rotation import norm
from drake_nonstop.mechanics.signals import PlannedParameters

_UP = np.array([0.0, 0.0, 1.0])
_FORCE_STEP = 1e-5  # N and N/s, of differences
_MOST = 0.25  # of a pull, by which it changes at once: bow grows faster the less it is
_CLOSE = 1e-9  # m and m/s, of an end that is reached
_ITERATIONS = 15
_PASSES = 1  # of a segment's direction: leaves 2 mm on 12 nodes, a second one 0.02 mm


class TimeWindow(NamedTuple):
    """An odd number k of instants about the present, and rates of the polynomial through them."""

    times: NDArray  # (k,), s, Chebyshev's instants, the present in the middle
    present: NDArray  # (4, k), from values to the present one and its first three rates
    derived: NDArray  # (2, k, k), to the first and second rates at all instants, 1/s and 1/s²

    @classmethod
    def of(cls, span: float, count: int) -> "TimeWindow":
        """`count` instants within ±`span` s."""
        points = np.sin(np.pi / 2 * np.arange(1 - count, count, 2) / count)
        values = np.linalg.inv(chebyshev.chebvander(points, count - 1))

        def derived(order: int, at: NDArray) -> NDArray:
            coefficients = chebyshev.chebder(np.eye(count), order) / span**order
            return chebyshev.chebvander(at, count - 1 - order) @ coefficients @ values

        present = np.array([derived(order, np.zeros(1))[0] for order in range(4)])
        return cls(span * points, present, np.stack([derived(order, points) for order in (1, 2)]))

    def rates(self, values: NDArray) -> tuple[NDArray, NDArray]:
        """First and second rates (k, n, 3) of values (k, n, 3) at all instants."""
        flat = values.reshape(len(values), -1)
        first, second = ((rows @ flat).reshape(values.shape) for rows in self.derived)
        return first, second

    def at_present(self, values: NDArray) -> list[NDArray]:
        """The present value and its first three rates, each (n, 3), of values (k, n, 3)."""
        rates = self.present @ values.reshape(len(values), -1)
        return [rate.reshape(values.shape[1:]) for rate in rates]


class BowedLines(NamedTuple):
    """Lines of N nodes over k instants, each array (..., k, n, 3), in W."""

    nodes: NDArray  # (N, k, n, 3), m
    ends: NDArray  # m, where the carriers are
    forces: NDArray  # N, that they pull with


def bowed_lines(
    forces: NDArray,
    attachments: NDArray,
    wind: NDArray,
    window: TimeWindow,
    *,
    cable: CableMaterial,
    nodes: int,
    gusts: NDArray | float = 0.0,
) -> BowedLines:
    """The lines that pull with these forces, over the instants of a window.

    Args:
        forces: f (k, n, 3), N, on the load, in W.
        attachments: (k, n, 3), m, in W.
        wind: (3,), m/s, in W, at the load.
        window: the k instants.
        cable: what the lines are made of; their damping is not counted.
        nodes: N, at least 1.
        gusts: (n, 3), m/s, in W, of the carriers beyond that wind, less and less towards the load.
    """
    shares, mass = segment_shares(nodes)[:, 0, 0], cable.mass / nodes
    point, force, change, bend = attachments, forces, 0.0 * forces, 0.0 * forces
    segment = _segment(force, shares[0], cable)
    found = []
    for place, (below, above) in zip(np.cumsum(shares), itertools.pairwise(shares), strict=False):
        point = point + segment
        found.append(point)
        velocity, acceleration = window.rates(point)
        past = wind + place * gusts - velocity
        without_drag = force + mass * (acceleration + cable.gravity * _UP)
        next_force = force + change + bend
        for _ in range(_PASSES):
            upper = _segment(next_force, above, cable)
            drag = node_drag(past, segment, upper, above / below, cable, nodes)
            next_force = without_drag - drag
        last_change, change, force = change, next_force - force, next_force
        # The first change has none before it to be compared with.
        bend = change - last_change if len(found) > 1 else bend
        segment = _segment(force, above, cable)
    return BowedLines(np.stack(found), point + segment, force)


def lines_between(
    forces: NDArray,
    attachments: NDArray,
    ends: NDArray,
    wind: NDArray,
    window: TimeWindow,
    *,
    cable: CableMaterial,
    nodes: int,
    gusts: NDArray,
) -> tuple[NDArray, NDArray] | None:
    """Positions and velocities (N, n, 3), m and m/s, of the nodes of lines to given ends.

    A constant force and one that grows with time are added to each line's pull on the load, such
    that it ends where its carrier is, as fast: Newton's method. None: it finds no such forces.

    Args:
        forces: (k, n, 3), N, about what the lines pull with on the load, in W.
        attachments: (k, n, 3), m, in W.
        ends: positions and velocities (2, n, 3), m and m/s, of the carriers at present.
        wind: (3,), m/s, in W, at the load.
        window: the k instants.
        cable: what the lines are made of.
        nodes: N, at least 1.
        gusts: (n, 3), m/s, in W, of the carriers beyond that wind.
    """
    n = len(ends[0])
    in_time = np.stack([np.ones(len(window.times)), window.times])
    added = np.zeros((n, 6))  # N and N/s
    tried = np.concatenate([np.zeros((1, 6)), _FORCE_STEP * np.eye(6)])  # all of them at once
    many = len(tried)
    for _ in range(_ITERATIONS):
        more = (added + tried[:, None]).reshape(many, n, 2, 3)
        pulls = forces[:, None] + np.einsum("rk,mnrc->kmnc", in_time, more)
        with np.errstate(all="ignore"):
            lines = bowed_lines(
                pulls.reshape(len(in_time[0]), -1, 3),
                np.tile(attachments, (1, many, 1)),
                wind,
                window,
                cable=cable.repeated(many),
                nodes=nodes,
                gusts=np.tile(gusts, (many, 1)),
            )
            motion = np.stack(window.at_present(lines.ends)[:2]).reshape(2, many, n, 3)
        reached = motion.transpose(2, 0, 3, 1).reshape(n, 6, many)
        if not np.all(np.isfinite(reached)):
            return None
        missing = ends.transpose(1, 0, 2).reshape(n, 6) - reached[..., 0]
        if np.max(np.abs(missing)) < _CLOSE:
            found = [window.at_present(node[:, :n])[:2] for node in lines.nodes]
            positions, velocities = zip(*found, strict=True)
            return np.stack(positions), np.stack(velocities)
        slopes = (reached[..., 1:] - reached[..., :1]) / _FORCE_STEP
        step = (np.linalg.pinv(slopes) @ missing[..., None])[..., 0]
        present = forces[len(forces) // 2] + added[:, :3]
        share = np.linalg.norm(step[:, :3], axis=1) / np.linalg.norm(present, axis=1)
        added = added + step / np.maximum(1.0, share / _MOST)[:, None]
    return None


def motion_over_window(
    terms: FlightTerms,
    pattern: Callable[..., NDArray],
    planned: NDArray,
    window: TimeWindow,
    attachments: NDArray,
) -> tuple[NDArray, NDArray]:
    """Cable forces on a load, N, and its attachments, m, (k, ..., n, 3) each, in W, over a window.

    The load follows the series of its motion, θ, ξ and A those of their plan.

    Args:
        terms: at the present, or at several instants (...,).
        pattern: the forces (..., n, 3) of the pattern, N, in L, at θ and A (..., 1).
        planned: (..., 8), `PlannedParameters`.
        window: the k instants.
        attachments: (n, 3), m, in L.
    """
    later = terms.over(window.times)
    angle, amplitude = (part.over(window.times) for part in PlannedParameters.view(planned).series)
    forces = later.forces + pattern(angle, amplitude)
    return forces @ later.motion.axes, later.motion.attached(attachments)


def with_feedback(window: TimeWindow, along: NDArray, forces: NDArray, rates: NDArray) -> NDArray:
    """Forces (k, n, 3), N, over a window, of which the present ones are known, and their rates.

    What these have beyond the forces `along` a reference goes on at the present rate.
    """
    present, present_rate, *_ = window.at_present(along)
    return along + (forces - present) + window.times[:, None, None] * (rates - present_rate)


def _segment(force: NDArray, share: float, cable: CableMaterial) -> NDArray:
    """From one end of a segment to the other, m."""
    return share * (cable.rest_length / norm(force) + 1 / cable.stiffness) * force
