"""The rigid parts of the scene's bodies: bars of the load, and what a carrier is made of."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Box, Capsule, Ellipsoid, Shape, Sphere
from pydrake.math import RigidTransform

from drake_nonstop.visualization.poses import cylinder_poses


@dataclass(kw_only=True)
class Part:
    """A shape at a pose in its body's frame."""

    name: str
    shape: Shape
    pose: RigidTransform = field(default_factory=RigidTransform)


def load_parts(attachments: NDArray, bar: float) -> list[Part]:
    """Bars from attachment to attachment, and from each to the centre of mass.

    Args:
        attachments: (n, 3) in m, in L.
        bar: m, radius of a bar.
    """
    offsets = attachments - attachments.mean(axis=0)
    plane = np.linalg.svd(offsets)[2][:2]  # the directions of largest spread
    rim = attachments[np.argsort(np.arctan2(*(plane @ offsets.T)))]
    edges = [*zip(rim, np.roll(rim, -1, axis=0), strict=True)]
    spokes = [(np.zeros(3), end) for end in attachments]
    poses, lengths = cylinder_poses(*np.array([*edges, *spokes]).swapaxes(0, 1))
    bars = [
        Part(name=f"bar{k}", shape=Capsule(bar, length), pose=RigidTransform(pose))
        for k, (pose, length) in enumerate(zip(poses, lengths, strict=True))
    ]
    return [*bars, Part(name="centre_of_mass", shape=Sphere(2 * bar))]


def carrier_parts(span: float) -> list[Part]:
    """An aircraft of a wing span in m: nose along x, left wing along y."""
    return [
        Part(name=name, shape=shape, pose=RigidTransform(span * np.array(position)))
        for name, shape, position in (
            ("fuselage", Ellipsoid(0.45 * span, 0.06 * span, 0.06 * span), [0.0, 0.0, 0.0]),
            ("wing", Ellipsoid(0.11 * span, 0.5 * span, 0.02 * span), [0.1, 0.0, 0.03]),
            ("tail", Ellipsoid(0.06 * span, 0.18 * span, 0.015 * span), [-0.38, 0.0, 0.02]),
            ("fin", Box(0.1 * span, 0.02 * span, 0.18 * span), [-0.38, 0.0, 0.1]),
        )
    ]
