"""Box "Load Desired Trajectory" of the figure."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.polynomial import Polynomial
from pydrake.trajectories import PiecewisePolynomial

from drake_nonstop.blocks.along_trajectory import AlongTrajectory, LoadTrajectory, reference_along
from drake_nonstop.mechanics.signals import PlannedParameters
from drake_nonstop.model.system import Model
from drake_nonstop.systems.documentation import own_config_class
from drake_nonstop.validation import (
    ScenarioError,
    StrictFields,
    checked,
    fulfilling,
    non_negative,
    one_of,
    positive,
    read_text,
    require,
    require_array,
    require_ranges,
    vector,
    warn_user,
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


def _pose(position: list[float], angles: Sequence[float] = (0.0, 0.0, 0.0)) -> NDArray:
    """[roll, pitch, yaw, x, y, z] (6,) of [roll, pitch, yaw] and [x, y, z]."""
    return np.array([*angles, *position], float)


def _rest_to_rest(
    config: _Displacement, angles: Sequence[float] = (0.0,) * 3
) -> PiecewisePolynomial:
    """The pose that changes from rest to rest, from `start_time` on, in `move_time`."""
    leg = config.move_time, _SMOOTH_STEPS[config.blend], _pose(config.displacement, angles)
    return _along_legs(config.start_pose(), config.start_time, [leg])


class _PathTrajectory(LoadTrajectory):
    """A load on the path that a config of its variant states."""

    def __init__(self, model: Model, config: Any = None):
        config = require_ranges(_BOX, config or own_config_class(type(self))())
        super().__init__(self.path(config), yaw_rate=getattr(config, "yaw_rate", 0.0))

    @staticmethod
    def path(config: Any) -> PiecewisePolynomial:
        """[roll, pitch, yaw, x, y, z] over the time in s."""
        raise NotImplementedError


@dataclass(kw_only=True)
class RestToRestConfig(_Displacement):
    """Rest, a move in which each coordinate follows a polynomial from rest to rest, and rest."""

    roll_pitch_yaw: list[float] = vector([0.0, 0.0, 0.0], "angles in rad")  # rad, change


class RestToRest(_PathTrajectory):
    """The paper's second experiment: component-wise quintic polynomials from rest to rest.

    A quintic's jerk steps where it begins and ends; that of `blend` "c4" is continuous.

    Raises:
        ScenarioError: move_time is not above zero, start_time is negative, a vector does not
            hold 3 finite numbers, or `blend` is another text.
    """

    @staticmethod
    def path(config: RestToRestConfig) -> PiecewisePolynomial:
        return _rest_to_rest(config, config.roll_pitch_yaw)


@dataclass(kw_only=True)
class ConstantVelocityMoveConfig(_Move):
    """Rest, a straight move at constant velocity, and rest."""

    velocity: list[float] = vector([0.7, 0.0, 0.0], "m/s")  # m/s
    start_time: float = non_negative(5.0)  # s
    move_time: float = positive(20.0)  # s
    blend_time: float = non_negative(1.0)  # s, of each change of velocity, centred on it; 0: a step


class ConstantVelocityMove(_PathTrajectory):
    """The paper's first experiment: the load rests, moves along a line, and rests.

    The paper's steps in velocity are blended over `blend_time`, by a quintic (so that the jerk is
    continuous) centred on the step: the line has the same length and is crossed at the same times.
    With `blend` "c4" the jerk's rate is continuous, too.

    Raises:
        ScenarioError: a field is out of range, or blend_time is too long for the other times.
    """

    @staticmethod
    def path(config: ConstantVelocityMoveConfig) -> PiecewisePolynomial:
        blend_time = config.blend_time
        is_short = blend_time / 2 <= config.start_time and blend_time <= config.move_time
        remedy = (
            "give at most twice start_time and at most move_time, since a blend is centred "
            "on the step in velocity that it replaces"
        )
        require(is_short, f"{_BOX}.blend_time", blend_time, remedy)
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
        return _along_legs(config.start_pose(), config.start_time - blend_time / 2, legs)


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


class Waypoints(_PathTrajectory):
    """The load moves from waypoint to waypoint, and rests at each of them.

    On each leg the coordinates of the pose follow a quintic from rest to rest, together, as in
    `RestToRest`: velocity and acceleration are continuous and are zero at each waypoint, and with
    `blend` "c4" the jerk.
    Angles are interpolated as given: from yaw 3 to yaw −3 the load rotates back by 6 rad.

    Raises:
        ScenarioError: the config's lists do not hold a finite row, and a time, per waypoint;
            a move time is not above zero, a rest time is below, or `blend` is another text.
    """

    @staticmethod
    def path(config: WaypointsConfig) -> PiecewisePolynomial:
        def rows(name: str, meaning: str, *shape: int | None) -> NDArray:
            return require_array(f"{_BOX}.{name}", getattr(config, name), shape, meaning)

        start, step = config.start_pose(), _SMOOTH_STEPS[config.blend]
        positions = rows("positions", "metres, a row per waypoint", None, 3)
        count = len(positions)
        angles, rests = np.tile(start[:3], (count, 1)), np.zeros(count)
        if len(config.roll_pitch_yaw) > 0:
            meaning = "angles in rad, a row per waypoint, or none at all"
            angles = rows("roll_pitch_yaw", meaning, count, 3)
        moves = rows("move_times", "seconds, one per waypoint", count)
        if len(config.rest_times) > 0:
            rests = rows("rest_times", "seconds, one per waypoint, or none at all", count)
        remedy = "give times greater than zero"
        require(np.all(moves > 0), f"{_BOX}.move_times", config.move_times, remedy)
        remedy = "give times that are not negative"
        require(np.all(rests >= 0), f"{_BOX}.rest_times", config.rest_times, remedy)
        changes = np.diff(np.vstack([start, np.hstack([angles, positions])]), axis=0)
        legs = []
        for rest, move, change in zip(rests, moves, changes, strict=True):
            legs += [(rest, np.zeros(1), change), (move, step, change)]
        return _along_legs(start, rests[0], legs[1:])  # it rests before its first leg


@dataclass(kw_only=True)
class SteadyTurnConfig(_Displacement):
    """A turn about the vertical at a constant rate, at rest or on the way from rest to rest."""

    yaw_rate: float = fulfilling(  # rad/s, at all times, counter-clockwise from above; not 0
        0.4,
        lambda rate: 1e-6 <= abs(rate) <= 100,
        "give 1e-6 to 100 rad/s, or the negative of such a number; RestToRest is for loads that do "
        "not turn",
    )


class SteadyTurn(_PathTrajectory):
    """The load turns about the vertical at a constant rate, and its carriers with it.

    The turn neither begins nor ends: the load turns at the start of a run and after its last
    metre. Its position moves from rest to rest as in `RestToRest`; roll and pitch stay those of the
    start. With `ConstantSpread` the carriers fly level circles at a constant tension.

    Raises:
        ScenarioError: yaw_rate is 0, or another field is out of range.
    """

    path = staticmethod(_rest_to_rest)


@dataclass(kw_only=True)
class PlannedTurnConfig(_Displacement):
    """A turn about the vertical at ξ, at rest or on the way from rest to rest."""


class PlannedTurn(AlongTrajectory):
    """The load turns about the vertical at the planned ξ: its yaw is the phase θ.

    As `SteadyTurn`, but at a rate that an `optimization_layer` may change. What makes `planned` has
    to make smooth ξ: give `phase: !ShapedPhase`. With `ConstantSpread` the carriers fly level
    circles.

    Raises:
        ScenarioError: a field is out of range.
    """

    reads = ("planned",)

    def __init__(self, model: Model, config: PlannedTurnConfig | None = None):
        super().__init__(_rest_to_rest(require_ranges(_BOX, config or PlannedTurnConfig())))

    @staticmethod
    def equations(planned: NDArray, coordinates: NDArray) -> tuple[NDArray, NDArray]:
        plan = PlannedParameters.view(planned)
        rates = plan.frequency, plan.frequency_rate, plan.frequency_second_rate
        turn = np.concatenate([plan.angle, *rates, np.zeros(1)])
        return reference_along(coordinates, turn)


_COLUMNS = ["t", "x", "y", "z", "roll", "pitch", "yaw"]  # s, m, rad; the angles are optional
_ROWS = f"2 to 20000 rows of {', '.join(_COLUMNS[:4])} or of {', '.join(_COLUMNS)}"


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
        return replace(self, file="", samples=_read_samples(self.file, f"{_BOX}.file"))


class SampledTrajectory(_PathTrajectory):
    """The load passes given poses at given times, along cubic splines of its coordinates.

    Velocity and acceleration are continuous between the first sample and the last. At these two
    the velocity is zero, and the acceleration steps: samples that begin and end at rest for a
    while make these steps small. The jerk steps at each sample. Omitted angles are zero; given
    ones are not unwrapped: a yaw that jumps by 2π makes the load rotate once, and a warning says
    so.

    Raises:
        ScenarioError: the file cannot be read, or the samples cannot be used.
    """

    @staticmethod
    def path(config: SampledTrajectoryConfig) -> PiecewisePolynomial:
        rows = config.resolved().samples
        samples, rest = _sample_array(rows, f"{_BOX}.samples", rows), np.zeros((6, 1))
        _warn_of_angles(samples[:, 4:])
        return PiecewisePolynomial.CubicWithContinuousSecondDerivatives(
            samples[:, 0], samples[:, [4, 5, 6, 1, 2, 3]].T, rest, rest
        )


def _warn_of_angles(angles: NDArray) -> None:
    """Warns of samples (n, 3), rad, by which the load turns in a way that may not be meant."""
    jumps = np.abs(np.diff(angles, axis=0)).max(axis=1)
    if np.any(jumps > np.pi):
        row = int(np.argmax(jumps > np.pi)) + 1
        warn_user(
            f"{_BOX}.samples: an angle changes by {jumps[row - 1]:.3g} rad from row {row} to row "
            f"{row + 1}, and the load turns as far; unwrap angles that pass through π "
            "(numpy.unwrap), and give them in rad"
        )
    elif np.any(np.abs(angles) > 2 * np.pi):
        farthest = float(np.max(np.abs(angles)))
        warn_user(f"{_BOX}.samples: an angle of {farthest:.4g} rad, beyond 2π: degrees given?")


def _read_samples(path: str, field: str) -> list[list[float]]:
    """The rows of a CSV file whose first line names its columns; see `_sample_array`.

    Errors do not show what is in it, but `field`: a scenario of somebody else may name any file.

    Raises:
        ScenarioError: the file cannot be read, or its samples cannot be used.
    """
    lines = [text for text in read_text(path, field).splitlines() if text.partition("#")[0].strip()]
    header = [name.strip() for name in lines[0].split(",")] if lines else []
    is_named = header in (_COLUMNS[:4], _COLUMNS) and len(lines) > 1
    require(is_named, field, path, f"give a CSV file with {_ROWS}, named in its first line")
    try:
        rows = np.genfromtxt(lines[1:], delimiter=",")  # NaN for what is no number
    except ValueError:
        raise ScenarioError(f"{field} = {path}: give {len(header)} numbers in each row") from None
    _sample_array(rows, field, path)
    return rows.tolist()


def _sample_array(rows: Any, field: str, value: Any) -> NDArray:
    """Samples (n, 7), [t, x, y, z, roll, pitch, yaw] in s, m and rad, omitted angles 0.

    Raises:
        ScenarioError: rows have another length, a number is not finite or above 1e6, or the times
            do not increase from 0 or above.
    """
    try:
        array = np.array(rows, float)
    except (TypeError, ValueError):
        array = np.zeros(0)
    is_table = array.ndim == 2 and 2 <= len(array) <= 20_000 and array.shape[1] in (4, 7)
    require(is_table, field, value, f"give {_ROWS}")
    steps = np.diff(array[:, 0], prepend=-1e-6)
    for is_sound, remedy in (
        (np.all(np.abs(array) <= 1e6, axis=1), "give finite numbers up to 1e6"),
        (steps >= 1e-6, "give times from 0 up that increase by 1e-6 s or more"),
    ):
        require(is_sound.all(), field, value, f"{remedy}, unlike in row {is_sound.argmin() + 1}")
    return np.pad(array, ((0, 0), (0, 7 - array.shape[1])))


VARIANTS = (RestToRest, ConstantVelocityMove, Waypoints, SampledTrajectory, SteadyTurn, PlannedTurn)
