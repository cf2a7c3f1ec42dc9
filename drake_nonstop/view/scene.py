"""The objects of a run in Meshcat: load, reference, cables, carriers and trails."""

import math

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Cylinder, Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform

from drake_nonstop.mechanics.lumped_cable import nodes_of
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.signals import AircraftState, Pose
from drake_nonstop.model.system import aircraft_in, overridden
from drake_nonstop.scenario.obstacles import GroundConfig
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.validation import require_ranges
from drake_nonstop.view.bodies import (
    AXIS_COLOURS,
    CABLE_COLOURS,
    GOAL_COLOUR,
    LOAD_COLOUR,
    MARK_COLOURS,
    OBSTACLE_COLOUR,
    REFERENCE_COLOUR,
    SLACK_COLOUR,
    X_AXIS,
    Colour,
    Part,
    Sizes,
    Snapshot,
    carrier_colour,
    carrier_parts,
    carrier_rotations,
    cylinder_poses,
    load_parts,
    obstacle_part,
    rgb,
    shade,
    stack_poses,
    stall_shares,
    tube,
    unit_vectors,
)
from drake_nonstop.view.camera import fit_view, look
from drake_nonstop.view.canvas import Canvas

ROOT = "/nonstop"  # of the objects' paths in Meshcat
MARK_RANGE = 1.5  # ε, up to which marks change their colour
COLOURED_FROM = 0.5  # of the stall, where wings begin to change their colour
TENSION_RANGE = 2.0  # of a cable's share of the load's weight, up to which it darkens
_REFERENCE_OPACITY, _MARK_OPACITY, _OBSTACLE_OPACITY, _GRID_OPACITY = 0.2, 0.25, 0.6, 0.2
_GROUND_OPACITY = 0.2  # obstacles stand out from it
_REFERENCE_BAR_RATIO = 1.7  # to the load's bars, which the reference's enclose: both are seen
_GOAL_BAR_RATIO = 0.4  # to the load's bars, which hide the goal's once the load is there
_TRAIL_RADIUS = 0.0025  # reaches
_FLOWN_RATIO, _DESIRED_RATIO = 0.5, 3.0  # to trails' radius: the desired path encloses the flown
_PATH_POINTS = 300
_MARK_RADIUS = 0.42  # of the wing span
_TRAIL_PIECES, _TRAIL_OPACITIES = 40, 8  # of one trail, and how many differ
_FOLLOWING_EXTENT = 1.5  # reaches; along a longer path the camera follows the reference
_FARTHEST_CARRIER = 3.0  # reaches from the reference; one farther away may be out of view
_GROUND_CLEARANCE = 0.3  # reaches, from the lowest point to the grid
_GROUND_WIDTH = 200.0  # reaches
_GRID_SQUARE = 0.5  # m, of Meshcat's grid
_MOST_PIECES = 6  # of a cable with nodes: more would make recordings large
_SIX_DIRECTIONS = np.vstack([np.eye(3), -np.eye(3)])


class Scene:
    """The objects of a run, which `draw` makes and `show` moves.

    - The load is a frame around its attachments. Its reference is a translucent copy of it.
    - Cables darken with their tension; slack ones have a colour of their own. Those with nodes are
      lines through some of them, of six pieces at most, evenly chosen.
    - Carriers have no attitude in the model: they are drawn along their velocity, with their top
      away from the cable.
    - The mark around a carrier turns from green to red as its speed decreases to ε.
    - Trails show the past paths of load and carriers.
    - Obstacles stand still.

    Where the system has aircraft, the carriers have an attitude: along the air that they meet, with
    bank and angle of attack. Then there are no marks; the wings turn from green to red towards the
    stall.

    Args:
        scenario: has the system, with what is simulated otherwise, the obstacles and sizes.
        nodes: of each cable, which a snapshot's `cable_state` has; 0: cables are straight.

    Raises:
        ScenarioError: a field of the scenario's `scene` is out of range.
    """

    def __init__(self, scenario: Scenario, nodes: int = 0):
        require_ranges("scene", scenario.scene)
        system = overridden(scenario.system, scenario.simulated)
        self._obstacles = scenario.obstacles
        # Indices of a cable's ends and nodes between which it is drawn.
        self.pieces = min(nodes + 1, _MOST_PIECES)  # cylinders that a cable is drawn as
        self._joints = np.linspace(0, nodes + 1, self.pieces + 1).round().astype(int)
        self._attachments = np.array(system.attachments)
        self._n = len(self._attachments)
        self._sizes = Sizes.of(system, scenario.scene)
        self._full_tension = TENSION_RANGE * system.load_mass * system.gravity / self._n  # N
        fading = scenario.scene.trail_time * np.sqrt(self._sizes.reach / system.gravity)
        self._piece_time = fading / _TRAIL_PIECES  # s
        self._aircraft = aircraft_in(system)
        self._trail_colours = [rgb(LOAD_COLOUR), *(rgb(carrier_colour(i)) for i in range(self._n))]
        self._start: tuple[NDArray, NDArray] | None = None  # the reference and grid, to be followed
        # Once the stage is set: of the narrowest window with all in view, and a grid's square in m.
        self.aspect_ratio, self.square = 1.0, 0.0
        self._reset()

    def _reset(self) -> None:
        """Starts without earlier headings and trails."""
        self._headings = np.tile(X_AXIS, (self._n, 1))
        self._trail_ends: NDArray | None = None  # (1 + n, 3), m, starts of the next pieces
        self._trail_start = 0.0  # s, of the next pieces
        self._trail_length = 0  # pieces, with those that have faded

    def draw(self, meshcat: Meshcat) -> None:
        """Makes the objects in a Meshcat and removes those of an earlier scene there."""
        self._reset()
        sizes = self._sizes
        meshcat.Delete(ROOT)
        for name, radius, colour, opacity in (
            ("load", sizes.bar, LOAD_COLOUR, 1.0),
            ("reference", _REFERENCE_BAR_RATIO * sizes.bar, REFERENCE_COLOUR, _REFERENCE_OPACITY),
        ):
            _draw(meshcat, name, load_parts(self._attachments, radius), colour, opacity)
        for each in self._obstacles:
            part = obstacle_part(each, _GROUND_WIDTH * sizes.reach)
            opacity = _GROUND_OPACITY if isinstance(each, GroundConfig) else _OBSTACLE_OPACITY
            _draw(meshcat, "obstacles", [part], OBSTACLE_COLOUR, opacity)
        for i in range(self._n):
            _draw(meshcat, f"carriers/{i}", carrier_parts(sizes.wing_span), carrier_colour(i))
            # Marks and trails start translucent: Meshcat prepares a material for that only here.
            if self._aircraft is None:
                mark = [Part(name="mark", shape=Sphere(_MARK_RADIUS * sizes.wing_span))]
                _draw(meshcat, f"carriers/{i}", mark, MARK_COLOURS[-1], _MARK_OPACITY)
            unit = Cylinder(sizes.cable, 1.0)  # m, to be scaled
            for path in self._cable_paths(i):
                meshcat.SetObject(path, unit, Rgba(*rgb(CABLE_COLOURS[0])))
        unit = Cylinder(_TRAIL_RADIUS * sizes.reach, 1.0)
        for body, trail in enumerate(self._trail_colours):
            for piece in range(_TRAIL_PIECES):
                meshcat.SetObject(f"{ROOT}/trails/{body}/{piece}", unit, Rgba(*trail, 0.0))

    def draw_task(self, meshcat: Meshcat, snapshots: list[Snapshot]) -> None:
        """Draws the load's flown and desired paths, and a frame at its goal, the last reference."""
        thin = _TRAIL_RADIUS * self._sizes.reach
        chosen = np.linspace(0, len(snapshots) - 1, min(len(snapshots), _PATH_POINTS)).astype(int)
        flown, desired = (
            np.array([(shown.load, shown.reference)[k].position for shown in snapshots])[chosen]
            for k in range(2)
        )
        dark, translucent = rgb(LOAD_COLOUR), (*rgb(REFERENCE_COLOUR), _REFERENCE_OPACITY)
        for name, path, radius, rgba in (
            ("flown", flown, _FLOWN_RATIO * thin, Rgba(*dark)),
            ("desired", desired, _DESIRED_RATIO * thin, Rgba(*translucent)),
        ):
            meshcat.SetTriangleMesh(f"{ROOT}/paths/{name}", *tube(path, radius), rgba)
        parts = load_parts(self._attachments, _GOAL_BAR_RATIO * self._sizes.bar)
        _draw(meshcat, "goal", parts, GOAL_COLOUR)
        (goal,) = _poses([snapshots[-1].reference])
        meshcat.SetTransform(f"{ROOT}/goal", goal)

    def set_stage(self, meshcat: Meshcat, path: NDArray, carriers: NDArray | None = None) -> None:
        """Sets a background, a camera that sees everything, its light, axes and a grid below.

        Along a long path, and one that is not known, the camera follows the reference; else it
        stands still.

        Args:
            meshcat: the Meshcat to set.
            path: (k, 3), m, positions of the load's reference; one where the others are not known.
            carriers: (k, n, 3), m, at the same instants, where they are known. Those far from
                the load may be out of view.
        """
        reach = self._sizes.reach
        if carriers is None:
            carriers = path[:, None] + reach * _SIX_DIRECTIONS[:5]  # all but straight below
        follows = len(path) == 1 or np.ptp(path, axis=0).max() > _FOLLOWING_EXTENT * reach
        apart = np.linalg.norm(carriers - path[:, None], axis=2)
        at = np.nonzero(apart < _FARTHEST_CARRIER * reach)
        around = _MARK_RADIUS * self._sizes.wing_span * _SIX_DIRECTIONS
        load = path[:, None] + self._sizes.radius * _SIX_DIRECTIONS
        points = np.concatenate([carriers[at][:, None] + around, load])
        moved = path - path[0] if follows else np.zeros(path.shape)  # the camera
        seen = (points - np.concatenate([moved[at[0]], moved])[:, None]).reshape(-1, 3)
        eye, target, self.aspect_ratio = fit_view(seen, path=path)
        look(meshcat, eye, target)
        grounds = [each.height for each in self._obstacles if isinstance(each, GroundConfig)]
        lowest = max([points[..., 2].min() - _GROUND_CLEARANCE * reach, *grounds])
        floor = np.array([*(path.min(axis=0) + path.max(axis=0))[:2] / 2, lowest])
        scale = 10.0 ** np.round(np.log10(reach / 2))
        self.square = _GRID_SQUARE * scale
        meshcat.SetTransform("/Grid", RigidTransform(floor))
        meshcat.SetProperty("/Grid/<object>", "scale", [scale, scale, scale])
        meshcat.SetProperty("/Grid/<object>", "opacity", _GRID_OPACITY)
        corner = 0.7 * seen.min(axis=0) + 0.3 * seen.mean(axis=0)
        thick = 2 * _TRAIL_RADIUS * reach
        for name, axis, colour in zip("xyz", np.eye(3), AXIS_COLOURS, strict=True):
            bar = tube(np.array([corner, corner + self.square * axis]), thick)
            meshcat.SetTriangleMesh(f"/axes/{name}", *bar, Rgba(*rgb(colour)))
        self._start = (path[0], floor) if follows else None

    def show(self, canvas: Canvas, snapshot: Snapshot) -> None:
        """Moves the objects to an instant, which has to be later than the one shown before."""
        X_WL, X_WR = _poses([snapshot.load, snapshot.reference])
        canvas.place(f"{ROOT}/load", X_WL)
        canvas.place(f"{ROOT}/reference", X_WR)
        if self._start is not None:
            # A recording cannot move its camera: all objects are shifted the opposite way.
            origin, floor = self._start
            shift = origin - snapshot.reference.position
            moved = stack_poses(np.eye(3), np.array([shift, floor + shift]))
            canvas.place(ROOT, moved[0])
            canvas.place("/Grid", moved[1])
        p_WA = self._attachments @ X_WL[:3, :3].T + X_WL[:3, 3]
        p_WC, velocities = snapshot.carriers.positions, snapshot.carriers.velocities
        self._show_cables(canvas, p_WA, snapshot)
        self._headings = unit_vectors(velocities, otherwise=self._headings)
        rotations = carrier_rotations(
            velocities,
            p_WC - p_WA,
            otherwise=self._headings,
            aircraft=self._aircraft,
            aircraft_state=snapshot.aircraft_state,
            wind=snapshot.wind,
        )
        for i, pose in enumerate(stack_poses(rotations, p_WC)):
            canvas.place(f"{ROOT}/carriers/{i}", pose)
        for i, (part, colour, opacity) in enumerate(self._judged(snapshot)):
            canvas.paint(f"{ROOT}/carriers/{i}/{part}", colour, opacity)
        self._extend_trails(canvas, snapshot.time, np.vstack([snapshot.load.position, p_WC]))

    def _judged(self, snapshot: Snapshot) -> list[tuple[str, Colour, float]]:
        """Of each carrier the part that shows how near it is to its bound, and how."""
        if self._aircraft is None:
            speeds = np.sqrt((snapshot.carriers.velocities**2).sum(axis=1)).tolist()
            colours = [mark_colour(speed, snapshot.speed_bound) for speed in speeds]
            return [("mark", colour, _MARK_OPACITY) for colour in colours]
        if snapshot.aircraft_state is None:
            return []
        shares = stall_shares(self._aircraft, AircraftState.view(snapshot.aircraft_state))
        return [("wing", wing_colour(share), 1.0) for share in shares.tolist()]

    def _cable_paths(self, i: int) -> list[str]:
        """The paths of a cable's pieces, from the load on."""
        path = f"{ROOT}/cables/{i}"
        return [path] if self.pieces == 1 else [f"{path}/{k}" for k in range(self.pieces)]

    def _show_cables(self, canvas: Canvas, attachments: NDArray, snapshot: Snapshot) -> None:
        """Cables from the attachments (n, 3), m, in W, through their nodes, to the carriers."""
        points = np.stack([attachments, snapshot.carriers.positions])
        if self.pieces > 1 and snapshot.cable_state is not None:
            nodes, _ = nodes_of(snapshot.cable_state, self._n)
            points = np.concatenate([points[:1], nodes, points[1:]])[self._joints]
        points = points.swapaxes(0, 1)  # (n, points, 3)
        poses, lengths = cylinder_poses(points[:, :-1].reshape(-1, 3), points[:, 1:].reshape(-1, 3))
        shares = (snapshot.tensions / self._full_tension).tolist()
        colours = [shade(CABLE_COLOURS, s) if s > 0 else rgb(SLACK_COLOUR) for s in shares]
        paths = [(path, i) for i in range(self._n) for path in self._cable_paths(i)]
        for (path, i), pose, length in zip(paths, poses, lengths.tolist(), strict=True):
            canvas.place(path, pose, length)
            canvas.paint(path, colours[i], 1.0)

    def _extend_trails(self, canvas: Canvas, time: float, bodies: NDArray) -> None:
        """Adds a piece to each trail, from its last end to `bodies` (1 + n, 3), when one is due."""
        if self._trail_ends is None:
            self._trail_ends, self._trail_start = bodies.copy(), time
            for body, colour in enumerate(self._trail_colours):
                for piece in range(_TRAIL_PIECES):
                    canvas.paint(f"{ROOT}/trails/{body}/{piece}", colour, 0.0)
            return
        if time < self._trail_start + self._piece_time - 1e-9:
            return
        newest = self._trail_length
        poses, lengths = cylinder_poses(self._trail_ends, bodies)
        for body, colour in enumerate(self._trail_colours):
            trail = f"{ROOT}/trails/{body}"
            canvas.place(f"{trail}/{newest % _TRAIL_PIECES}", poses[body], lengths[body])
            for age in range(min(newest + 1, _TRAIL_PIECES)):  # the oldest is used again
                opacity = math.ceil(_TRAIL_OPACITIES * (1 - age / (_TRAIL_PIECES - 1)))
                path = f"{trail}/{(newest - age) % _TRAIL_PIECES}"
                canvas.paint(path, colour, opacity / _TRAIL_OPACITIES, fades=age > 0)
        self._trail_ends, self._trail_start = bodies.copy(), time
        self._trail_length += 1


def mark_colour(speed: float, speed_bound: float) -> Colour:
    """The colour of the mark around a carrier; both speeds in m/s."""
    excess = np.inf if speed_bound <= 0 else speed / speed_bound - 1
    return shade(MARK_COLOURS, excess / (MARK_RANGE - 1))


def wing_colour(share: float) -> Colour:
    """The colour of the wing of an aircraft; the share is 1 where it stalls."""
    return shade(MARK_COLOURS, (1 - share) / (1 - COLOURED_FROM))


def _poses(poses: list[Pose]) -> NDArray:
    quaternions = np.array([pose.quaternion for pose in poses])
    return stack_poses(rotation_matrix(quaternions), np.array([pose.position for pose in poses]))


def _draw(
    meshcat: Meshcat, name: str, parts: list[Part], colour: str, opacity: float = 1.0
) -> None:
    for part in parts:
        path = f"{ROOT}/{name}/{part.name}"
        meshcat.SetObject(path, part.shape, Rgba(*rgb(colour), opacity))
        meshcat.SetTransform(path, part.pose)
