"""References of a load that are functions of coordinates along a trajectory."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.trajectories import PiecewisePolynomial

from drake_nonstop.mechanics.reference_preview import ReferencePreview
from drake_nonstop.mechanics.rotation import angular_motion, roll_pitch_yaw_to_quaternion
from drake_nonstop.mechanics.signal_layouts import by_name
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    REFERENCE_HIGHER_RATES_SIZE,
    LoadReference,
    ReferenceHigherRates,
)
from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.systems.elementwise import RowsFunction
from drake_nonstop.systems.traced_block import TracedBlock

_BOX = "load_trajectory"
_RATES = 4  # derivatives of the coordinates
_SIZES = {"reference": LOAD_REFERENCE_SIZE, "reference_higher_rates": REFERENCE_HIGHER_RATES_SIZE}


class _Coordinates:
    """Coordinates along a trajectory with their derivatives; they rest beyond its ends."""

    def __init__(self, trajectory: PiecewisePolynomial):
        self._derivatives = [trajectory.MakeDerivative(k) for k in range(_RATES + 2)]
        self._limits = trajectory.start_time(), trajectory.end_time()
        self._values = [each.value for each in self._derivatives[: _RATES + 1]]
        self.size = (_RATES + 1) * trajectory.rows()

    def rows(self, times: NDArray, first: int = 0) -> NDArray:
        """The coordinates and four derivatives (k, size) at times (k,), s.

        `first` is 1 for the rates of all of these.
        """
        derivatives = self._derivatives[first : first + _RATES + 1]
        values = np.array([each.vector_values(times) for each in derivatives])
        start, end = self._limits
        values[1 - first :, :, (times < start) | (times > end)] = 0
        return values.reshape(-1, len(times)).T

    def row(self, time: float) -> NDArray:
        """Returns the values at one time, s."""
        start, end = self._limits
        if not start <= time <= end:
            return self.rows(np.array([time]))[0]
        return np.concatenate([value(time) for value in self._values], axis=None)


class AlongTrajectory(TracedBlock):
    """A reference that is a function of coordinates along a trajectory.

    `reference` takes the inputs, the coordinates, and the time, and returns `reference` and
    `reference_higher_rates`; other arguments are those of `TracedBlock`.
    """

    def __init__(
        self,
        trajectory: PiecewisePolynomial,
        reference: Callable[..., tuple[NDArray, NDArray]],
        **others: Any,
    ):
        self._coordinates = _Coordinates(trajectory)
        known = {"coordinates": self._coordinates.size}
        super().__init__(reference, known=known, outputs=_SIZES, **others)

    def precomputed_inputs(self, names: Sequence[str], times: NDArray) -> list[NDArray]:
        """The coordinates and their derivatives at times (k,), s."""
        return [self._coordinates.rows(times) for _ in names]

    def quantity_at(self, name: str, time: float) -> NDArray:
        """A row of them."""
        return self._coordinates.row(time)

    def precomputed_input_rates(self, names: Sequence[str], times: NDArray) -> list[NDArray]:
        """Their rates, likewise."""
        return [self._coordinates.rows(times, first=1) for _ in names]


class LoadTrajectory(AlongTrajectory):
    """The desired motion of the load along a piecewise polynomial.

    `reference_preview` is a `ReferencePreview`: the reference at any time.

    Args:
        trajectory: the rows [roll, pitch, yaw (rad), x, y, z (m)], or other coordinates that
            `pose` converts to these, twice continuously differentiable where the load has to
            follow closely. Before its start and after its end the load rests at its first and
            last pose.
        pose: maps the coordinates and their four derivatives (5, rows) to those of [roll,
            pitch, yaw, x, y, z], (5, 6), and runs on object arrays. None: the rows are these.
        yaw_rate: rad/s, at which the load turns about the vertical besides, at all times.
    """

    makes = ("reference", "reference_higher_rates", "reference_preview")

    traced_output: Any = None  # all of it is known beforehand, see `precomputed_outputs`

    def __init__(
        self,
        trajectory: PiecewisePolynomial,
        pose: Callable[[NDArray], NDArray] | None = None,
        *,
        yaw_rate: float = 0.0,
    ):
        def reference(values: NDArray, time: NDArray) -> tuple[NDArray, NDArray]:
            coordinates = pose(values.reshape(_RATES + 1, -1)) if pose else values
            turn = np.concatenate([yaw_rate * time, [yaw_rate, 0.0, 0.0, 0.0]])
            return reference_along(coordinates, turn)

        key = (reference_along.__qualname__, yaw_rate) if pose is None else None
        super().__init__(trajectory, reference, inputs={}, reads_time=True, key=key)
        self._rows = rows = _rows_of(self._coordinates, reference, key)
        preview = ReferencePreview(
            lambda time: rows(np.array([time]))["reference"][0],
            references=lambda times: rows(times)["reference"],
            higher_rates=lambda time: rows(np.array([time]))["reference_higher_rates"][0],
        )
        declare_preview(self, preview)

    def precomputed_outputs(self, ports: Sequence[str], times: NDArray) -> list[NDArray]:
        """Values of vector-valued ports at times (k,) in s, (k, size) of each."""
        rows = self._rows(times)
        return [rows[port] for port in ports]


def declare_preview(block: LeafBlock, preview: ReferencePreview) -> None:
    """Gives a block the output `reference_preview`, which is always the same object."""
    made, tickets = AbstractValue.Make(preview), {block.nothing_ticket()}
    block.DeclareAbstractOutputPort(
        "reference_preview", lambda: made.Clone(), lambda context, value: None, tickets
    )


def _rows_of(
    coordinates: _Coordinates, reference: Callable[..., tuple[NDArray, NDArray]], key: Any
) -> Callable[[NDArray], dict[str, NDArray]]:
    """Function of times (k,) in s for the rows of both outputs, the one that is traced."""

    @functools.cache  # most runs do not ask for any
    def traced() -> RowsFunction:
        return RowsFunction(
            lambda *values: np.concatenate(reference(*values)),
            [coordinates.size, 1],
            name=lambda: _BOX,
            key=None if key is None else ("rows", *key),
        )

    def rows(times: NDArray) -> dict[str, NDArray]:
        vectors = np.concatenate([coordinates.rows(times), times[:, None]], axis=1)
        return by_name(_SIZES, traced()(vectors))

    return rows


def reference_along(pose: NDArray, turn: NDArray) -> tuple[NDArray, NDArray]:
    """`reference` (22,) and its higher rates (6,).

    Args:
        pose: [roll, pitch, yaw, x, y, z] and its derivatives, (5, 6) or flat.
        turn: what the yaw is larger by, and its derivatives (5,).
    """
    angles, positions = np.split(pose.reshape(_RATES + 1, 6), 2, axis=1)
    roll_pitch_yaw = np.column_stack([angles[:, :2], angles[:, 2] + turn])
    angular_velocity, angular_acceleration, angular_jerk = angular_motion(*roll_pitch_yaw[:4])
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
