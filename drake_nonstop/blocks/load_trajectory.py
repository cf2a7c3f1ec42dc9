"""Box "Load Desired Trajectory" of the figure."""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pydrake.polynomial import Polynomial
from pydrake.trajectories import PiecewisePolynomial

from drake_nonstop.blocks.along_trajectory import AlongTrajectory, LoadTrajectory, reference_along
from drake_nonstop.mechanics.rotation import circular_motion
from drake_nonstop.mechanics.signals import PlannedParameters
from drake_nonstop.model.pose_samples import read_samples, sample_array
from drake_nonstop.model.system import Model
from drake_nonstop.validation import (
    StrictFields,
    checked,
    fulfilling,
    non_negative,
    number_with,
    one_of,
    positive,
    require,
    require_array,
    require_ranges,
    vector,
)

_BOX = "load_trajectory"

# Polynomials from 0 to 1 on [0, 1] of which, and of a number of derivatives, the ends are at rest.
_SMOOTH_STEPS = {
    "c3": np.array([0.0, 0.0, 0.0, 10.0, -15.0, 6.0]),
    "c4": np.array([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0]),
}


def _along_legs(
    start: NDArray, time: float, legs: Iterable[tuple[float, NDArray, NDArray]]
) -> PiecewisePolynomial:
    """Coordinates (k,) that leave a start at a time in s, and go from leg to leg.

    On a leg of a duration T in s, with the coefficients of a polynomial p that is 0 at 0, and a
    scale (k,), they change by scale p(t / T). One without duration is left out.
    """
    segments, breaks = [], [time]
    for duration, coefficients, scale in legs:
        if duration == 0:
            continue
        rows = np.outer(scale, coefficients) / duration ** np.arange(len(coefficients))
        polynomials = [
            [Polynomial(c) + Polynomial(row)] for c, row in zip(start, rows, strict=True)
        ]
        segments.append(np.array(polynomials))
        breaks.append(breaks[-1] + duration)
        start = start + scale * coefficients.sum()
    require(
        np.all(np.diff(breaks) >= np.finfo(float).eps),  # Drake would abort the process
        f"{_BOX} (instants in s)",
        breaks,
        "give times that are not lost in the rounding of others",
    )
    return PiecewisePolynomial(segments, breaks)


@dataclass(kw_only=True)
class _Move(StrictFields):
    """Where a move starts and how smooth it is, for the configs of several blocks."""

    start_position: list[float] = vector([0.0, 0.0, 0.0], "metres")  # m
    start_roll_pitch_yaw: list[float] = vector([0.0, 0.0, 0.0], "angles in rad")  # rad
    # "c3": what changes is continuous with two derivatives, a quintic; "c4": with three, a septic.
    blend: str = checked("c3", one_of(_SMOOTH_STEPS, f"give {' or '.join(_SMOOTH_STEPS)}"))

    def start_pose(self) -> NDArray:
        """[roll, pitch, yaw, x, y, z] (6,)."""
        return _pose(self.start_position, self.start_roll_pitch_yaw)


@dataclass(kw_only=True)
class _Displacement(_Move):
    """A displacement from rest to rest."""

    displacement: list[float] = vector([0.0, 0.0, 0.0], "metres")  # m
    start_time: float = non_negative(0.0)  # s, of the displacement
    move_time: float = positive(10.0)  # s, of the displacement


def _array(config: _Move, name: str, meaning: str, *shape: int | None) -> NDArray:
    """A field of the config, checked."""
    return require_array(f"{_BOX}.{name}", getattr(config, name), shape, meaning)


def _pose(position: list[float], angles: Sequence[float] = (0.0, 0.0, 0.0)) -> NDArray:
    """[roll, pitch, yaw, x, y, z] (6,) of [roll, pitch, yaw] and [x, y, z]."""
    return np.array([*angles, *position], float)


def _rest_to_rest(
    config: "_Displacement | CircleConfig", start: NDArray, change: NDArray
) -> PiecewisePolynomial:
    """Coordinates that change from rest to rest, from `start_time` on, in `move_time`."""
    leg = config.move_time, _SMOOTH_STEPS[config.blend], change
    return _along_legs(start, config.start_time, [leg])


@dataclass(kw_only=True)
class RestToRestConfig(_Displacement):
    """Rest, a move in which each coordinate follows a polynomial from rest to rest, and rest."""

    roll_pitch_yaw: list[float] = vector([0.0, 0.0, 0.0], "angles in rad")  # rad, change


class RestToRest(LoadTrajectory):
    """The paper's second experiment: component-wise quintic polynomials from rest to rest.

    A quintic's jerk steps where it begins and ends; that of `blend` "c4" is continuous.

    Raises:
        ScenarioError: move_time is not above zero, start_time is negative, a vector does not
            hold 3 finite numbers, or `blend` is another text.
    """

    def __init__(self, model: Model, config: RestToRestConfig | None = None):
        config = require_ranges(_BOX, config or RestToRestConfig())
        change = _pose(config.displacement, config.roll_pitch_yaw)
        super().__init__(_rest_to_rest(config, config.start_pose(), change))


@dataclass(kw_only=True)
class ConstantVelocityMoveConfig(_Move):
    """Rest, a straight move at constant velocity, and rest."""

    velocity: list[float] = vector([0.7, 0.0, 0.0], "m/s")  # m/s
    start_time: float = non_negative(5.0)  # s
    move_time: float = positive(20.0)  # s
    blend_time: float = non_negative(1.0)  # s, of each change of velocity, centred on it; 0: a step


class ConstantVelocityMove(LoadTrajectory):
    """The paper's first experiment: the load rests, moves along a line, and rests.

    The paper's steps in velocity are blended over `blend_time`, by a quintic (so that the jerk is
    continuous) centred on the step: the line has the same length and is crossed at the same times.
    With `blend` "c4" the jerk's rate is continuous, too.

    Raises:
        ScenarioError: move_time is not above zero, start_time or blend_time is negative,
            blend_time is too long for them, a vector does not hold 3 finite numbers, or
            `blend` is another text.
    """

    def __init__(self, model: Model, config: ConstantVelocityMoveConfig | None = None):
        config = require_ranges(_BOX, config or ConstantVelocityMoveConfig())
        blend_time = config.blend_time
        require(
            blend_time / 2 <= config.start_time and blend_time <= config.move_time,
            f"{_BOX}.blend_time",
            blend_time,
            "give at most twice start_time and at most move_time, since a blend is centred "
            "on the step in velocity that it replaces",
        )
        velocity = _pose(config.velocity)
        # The integral of the velocity's smooth step: from rest to one unit of velocity.
        step = _SMOOTH_STEPS[config.blend]
        blend = np.concatenate([[0.0], step / np.arange(1, len(step) + 1)])
        cruise = config.move_time - blend_time
        legs = [
            (blend_time, blend, blend_time * velocity),
            (cruise, np.array([0.0, 1.0]), cruise * velocity),
            (blend_time, np.array([0.0, 1.0, *-blend[2:]]), blend_time * velocity),
        ]
        start_time = config.start_time - blend_time / 2
        super().__init__(_along_legs(config.start_pose(), start_time, legs))


@dataclass(kw_only=True)
class WaypointsConfig(_Move):
    """Moves from pose to pose, each from rest to rest, with rests between them."""

    positions: list[list[float]] = field(  # m, in W, a row per waypoint
        default_factory=lambda: [[1.0, 0.0, 0.0]]
    )
    roll_pitch_yaw: list[list[float]] = field(  # rad, a row per waypoint; empty: the start's
        default_factory=list
    )
    move_times: list[float] = field(default_factory=lambda: [10.0])  # s, of each leg
    rest_times: list[float] = field(default_factory=list)  # s, before each leg; empty: none


class Waypoints(LoadTrajectory):
    """The load moves from waypoint to waypoint, and rests at each of them.

    On each leg the coordinates of the pose follow a quintic from rest to rest, together, as in
    `RestToRest`: velocity and acceleration are continuous and are zero at each waypoint, and with
    `blend` "c4" the jerk.
    Angles are interpolated as given: from yaw 3 to yaw −3 the load rotates back by 6 rad.

    Raises:
        ScenarioError: the config's lists do not hold a finite row, and a time, per waypoint;
            a move time is not above zero, a rest time is below, or `blend` is another text.
    """

    def __init__(self, model: Model, config: WaypointsConfig | None = None):
        config = require_ranges(_BOX, config or WaypointsConfig())
        start, step = config.start_pose(), _SMOOTH_STEPS[config.blend]
        positions = _array(config, "positions", "metres, a row per waypoint", None, 3)
        count = len(positions)
        angles, rests = np.tile(start[:3], (count, 1)), np.zeros(count)
        if len(config.roll_pitch_yaw) > 0:
            meaning = "angles in rad, a row per waypoint, or none at all"
            angles = _array(config, "roll_pitch_yaw", meaning, count, 3)
        moves = _array(config, "move_times", "seconds, one per waypoint", count)
        if len(config.rest_times) > 0:
            meaning = "seconds, one per waypoint, or none at all"
            rests = _array(config, "rest_times", meaning, count)
        remedy = "give times greater than zero"
        require(np.all(moves > 0), f"{_BOX}.move_times", config.move_times, remedy)
        remedy = "give times that are not negative"
        require(np.all(rests >= 0), f"{_BOX}.rest_times", config.rest_times, remedy)
        changes = np.diff(np.vstack([start, np.hstack([angles, positions])]), axis=0)
        legs = []
        for rest, move, change in zip(rests, moves, changes, strict=True):
            legs += [(rest, np.zeros(1), change), (move, step, change)]
        super().__init__(_along_legs(start, rests[0], legs[1:]))  # it rests before its first leg


_check_finite = number_with(math.isfinite, "give a finite number")


@dataclass(kw_only=True)
class CircleConfig(_Move):
    """Rest, a level circle or a part of it, and rest; it begins at the start position."""

    radius: float = positive(1.0)  # m
    # rad, of the centre seen from the start, x to y
    centre_direction: float = checked(math.pi / 2, _check_finite)
    # number of rounds, counter-clockwise from above; negative: clockwise
    turns: float = checked(1.0, _check_finite)
    turns_with_path: bool = False  # whether the load's yaw rotates as much as its path
    start_time: float = non_negative(0.0)  # s
    move_time: float = positive(20.0)  # s


@dataclass(frozen=True)
class _OnCircle:
    """The pose of a load on a circle, a function that is equal to that of an equal circle."""

    radius: float  # m

    def __call__(self, values: NDArray) -> NDArray:
        """[roll, pitch, yaw, x, y, z] of that on the centre, and θ, each with derivatives."""
        on_circle = values[:, 3:5] + circular_motion(values[:, 6], self.radius)
        return np.column_stack([values[:, :3], on_circle, values[:, 5]])


class Circle(LoadTrajectory):
    """The load moves round a level circle, at the height of its start, from rest to rest.

    The angle θ on the circle follows a quintic, so that velocity and acceleration are continuous,
    or, with `blend` "c4", a septic, and the jerk is. The position is on the circle to rounding:
    p = c + r (cos θ, sin θ), with its derivatives by the chain rule.

    Raises:
        ScenarioError: radius or move_time is not above zero, start_time is negative,
            another number is not finite, or `blend` is another text.
    """

    def __init__(self, model: Model, config: CircleConfig | None = None):
        config = require_ranges(_BOX, config or CircleConfig())
        radius, direction = config.radius, config.centre_direction
        to_centre = radius * np.array([np.cos(direction), np.sin(direction)])
        start = np.append(config.start_pose() + np.pad(to_centre, (3, 1)), direction + np.pi)
        turn = 2 * np.pi * config.turns
        change = np.array([0.0, 0.0, turn if config.turns_with_path else 0.0, *np.zeros(3), turn])
        super().__init__(_rest_to_rest(config, start, change), _OnCircle(radius))


@dataclass(kw_only=True)
class SteadyTurnConfig(_Displacement):
    """A turn about the vertical at a constant rate, at rest or on the way from rest to rest."""

    yaw_rate: float = fulfilling(  # rad/s, at all times, counter-clockwise from above; not 0
        0.4,
        lambda rate: 1e-6 <= abs(rate) <= 100,
        "give 1e-6 to 100 rad/s, or the negative of such a number; RestToRest is for loads that do "
        "not turn",
    )


class SteadyTurn(LoadTrajectory):
    """The load turns about the vertical at a constant rate, and its carriers with it.

    The turn neither begins nor ends: the load turns at the start of a run and after its last
    metre. Its position moves from rest to rest as in `RestToRest`; roll and pitch stay those of the
    start. With `ConstantSpread` the carriers fly level circles at a constant tension.

    Raises:
        ScenarioError: yaw_rate is 0, move_time is not above zero, start_time is negative, a
            vector does not hold 3 finite numbers, or `blend` is another text.
    """

    def __init__(self, model: Model, config: SteadyTurnConfig | None = None):
        config = require_ranges(_BOX, config or SteadyTurnConfig())
        trajectory = _rest_to_rest(config, config.start_pose(), _pose(config.displacement))
        super().__init__(trajectory, yaw_rate=config.yaw_rate)


@dataclass(kw_only=True)
class PlannedTurnConfig(_Displacement):
    """A turn about the vertical at ξ, at rest or on the way from rest to rest."""


class PlannedTurn(AlongTrajectory):
    """The load turns about the vertical at the planned ξ: its yaw is the phase θ.

    As `SteadyTurn`, but at a rate that an `optimization_layer` may change. What makes `planned` has
    to make smooth ξ: give `phase: !ShapedPhase`. With `ConstantSpread` the carriers fly level
    circles.

    Raises:
        ScenarioError: move_time is not above zero, start_time is negative, a vector does not hold
            3 finite numbers, or `blend` is another text.
    """

    reads = ("planned",)

    def __init__(self, model: Model, config: PlannedTurnConfig | None = None):
        config = require_ranges(_BOX, config or PlannedTurnConfig())
        super().__init__(_rest_to_rest(config, config.start_pose(), _pose(config.displacement)))

    @staticmethod
    def equations(planned: NDArray, coordinates: NDArray) -> tuple[NDArray, NDArray]:
        plan = PlannedParameters.view(planned)
        rates = plan.frequency, plan.frequency_rate, plan.frequency_second_rate
        turn = np.concatenate([plan.angle, *rates, np.zeros(1)])
        return reference_along(coordinates, turn)


@dataclass(kw_only=True)
class SampledTrajectoryConfig(StrictFields):
    """A smooth curve through poses at given times, from a file or in the scenario itself."""

    # A CSV file with the samples, read as a scenario is loaded; its first line names the columns
    # t, x, y, z or t, x, y, z, roll, pitch, yaw. Empty: the samples are given here.
    file: str = ""
    # Rows of t, x, y, z or of t, x, y, z, roll, pitch, yaw; omitted angles are 0.
    samples: list[list[float]] = field(  # s, m, rad
        default_factory=lambda: [[0.0, 0.0, 0.0, 0.0], [10.0, 1.0, 0.0, 0.0]]
    )

    def resolved(self) -> "SampledTrajectoryConfig":
        """The config with the file's rows as samples, and without the file."""
        if not self.file:
            return self
        samples = read_samples(self.file, f"{_BOX}.file")
        return dataclasses.replace(self, file="", samples=samples)

    def sample_array(self) -> NDArray:
        """The samples (n, 7), [t, x, y, z, roll, pitch, yaw], checked."""
        samples = self.resolved().samples
        return sample_array(samples, f"{_BOX}.samples", samples)

    @property
    def start_position(self) -> list[float]:
        """The first sample's position in m."""
        return self.sample_array()[0, 1:4].tolist()

    @property
    def start_roll_pitch_yaw(self) -> list[float]:
        """The first sample's angles in rad."""
        return self.sample_array()[0, 4:].tolist()


class SampledTrajectory(LoadTrajectory):
    """The load passes given poses at given times, along cubic splines of its coordinates.

    Velocity and acceleration are continuous between the first sample and the last. At these two
    the velocity is zero, and the acceleration steps: samples that begin and end at rest for a
    while make these steps small. The jerk steps at each sample. Omitted angles are zero; given
    ones are not unwrapped, so that a yaw that jumps by 2π makes the load rotate once.

    Raises:
        ScenarioError: the file cannot be read, or the samples cannot be used: see
            `pose_samples.read_samples` and `pose_samples.sample_array`.
    """

    def __init__(self, model: Model, config: SampledTrajectoryConfig | None = None):
        samples = (config or SampledTrajectoryConfig()).sample_array()
        rest, poses = np.zeros((6, 1)), samples[:, [4, 5, 6, 1, 2, 3]].T
        super().__init__(
            PiecewisePolynomial.CubicWithContinuousSecondDerivatives(
                samples[:, 0], poses, rest, rest
            )
        )


VARIANTS = (
    RestToRest,
    ConstantVelocityMove,
    Waypoints,
    Circle,
    SampledTrajectory,
    SteadyTurn,
    PlannedTurn,
)

__all__ = ["RestToRest", "RestToRestConfig", "ConstantVelocityMove", "ConstantVelocityMoveConfig"]
__all__ += ["Waypoints", "WaypointsConfig", "Circle", "CircleConfig"]
__all__ += ["SampledTrajectory", "SampledTrajectoryConfig", "SteadyTurn", "SteadyTurnConfig"]
__all__ += ["PlannedTurn", "PlannedTurnConfig"]
