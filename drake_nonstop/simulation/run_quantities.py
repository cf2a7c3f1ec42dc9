"""The quantities of a run that metrics and figures are made from."""

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rotation import (
    quaternion_conjugate,
    quaternion_product,
    rotation_matrix,
    rotation_vector,
)
from drake_nonstop.mechanics.signals import CarrierStates, Parameters, Pose
from drake_nonstop.model.system import SystemParameters, overridden
from drake_nonstop.optimization.diagnostics import Diagnostics
from drake_nonstop.simulation.run import Run

# The entries of the signal `diagnostics` that count updates.
_UPDATE_COUNTS = ("updates", "kept", "solved", "relaxed", "held")
_CHUNK = 10_000  # rows that are computed at a time: their temporary arrays are small
_MOST_DISTANCES = 2**13  # between two of many, at once
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
    def system(self) -> SystemParameters:
        """The simulated load, cables and carriers."""
        return overridden(self.run.scenario.system, self.run.scenario.simulated)

    @property
    def reach(self) -> float:
        """The distance of a carrier from the load, as `RunLimits` has it, m."""
        radii = np.linalg.norm(self.system.attachments, axis=1)
        return float(np.max(radii)) + self.system.cable_length

    @property
    def load_weight(self) -> float:
        """N."""
        return self.system.load_mass * self.system.gravity

    @cached_property
    def climb_angles(self) -> NDArray:
        """The angles (k, n) of the carriers' velocities to the horizontal, rad, none negative."""
        return in_chunks(_climb_angles, self.carrier_velocities)

    @cached_property
    def _carrier_motion(self) -> tuple[NDArray, NDArray] | None:
        """Velocities (m/s) and accelerations (m/s²) of the carriers; None: too few steps."""
        # Where an update or a sample ends a step, another may be a rounding error away.
        apart = np.append(True, np.diff(self.time) > 1e-9)
        time, velocities = self.time[apart], self.carrier_velocities[apart]
        return None if len(time) < 3 else (velocities, np.gradient(velocities, time, axis=0))

    @cached_property
    def largest_acceleration(self) -> float | None:
        """The largest acceleration of a carrier, m/s²; None: unknown."""
        if self._carrier_motion is None:
            return None
        return float(np.max(np.linalg.norm(self._carrier_motion[1], axis=2)))

    @cached_property
    def sharpest_turn(self) -> tuple[float | None, float | None]:
        """The largest normal acceleration (m/s²) and smallest turn radius (m); None: unknown."""
        if self._carrier_motion is None:
            return None, None
        velocities, accelerations = self._carrier_motion
        speeds = np.linalg.norm(velocities, axis=2)
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
    def largest_carrier_force(self) -> float | None:
        """The largest force asked for of a carrier at 100 Hz, N; None: unknown."""
        try:
            forces = self.run.signal("carrier_forces")
        except KeyError:  # nothing in the loop makes it
            return None
        return float(np.max(np.linalg.norm(forces.reshape(len(forces), -1, 3), axis=2)))

    @cached_property
    def time_below_bound(self) -> float:
        """For how long a carrier was below ε, s."""
        return self.duration_of(np.any(self.speeds < self.speed_bounds[:, None], axis=1))

    @cached_property
    def carrier_separation(self) -> float:
        """The least distance of two carriers, m."""
        return float(np.min(closest_carriers(self.carrier_positions)))

    @cached_property
    def tensions(self) -> NDArray:
        """(k, n), N."""
        return self.run.steps["tensions"]

    @cached_property
    def slack_time(self) -> float:
        """For how long a cable was slack, s."""
        return self.duration_of(np.any(self.tensions <= 0, axis=1))

    @cached_property
    def cable_separations(self) -> NDArray:
        """The least distance of each two cables (pairs,), m."""
        distances = cable_distances(self.attachment_positions, self.carrier_positions)
        return distances.min(axis=1)

    @cached_property
    def closest_cables_for_attachments(self) -> tuple[float, float]:
        """The two cables that come closest for where they are attached, m.

        Their least distance and the distance of their attachments, beyond which no two cables
        can be apart. Cables that are attached at one point are left out.
        """
        attachments = np.array(self.system.attachments)
        apart = np.array([np.linalg.norm(a - b) for a, b in combinations(attachments, 2)])
        shares = np.divide(
            self.cable_separations, apart, out=np.full(len(apart), np.inf), where=apart > 0
        )
        closest = np.argmin(shares)
        return float(self.cable_separations[closest]), float(apart[closest])

    @cached_property
    def attachment_positions(self) -> NDArray:
        """Where the cables are attached to the load, (k, n, 3), in W, m."""
        return attachment_positions(self.run, self.run.steps["load_state"])

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
    errors = in_chunks(_load_errors, run.signal("load_state"), run.signal("reference"))
    return errors[:, :3], errors[:, 3:]


def _load_errors(load_states: NDArray, references: NDArray) -> NDArray:
    """[position error, orientation error] (k, 6)."""
    state, reference = Pose.view(load_states), Pose.view(references)
    inverse = quaternion_conjugate(reference.quaternion)
    rotation = rotation_vector(quaternion_product(inverse, state.quaternion))
    return np.hstack([state.position - reference.position, rotation])


def carrier_speeds(carrier_state: NDArray) -> NDArray:
    """Speeds (k, n) in m/s of carrier states (k, 6n)."""
    return in_chunks(_norms, CarrierStates.view(carrier_state).velocities)


def _norms(vectors: NDArray) -> NDArray:
    return np.linalg.norm(vectors, axis=-1)


def _climb_angles(velocities: NDArray) -> NDArray:
    return np.arctan2(np.abs(velocities[..., 2]), _norms(velocities[..., :2]))


def in_chunks(function: Callable[..., NDArray], *arrays: NDArray) -> NDArray:
    """`function(*arrays)`, a few rows at a time; its rows depend on those of the arrays only."""
    starts = range(0, max(len(arrays[0]), 1), _CHUNK)
    parts = [function(*(array[i : i + _CHUNK] for array in arrays)) for i in starts]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def closest_carriers(positions: NDArray) -> NDArray:
    """The distance (k,) of the closest two of carriers at `positions` (k, n, 3), m."""

    def distances(a: NDArray, b: NDArray) -> NDArray:
        return np.linalg.norm(a - b, axis=-1)

    return _least_of_pairs(distances, positions)


def closest_cables(ends: NDArray, carriers: NDArray) -> NDArray:
    """The distance (k,) of the closest two straight cables from `ends` to `carriers`, m.

    Both (k, n, 3).
    """
    return _least_of_pairs(segment_distances, ends, carriers)


def _least_of_pairs(distances: Callable[..., NDArray], *points: NDArray) -> NDArray:
    """The least distance (k,) of any two of n, each with some `points` (k, n, 3).

    A few steps and the pairs of one with all that follow at a time: this bounds the memory. The
    components are laid out apart, which is several times faster.
    """
    steps, count = points[0].shape[:2]
    at_once = max(1, _MOST_DISTANCES // count)
    least = np.empty(steps)
    for start in range(0, steps, at_once):
        some = slice(start, start + at_once)
        parts = [np.moveaxis(np.moveaxis(part[some], 2, 0).copy(), 0, 2) for part in points]
        least[some] = np.min(
            [
                distances(
                    *(part[:, i : i + 1] for part in parts), *(part[:, i + 1 :] for part in parts)
                ).min(axis=1)
                for i in range(count - 1)
            ],
            axis=0,
        )
    return least


def segment_distances(a: NDArray, b: NDArray, c: NDArray, d: NDArray) -> NDArray:
    """Distances (…) between the segments from a to b and from c to d, (…, 3) each.

    The nearest points of the two lines are clamped to the segments, one after the other
    (C. Ericson, Real-Time Collision Detection, section 5.1.9).
    """
    u, v, w = b - a, d - c, a - c
    uu, vv, uv = (u * u).sum(axis=-1), (v * v).sum(axis=-1), (u * v).sum(axis=-1)
    uw, vw = (u * w).sum(axis=-1), (v * w).sum(axis=-1)
    tiny = np.finfo(float).tiny
    determinant = uu * vv - uv * uv
    parallel = determinant <= 1e-12 * uu * vv
    on_first = np.where(parallel, 0.0, uv * vw - vv * uw) / np.where(parallel, 1.0, determinant)
    on_first = on_first.clip(0, 1)
    on_second = ((uv * on_first + vw) / (vv + tiny)).clip(0, 1)
    on_first = ((uv * on_second - uw) / (uu + tiny)).clip(0, 1)
    gap = w + on_first[..., None] * u - on_second[..., None] * v
    return np.linalg.norm(gap, axis=-1)


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
