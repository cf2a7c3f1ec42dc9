"""Scenes and instants to show in them, for the tests of the visualization."""

from collections import defaultdict

import numpy as np
from pydrake.math import RigidTransform

from drake_nonstop.mechanics.signals import CarrierStates, Pose
from drake_nonstop.model.system import SystemParameters
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.view.bodies import Snapshot
from drake_nonstop.view.scene import ROOT, Scene


class ListCanvas:
    """A canvas that lists what it was given, in order, by path below the root."""

    def __init__(self):
        self.poses = defaultdict(list)
        self.lengths = defaultdict(list)
        self.colours = defaultdict(list)
        self.opacities = defaultdict(list)

    def place(self, path, pose, length=1.0):
        self.poses[path.removeprefix(ROOT)].append(RigidTransform(pose))
        self.lengths[path.removeprefix(ROOT)].append(length)

    def paint(self, path, colour, opacity, *, fades=False):
        self.colours[path.removeprefix(ROOT)].append(tuple(colour))
        self.opacities[path.removeprefix(ROOT)].append(opacity)

    def ends(self, path, which=0):
        """The ends of a cylinder that was placed."""
        pose, length = self.poses[path][which], self.lengths[path][which]
        return np.array([pose @ np.array([0, 0, side * length / 2]) for side in (-1, 1)])


def polygon(n):
    angles = 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n)])


def scenario(n=4, **fields):
    system = SystemParameters(attachments=polygon(n).tolist(), cable_length=0.8)
    return Scenario(system=system, **fields)


def snapshot(time=0.0, n=4, speed_bound=0.5, velocities=None, **fields):
    """Carriers that circle above a turning load on its way along x."""
    angles = time + 2 * np.pi * np.arange(n) / n
    position, quaternion = np.array([0.7 * time, 0, 0]), [np.cos(time / 4), 0, 0, np.sin(time / 4)]
    if velocities is None:
        velocities = np.column_stack([-np.sin(angles), np.cos(angles), np.zeros(n)])
    return Snapshot(
        time=time,
        load=Pose(np.array(quaternion), position),
        reference=Pose(np.array(quaternion), position + np.array([0, 0.1, 0])),
        carriers=CarrierStates(
            position + np.column_stack([np.cos(angles), np.sin(angles), np.full(n, 0.8)]),
            velocities,
        ),
        speed_bound=speed_bound,
        **{"tensions": np.full(n, 2.5)} | fields,
    )


def shown(*snapshots, n=4, nodes=0):
    canvas = ListCanvas()
    made = Scene(scenario(n), nodes=nodes)
    for each in snapshots:
        made.show(canvas, each)
    return canvas
