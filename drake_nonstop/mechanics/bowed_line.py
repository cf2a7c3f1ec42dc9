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
import math
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from drake_nonstop.mechanics.grasp import wrenches_along
from drake_nonstop.mechanics.lumped_cable import CableMaterial, node_drag, segment_shares
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.rotation import cross, norm, rotate_quaternion, rotation_matrix
from drake_nonstop.mechanics.signals import LoadReference, PlannedParameters, ReferenceHigherRates

_UP = np.array([0.0, 0.0, 1.0])
_FORCE_STEP = 1e-5  # N and N/s, of differences
_CLOSE = 1e-9  # m and m/s, of an end that is reached
_ITERATIONS = 15
_PASSES = 1  # of a segment's direction: leaves 2 mm on 12 nodes, a second one 0.02 mm


class TimeWindow(NamedTuple):
    """An odd number k of instants about the present, and rates of the polynomial through them.

    The instants are Chebyshev's, symmetric about the present. Matrices of derivatives therefore are
    given for sums and differences of values at opposite instants, which halves the arithmetic.
    """

    times: NDArray  # (k,), s, the present in the middle
    present: NDArray  # (4, k), from values to the present one and its first three rates
    of_sums: tuple[NDArray, NDArray]  # first and second, 1/s and 1/s², of the later half
    of_differences: tuple[NDArray, NDArray]

    @classmethod
    def of(cls, span: float, count: int) -> "TimeWindow":
        """`count` instants within ±`span` s."""
        points = np.sin(np.pi / 2 * np.arange(1 - count, count, 2) / count)
        values = np.linalg.inv(chebyshev.chebvander(points, count - 1))

        def derived(order: int, at: NDArray) -> NDArray:
            coefficients = chebyshev.chebder(np.eye(count), order) / span**order
            return chebyshev.chebvander(at, count - 1 - order) @ coefficients @ values

        half = count // 2
        later = [derived(order, points[half:]) for order in (1, 2)]
        ahead, behind = zip(*((d[:, half:], d[:, half::-1]) for d in later), strict=True)
        present = np.array([derived(order, np.zeros(1))[0] for order in range(4)])
        # With v(−t) = s − d and v(t) = s + d, where the present one counts once.
        share = np.where(np.arange(half + 1) == 0, 0.5, 1.0)
        sums = tuple((a + b) * share for a, b in zip(ahead, behind, strict=True))
        differences = tuple((a - b)[:, 1:] for a, b in zip(ahead, behind, strict=True))
        return cls(span * points, present, sums, differences)

    def rates(self, values: NDArray) -> tuple[NDArray, NDArray]:
        """First and second rates (k, n, 3) of values (k, n, 3) at all instants."""
        half = len(self.times) // 2
        ahead, behind = (v.reshape(half + 1, -1) for v in (values[half:], values[half::-1]))
        sums, differences = (ahead + behind) / 2, ((ahead - behind) / 2)[1:]
        found = []
        for order, (of_sums, of_differences) in enumerate(
            zip(self.of_sums, self.of_differences, strict=True)
        ):
            even, odd = of_sums @ sums, of_differences @ differences
            if order == 0:  # the rate of what is even is odd
                even, odd = odd, even
            found.append(np.concatenate([(even - odd)[:0:-1], even + odd]).reshape(values.shape))
        return found[0], found[1]

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
    up: NDArray = _UP,
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
        up: e₃ (3,), where all vectors are those of another frame; or (n, 3).
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
        without_drag = force + mass * (acceleration + cable.gravity * up)
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
                cable=cable,
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
        added = added + (np.linalg.pinv(slopes) @ missing[..., None])[..., 0]
    return None


def motion_over_window(
    load: RigidLoad,
    reference: NDArray,
    reference_higher_rates: NDArray,
    planned: NDArray,
    forces: NDArray,
    rates: NDArray,
    wind: NDArray,
    window: TimeWindow,
    *,
    attachments: NDArray,
    pseudo_inverse: NDArray,
    offset: NDArray,
    basis: NDArray,
    phases: NDArray,
    orders: NDArray,
) -> tuple[NDArray, NDArray]:
    """Cable forces (k, n, 3), N, on a load, and its attachments (k, n, 3), m, in W, over a window.

    The load follows its reference's series in time, and θ, ξ and A those of the plan. The forces
    are those of this motion, and what the present ones have beyond them, which goes on at the
    present rate.

    Args:
        load: the controllers' model.
        reference: (22,), the present one.
        reference_higher_rates: (6,), [angular jerk; snap].
        planned: (8,), `PlannedParameters`.
        forces: f (n, 3), N, the present desired ones on the load, in W.
        rates: ḟ (n, 3), N/s.
        wind: (3,), m/s, in W, steady.
        window: the k instants.
        attachments: (n, 3), m, in L.
        pseudo_inverse: (3n, 6), in L.
        offset: (3n,), N, in L.
        basis: N₀ (3n, m), in L.
        phases: (m,), rad, of the pattern.
        orders: (m,).
    """
    t = window.times[:, None]
    now, plan = LoadReference.view(reference), PlannedParameters.view(planned)
    higher = ReferenceHigherRates.view(reference_higher_rates)
    alpha, omega = now.angular_acceleration, now.angular_velocity
    # Magnus' series, of which the commutator is of third order in time.
    turn = _series(t, 0 * omega, omega, alpha, higher.angular_jerk + cross(alpha, omega) / 2)
    R_WL = rotation_matrix(rotate_quaternion(now.quaternion + 0 * t, turn))
    motion = now.position, now.velocity, now.acceleration, now.jerk, higher.snap
    position, velocity, acceleration = (_series(t, *motion[order:]) for order in range(3))
    torque = _series(t, *(w[:3] for w in wrenches_along(load, reference, wind)))
    force = load.mass * (acceleration + load.gravity * _UP) + load.drag * (velocity - wind)
    wrench = np.concatenate([torque, (force[:, None] @ R_WL)[:, 0]], axis=1)
    angle = _series(t, plan.angle, plan.frequency, plan.frequency_rate, plan.frequency_second_rate)
    amplitudes = plan.amplitude, plan.amplitude_rate, plan.amplitude_second_rate
    amplitude = _series(t, *amplitudes, plan.amplitude_third_rate)
    values = amplitude * np.cos(orders * angle + phases)
    of_motion = wrench @ pseudo_inverse.T + offset + values @ basis.T
    along = of_motion.reshape(len(t), -1, 3) @ R_WL.swapaxes(-1, -2)
    ends = position[:, None] + attachments @ R_WL.swapaxes(-1, -2)
    present, present_rate, *_ = window.at_present(along)
    of_feedback = (forces - present) + t[:, :, None] * (rates - present_rate)
    return along + of_feedback, ends


def _series(time: NDArray, *rates: NDArray) -> NDArray:
    """A value with these rates, in order, at times (k, 1) from the present on."""
    terms = [rate * time**order / math.factorial(order) for order, rate in enumerate(rates)]
    return sum(terms[1:], terms[0])


def _segment(force: NDArray, share: float, cable: CableMaterial) -> NDArray:
    """From one end of a segment to the other, m."""
    return share * (cable.rest_length / norm(force) + 1 / cable.stiffness) * force
