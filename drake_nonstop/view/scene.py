"""The objects of a run in Meshcat: load, reference, cables, carriers and trails."""

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Cylinder, Meshcat, MeshcatCone, Rgba, Sphere
from pydrake.math import RigidTransform

from drake_nonstop.mechanics.aircraft import Aircraft, stall_speed
from drake_nonstop.mechanics.lumped_cable import nodes_of
from drake_nonstop.mechanics.rotation import rotation_matrix
from drake_nonstop.mechanics.signals import AircraftState
from drake_nonstop.model.system import Model, SystemParameters, aircraft_in
from drake_nonstop.scenario.obstacles import GroundConfig, Obstacle
from drake_nonstop.scenario.scene_config import SceneConfig
from drake_nonstop.validation import require_ranges
from drake_nonstop.view.bodies import (
    SMALL,
    X_AXIS,
    Colour,
    Part,
    Snapshot,
    carrier_parts,
    carrier_rotations,
    cylinder_poses,
    load_parts,
    make_shades,
    obstacle_part,
    pick_shade,
    rgb,
    stack_poses,
    tube,
    unit_vectors,
)
from drake_nonstop.view.canvas import ROOT, Canvas, FollowingCamera, fit_view, look

_REFERENCE_BAR_RATIO = 1.7  # to the load's bars, which the reference's enclose: both are seen
_GOAL_BAR_RATIO = 0.4  # to the load's bars, which hide the goal's once the load is there
_FLOWN_RATIO, _DESIRED_RATIO = 0.5, 3.0  # to trails' radius: the desired path encloses the flown
_PATH_POINTS = 300
_MARK_RADIUS = 0.42  # of the wing span
_TRAIL_OPACITIES = 8  # different ones, of a trail's pieces
COLOURED_FROM = 0.5  # of the stall, where wings begin to change their colour
_LEAST_WIND = 0.05  # m/s, that is shown
_ARROW_TIME = 0.05  # reaches per m/s, the wind's arrow
_ARROW_HEIGHT = 0.3  # reaches, above the load's reference
_ARROW_RADIUS = 0.006  # reaches
_FOLLOWING_EXTENT = 1.5  # reaches; along a longer path the camera follows the reference
_FARTHEST_CARRIER = 3.0  # reaches from the reference; one farther away may be out of view
_GROUND_CLEARANCE = 0.3  # reaches, from the lowest point to the grid
_GROUND_WIDTH = 200.0  # reaches
_GRID_OPACITY = 0.2
_MOST_PIECES = 6  # of a cable with nodes: more would make recordings large
_SIX_DIRECTIONS = np.vstack([np.eye(3), -np.eye(3)])
_HEAD_LENGTH, _HEAD_RADIUS = 10.0, 3.0  # of the arrow's radius


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
    stall. The wind at the load is an arrow above it.

    Args:
        system: attachments, cable length, load mass and gravity of what is shown.
        config: colours and sizes.
        obstacles: of the scenario.
        nodes: of each cable, which a snapshot's `cable_state` has; 0: cables are straight.

    Raises:
        ScenarioError: a field of the config is out of range.
    """

    def __init__(
        self,
        system: SystemParameters | Model,
        config: SceneConfig | None = None,
        obstacles: Sequence[Obstacle] = (),
        *,
        nodes: int = 0,
    ):
        self.config = config or SceneConfig()
        require_ranges("scene", self.config)
        self._obstacles = obstacles
        # Indices of a cable's ends and nodes between which it is drawn.
        pieces = min(nodes + 1, _MOST_PIECES)
        self._joints = np.linspace(0, nodes + 1, pieces + 1).round().astype(int)
        self._attachments = np.array(system.attachments)
        self._n = len(self._attachments)
        self.radius = float(np.max(np.linalg.norm(self._attachments, axis=1)))  # m, of the load
        self.reach = self.radius + float(np.max(system.cable_length))
        self.cable_radius = self.config.cable_radius * self.reach  # m
        self.bar_radius = max(self.config.bar_radius * self.radius, 2 * self.cable_radius)  # m
        self.wing_span = self.config.wing_span * self.reach  # m
        self.weight_share = system.load_mass * system.gravity / self._n  # N, of a cable
        fading = self.config.trail_time * np.sqrt(self.reach / system.gravity)
        self.piece_time = fading / self.config.trail_pieces  # s
        self._mark_colours = make_shades(self.config.mark_colours)
        self._cable_colours = make_shades(self.config.cable_colours)
        self._slack_colour = rgb(self.config.slack_colour)
        palette = itertools.cycle(self.config.carrier_colours)
        self.carrier_colours = [rgb(next(palette)) for _ in range(self._n)]
        self.load_colour = rgb(self.config.load_colour)
        self._wind_colour = rgb(self.config.wind_colour)
        self._aircraft = aircraft_in(system)
        self._trail_colours = [self.load_colour, *self.carrier_colours]
        # Of a piece by the number of newer ones; the oldest is invisible, and used again.
        fresh = 1 - np.arange(self.config.trail_pieces) / (self.config.trail_pieces - 1)
        opacities = np.ceil(_TRAIL_OPACITIES * fresh) / _TRAIL_OPACITIES
        ages = np.flatnonzero(np.diff(opacities, prepend=2.0))  # where it changes
        self._trail_opacities = {int(age): float(opacities[age]) for age in ages}
        self._camera: FollowingCamera | None = None
        self.aspect_ratio = 1.0  # of the narrowest window with all in view, once the stage is set
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
        config, root = self.config, ROOT
        bar, span = self.bar_radius, self.wing_span
        translucent = Rgba(*rgb(config.reference_colour), config.reference_opacity)
        meshcat.Delete(root)
        load, reference = (
            load_parts(self._attachments, radius) for radius in (bar, _REFERENCE_BAR_RATIO * bar)
        )
        _draw(meshcat, f"{root}/load", load, Rgba(*self.load_colour))
        _draw(meshcat, f"{root}/reference", reference, translucent)
        solid = Rgba(*rgb(config.obstacle_colour), config.obstacle_opacity)
        parts = [obstacle_part(each, _GROUND_WIDTH * self.reach) for each in self._obstacles]
        _draw(meshcat, f"{root}/obstacles", parts, solid)
        for i, colour in enumerate(self.carrier_colours):
            _draw(meshcat, f"{root}/carriers/{i}", carrier_parts(span), Rgba(*colour))
            # Marks and trails start translucent: Meshcat prepares a material for that only here.
            mark = Rgba(*self._mark_colours[-1], config.mark_opacity)
            if self._aircraft is None:
                meshcat.SetObject(f"{root}/carriers/{i}/mark", Sphere(_MARK_RADIUS * span), mark)
            unit = Cylinder(self.cable_radius, 1.0)  # m, to be scaled
            for path in self._cable_paths(i):
                meshcat.SetObject(path, unit, Rgba(*self._cable_colours[0]))
        if self._aircraft is not None:
            shaft, head = (Rgba(*self._wind_colour, 0.0) for _ in range(2))
            radius = _ARROW_RADIUS * self.reach
            meshcat.SetObject(f"{root}/wind/shaft", Cylinder(radius, 1.0), shaft)
            cone = MeshcatCone(_HEAD_LENGTH * radius, _HEAD_RADIUS * radius, _HEAD_RADIUS * radius)
            meshcat.SetObject(f"{root}/wind/head", cone, head)
        unit = Cylinder(config.trail_radius * self.reach, 1.0)
        for body, colour in enumerate(self._trail_colours):
            for piece in range(config.trail_pieces):
                meshcat.SetObject(f"{root}/trails/{body}/{piece}", unit, Rgba(*colour, 0.0))

    def draw_task(self, meshcat: Meshcat, flown: NDArray, desired: NDArray, end: Snapshot) -> None:
        """Draws paths (k, 3) of the load in m, and a frame at its goal, the reference's end."""
        config, thin = self.config, self.config.trail_radius * self.reach
        reference = rgb(config.reference_colour)
        for name, path, radius, rgba in (
            ("flown", flown, _FLOWN_RATIO * thin, Rgba(*self.load_colour)),
            ("desired", desired, _DESIRED_RATIO * thin, Rgba(*reference, config.reference_opacity)),
        ):
            chosen = np.linspace(0, len(path) - 1, min(len(path), _PATH_POINTS)).astype(int)
            meshcat.SetTriangleMesh(f"{ROOT}/paths/{name}", *tube(path[chosen], radius), rgba)
        parts = load_parts(self._attachments, _GOAL_BAR_RATIO * self.bar_radius)
        _draw(meshcat, f"{ROOT}/goal", parts, Rgba(*reference))
        (goal,) = stack_poses(rotation_matrix(end.reference_quaternion), desired[-1:])
        meshcat.SetTransform(f"{ROOT}/goal", goal)

    def set_stage(self, meshcat: Meshcat, path: NDArray, carriers: NDArray | None = None) -> None:
        """Sets a plain background, a camera that sees everything, its light and a grid below.

        Along a long path the camera follows the reference; else it stands still.

        Args:
            meshcat: the Meshcat to set.
            path: (k, 3), m, positions of the load's reference.
            carriers: (k, n, 3), m, at the same instants, where they are known. Those far from
                the load may be out of view.
        """
        if carriers is None:
            carriers = path[:, None] + self.reach * _SIX_DIRECTIONS[:5]  # all but straight below
        follows = np.ptp(path, axis=0).max() > _FOLLOWING_EXTENT * self.reach
        apart = np.linalg.norm(carriers - path[:, None], axis=2)
        at = np.nonzero(apart < _FARTHEST_CARRIER * self.reach)
        radius = _MARK_RADIUS * self.wing_span
        points = np.concatenate(
            [
                carriers[at][:, None] + radius * _SIX_DIRECTIONS,
                path[:, None] + self.radius * _SIX_DIRECTIONS,
            ]
        )
        moved = path - path[0] if follows else np.zeros(path.shape)  # the camera
        seen = (points - np.concatenate([moved[at[0]], moved])[:, None]).reshape(-1, 3)
        eye, target, self.aspect_ratio = fit_view(seen, path=path)
        look(meshcat, eye, target, rgb(self.config.background_colour))
        middle = (path.min(axis=0) + path.max(axis=0)) / 2
        lowest = points[..., 2].min() - _GROUND_CLEARANCE * self.reach
        grounds = [each.height for each in self._obstacles if isinstance(each, GroundConfig)]
        lowest = max([lowest, *grounds])
        floor = np.array([*middle[:2], lowest])
        scale = 10.0 ** np.round(np.log10(self.reach / 2))  # 1: squares of 0.5 m
        meshcat.SetTransform("/Grid", RigidTransform(floor))
        meshcat.SetProperty("/Grid/<object>", "scale", [scale, scale, scale])
        meshcat.SetProperty("/Grid/<object>", "opacity", _GRID_OPACITY)
        camera = FollowingCamera(origin=path[0], target=target, floor=floor)
        self._camera = camera if follows else None

    def show(self, canvas: Canvas, snapshot: Snapshot) -> None:
        """Moves the objects to an instant, which has to be later than the one shown before."""
        quaternions = np.array([snapshot.load_quaternion, snapshot.reference_quaternion])
        positions = np.array([snapshot.load_position, snapshot.reference_position])
        X_WL, X_WR = stack_poses(rotation_matrix(quaternions), positions)
        canvas.place(f"{ROOT}/load", X_WL)
        canvas.place(f"{ROOT}/reference", X_WR)
        if self._camera is not None:
            canvas.follow(snapshot.reference_position, self._camera)
        p_WA = self._attachments @ X_WL[:3, :3].T + X_WL[:3, 3]
        p_WC = snapshot.carriers
        self._show_cables(canvas, p_WA, snapshot)
        speeds = np.sqrt((snapshot.velocities**2).sum(axis=1))
        self._headings = unit_vectors(snapshot.velocities, otherwise=self._headings)
        rotations = carrier_rotations(
            snapshot.velocities,
            p_WC - p_WA,
            otherwise=self._headings,
            aircraft=self._aircraft,
            aircraft_state=snapshot.aircraft_state,
            wind=snapshot.wind,
        )
        if self._aircraft is not None and snapshot.aircraft_state is not None:
            state = AircraftState.view(snapshot.aircraft_state)
            for i, share in enumerate(stall_shares(self._aircraft, state).tolist()):
                canvas.paint(f"{ROOT}/carriers/{i}/wing", self.wing_colour(share), 1.0)
            winds = np.zeros(3) if snapshot.wind is None else snapshot.wind
            at_load = snapshot.load_wind
            at_load = winds.reshape(-1, 3).mean(axis=0) if at_load is None else at_load
            self._show_wind(canvas, snapshot.reference_position, at_load)
        carriers = stack_poses(rotations, p_WC)
        for i, speed in enumerate(speeds.tolist()):
            canvas.place(f"{ROOT}/carriers/{i}", carriers[i])
            if self._aircraft is None:
                colour = self.mark_colour(speed, snapshot.speed_bound)
                canvas.paint(f"{ROOT}/carriers/{i}/mark", colour, self.config.mark_opacity)
        self._extend_trails(canvas, snapshot.time, np.vstack([snapshot.load_position, p_WC]))

    @property
    def pieces(self) -> int:
        """The number of cylinders that a cable is drawn as."""
        return len(self._joints) - 1

    def _cable_paths(self, i: int) -> list[str]:
        """The paths of a cable's pieces, from the load on."""
        path = f"{ROOT}/cables/{i}"
        return [path] if self.pieces == 1 else [f"{path}/{k}" for k in range(self.pieces)]

    def _show_cables(self, canvas: Canvas, attachments: NDArray, snapshot: Snapshot) -> None:
        """Cables from the attachments (n, 3), m, in W, through their nodes, to the carriers."""
        points = np.stack([attachments, snapshot.carriers])
        if self.pieces > 1 and snapshot.cable_state is not None:
            nodes, _ = nodes_of(snapshot.cable_state, self._n)
            points = np.concatenate([points[:1], nodes, points[1:]])[self._joints]
        points = points.swapaxes(0, 1)  # (n, points, 3)
        poses, lengths = cylinder_poses(points[:, :-1].reshape(-1, 3), points[:, 1:].reshape(-1, 3))
        colours = [self.cable_colour(tension) for tension in snapshot.tensions.tolist()]
        paths = [(path, i) for i in range(self._n) for path in self._cable_paths(i)]
        for (path, i), pose, length in zip(paths, poses, lengths.tolist(), strict=True):
            canvas.place(path, pose, length)
            canvas.paint(path, colours[i], 1.0)

    def mark_colour(self, speed: float, speed_bound: float) -> Colour:
        """The colour of the mark around a carrier; both speeds in m/s."""
        excess = np.inf if speed_bound <= 0 else speed / speed_bound - 1
        return pick_shade(self._mark_colours, excess / (self.config.mark_range - 1))

    def wing_colour(self, share: float) -> Colour:
        """The colour of the wing of an aircraft; the share is 1 where it stalls."""
        return pick_shade(self._mark_colours, (1 - share) / (1 - COLOURED_FROM))

    def cable_colour(self, tension: float) -> Colour:
        """The colour of a cable of this tension in N."""
        if tension <= 0:
            return self._slack_colour
        full = self.config.tension_range * self.weight_share
        return pick_shade(self._cable_colours, tension / full)

    def _show_wind(self, canvas: Canvas, load: NDArray, wind: NDArray) -> None:
        """An arrow above the load (3,), m, along the wind (3,), m/s, as long as it is strong."""
        speed = float(np.sqrt((wind**2).sum()))
        length = _ARROW_TIME * self.reach * speed
        direction = wind / max(speed, SMALL)
        start = load + np.array([0.0, 0.0, _ARROW_HEIGHT * self.reach])
        end = start + length * direction
        tip = end + _HEAD_LENGTH * _ARROW_RADIUS * self.reach * direction
        (shaft, head), _ = cylinder_poses(np.array([start, tip]), np.array([end, end]))
        head[:3, 3] = tip  # from which Meshcat's cone widens along z
        for part, pose, scale in (("shaft", shaft, max(length, SMALL)), ("head", head, 1.0)):
            path = f"{ROOT}/wind/{part}"
            canvas.place(path, pose, scale)
            canvas.paint(path, self._wind_colour, 1.0 if speed > _LEAST_WIND else 0.0)

    def _extend_trails(self, canvas: Canvas, time: float, bodies: NDArray) -> None:
        """Adds a piece to each trail, from its last end to `bodies` (1 + n, 3), when one is due."""
        pieces = self.config.trail_pieces
        if self._trail_ends is None:
            self._trail_ends, self._trail_start = bodies.copy(), time
            for body, colour in enumerate(self._trail_colours):
                for piece in range(pieces):
                    canvas.paint(f"{ROOT}/trails/{body}/{piece}", colour, 0.0)
            return
        if time < self._trail_start + self.piece_time - 1e-9:
            return
        newest = self._trail_length
        poses, lengths = cylinder_poses(self._trail_ends, bodies)
        for body, colour in enumerate(self._trail_colours):
            trail = f"{ROOT}/trails/{body}"
            canvas.place(f"{trail}/{newest % pieces}", poses[body], lengths[body])
            for age, opacity in self._trail_opacities.items():
                if age <= newest:
                    path = f"{trail}/{(newest - age) % pieces}"
                    canvas.paint(path, colour, opacity, fades=age > 0)
        self._trail_ends, self._trail_start = bodies.copy(), time
        self._trail_length += 1


def stall_shares(aircraft: Aircraft, state: AircraftState) -> NDArray:
    """How near aircraft (n,) are to their stall, by lift or by airspeed, from 0 to 1."""
    by_speed = (stall_speed(aircraft) / np.maximum(state.airspeed, SMALL)) ** 2
    return np.maximum(state.lift / aircraft.max_lift, by_speed)


def _draw(meshcat: Meshcat, path: str, parts: list[Part], rgba: Rgba) -> None:
    for part in parts:
        meshcat.SetObject(f"{path}/{part.name}", part.shape, rgba)
        meshcat.SetTransform(f"{path}/{part.name}", part.pose)
