"""What a run looks like in Meshcat: load, cables, carriers, trails and the reference."""

import itertools
import logging
import re
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
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
from pydrake.math import RigidTransform, RollPitchYaw

from drake_nonstop.mechanics.rotation import cross, rotation_matrix
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.systems.drake_log import drake_log_level
from drake_nonstop.validation import (
    ScenarioError,
    is_number,
    require,
    require_non_negative,
    require_positive,
)


@dataclass(kw_only=True)
class SceneConfig:
    """Colours (#rrggbb) and sizes; the reach is the furthest that a carrier gets from the load."""

    load_colour: str = "#30343b"
    reference_colour: str = "#8a4fff"
    reference_opacity: float = 0.2
    # The palette begins with Okabe and Ito's, made for the colour-blind too.
    carrier_colours: list[str] = field(
        default_factory=lambda: [
            *("#0072b2", "#d55e00", "#009e73", "#cc79a7"),
            *("#e69f00", "#56b4e9", "#7f5f3f", "#882255"),
        ]
    )
    mark_colours: list[str] = field(  # of a carrier at ε, between, and from mark_range ε up
        default_factory=lambda: ["#e0101a", "#f5b800", "#18a048"]
    )
    mark_range: float = 1.5  # of ε
    mark_opacity: float = 0.35
    cable_colours: list[str] = field(  # of a cable from no tension up to tension_range
        default_factory=lambda: ["#9cc4e4", "#08306b"]
    )
    tension_range: float = 2.0  # of a cable's share of the load's weight
    slack_colour: str = "#ff00c8"
    background_colour: str = "#f7f7fa"
    wing_span: float = 0.2  # of the reach
    cable_radius: float = 0.0035  # of the reach
    bar_radius: float = 0.022  # of the load's radius, but never thinner than two cables
    trail_radius: float = 0.0025  # of the reach
    trail_time: float = 10.0  # of √(reach/gravity), until a trail has faded
    trail_pieces: int = 40  # that it fades in


Colour = tuple[float, float, float]  # red, green and blue, from 0 to 1

_SMALL = 1e-6  # m, m/s: has no direction

ROOT = "/nonstop"  # of the objects' paths in Meshcat

# What the eye need not choose.
GHOST_GROWTH = 1.7  # the reference's bars enclose the load's, so that both are seen
MARK_RADIUS = 0.42  # of the wing span
SHADES = 33  # of marks and cables; a change of colour is shown in such steps
TRAIL_OPACITIES = 8  # different ones, of a trail's pieces

# What the camera sees, and in what light.
VERTICAL_VIEW = 40.0  # degrees
ASPECT_RATIO = 1.5  # of the narrowest window in which all is in view
ELEVATION = 25.0  # degrees, above the horizon
OBLIQUENESS = 20.0  # degrees, off the side of the load's way
MARGIN = 1.15  # of the distance
FOLLOWED_WAY = 1.5  # reaches; on a longer one the camera goes along
ASTRAY = 3.0  # reaches, off the reference: what is further out need not be in view
GROUND_CLEARANCE = 0.3  # of the reach, from the lowest point to the grid
GRID_OPACITY = 0.2
SUNLIGHT, AMBIENT_LIGHT = 2.0, 1.2  # three.js intensities


@dataclass(kw_only=True)
class Snapshot:
    """An instant of a run, all in the world frame."""

    time: float  # s
    load: NDArray  # (7,), quaternion, of any length, and position, as is the reference
    reference: NDArray
    carriers: NDArray  # (n, 3), m
    velocities: NDArray  # (n, 3), m/s
    tensions: NDArray  # (n,), N
    speed_bound: float  # m/s

    @property
    def is_finite(self) -> bool:
        """Whether it can be shown."""
        arrays = (self.load, self.reference, self.carriers, self.velocities, self.tensions)
        return all(np.isfinite(array).all() for array in arrays) and bool(
            self.load[:4].any() and self.reference[:4].any()
        )


@dataclass(kw_only=True)
class Stage:
    """What a camera that goes along was set to."""

    origin: NDArray  # (3,), of the way that it goes, as the others in the world frame
    target: NDArray  # (3,), what it looked at there
    floor: NDArray  # (3,), where the grid is


def start_meshcat(port: int | None = None) -> Meshcat:
    """A Meshcat for this machine alone, without a line in the log.

    Args:
        port: where it is served; 0 for any free port, None for the first free one from 7000 on.

    Raises:
        ScenarioError: the port is taken or none.
    """
    remedy = "give a free port from 1024 to 65535, or 0 for any"
    # Drake ends the process where the number is none of these.
    require(port is None or port == 0 or 1024 <= port <= 65535, "--port", port, remedy)
    with drake_log_level(logging.WARNING):
        try:
            return Meshcat(MeshcatParams(host="localhost", port=port))
        except RuntimeError:
            raise ScenarioError(f"--port = {port}: {remedy}") from None


class Canvas(Protocol):
    """Where a scene moves its objects: a Meshcat that is watched, or a recording."""

    def follow(self, position: NDArray, stage: Stage) -> None:
        """Has the camera go along with what moved from the stage's origin to a position (3,)."""
        ...

    def place(self, path: str, pose: NDArray, length: float = 1.0) -> None:
        """Puts an object at a pose (4, 4), its own z axis scaled by the length."""
        ...

    def paint(self, path: str, colour: Colour, opacity: float, *, fades: bool = False) -> None:
        """Gives the objects below the path a colour and an opacity from 0 to 1.

        One that fades may change gradually from what it was when last painted.
        """
        ...


class LiveCanvas:
    """A Meshcat, as a canvas: what is placed there is seen at once."""

    def __init__(self, meshcat: Meshcat):
        self._meshcat = meshcat
        self._painted: dict[str, tuple[float, ...]] = {}

    def follow(self, position: NDArray, stage: Stage) -> None:
        """See `Canvas`."""
        way = position - stage.origin
        self._meshcat.SetTransform("/Cameras/default", RigidTransform(way))
        self._meshcat.SetCameraTarget(stage.target + way)

    def place(self, path: str, pose: NDArray, length: float = 1.0) -> None:
        """See `Canvas`."""
        if length != 1.0:
            pose = pose.copy()
            pose[:3, 2] *= length
        self._meshcat.SetTransform(path, pose)

    def paint(self, path: str, colour: Colour, opacity: float, *, fades: bool = False) -> None:
        """See `Canvas`."""
        rgba = *colour, opacity
        if self._painted.get(path) != rgba:
            self._painted[path] = rgba
            self._meshcat.SetProperty(path, "color", list(rgba))


class FilmCanvas:
    """A recording, as a canvas; `frame` is what is being recorded.

    A viewer interpolates between the frames that were written. What did not change is not
    written again, which keeps a recording small; before a change it is, once more.
    """

    def __init__(self, animation: MeshcatAnimation):
        self._animation = animation
        self.frame = 0
        self._tracks: dict[tuple[str, str], tuple[int, Any]] = {}  # last frame and value of each

    def follow(self, position: NDArray, stage: Stage) -> None:
        """See `Canvas`.

        What a recorded camera looks at stays where it was, so the world moves the other way.
        """
        way = position - stage.origin
        root, grid = _poses(np.eye(3), np.array([-way, stage.floor - way]))
        self._place(ROOT, root)
        self._place("/Grid", grid)

    def place(self, path: str, pose: NDArray, length: float = 1.0) -> None:
        """See `Canvas`."""
        self._place(path, pose)
        # Three digits, so that a cable that hardly stretches is hardly ever written.
        self._write(path, "scale", [1.0, 1.0, float(f"{length:.3g}")])

    def paint(self, path: str, colour: Colour, opacity: float, *, fades: bool = False) -> None:
        """See `Canvas`; the path has to be that of one object.

        Colours of a path play back only for the materials, which belong to the object below it.
        """
        path += "/<object>"
        self._write(path, "material.color", list(colour))
        self._write(path, "material.opacity", opacity, holds=not fades)

    def finish(self) -> None:
        """Has all tracks end at the present frame: a shorter one would start again early."""
        for (path, name), (frame, value) in list(self._tracks.items()):
            if frame < self.frame:
                self._record(self.frame, path, name, value)

    def _place(self, path: str, pose: NDArray) -> None:
        self._write(path, "transform", tuple(pose.ravel().tolist()))

    def _write(self, path: str, name: str, value: Any, *, holds: bool = True) -> None:
        frame, previous = self._tracks.get((path, name), (self.frame, None))
        if previous == value:
            return
        if holds and frame < self.frame - 1:
            self._record(self.frame - 1, path, name, previous)
        self._record(self.frame, path, name, value)

    def _record(self, frame: int, path: str, name: str, value: Any) -> None:
        self._tracks[path, name] = frame, value
        if name == "transform":
            self._animation.SetTransform(frame, path, RigidTransform(np.reshape(value, (4, 4))))
        else:
            self._animation.SetProperty(frame, path, name, value)


class Scene:
    """The objects of a run, which `draw` makes and `show` moves.

    The load, a frame around its attachment points, hangs from its carriers and follows its
    reference, a translucent ghost. Cables darken with their tension and are of a colour of
    their own where they are slack. The carriers have no attitude in the model: they are drawn
    along their velocity, banked away from their cable. The mark around each turns from green
    to red as its speed comes down to ε. Trails show where load and carriers have been.

    Args:
        system: whose attachments, cable length, load mass and gravity are shown.
        config: colours and sizes.

    Raises:
        ScenarioError: a field of the config is out of range.
    """

    def __init__(self, system: SystemParameters | Model, config: SceneConfig | None = None):
        self.config = config or SceneConfig()
        _check(self.config)
        self._attachments = np.array(system.attachments)
        self._n = len(self._attachments)
        self.radius = float(np.max(np.linalg.norm(self._attachments, axis=1)))  # m, of the load
        self.reach = self.radius + system.cable_length
        self._weight_share = system.load_mass * system.gravity / self._n
        fading = self.config.trail_time * np.sqrt(self.reach / system.gravity)
        self._piece_time = fading / self.config.trail_pieces
        self._mark_colours = _shades(self.config.mark_colours)
        self._cable_colours = _shades(self.config.cable_colours)
        self._slack_colour = _rgb(self.config.slack_colour)
        palette = itertools.cycle(self.config.carrier_colours)
        self._carrier_colours = [_rgb(next(palette)) for _ in range(self._n)]
        self._trail_colours = [_rgb(self.config.load_colour), *self._carrier_colours]
        opacities = [
            _trail_opacity(age, self.config.trail_pieces) for age in range(self.config.trail_pieces)
        ]
        self._trail_opacities = {  # by the number of newer pieces, where it changes
            age: opacity
            for age, opacity in enumerate(opacities)
            if age == 0 or opacity != opacities[age - 1]
        }
        self._stage: Stage | None = None
        self._forget()

    def _forget(self) -> None:
        self._headings = np.tile([1.0, 0.0, 0.0], (self._n, 1))
        self._trail_ends: NDArray | None = None  # (1 + n, 3), where the next pieces start
        self._trail_start = 0.0  # s
        self._trail_length = 0  # pieces, those that have faded among them

    def draw(self, meshcat: Meshcat) -> None:
        """Makes the objects, bodies in their own frames, in place of earlier ones."""
        self._forget()
        config = self.config
        cable = config.cable_radius * self.reach
        bar = max(config.bar_radius * self.radius, 2 * cable)
        ghost = Rgba(*_rgb(config.reference_colour), config.reference_opacity)
        span = config.wing_span * self.reach
        meshcat.Delete(ROOT)
        self._draw_load(meshcat, f"{ROOT}/load", bar, Rgba(*_rgb(config.load_colour)))
        self._draw_load(meshcat, f"{ROOT}/reference", GHOST_GROWTH * bar, ghost)
        for i, colour in enumerate(self._carrier_colours):
            _draw_carrier(meshcat, f"{ROOT}/carriers/{i}", span, Rgba(*colour))
            # Marks and trails start translucent: a viewer prepares a material for that once.
            mark = Rgba(*self._mark_colours[-1], config.mark_opacity)
            meshcat.SetObject(f"{ROOT}/carriers/{i}/mark", Sphere(MARK_RADIUS * span), mark)
            unit = Cylinder(cable, 1.0)  # m, scaled to its length
            meshcat.SetObject(f"{ROOT}/cables/{i}", unit, Rgba(*self._cable_colours[0]))
        unit = Cylinder(config.trail_radius * self.reach, 1.0)
        for body, colour in enumerate(self._trail_colours):
            for piece in range(config.trail_pieces):
                meshcat.SetObject(f"{ROOT}/trails/{body}/{piece}", unit, Rgba(*colour, 0.0))

    def set_stage(self, meshcat: Meshcat, path: NDArray, carriers: NDArray | None = None) -> None:
        """Sets a plain background, a camera that sees all, its light and a grid below.

        Where the way is long the camera goes along with the reference, else it stands still.

        Args:
            meshcat: where.
            path: (k, 3), of the reference.
            carriers: (k, n, 3), at the same instants, as far as they are known; those that
                went astray need not be in view.
        """
        if carriers is None:
            around = self.reach * np.vstack([np.eye(3), -np.eye(3)])[[0, 1, 2, 3, 4]]
            carriers = path[:, None] + around
        is_long = np.ptp(path, axis=0).max() > FOLLOWED_WAY * self.reach
        way = path - path[0] if is_long else np.zeros((len(path), 3))  # of the camera
        near = np.linalg.norm(carriers - path[:, None], axis=2) < ASTRAY * self.reach
        rim = path[:, None] + self.radius * np.vstack([np.eye(3), -np.eye(3)])
        mark = MARK_RADIUS * self.config.wing_span * self.reach * np.vstack([np.eye(3), -np.eye(3)])
        marks = (carriers[near][:, None] + mark).reshape(-1, 3)
        bodies = np.concatenate([marks, rim.reshape(-1, 3)])
        repeats = 6 * near.sum(axis=1)
        ways = np.concatenate([np.repeat(way, repeats, axis=0), np.repeat(way, 6, axis=0)])
        eye, target = _view(bodies - ways, path=path)
        middle = (path.min(axis=0) + path.max(axis=0)) / 2
        floor = np.array([*middle[:2], bodies[:, 2].min() - GROUND_CLEARANCE * self.reach])
        self._stage = Stage(origin=path[0], target=target, floor=floor) if is_long else None

        for edge in ("top_color", "bottom_color"):
            background = list(_rgb(self.config.background_colour))
            meshcat.SetProperty("/Background/<object>", edge, background)
        meshcat.SetProperty("/Axes", "visible", False)
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

        scale = 10.0 ** np.round(np.log10(self.reach / 2))  # 1: squares of 0.5 m
        meshcat.SetTransform("/Grid", RigidTransform(floor))
        meshcat.SetProperty("/Grid/<object>", "scale", [scale, scale, scale])
        meshcat.SetProperty("/Grid/<object>", "opacity", GRID_OPACITY)

    def show(self, canvas: Canvas, snapshot: Snapshot) -> None:
        """Moves the objects to an instant; instants have to follow each other in time."""
        bodies = np.array([snapshot.load, snapshot.reference])
        X_WL, X_WR = _poses(rotation_matrix(bodies[:, :4]), bodies[:, 4:])
        canvas.place(f"{ROOT}/load", X_WL)
        canvas.place(f"{ROOT}/reference", X_WR)
        if self._stage is not None:
            canvas.follow(snapshot.reference[4:], self._stage)
        p_WA = self._attachments @ X_WL[:3, :3].T + X_WL[:3, 3]
        p_WC = snapshot.carriers
        cables, lengths = _between(p_WA, p_WC)
        speeds = np.sqrt((snapshot.velocities**2).sum(axis=1))
        flies = speeds > _SMALL
        self._headings[flies] = snapshot.velocities[flies] / speeds[flies, None]
        carriers = _poses(_attitudes(self._headings, up=p_WC - p_WA), p_WC)
        tensions = snapshot.tensions.tolist()
        for i, (speed, length) in enumerate(zip(speeds.tolist(), lengths.tolist(), strict=True)):
            canvas.place(f"{ROOT}/cables/{i}", cables[i], length)
            canvas.paint(f"{ROOT}/cables/{i}", self.cable_colour(tensions[i]), 1.0)
            canvas.place(f"{ROOT}/carriers/{i}", carriers[i])
            colour = self.mark_colour(speed, snapshot.speed_bound)
            canvas.paint(f"{ROOT}/carriers/{i}/mark", colour, self.config.mark_opacity)
        self._extend_trails(canvas, snapshot.time, np.vstack([snapshot.load[4:], p_WC]))

    def mark_colour(self, speed: float, speed_bound: float) -> Colour:
        """The colour of the mark around a carrier: the first of them at ε and below."""
        excess = np.inf if speed_bound <= 0 else speed / speed_bound - 1
        return _shade(self._mark_colours, excess / (self.config.mark_range - 1))

    def cable_colour(self, tension: float) -> Colour:
        """The colour of a cable."""
        if tension <= 0:
            return self._slack_colour
        full = self.config.tension_range * self._weight_share
        return _shade(self._cable_colours, tension / full)

    def _extend_trails(self, canvas: Canvas, time: float, bodies: NDArray) -> None:
        """Adds a piece to each trail (1 + n), where it is time for one."""
        pieces = self.config.trail_pieces
        if self._trail_ends is None:
            self._trail_ends, self._trail_start = bodies.copy(), time
            for body, colour in enumerate(self._trail_colours):
                for piece in range(pieces):
                    canvas.paint(f"{ROOT}/trails/{body}/{piece}", colour, 0.0)
            return
        if time < self._trail_start + self._piece_time - 1e-9:
            return
        newest = self._trail_length
        poses, lengths = _between(self._trail_ends, bodies)
        for body, colour in enumerate(self._trail_colours):
            canvas.place(f"{ROOT}/trails/{body}/{newest % pieces}", poses[body], lengths[body])
            for age, opacity in self._trail_opacities.items():
                if age <= newest:
                    path = f"{ROOT}/trails/{body}/{(newest - age) % pieces}"
                    canvas.paint(path, colour, opacity, fades=age > 0)
        self._trail_ends, self._trail_start = bodies.copy(), time
        self._trail_length += 1

    def _draw_load(self, meshcat: Meshcat, path: str, bar: float, rgba: Rgba) -> None:
        """A frame: bars around the attachments and spokes to the centre of mass."""
        attachments = self._attachments
        offsets = attachments - attachments.mean(axis=0)
        plane = np.linalg.svd(offsets)[2][:2]  # the two directions in which they spread most
        rim = attachments[np.argsort(np.arctan2(*(plane @ offsets.T)))]
        edges = [*zip(rim, np.roll(rim, -1, axis=0), strict=True)]
        spokes = [(np.zeros(3), end) for end in attachments]
        poses, lengths = _between(*np.array([*edges, *spokes]).swapaxes(0, 1))
        for k, (pose, length) in enumerate(zip(poses, lengths, strict=True)):
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


def _trail_opacity(age: int, pieces: int) -> float:
    """The opacity of a piece that has `age` newer ones; the oldest will be used again."""
    if age >= pieces - 1:
        return 0.0
    return float(np.ceil(TRAIL_OPACITIES * (1 - age / (pieces - 1))) / TRAIL_OPACITIES)


def _poses(rotations: NDArray, positions: NDArray) -> NDArray:
    """Poses (k, 4, 4) of rotation matrices (k, 3, 3), or one for all, and positions (k, 3)."""
    poses = np.zeros((len(positions), 4, 4))
    poses[:, :3, :3] = rotations
    poses[:, :3, 3] = positions
    poses[:, 3, 3] = 1.0
    return poses


def _between(starts: NDArray, ends: NDArray) -> tuple[NDArray, NDArray]:
    """Where cylinders lie that connect points (k, 3), and their lengths (k,), never quite zero."""
    axes = _directions(ends - starts, otherwise=np.array([0.0, 0.0, 1.0]))
    lengths = np.maximum(np.sqrt(((ends - starts) ** 2).sum(axis=1)), _SMALL)
    sides = _sides(axes)
    rotations = np.stack([sides, cross(axes, sides), axes], axis=2)
    return _poses(rotations, (starts + ends) / 2), lengths


def _attitudes(headings: NDArray, up: NDArray) -> NDArray:
    """Attitudes (k, 3, 3) with the nose (x) along unit vectors and the top (z) towards `up`."""
    across = up - (up * headings).sum(axis=1, keepdims=True) * headings
    tops = _directions(across, otherwise=_sides(headings))
    return np.stack([headings, cross(tops, headings), tops], axis=2)


def _sides(axes: NDArray) -> NDArray:
    """A unit vector across each of some (k, 3)."""
    others = np.where(np.abs(axes[:, :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    return _directions(cross(others, axes), otherwise=others)


def _directions(vectors: NDArray, *, otherwise: NDArray) -> NDArray:
    """Unit vectors along some (k, 3), or the others where these are (almost) zero."""
    lengths = np.sqrt((vectors**2).sum(axis=1, keepdims=True))
    return np.where(lengths > _SMALL, vectors / np.maximum(lengths, _SMALL), otherwise)


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


def _shades(colours: list[str]) -> list[Colour]:
    """Some at equal steps along the way through all of the colours."""
    stops = np.linspace(0, 1, len(colours))
    channels = np.transpose([_rgb(colour) for colour in colours])
    mixed = [np.interp(np.linspace(0, 1, SHADES), stops, channel) for channel in channels]
    return [tuple(shade) for shade in np.transpose(mixed).tolist()]


def _shade(shades: list[Colour], share: float) -> Colour:
    """The one at a share from 0 to 1 of the way."""
    return shades[round(min(max(share, 0.0), 1.0) * (SHADES - 1))]


def _rgb(colour: str) -> Colour:
    red, green, blue = bytes.fromhex(colour[1:])
    return red / 255, green / 255, blue / 255


def _check(config: SceneConfig) -> None:
    lists = {
        name: getattr(config, name) for name in ("carrier_colours", "mark_colours", "cable_colours")
    }
    for name, least in (("carrier_colours", 1), ("mark_colours", 2), ("cable_colours", 2)):
        colours = lists[name]
        require(len(colours) >= least, f"scene.{name}", colours, f"give {least} or more of #rrggbb")
    singles = {
        name: [getattr(config, name)]
        for name in ("load_colour", "reference_colour", "slack_colour", "background_colour")
    }
    for name, colours in (lists | singles).items():
        for colour in colours:
            require(
                isinstance(colour, str) and re.fullmatch("#[0-9a-fA-F]{6}", colour),
                f"scene.{name}",
                colour,
                "give a colour as #rrggbb, such as #0072b2",
            )
    require_positive(
        "scene",
        wing_span=config.wing_span,
        cable_radius=config.cable_radius,
        bar_radius=config.bar_radius,
        trail_radius=config.trail_radius,
        trail_time=config.trail_time,
        tension_range=config.tension_range,
    )
    require_non_negative(
        "scene", mark_opacity=config.mark_opacity, reference_opacity=config.reference_opacity
    )
    require(
        is_number(config.mark_range) and config.mark_range > 1,
        "scene.mark_range",
        config.mark_range,
        "give a number greater than 1",
    )
    require(
        isinstance(config.trail_pieces, int) and 2 <= config.trail_pieces <= 1000,
        "scene.trail_pieces",
        config.trail_pieces,
        "give a whole number from 2 to 1000",
    )
