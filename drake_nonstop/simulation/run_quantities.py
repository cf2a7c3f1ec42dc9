"""The quantities of a run that metrics and figures are made from."""

import math
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rotation import (
    quaternion_conjugate,
    quaternion_product,
    rotation_matrix,
    rotation_vector,
)
from drake_nonstop.mechanics.signals import CarrierStates, Parameters, Pose
from drake_nonstop.model.system import overridden
from drake_nonstop.optimization.diagnostics import Diagnostics
from drake_nonstop.simulation.run import Run

# The entries of the signal `diagnostics` that count updates.
_UPDATE_COUNTS = ("updates", "kept", "solved", "relaxed", "held")
_SMALL_TURN = math.cos(0.2)  # of a velocity between two steps
_TURN = 0.1  # s, over which a turn is measured
_PARTS, _REFINEMENTS = 8, 4  # of an interval between two steps, in search of a least distance
_SOLVE_TIME_QUANTILES = {"p50": 0.5, "p99": 0.99, "max": 1.0}


class RunQuantities:
    """The quantities of a run that metrics are made from, each computed once.

    k is the number of steps, n that of the carriers.
    """

    def __init__(self, run: Run):
        self.run = run

    @cached_property
    def time(self) -> NDArray:
        """The instants (k,) of the steps, s."""
        return self.run.steps["time"]

    @property
    def simulated_time(self) -> float:
        """The time of the last step, s."""
        return float(self.time[-1])

    @cached_property
    def position_error(self) -> NDArray:
        """The load's distance (samples,) from its reference at 100 Hz, m."""
        return np.linalg.norm(self._load_errors[0], axis=1)

    @cached_property
    def orientation_error(self) -> NDArray:
        """The load's angle (samples,) to its reference at 100 Hz, rad."""
        return np.linalg.norm(self._load_errors[1], axis=1)

    @cached_property
    def _load_errors(self) -> tuple[NDArray, NDArray]:
        return load_errors(self.run)

    @cached_property
    def carrier_positions(self) -> NDArray:
        """(k, n, 3), m."""
        return CarrierStates.view(self.run.steps["carrier_state"]).positions

    @cached_property
    def carrier_velocities(self) -> NDArray:
        """(k, n, 3), m/s."""
        return CarrierStates.view(self.run.steps["carrier_state"]).velocities

    @cached_property
    def speeds(self) -> NDArray:
        """The carriers' speeds (k, n), m/s."""
        return carrier_speeds(self.run.steps["carrier_state"])

    @cached_property
    def speed_bounds(self) -> NDArray:
        """The ε (k,), m/s."""
        return speed_bounds(self.run)

    @cached_property
    def slowest_speed(self) -> float:
        """Of any carrier, m/s, also between two steps.

        Where a velocity turns far in a step it changes linearly there. Elsewhere a chord would be
        slower than its arc, and the speed between two steps is within 0.5 % of theirs.
        """
        velocities, speeds = self.carrier_velocities, self.speeds
        products = (velocities[:-1] * velocities[1:]).sum(axis=-1)
        turns_far = products < _SMALL_TURN * speeds[:-1] * speeds[1:]
        between = _least_squares(velocities)[turns_far]
        return float(np.sqrt(min([np.min(speeds) ** 2, *between])))

    @cached_property
    def steepest_angle(self) -> float:
        """The largest angle of a carrier's velocity to the horizontal, rad, with the same.

        It is where the velocity is, or where the derivative of its slope is zero in between.
        """
        velocities = self.carrier_velocities
        starts, changes = velocities[:-1], np.diff(velocities, axis=0)
        level, level_change = starts[..., :2], changes[..., :2]
        rise, rise_change = starts[..., 2], changes[..., 2]
        mixed = (level * level_change).sum(axis=-1)
        numerator = rise * mixed - rise_change * (level * level).sum(axis=-1)
        denominator = rise_change * mixed - rise * (level_change * level_change).sum(axis=-1)
        shares = (numerator / np.where(denominator == 0, np.inf, denominator)).clip(0, 1)
        between = starts + shares[..., None] * changes
        candidates = np.concatenate([velocities, between])
        level_speeds = np.linalg.norm(candidates[..., :2], axis=-1)
        return float(np.max(np.arctan2(np.abs(candidates[..., 2]), level_speeds)))

    @cached_property
    def sharpest_turn(self) -> tuple[float | None, float | None]:
        """The largest normal acceleration (m/s²) and smallest turn radius (m); None: unknown."""
        time = self.run.time
        velocities = CarrierStates.view(self.run.signal("carrier_state")).velocities
        speeds = np.linalg.norm(velocities, axis=2)
        if len(time) < 3:
            return None, None
        apart = max(1, min(round(_TURN / 2 / (time[1] - time[0])), (len(time) - 1) // 2))
        intervals = (time[2 * apart :] - time[: -2 * apart])[:, None, None]
        accelerations = (velocities[2 * apart :] - velocities[: -2 * apart]) / intervals
        velocities, speeds = velocities[apart:-apart], speeds[apart:-apart]
        if not np.any(speeds > 0):
            return None, None
        # v × a is speed × normal acceleration, and stays defined where a carrier stops.
        crossed = np.linalg.norm(np.cross(velocities, accelerations), axis=2)
        moving = speeds > 0
        curvature = float(np.max(crossed[moving] / speeds[moving] ** 3))
        return (
            float(np.max(crossed[moving] / speeds[moving])),
            1 / curvature if curvature > 0 else None,
        )

    @cached_property
    def tensions(self) -> NDArray:
        """(k, n), N."""
        return self.run.steps["tensions"]

    @cached_property
    def attachment_positions(self) -> NDArray:
        """Where the cables are attached to the load, (k, n, 3), in W, m."""
        return attachment_positions(self.run, self.run.steps["load_state"])

    @property
    def least_carrier_distance(self) -> float:
        """That of any two carriers, m, which move along straight lines between the steps."""
        return min(
            _least_length(self.carrier_positions[:, i] - self.carrier_positions[:, j])
            for i, j in combinations(range(self.carrier_positions.shape[1]), 2)
        )

    @property
    def least_cable_distance(self) -> float:
        """That of any two straight cables, m, whose ends move likewise."""
        ends, carriers = self.attachment_positions, self.carrier_positions
        return min(
            _least_segment_distance(
                np.stack([ends[:, i], carriers[:, i], ends[:, j], carriers[:, j]])
            )
            for i, j in combinations(range(carriers.shape[1]), 2)
        )

    @cached_property
    def update_counts(self) -> dict[str, int]:
        """How many updates of the optimization layer there were, and how they ended."""
        if "diagnostics" not in self.run.steps:
            return dict.fromkeys(_UPDATE_COUNTS, 0)
        diagnostics = Diagnostics.view(self.run.steps["diagnostics"][-1])
        return {name: int(getattr(diagnostics, name)) for name in _UPDATE_COUNTS}

    @cached_property
    def solve_times(self) -> dict[str, float | None]:
        """Quantiles of the wall time of an update, ms; None where nothing was solved."""
        if not len(self.run.solve_times):
            return dict.fromkeys(_SOLVE_TIME_QUANTILES)
        shares = list(_SOLVE_TIME_QUANTILES.values())
        quantiles = (1e3 * np.quantile(self.run.solve_times, shares)).tolist()
        return dict(zip(_SOLVE_TIME_QUANTILES, quantiles, strict=True))

    @cached_property
    def final_parameters(self) -> Parameters:
        """ξ (1,), rad/s, and A (1,), N."""
        return Parameters.view(self.run.signal("parameters")[-1])

    def duration_of(self, condition: NDArray) -> float:
        """For how long (s) a condition (k,) holds; a step stands for half its two intervals."""
        if len(self.time) < 2:
            return 0.0
        intervals = np.diff(self.time)
        weights = np.concatenate([intervals, [0.0]]) + np.concatenate([[0.0], intervals])
        return float(np.sum(weights[condition]) / 2)


def load_errors(run: Run) -> tuple[NDArray, NDArray]:
    """Position (m) and orientation (rad) errors of the load, (samples, 3) each.

    The orientation error is the rotation vector from the reference to the load, in L; its
    norm is the angle between the two.
    """
    state, reference = (Pose.view(run.signal(name)) for name in ("load_state", "reference"))
    inverse = quaternion_conjugate(reference.quaternion)
    rotation = rotation_vector(quaternion_product(inverse, state.quaternion))
    return state.position - reference.position, rotation


def carrier_speeds(carrier_state: NDArray) -> NDArray:
    """Speeds (k, n) in m/s of carrier states (k, 6n)."""
    return np.linalg.norm(CarrierStates.view(carrier_state).velocities, axis=2)


def closest_carriers(positions: NDArray) -> NDArray:
    """The distance (k,) of the closest two of carriers at `positions` (k, n, 3), m."""
    return np.min(
        [
            np.linalg.norm(positions[:, i] - positions[:, j], axis=1)
            for i, j in combinations(range(positions.shape[1]), 2)
        ],
        axis=0,
    )


def closest_cables(ends: NDArray, carriers: NDArray) -> NDArray:
    """The distance (k,) of the closest two straight cables from `ends` to `carriers`, m.

    Both (k, n, 3).
    """
    return np.min(
        [
            segment_distances(ends[:, i], carriers[:, i], ends[:, j], carriers[:, j])
            for i, j in combinations(range(ends.shape[1]), 2)
        ],
        axis=0,
    )


def segment_distances(a: NDArray, b: NDArray, c: NDArray, d: NDArray) -> NDArray:
    """Distances (k,) between the segments from a to b and from c to d, (k, 3) each.

    The nearest points of the two lines are clamped to the segments, one after the other
    (C. Ericson, Real-Time Collision Detection, section 5.1.9).
    """
    u, v, w = b - a, d - c, a - c
    uu, vv, uv = (u * u).sum(axis=1), (v * v).sum(axis=1), (u * v).sum(axis=1)
    uw, vw = (u * w).sum(axis=1), (v * w).sum(axis=1)
    tiny = np.finfo(float).tiny
    determinant = uu * vv - uv * uv
    parallel = determinant <= 1e-12 * uu * vv
    on_first = np.where(parallel, 0.0, uv * vw - vv * uw) / np.where(parallel, 1.0, determinant)
    on_first = on_first.clip(0, 1)
    on_second = ((uv * on_first + vw) / (vv + tiny)).clip(0, 1)
    on_first = ((uv * on_second - uw) / (uu + tiny)).clip(0, 1)
    gap = w + on_first[:, None] * u - on_second[:, None] * v
    return np.linalg.norm(gap, axis=1)


def _least_length(vectors: NDArray) -> float:
    """The least length of vectors (k, 3), each of which changes linearly to the next."""
    return float(np.sqrt(np.min(_least_squares(vectors))))


def _least_squares(vectors: NDArray) -> NDArray:
    """The least squares (k - 1, ...) on the lines from vector to vector (k, ..., 3)."""
    starts, changes = vectors[:-1], np.diff(vectors, axis=0)
    squares = (changes * changes).sum(axis=-1)
    shares = -(starts * changes).sum(axis=-1) / np.where(squares > 0, squares, 1.0)
    nearest = starts + shares.clip(0, 1)[..., None] * changes
    return (nearest * nearest).sum(axis=-1)


def _least_segment_distance(ends: NDArray) -> float:
    """The least distance of two segments with the ends (4, k, 3), each changing likewise."""
    distances = segment_distances(*ends)
    least = float(np.min(distances))
    travel = np.linalg.norm(np.diff(ends, axis=1), axis=2).reshape(2, 2, -1).max(axis=1).sum(axis=0)
    may_be_less = (distances[:-1] + distances[1:] - travel) / 2 < least
    if not np.any(may_be_less):
        return least
    starts, changes = ends[:, :-1][:, may_be_less], np.diff(ends, axis=1)[:, may_be_less]
    low, width = np.zeros(starts.shape[1]), 1.0
    for _ in range(_REFINEMENTS):  # about the nearest of some instants in each interval
        shares = (low + width * np.linspace(0, 1, _PARTS + 1)[:, None]).clip(0, 1)
        between = starts[:, None] + shares[..., None] * changes[:, None]
        distances = segment_distances(*between.reshape(4, -1, 3)).reshape(shares.shape)
        least = min(least, float(np.min(distances)))
        nearest = np.take_along_axis(shares, np.argmin(distances, axis=0)[None], axis=0)[0]
        low, width = nearest - width / _PARTS, 2 * width / _PARTS
    return least


def speed_bounds(run: Run) -> NDArray:
    """The ε (m/s) that was asked for at every step (steps,); it may change during a live run."""
    if "speed_bound" in run.steps:
        return run.steps["speed_bound"][:, 0]
    return np.full(len(run.steps["time"]), run.scenario.speed_bound)


def attachment_positions(run: Run, load_states: NDArray) -> NDArray:
    """The simulated attachment points (k, n, 3), in W, for load states (k, 13)."""
    system = overridden(run.scenario.system, run.scenario.simulated)
    quaternions, positions = Pose.view(load_states)
    R_WL = rotation_matrix(quaternions)
    return positions[:, None] + np.array(system.attachments) @ R_WL.swapaxes(1, 2)
