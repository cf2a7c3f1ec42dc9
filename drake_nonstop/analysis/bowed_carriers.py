"""The motion of carriers on cables that bow, along a plan or at rest."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.blocks.lumped_cables import material_of
from drake_nonstop.mechanics.bowed_line import bowed_lines, motion_over_window
from drake_nonstop.mechanics.planned_orbit import OrbitMotion
from drake_nonstop.mechanics.rigid_load import RigidLoad
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.signals import LoadReference
from drake_nonstop.model.descriptions import CableShape
from drake_nonstop.model.system import Model

_NO_HIGHER_RATES = np.zeros(6)


class BowedMotion(NamedTuple):
    """The motion of n carriers at the ends of bowed cables, and these, at k instants, in L."""

    motion: OrbitMotion  # its forces are those that carriers pull with
    load_forces: NDArray  # (k, n, 3), N, of the cables on the load
    nodes: NDArray  # (N, k, n, 3), m, from the attachments

    @property
    def bows(self) -> NDArray:
        """The largest distances (k, n), m, of nodes from the line between a cable's ends."""
        chords = self.motion.cables
        apart = np.linalg.norm(np.cross(self.nodes, chords), axis=-1).max(axis=0)
        return apart / np.linalg.norm(chords, axis=-1)


def bowed_motion(
    shape: CableShape,
    model: Model,
    load: RigidLoad,
    references: NDArray,
    planned: NDArray,
    load_winds: NDArray,
    winds: NDArray,
    straight: OrbitMotion,
) -> BowedMotion:
    """Where `BowedCarrierTrajectory` has carriers that follow a plan exactly.

    The references' angular jerk and snap are taken as zero. Where the simulated cables pull with
    other forces at the load than those of the model, carriers pull with as much more.

    Args:
        shape: how finely the block resolves the cables.
        model: what the controllers believe.
        load: that moves so.
        references: (k, 22).
        planned: (k, 8), `PlannedParameters`.
        load_winds: (k, 3), m/s, in W, at the load.
        winds: (k, 1, 3) or (k, n, 3), m/s, in W, at the carriers.
        straight: the motion on straight cables, and the forces of the simulated ones on the load.
    """
    window, pattern = shape.window, model.pattern
    over_window = [
        motion_over_window(
            *(load, reference, _NO_HIGHER_RATES, plan, None, None, wind, window),
            attachments=model.attachments,
            pseudo_inverse=model.pseudo_inverse,
            offset=pattern.offset,
            basis=pattern.basis,
            phases=pattern.phases,
            orders=pattern.orders,
        )
        for reference, plan, wind in zip(references, planned, load_winds, strict=True)
    ]
    forces, attachments = (np.stack(parts, axis=1) for parts in zip(*over_window, strict=True))
    size, size_of_lines = forces.shape[1:], (len(window.times), -1, 3)
    at_load = np.broadcast_to(load_winds[:, None], size)
    lines = bowed_lines(
        forces.reshape(size_of_lines),
        attachments.reshape(size_of_lines),
        at_load.reshape(-1, 3),
        window,
        cable=material_of(model),
        nodes=shape.nodes,
        gusts=(winds - at_load).reshape(-1, 3),
    )
    R_WL = rotation_matrix(LoadReference.view(references).quaternion)
    now = len(window.times) // 2
    position, velocity, acceleration, _ = (
        rate.reshape(size) for rate in window.at_present(lines.ends)
    )
    beyond = straight.forces - forces[now] @ R_WL
    pulls = lines.forces[now].reshape(size) @ R_WL + beyond
    nodes = lines.nodes[:, now].reshape(-1, *size)
    return BowedMotion(
        OrbitMotion(
            pulls,
            (position - attachments[now]) @ R_WL,
            (velocity - winds) @ R_WL,
            acceleration @ R_WL,
        ),
        straight.forces,
        (nodes - attachments[now]) @ R_WL,
    )
