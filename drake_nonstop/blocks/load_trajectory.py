"""Box "Load Desired Trajectory" of the figure."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pydrake.polynomial import Polynomial
from pydrake.systems.framework import BasicVector, Context, LeafSystem
from pydrake.trajectories import PiecewisePolynomial

from drake_nonstop.compiled import CompiledFunction
from drake_nonstop.mechanics.rotation import angular_motion, roll_pitch_yaw_to_quaternion
from drake_nonstop.system import Model
from drake_nonstop.validation import (
    require,
    require_array,
    require_non_negative,
    require_positive,
)


class LoadTrajectory(LeafSystem):
    """The desired pose of the load, its derivatives up to jerk, from a piecewise polynomial.

    .. pydrake_system::

        name: LoadTrajectory
        output_ports:
        - reference

    `reference` (22): [quaternion, position, angular velocity, velocity, angular
    acceleration, acceleration, jerk], in W.

    Args:
        trajectory: six rows [roll, pitch, yaw (rad), x, y, z (m)], twice continuously
            differentiable where the load is to follow closely. Before its start and after
            its end the load rests at its first and last pose.
    """

    def __init__(self, trajectory: PiecewisePolynomial):
        super().__init__()
        self._start, self._end = trajectory.start_time(), trajectory.end_time()
        self._trajectory = _with_derivatives(trajectory, 3)
        self._reference = CompiledFunction(_reference, [24], name=self.get_name)
        self.DeclareVectorOutputPort("reference", 22, self._calc_reference, {self.time_ticket()})

    def _calc_reference(self, context: Context, output: BasicVector) -> None:
        time = context.get_time()
        value = self._trajectory.value(time)[:, 0]
        if not self._start <= time <= self._end:
            value[6:] = 0
        output.SetFromVector(self._reference(value)[0])


def _with_derivatives(trajectory: PiecewisePolynomial, order: int) -> PiecewisePolynomial:
    """The trajectory's rows, and below them those of its derivatives up to `order`."""
    columns = []
    for segment in range(trajectory.get_number_of_segments()):
        rows = trajectory.getPolynomialMatrix(segment)
        columns.append(
            np.concatenate([[[row.Derivative(k)] for row in rows[:, 0]] for k in range(order + 1)])
        )
    return PiecewisePolynomial(columns, trajectory.get_segment_times())


def _reference(values: NDArray) -> NDArray:
    """`reference` (22,) of [roll, pitch, yaw, x, y, z] and three derivatives (24,)."""
    pose, rate, acceleration, jerk = values.reshape(4, 6)
    angular_velocity, angular_acceleration = angular_motion(pose[:3], rate[:3], acceleration[:3])
    return np.concatenate(
        [
            roll_pitch_yaw_to_quaternion(pose[:3]),
            pose[3:],
            angular_velocity,
            rate[3:],
            angular_acceleration,
            acceleration[3:],
            jerk[3:],
        ]
    )


_SMOOTH_STEP = np.array([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])  # quintic from 0 to 1 on [0, 1]


def _segment(coefficients: NDArray, scale: NDArray, duration: float) -> NDArray:
    """A column of polynomials scale_i p(t / duration); p has the given coefficients."""
    powers = duration ** np.arange(len(coefficients))
    return np.array([[Polynomial(s * coefficients / powers)] for s in scale])


def _pose(config: "RestToRestConfig | ConstantVelocityMoveConfig", owner: str) -> NDArray:
    return np.concatenate(
        [
            require_array(
                f"{owner}.start_roll_pitch_yaw",
                config.start_roll_pitch_yaw,
                [3],
                "angles in rad",
            ),
            require_array(f"{owner}.start_position", config.start_position, [3], "metres"),
        ]
    )


@dataclass(kw_only=True)
class RestToRestConfig:
    """Rest, a move in which each coordinate runs a quintic from rest to rest, and rest."""

    start_position: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # m
    start_roll_pitch_yaw: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # rad
    displacement: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # m
    roll_pitch_yaw: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # rad, change
    start_time: float = 0.0  # s
    move_time: float = 10.0  # s


class RestToRest(LoadTrajectory):
    """The paper's second experiment: component-wise quintic polynomials from rest to rest."""

    def __init__(self, model: Model, config: RestToRestConfig | None = None):
        config = config or RestToRestConfig()
        require_non_negative("load_trajectory", start_time=config.start_time)
        require_positive("load_trajectory", move_time=config.move_time)
        start = _pose(config, "load_trajectory")
        change = np.concatenate(
            [
                require_array(
                    "load_trajectory.roll_pitch_yaw", config.roll_pitch_yaw, [3], "angles in rad"
                ),
                require_array("load_trajectory.displacement", config.displacement, [3], "metres"),
            ]
        )
        segment = _segment(_SMOOTH_STEP, change, config.move_time)
        segment = segment + np.array([[Polynomial(c)] for c in start])
        super().__init__(
            PiecewisePolynomial(
                [segment], [config.start_time, config.start_time + config.move_time]
            )
        )


@dataclass(kw_only=True)
class ConstantVelocityMoveConfig:
    """Rest, a straight move at constant velocity, and rest."""

    start_position: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # m
    start_roll_pitch_yaw: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # rad
    velocity: list[float] = field(default_factory=lambda: [0.7, 0.0, 0.0])  # m/s
    start_time: float = 5.0  # s
    move_time: float = 20.0  # s
    blend_time: float = 1.0  # s, of each change of velocity, centred on it; 0: a step


class ConstantVelocityMove(LoadTrajectory):
    """The paper's first experiment: the load rests, moves along a line, and rests.

    The printed steps in velocity are blended over `blend_time`, velocity running a
    quintic (so that the jerk is continuous) centred on the step: the line has the same
    length and is crossed at the same times.
    """

    def __init__(self, model: Model, config: ConstantVelocityMoveConfig | None = None):
        config = config or ConstantVelocityMoveConfig()
        owner = "load_trajectory"
        require_non_negative(owner, start_time=config.start_time, blend_time=config.blend_time)
        require_positive(owner, move_time=config.move_time)
        half = config.blend_time / 2
        require(
            half <= config.start_time and config.blend_time <= config.move_time,
            f"{owner}.blend_time",
            config.blend_time,
            "give at most twice start_time and at most move_time, since a blend is centred "
            "on the step in velocity that it replaces",
        )
        start = _pose(config, owner)
        velocity = np.concatenate(
            [
                np.zeros(3),
                require_array(f"{owner}.velocity", config.velocity, [3], "m/s"),
            ]
        )
        # The integral of the velocity's smooth step: from rest to one unit of velocity.
        blend = np.concatenate([[0.0], _SMOOTH_STEP / np.arange(1, 7)])
        cruise = config.move_time - config.blend_time
        pieces = [
            (half * 2, blend, half * 2),
            (cruise, np.array([0.0, 1.0]), cruise),
            (half * 2, np.array([0.0, 1.0, *-blend[2:]]), half * 2),
        ]
        breaks, segments, position = [config.start_time - half], [], start
        for duration, coefficients, distance in pieces:
            if duration == 0:
                continue
            segment = _segment(coefficients, distance * velocity, duration)
            segments.append(segment + np.array([[Polynomial(c)] for c in position]))
            breaks.append(breaks[-1] + duration)
            position = position + distance * velocity * coefficients.sum()
        super().__init__(PiecewisePolynomial(segments, breaks))
