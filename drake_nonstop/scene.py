"""A run to watch: an animated 3D scene in one HTML file that opens offline."""

import logging
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Meshcat,
    MeshcatAnimation,
    MeshcatParams,
    Rgba,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from drake_nonstop.quiet import quiet_drake
from drake_nonstop.simulate import SIGNAL_PERIOD, Run
from drake_nonstop.system import overridden

# Colours. The carriers' palette begins with Okabe and Ito's, made for the colour-blind too.
PALETTE = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f5f3f", "#882255"
LOAD_COLOUR = "#30343b"
REFERENCE_COLOUR = "#8a4fff"
REFERENCE_OPACITY = 0.2
BACKGROUND = [0.97, 0.97, 0.98]

# Sizes. "Reach" is how far a carrier gets from the load's centre of mass.
WING_SPAN = 0.2  # of the reach
CABLE_RADIUS = 0.0035  # of the reach
BAR_RADIUS = 0.022  # of the load's radius, but never thinner than two cables
GHOST_GROWTH = 1.7  # the reference's bars enclose the load's, so that both are seen
TRAIL_PERIOD = 0.25  # s, a trail grows by a piece as often as this ...
TRAIL_PIECES = 60  # ... or in as many pieces as this, where that is less often

# What the camera sees, and in what light.
VERTICAL_VIEW = 40.0  # degrees
ASPECT_RATIO = 1.5  # of the narrowest window in which all is in view
ELEVATION = 25.0  # degrees, above the horizon
OBLIQUENESS = 20.0  # degrees, off the side of the load's way
MARGIN = 1.15  # of the distance
ASTRAY = 3.0  # reaches, off the reference: what is further out need not be in view
GROUND_CLEARANCE = 0.3  # of the reach, from the lowest point to the grid
GRID_OPACITY = 0.2
SUNLIGHT, AMBIENT_LIGHT = 2.0, 1.2  # three.js intensities


def record_replay(run: Run, *, frame_rate: float = 25.0) -> str:
    """The run as a Meshcat recording, an HTML page without links to anything outside.

    The load (dark) hangs from its carriers, each with its own colour, and follows its
    reference (translucent). Trails show where load and carriers have been. The carriers
    have no attitude in the model: they are drawn along their velocity, banked away from
    their cable. Samples from the first that is not finite are left out.

    Args:
        run: what `simulate` returned, or what a RunStopped or RunInterrupted carries.
        frame_rate: frames per second of simulated time; between them the viewer
            interpolates.
    """
    with quiet_drake(logging.WARNING):  # Meshcat's address is of no use here
        meshcat = Meshcat(MeshcatParams(host="localhost", port=0))  # any free port
    frame_rate = min(frame_rate, 1 / SIGNAL_PERIOD)
    motion = _motion(run, frame_rate)
    if len(motion.load):
        _set_stage(meshcat, motion)
        _draw(meshcat, motion)
        animation = MeshcatAnimation(frame_rate)
        _animate(animation, motion)
        meshcat.SetAnimation(animation)
    return meshcat.StaticHtml()


@dataclass(kw_only=True)
class _Motion:
    """A run's frames, all in the world frame but for `attachments` in the load's."""

    attachments: NDArray  # (n, 3)
    radius: float  # m, of the load
    reach: float  # m
    stride: int  # frames per piece of a trail
    load: NDArray  # (frames, 7), quaternion and position, as is the reference
    reference: NDArray
    carriers: NDArray  # (frames, n, 3)
    velocities: NDArray  # (frames, n, 3)

    @property
    def points(self) -> NDArray:
        """Where load and carriers are (points, 3), without carriers that went astray."""
        bodies = np.concatenate([self.load[:, None, 4:], self.carriers], axis=1)
        goals = self.reference[:, None, 4:]
        near = np.linalg.norm(bodies - goals, axis=2) < ASTRAY * self.reach
        rim = goals + self.radius * np.vstack([np.eye(3), -np.eye(3)])
        return np.concatenate([bodies[near], rim.reshape(-1, 3)])

    @property
    def boundaries(self) -> list[int]:
        """The frames where a trail's pieces meet."""
        last = len(self.load) - 1
        return [*range(0, last, self.stride), last]


def _motion(run: Run, frame_rate: float) -> _Motion:
    system = overridden(run.scenario.system, run.scenario.simulated)
    attachments = np.array(system.attachments)
    radius = float(np.max(np.linalg.norm(attachments, axis=1)))
    load, reference = _poses(run.signal("load_state")), _poses(run.signal("reference"))
    carriers = run.signal("carrier_state").reshape(len(load), 2, len(attachments), 3)

    finite = [
        np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
        for values in (load, reference, carriers)
    ]
    good = np.logical_and.accumulate(np.all(finite, axis=0))
    frames = np.floor(run.time[good] * frame_rate + 1e-6)
    samples = np.unique(frames, return_index=True)[1]
    return _Motion(
        attachments=attachments,
        radius=radius,
        reach=radius + system.cable_length,
        stride=max(1, round(TRAIL_PERIOD * frame_rate), -(-len(samples) // TRAIL_PIECES)),
        load=load[samples],
        reference=reference[samples],
        carriers=carriers[samples, 0],
        velocities=carriers[samples, 1],
    )


def _poses(states: NDArray) -> NDArray:
    """Quaternions, normalized, and positions (samples, 7); not finite where that fails."""
    poses = states[:, :7].copy()
    with np.errstate(all="ignore"):
        poses[:, :4] /= np.linalg.norm(poses[:, :4], axis=1, keepdims=True)
    return poses


def _draw(meshcat: Meshcat, motion: _Motion) -> None:
    """Sets the objects: bodies in their own frames, trails in the world frame."""
    bar = max(BAR_RADIUS * motion.radius, 2 * CABLE_RADIUS * motion.reach)
    ghost = _rgba(REFERENCE_COLOUR, REFERENCE_OPACITY)
    _draw_load(meshcat, "/load", motion.attachments, bar, _rgba(LOAD_COLOUR))
    _draw_load(meshcat, "/reference", motion.attachments, GHOST_GROWTH * bar, ghost)
    _draw_trail(meshcat, "/trails/load", motion, motion.load[:, 4:], _rgba(LOAD_COLOUR))
    for i in range(len(motion.attachments)):
        colour = _rgba(PALETTE[i % len(PALETTE)])
        _draw_carrier(meshcat, f"/carriers/{i}", WING_SPAN * motion.reach, colour)
        cable = Cylinder(CABLE_RADIUS * motion.reach, 1.0)  # m, scaled to its length
        meshcat.SetObject(f"/cables/{i}", cable, colour)
        _draw_trail(meshcat, f"/trails/{i}", motion, motion.carriers[:, i], colour)


def _draw_load(meshcat: Meshcat, path: str, attachments: NDArray, bar: float, rgba: Rgba) -> None:
    """A frame: bars around the attachments and spokes to the centre of mass."""
    offsets = attachments - attachments.mean(axis=0)
    plane = np.linalg.svd(offsets)[2][:2]  # the two directions in which they spread most
    rim = attachments[np.argsort(np.arctan2(*(plane @ offsets.T)))]
    spokes = [(np.zeros(3), end) for end in attachments]
    for k, (start, end) in enumerate([*zip(rim, np.roll(rim, -1, axis=0), strict=True), *spokes]):
        pose, length = _between(start, end)
        meshcat.SetObject(f"{path}/bar{k}", Capsule(bar, length), rgba)
        meshcat.SetTransform(f"{path}/bar{k}", pose)
    meshcat.SetObject(f"{path}/centre_of_mass", Sphere(2 * bar), rgba)


def _draw_carrier(meshcat: Meshcat, path: str, span: float, rgba: Rgba) -> None:
    """An aircraft: nose along x, left wing along y."""
    for part, shape, position in (
        ("fuselage", Ellipsoid(0.45 * span, 0.06 * span, 0.06 * span), [0.0, 0.0, 0.0]),
        ("wing", Ellipsoid(0.11 * span, 0.5 * span, 0.02 * span), [0.1, 0.0, 0.03]),
        ("tail", Ellipsoid(0.06 * span, 0.18 * span, 0.015 * span), [-0.38, 0.0, 0.02]),
        ("fin", Box(0.1 * span, 0.02 * span, 0.18 * span), [-0.38, 0.0, 0.1]),
    ):
        meshcat.SetObject(f"{path}/{part}", shape, rgba)
        meshcat.SetTransform(f"{path}/{part}", RigidTransform(span * np.array(position)))


def _draw_trail(meshcat: Meshcat, path: str, motion: _Motion, points: NDArray, rgba: Rgba) -> None:
    """A polyline in pieces, each named after the frame from which on it is visible."""
    for start, end in pairwise(motion.boundaries):
        meshcat.SetLine(f"{path}/{end}", points[start : end + 1].T, rgba=rgba)
        meshcat.SetProperty(f"{path}/{end}", "visible", False)


def _animate(animation: MeshcatAnimation, motion: _Motion) -> None:
    """Sets the motion, frame by frame, of what `_draw` has drawn."""
    n = len(motion.attachments)
    headings = np.tile([1.0, 0.0, 0.0], (n, 1))
    for frame, (load, reference) in enumerate(zip(motion.load, motion.reference, strict=True)):
        X_WL = _transform(load)
        animation.SetTransform(frame, "/load", X_WL)
        animation.SetTransform(frame, "/reference", _transform(reference))
        for i in range(n):
            p_WA = X_WL @ motion.attachments[i]
            p_WC = motion.carriers[frame, i]
            cable, length = _between(p_WA, p_WC)
            animation.SetTransform(frame, f"/cables/{i}", cable)
            animation.SetProperty(frame, f"/cables/{i}", "scale", [1.0, 1.0, length])
            headings[i] = _direction(motion.velocities[frame, i], otherwise=headings[i])
            attitude = _attitude(headings[i], up=p_WC - p_WA)
            animation.SetTransform(frame, f"/carriers/{i}", RigidTransform(attitude, p_WC))

    last = len(motion.load) - 1  # all tracks end there: a shorter one would restart early
    for trail in ("load", *range(n)):
        for end in motion.boundaries[1:]:
            for frame, visible in ((0, False), (end, True), (last, True)):
                animation.SetProperty(frame, f"/trails/{trail}/{end}", "visible", visible)


def _transform(pose: NDArray) -> RigidTransform:
    return RigidTransform(RotationMatrix(Quaternion(pose[:4])), pose[4:7])


def _between(start: NDArray, end: NDArray) -> tuple[RigidTransform, float]:
    """Where a cylinder lies that connects two points, and its length, never quite zero."""
    axis = _direction(end - start, otherwise=np.array([0.0, 0.0, 1.0]))
    rotation = RotationMatrix.MakeFromOneVector(axis, axis_index=2)
    length = max(float(np.linalg.norm(end - start)), 1e-6)
    return RigidTransform(rotation, (start + end) / 2), length


def _attitude(heading: NDArray, up: NDArray) -> RotationMatrix:
    """The attitude with the nose (x) along a unit vector and the top (z) towards `up`."""
    z = _direction(np.cross(heading, np.cross(up, heading)), otherwise=np.zeros(3))
    if not z.any():
        return RotationMatrix.MakeFromOneVector(heading, axis_index=0)
    return RotationMatrix(np.column_stack([heading, np.cross(z, heading), z]))


def _direction(vector: NDArray, *, otherwise: NDArray) -> NDArray:
    """The unit vector along `vector`, or the other one where that is (almost) zero."""
    length = np.linalg.norm(vector)
    return vector / length if length > 1e-6 else otherwise


def _set_stage(meshcat: Meshcat, motion: _Motion) -> None:
    """Sets a plain background, a camera that sees all, its light and a grid below."""
    for edge in ("top_color", "bottom_color"):
        meshcat.SetProperty("/Background/<object>", edge, BACKGROUND)
    meshcat.SetProperty("/Axes", "visible", False)
    points = motion.points
    eye, target = _view(points, path=motion.reference[:, 4:])
    distance = np.linalg.norm(eye - target)
    camera = "/Cameras/default/rotated/<object>"
    meshcat.SetProperty(camera, "fov", VERTICAL_VIEW)
    meshcat.SetProperty(camera, "near", distance / 100)
    meshcat.SetProperty(camera, "far", distance * 100)
    meshcat.SetCameraPose(eye, target)

    # Most of Meshcat's lamps light up the first metres only: a far one serves every size.
    for lamp in ("SpotLight", "PointLightNegativeX", "PointLightPositiveX"):
        meshcat.SetProperty(f"/Lights/{lamp}", "visible", False)
    sun = (eye - target) / distance + [0.0, 0.0, 1.0]
    meshcat.SetProperty("/Lights/FillLight/<object>", "position", sun.tolist())
    meshcat.SetProperty("/Lights/FillLight/<object>", "intensity", SUNLIGHT)
    meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", AMBIENT_LIGHT)

    scale = 10.0 ** np.round(np.log10(motion.reach / 2))  # 1: squares of 0.5 m
    floor = [*target[:2], points[:, 2].min() - GROUND_CLEARANCE * motion.reach]
    grid = RigidTransform(floor).GetAsMatrix4() @ np.diag([scale, scale, scale, 1.0])
    meshcat.SetTransform("/Grid", grid)
    meshcat.SetProperty("/Grid/<object>", "opacity", GRID_OPACITY)


def _view(points: NDArray, *, path: NDArray) -> tuple[NDArray, NDArray]:
    """Where a camera stands and looks: across a path, with all points just in view."""
    ways = path - path[0]
    way = ways[np.argmax(np.linalg.norm(ways, axis=1))]
    yaw = np.arctan2(way[1], way[0]) - np.radians(OBLIQUENESS)
    R_WC = RollPitchYaw(np.radians(-ELEVATION), 0.0, yaw).ToRotationMatrix().matrix()
    seen = points @ R_WC  # in the camera's axes: to the right, ahead, up
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    right, ahead, up = (seen - middle).T
    slope = np.tan(np.radians(VERTICAL_VIEW) / 2)
    spread = np.maximum(np.abs(right) / ASPECT_RATIO, np.abs(up))
    distance = MARGIN * np.max(spread / slope - ahead)
    return R_WC @ (middle - [0.0, distance, 0.0]), R_WC @ middle


def _rgba(colour: str, opacity: float = 1.0) -> Rgba:
    red, green, blue = bytes.fromhex(colour[1:])
    return Rgba(red / 255, green / 255, blue / 255, opacity)
