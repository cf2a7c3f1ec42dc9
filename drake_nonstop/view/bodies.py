"""The scene's bodies: an instant of a run, their poses, the parts they are made of, and colours."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Box, Capsule, Ellipsoid, Shape, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from drake_nonstop.mechanics.aircraft import Aircraft, angle_of_attack, stall_speed
from drake_nonstop.mechanics.rotation import cross
from drake_nonstop.mechanics.signals import SIGNALS, AircraftState, CarrierStates, Pose
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.scenario.obstacles import GroundConfig, Obstacle, SphereConfig
from drake_nonstop.scenario.scene_config import SceneConfig

Colour = tuple[float, float, float]  # red, green and blue, from 0 to 1

# As #rrggbb; several of a body from the first value of what they show to its last.
LOAD_COLOUR, REFERENCE_COLOUR, OBSTACLE_COLOUR = "#30343b", "#8a4fff", "#a08c72"
# The palette starts with that of Okabe and Ito, which the colour-blind can tell apart.
CARRIER_COLOURS = (
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7"),
    *("#e69f00", "#56b4e9", "#7f5f3f", "#882255"),
)
MARK_COLOURS = "#e0101a", "#f5b800", "#18a048"  # at ε or the stall, between, and far from it
CABLE_COLOURS = "#9cc4e4", "#08306b"  # from no tension up
SLACK_COLOUR, GOAL_COLOUR = "#ff00c8", "#6b8e00"
AXIS_COLOURS = "#c00000", "#008000", "#0000c0"  # of x, y and z

SMALL = 1e-6  # m, m/s: a shorter vector has no direction
_BAR_RADIUS, _CABLE_RADIUS = 0.022, 0.0035  # of the load's radius, of the reach
_PLATE = 1e-4  # of its width: how thick the ground is
_SHADES = 32  # steps in which marks and cables change their colour
X_AXIS, Z_AXIS = np.eye(3)[[0, 2]]


def signal_sizes(names: Iterable[str], n: int) -> dict[str, int]:
    """The sizes of vector signals of the loop, for n carriers."""
    return {name: layout.count(n, 0) for name in names if (layout := SIGNALS[name]) is not None}


@dataclass(kw_only=True)
class Snapshot:
    """An instant of a run, all in the world frame; quaternions are of any norm."""

    time: float  # s
    load: Pose
    reference: Pose
    carriers: CarrierStates
    tensions: NDArray  # (n,), N
    speed_bound: float  # m/s
    # Where the carriers are aircraft, see `Scene`; None: unknown.
    aircraft_state: NDArray | None = None  # (4n,)
    wind: NDArray | None = None  # (3n,), m/s, at the carriers
    cable_state: NDArray | None = None  # (6Nn,), of cables with N nodes, see `LumpedCables`

    @classmethod
    def from_signals(
        cls,
        time: float,
        *,
        load_state: NDArray,
        reference: NDArray,
        carrier_state: NDArray,
        speed_bound: NDArray,
        **others: Any,
    ) -> "Snapshot":
        """The instant (s) at which the loop's signals have these values.

        `others` are the fields that signals have the names of.
        """
        load, desired = Pose.view(load_state), Pose.view(reference)
        carriers, bound = CarrierStates.view(carrier_state), float(speed_bound[0])
        return cls(
            time=time, load=load, reference=desired, carriers=carriers, speed_bound=bound, **others
        )

    @property
    def is_finite(self) -> bool:
        """Whether it can be shown: all arrays are finite, and no quaternion is zero."""
        others = (self.tensions, self.aircraft_state, self.wind, self.cable_state)
        arrays = [*self.load, *self.reference, *self.carriers]
        arrays += [array for array in others if array is not None]
        quaternions = self.load.quaternion, self.reference.quaternion
        return all(np.isfinite(array).all() for array in arrays) and all(map(np.any, quaternions))


@dataclass(frozen=True)
class Sizes:
    """Sizes of the bodies of a system, in m."""

    radius: float  # of the load, from its centre of mass
    reach: float  # and the longest cable
    wing_span: float
    cable: float  # radius
    bar: float  # radius

    @classmethod
    def of(cls, system: SystemParameters | Model, config: SceneConfig) -> "Sizes":
        """The sizes of what a system is drawn as."""
        radius = float(np.linalg.norm(np.array(system.attachments), axis=1).max())
        reach = radius + float(np.max(system.cable_length))
        cable = _CABLE_RADIUS * reach
        bar = max(_BAR_RADIUS * radius, 2 * cable)
        return cls(radius, reach, config.wing_span * reach, cable, bar)


def stack_poses(rotations: NDArray, positions: NDArray) -> NDArray:
    """Poses (k, 4, 4) of rotation matrices (k, 3, 3), or one for all, and positions (k, 3)."""
    poses = np.zeros((len(positions), 4, 4))
    poses[:, :3, :3] = rotations
    poses[:, :3, 3] = positions
    poses[:, 3, 3] = 1.0
    return poses


def cylinder_poses(starts: NDArray, ends: NDArray) -> tuple[NDArray, NDArray]:
    """Poses (k, 4, 4) of cylinders (along z) between points (k, 3) in m, and lengths (k,) in m.

    A length is never below `SMALL`.
    """
    axes = unit_vectors(ends - starts, otherwise=Z_AXIS)
    lengths = np.maximum(np.sqrt(((ends - starts) ** 2).sum(axis=1)), SMALL)
    sides = _perpendiculars(axes)
    rotations = np.stack([sides, cross(axes, sides), axes], axis=2)
    return stack_poses(rotations, (starts + ends) / 2), lengths


def tube(path: NDArray, radius: float) -> tuple[NDArray, NDArray]:
    """Vertices (3, v) and triangles (3, f) of square bars along a path (k, 3), m."""
    path = path if len(path) > 1 else path[[0, 0]]
    poses, lengths = cylinder_poses(path[:-1], path[1:])
    ring = radius * np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    halves = lengths[:, None, None] / 2 * Z_AXIS
    corners = np.concatenate([ring - halves, ring + halves], axis=1)  # (k - 1, 8, 3), in the bars
    vertices = corners @ poses[:, :3, :3].swapaxes(1, 2) + poses[:, None, :3, 3]
    side = np.arange(4)
    after = (side + 1) % 4
    sides = np.concatenate([[side, after, side + 4], [after, after + 4, side + 4]], axis=1)
    faces = sides[:, None] + 8 * np.arange(len(poses))[:, None]
    return (
        np.asfortranarray(vertices.reshape(-1, 3).T),
        np.asfortranarray(faces.reshape(3, -1), dtype=np.int32),
    )


def attitudes(headings: NDArray, up: NDArray) -> NDArray:
    """Rotation matrices (k, 3, 3) with x along unit vectors `headings` and z towards `up`."""
    across = up - (up * headings).sum(axis=1, keepdims=True) * headings
    tops = unit_vectors(across, otherwise=_perpendiculars(headings))
    return np.stack([headings, cross(tops, headings), tops], axis=2)


def carrier_rotations(
    velocities: NDArray,
    up: NDArray,
    *,
    otherwise: NDArray = X_AXIS,
    aircraft: Aircraft | None = None,
    aircraft_state: NDArray | None = None,
    wind: NDArray | None = None,
) -> NDArray:
    """Rotation matrices (n, 3, 3) of carriers: nose, left wing, top.

    They fly along their velocity with the top `up`. Aircraft whose state is known are in
    coordinated flight instead: along the air that they meet, with bank and angle of attack.

    Args:
        velocities: (n, 3), m/s.
        up: (n, 3), away from the cables.
        otherwise: (n, 3), directions of carriers without a velocity.
        aircraft: that the carriers are.
        aircraft_state: (4n,), of aircraft.
        wind: (3n,), m/s, at them.
    """
    if aircraft is None or aircraft_state is None:
        return attitudes(unit_vectors(velocities, otherwise=otherwise), up=up)
    state = AircraftState.view(aircraft_state)
    air = velocities if wind is None else velocities - wind.reshape(-1, 3)
    ahead = unit_vectors(air, otherwise=X_AXIS)
    level = attitudes(ahead, up=np.broadcast_to(Z_AXIS, ahead.shape))
    lift = np.cos(state.bank)[:, None] * level[..., 2] - np.sin(state.bank)[:, None] * level[..., 1]
    pitch = angle_of_attack(aircraft, state.lift)[:, None]
    nose = np.cos(pitch) * ahead + np.sin(pitch) * lift
    return attitudes(nose, up=np.cos(pitch) * lift - np.sin(pitch) * ahead)


def unit_vectors(vectors: NDArray, *, otherwise: NDArray) -> NDArray:
    """Unit vectors (k, 3) along `vectors`, or `otherwise` where these are not above `SMALL`."""
    lengths = np.sqrt((vectors**2).sum(axis=1, keepdims=True))
    return np.where(lengths > SMALL, vectors / np.maximum(lengths, SMALL), otherwise)


def _perpendiculars(axes: NDArray) -> NDArray:
    """A unit vector perpendicular to each of some unit vectors (k, 3)."""
    others = np.where(np.abs(axes[:, :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    return unit_vectors(cross(others, axes), otherwise=others)


def stall_shares(aircraft: Aircraft, state: AircraftState) -> NDArray:
    """How near aircraft (n,) are to their stall, by lift or by airspeed, from 0 to 1."""
    by_speed = (stall_speed(aircraft) / np.maximum(state.airspeed, SMALL)) ** 2
    return np.maximum(state.lift / aircraft.max_lift, by_speed)


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


def obstacle_part(obstacle: Obstacle, width: float) -> Part:
    """An obstacle in W; the ground is a plate of that width, m."""
    position, half, rotation, radius = obstacle.shape()
    if isinstance(obstacle, GroundConfig):
        half = width / 2 * np.array([1.0, 1.0, _PLATE])
        position = np.array([0.0, 0.0, obstacle.height - half[2]])
    solid = Sphere(radius) if isinstance(obstacle, SphereConfig) else Box(*(2 * half))
    pose = RigidTransform(RotationMatrix(rotation), position)
    return Part(name=obstacle.name, shape=solid, pose=pose)


def rgb(colour: str) -> Colour:
    """The colour that is written as #rrggbb."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red / 255, green / 255, blue / 255


def carrier_colour(i: int) -> str:
    """The colour of a carrier, from 0 on, as #rrggbb."""
    return CARRIER_COLOURS[i % len(CARRIER_COLOURS)]


def shade(colours: tuple[str, ...], share: float) -> Colour:
    """The colour at a share of the range of some: the first at 0, below and at NaN.

    The last is that from 1 up. There are 33 in all, so that a recording remains small.
    """
    step = round(min(max(0.0, share), 1.0) * _SHADES) / _SHADES
    channels, stops = np.transpose([*map(rgb, colours)]), np.linspace(0, 1, len(colours))
    red, green, blue = (float(np.interp(step, stops, channel)) for channel in channels)
    return red, green, blue
