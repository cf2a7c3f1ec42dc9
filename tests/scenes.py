"""Scenes and instants to show in them, for the tests of the visualization."""

from collections import defaultdict

import numpy as np
from pydrake.math import RigidTransform

from drake_nonstop.model.system import SystemParameters
from drake_nonstop.view.bodies import Snapshot
from drake_nonstop.view.canvas import ROOT
from drake_nonstop.view.scene import Scene


class ListCanvas:
    """A canvas that lists what it was given, in order, by path below the root."""

    def __init__(self):
        self.poses = defaultdict(list)
        self.lengths = defaultdict(list)
        self.colours = defaultdict(list)
        self.opacities = defaultdict(list)
        self.followed = []

    def follow(self, position, camera):
        self.followed.append(position)

    def place(self, path, pose, length=1.0):
        self.poses[path.removeprefix(ROOT)].append(RigidTransform(pose))
        self.lengths[path.removeprefix(ROOT)].append(length)

    def paint(self, path, colour, opacity, *, fades=False):
        self.colours[path.removeprefix(ROOT)].append(tuple(colour))
        self.opacities[path.removeprefix(ROOT)].append(opacity)


def polygon(n):
    angles = 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n)])


def system(n=4, cable_length=0.8):
    return SystemParameters(attachments=polygon(n).tolist(), cable_length=cable_length)


def snapshot(time=0.0, n=4, speed_bound=0.5, **fields):
    """Carriers that circle above a turning load on its way along x."""
    angles = time + 2 * np.pi * np.arange(n) / n
    positions = np.column_stack([np.cos(angles), np.sin(angles), np.full(n, 0.8)])
    load_position = np.array([0.7 * time, 0, 0])
    values = {
        "load_quaternion": np.array([np.cos(time / 4), 0, 0, np.sin(time / 4)]),
        "load_position": load_position,
        "reference_quaternion": np.array([np.cos(time / 4), 0, 0, np.sin(time / 4)]),
        "reference_position": load_position + np.array([0, 0.1, 0]),
        "carriers": positions + load_position,
        "velocities": np.column_stack([-np.sin(angles), np.cos(angles), np.zeros(n)]),
        "tensions": np.full(n, 2.5),
    }
    return Snapshot(time=time, speed_bound=speed_bound, **(values | fields))


def shown(*snapshots, n=4, config=None, nodes=0):
    canvas = ListCanvas()
    made = Scene(system(n), config, nodes=nodes)
    for each in snapshots:
        made.show(canvas, each)
    return canvas
