"""Cables with mass and drag: nodes in a line between springs that only pull.

A cable of the length L₀ is cut into N equal pieces, with a node in the middle of each that has the
piece's mass m = ρ_c π d²/4 L₀/N and its drag. The N + 1 segments from the load's attachment over
the nodes to the carrier are L₀/N long, the first and the last half of that. With the tensions T_k
and directions u_k of the segments below and above a node, and its velocity v,

    m v̇ = T_{k+1} u_{k+1} − T_k u_k + ½ ρ d L₀/N (C_D ‖w_n‖ w_n + π C_f ‖w_t‖ w_t) − m g e₃,

where w_n and w_t are the parts of w − v, the air's velocity past the node, across and along the
cable. The wind w runs linearly along the cable from that at the load to that at the carrier.

A segment is a spring-damper as of `mechanics.cable`, of a share of the cable's compliance. Its
damping is limited: steps that resolve the waves along the cable then suffice.

Arrays of nodes are (N, n, 3), those of n cables, the load's neighbours first; W, SI.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.cable import (
    ends_of_cables,
    tensions_and_directions,
    within,
)
from drake_nonstop.mechanics.rotation import absolute

_UP = np.array([0.0, 0.0, 1.0])
_LEAST = 1e-12  # m²/s², beside the square of a speed, which may vanish


class CableMaterial(NamedTuple):
    """What cables are made of; numbers of cables that differ are (n, 1), also of symbols."""

    rest_length: float | NDArray  # m, L₀
    stiffness: float | NDArray  # N/m, of the whole cable
    damping: float | NDArray  # N s/m, likewise
    diameter: float | NDArray  # m, d
    density: float | NDArray  # kg/m³, ρ_c
    drag: float | NDArray  # C_D of flow across, of the diameter
    friction: float | NDArray  # C_f of flow along, of the circumference
    air_density: float | NDArray  # kg/m³, ρ
    gravity: float | NDArray  # m/s²

    @property
    def mass(self) -> float | NDArray:
        """Mass of a cable, kg."""
        return self.density * np.pi / 4 * self.diameter * self.diameter * self.rest_length

    def repeated(self, times: int) -> "CableMaterial":
        """The n cables several times, one set after the other."""
        sizes = (np.size(number) for number in self)
        return CableMaterial._make(
            np.tile(number, (times, 1)) if size > 1 else number
            for number, size in zip(self, sizes, strict=True)
        )


class LumpedCables(NamedTuple):
    """What nodes do, and what the cables' ends pull with."""

    rates: NDArray  # (6Nn,), of the state
    load_forces: NDArray  # (n, 3), N, on the load
    carrier_forces: NDArray  # (n, 3), N, of the carriers on their cables
    tensions: NDArray  # (N + 1, n), N, from the load on


def nodes_of(state: NDArray, n: int) -> tuple[NDArray, NDArray]:
    """Positions and velocities, each (N, n, 3), of a state (6Nn,): all positions come first."""
    positions, velocities = np.split(state, 2)
    return positions.reshape(-1, n, 3), velocities.reshape(-1, n, 3)


def segment_shares(nodes: int) -> NDArray:
    """Shares (N + 1, 1, 1) of the cable that its segments are."""
    inner = np.ones(nodes + 1)
    inner[[0, -1]] = 0.5
    return inner[:, None, None] / nodes


def straight_nodes(
    load_state: NDArray, carrier_state: NDArray, *, attachments: NDArray, nodes: int
) -> NDArray:
    """The state (6Nn,) of cables that are straight and stretched evenly."""
    places = np.cumsum(segment_shares(nodes))[:-1, None, None]
    lines = ends_of_cables(load_state, carrier_state, attachments)
    return np.concatenate([(low + places * (high - low)).ravel() for low, high in lines])


def lumped_cables(
    state: NDArray,
    load_state: NDArray,
    carrier_state: NDArray,
    wind: NDArray,
    load_wind: NDArray,
    *,
    attachments: NDArray,
    cable: CableMaterial,
    max_damping_ratio: float | NDArray,
) -> LumpedCables:
    """The motion of the nodes of n cables, and the forces at both ends.

    Args:
        state: see `nodes_of`.
        load_state: (13,), in W.
        carrier_state: (6n,), in W.
        wind: (3n,), m/s, at the carriers.
        load_wind: (3,), m/s, at the load.
        attachments: (n, 3), m, in L.
        cable: what they are made of.
        max_damping_ratio: of the fastest wave along the cable; the damping is at most that.
    """
    positions, velocities = nodes_of(state, len(attachments))
    ends, end_velocities = ends_of_cables(load_state, carrier_state, attachments)
    points, speeds = (
        np.concatenate([low[None], inner, high[None]])
        for inner, (low, high) in ((positions, ends), (velocities, end_velocities))
    )
    count = len(positions)
    shares, mass = segment_shares(count), cable.mass
    # The fastest wave turns by 2 N √(K/M) rad/s, and B/K times half of that is its damping ratio.
    most = max_damping_ratio * np.sqrt(cable.stiffness * mass) / count
    stretch = points[1:] - points[:-1]
    tensions, directions = tensions_and_directions(
        stretch,
        speeds[1:] - speeds[:-1],
        rest_length=cable.rest_length * shares,
        stiffness=cable.stiffness / shares,
        damping=within(np.atleast_1d(cable.damping), 0.0, most) / shares,
    )
    pulls = tensions * directions
    places = np.cumsum(shares)[:-1, None, None]
    past = load_wind + places * (wind.reshape(-1, 3) - load_wind) - velocities
    drag = node_drag(past, stretch[:-1], stretch[1:], shares[1:] / shares[:-1], cable, count)
    forces = pulls[1:] - pulls[:-1] + drag
    accelerations = forces / (mass / count) - cable.gravity * _UP
    return LumpedCables(
        np.concatenate([velocities.ravel(), accelerations.ravel()]),
        pulls[0],
        pulls[-1],
        tensions[..., 0],
    )


def node_drag(
    past: NDArray,
    below: NDArray,
    above: NDArray,
    ratio: float | NDArray,
    cable: CableMaterial,
    nodes: int,
) -> NDArray:
    """Drag (..., 3), N, of one of a cable's nodes.

    Args:
        past: w − v (..., 3), m/s, the air's velocity past the node.
        below: (..., 3), m, the segment below the node, from end to end.
        above: (..., 3), m, that above it.
        ratio: of the share of the cable that the segment above is, to that below.
        cable: what it is made of.
        nodes: N.
    """
    # The tangent of the parabola through a node and its neighbours.
    tangents = ratio * below + above / ratio
    square = (tangents * tangents).sum(axis=-1, keepdims=True)
    along = (past * tangents).sum(axis=-1, keepdims=True) / square
    across = past - along * tangents
    rubbing = np.pi * cable.friction * np.sqrt(square) * absolute(along) * along
    speed = np.sqrt((across * across).sum(axis=-1, keepdims=True) + _LEAST)
    pressure = cable.air_density / 2 * cable.diameter * cable.rest_length / nodes
    return pressure * (cable.drag * speed * across + rubbing * tangents)
