"""References of a load that are functions of coordinates along a trajectory."""

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.trajectories import Trajectory

from drake_nonstop.mechanics.reference_preview import ReferencePreview
from drake_nonstop.mechanics.rotation import angular_velocity_of, roll_pitch_yaw_to_quaternion
from drake_nonstop.mechanics.signal_layouts import by_name
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    REFERENCE_HIGHER_RATES_SIZE,
    LoadReference,
    ReferenceHigherRates,
)
from drake_nonstop.mechanics.taylor import Taylor
from drake_nonstop.model.block import Block
from drake_nonstop.model.system import Model
from drake_nonstop.systems.grid_function import GridFunction
from drake_nonstop.validation import require

_BOX = "load_trajectory"
_RATES = 4  # derivatives of the coordinates
_SIZES = {"reference": LOAD_REFERENCE_SIZE, "reference_higher_rates": REFERENCE_HIGHER_RATES_SIZE}


class _Coordinates:
    """Coordinates along a trajectory with their derivatives; they rest beyond its ends."""

    def __init__(self, trajectory: Trajectory):
        # A trajectory without derivatives would end the process.
        is_one = isinstance(trajectory, Trajectory) and trajectory.has_derivative()
        is_pose = is_one and (trajectory.rows(), trajectory.cols()) == (6, 1)
        remedy = (
            "give a Trajectory of Drake's with derivatives, of the rows roll, pitch, yaw, x, y, z"
        )
        require(is_pose, f"{_BOX}.trajectory", trajectory, remedy)
        self._derivatives = [trajectory.MakeDerivative(k) for k in range(_RATES + 2)]
        self._limits = trajectory.start_time(), trajectory.end_time()
        self.size = (_RATES + 1) * 6

    def rows(self, times: NDArray, first: int = 0) -> NDArray:
        """The coordinates and four derivatives (k, size) at times (k,), s.

        `first` is 1 for the rates of all of these.
        """
        at = np.clip(times, *self._limits)
        made = [each.vector_values(at).T for each in self._derivatives[first : first + _RATES + 1]]
        values = np.stack(made, axis=1)
        values[at != times, 1 - first :] = 0
        return values.reshape(len(times), -1)


class AlongTrajectory(Block):
    """A reference that is a function of coordinates along a trajectory.

    `equations` take the coordinates and their four derivatives, flat, behind the inputs.
    """

    makes: ClassVar[tuple[str, ...]] = ("reference", "reference_higher_rates")

    def __init__(self, trajectory: Trajectory):
        self._coordinates = _Coordinates(trajectory)
        super().__init__(None)

    def quantities(self, model: Model) -> Mapping[str, int]:
        return {"coordinates": self._coordinates.size}

    def precomputed_inputs(self, names: Sequence[str], times: NDArray) -> list[NDArray]:
        """The coordinates and their derivatives at times (k,), s."""
        return [self._coordinates.rows(times) for _ in names]

    def precomputed_input_rates(self, names: Sequence[str], times: NDArray) -> list[NDArray]:
        """Their rates, likewise."""
        return [self._coordinates.rows(times, first=1) for _ in names]


class LoadTrajectory(AlongTrajectory):
    """The desired motion of the load along a Trajectory of Drake's.

    `reference_preview` is a `ReferencePreview`: the reference at any time.

    Args:
        trajectory: the rows [roll, pitch, yaw (rad), x, y, z (m)], twice continuously
            differentiable where the load has to follow closely, such as a PiecewisePolynomial or a
            BsplineTrajectory. Before its start and after its end the load rests at its first and
            last pose.
        yaw_rate: rad/s, of a further turn about the vertical, at all times.

    Raises:
        ScenarioError: it is no Trajectory, has no derivatives, or has other rows.
    """

    makes = ("reference", "reference_higher_rates", "reference_preview")
    reads_time = True

    def __init__(self, trajectory: Trajectory, *, yaw_rate: float = 0.0):
        self._constants = {"yaw_rate": yaw_rate}
        super().__init__(trajectory)

    @staticmethod
    def equations(
        coordinates: NDArray, time: NDArray, *, yaw_rate: float
    ) -> tuple[NDArray, NDArray]:
        turn = np.concatenate([yaw_rate * time, [yaw_rate, 0.0, 0.0, 0.0]])
        return reference_along(coordinates, turn)

    def constants(self, model: Model, config: Any) -> dict[str, Any]:
        return self._constants

    def fixed_outputs(self) -> Mapping[str, Any]:
        return {"reference_preview": _preview(self._coordinates, self.equations, self._constants)}


def _preview(
    coordinates: _Coordinates,
    equations: Callable[..., tuple[NDArray, NDArray]],
    constants: Mapping[str, Any],
) -> ReferencePreview:
    """The preview of a trajectory by the equations of its block."""

    @functools.cache  # most runs do not ask for any
    def traced() -> GridFunction:
        return GridFunction(
            lambda row, _: equations(row[:-1], row[-1:], **constants),
            coordinates.size + 1,
            key=("rows", equations, *constants.values()),
            compiles=False,
        )

    def rows(times: NDArray) -> dict[str, NDArray]:
        vectors = np.concatenate([coordinates.rows(times), times[:, None]], axis=1)
        return by_name(_SIZES, traced().rows(vectors, lambda: _BOX))

    return ReferencePreview(
        lambda time: rows(np.array([time]))["reference"][0],
        references=lambda times: rows(times)["reference"],
        higher_rates=lambda time: rows(np.array([time]))["reference_higher_rates"][0],
    )


def reference_along(pose: NDArray, turn: NDArray) -> tuple[NDArray, NDArray]:
    """`reference` (22,) and its higher rates (6,).

    Args:
        pose: [roll, pitch, yaw, x, y, z] and its derivatives, (5, 6) or flat.
        turn: what the yaw is larger by, and its derivatives (5,).
    """
    angles, positions = np.split(pose.reshape(_RATES + 1, 6), 2, axis=1)
    roll_pitch_yaw = np.column_stack([angles[:, :2], angles[:, 2] + turn])
    spin = angular_velocity_of(Taylor.of_rates(*roll_pitch_yaw[:4]))
    angular_velocity, angular_acceleration, angular_jerk = spin.rates
    reference = np.concatenate(
        LoadReference(
            quaternion=roll_pitch_yaw_to_quaternion(roll_pitch_yaw[0]),
            position=positions[0],
            angular_velocity=angular_velocity,
            velocity=positions[1],
            angular_acceleration=angular_acceleration,
            acceleration=positions[2],
            jerk=positions[3],
        )
    )
    higher_rates = ReferenceHigherRates(angular_jerk=angular_jerk, snap=positions[4])
    return reference, np.concatenate(higher_rates)
