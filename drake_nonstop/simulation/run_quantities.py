"""The quantities of a run that metrics and figures are made from."""

import math
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.limit_along import LimitAlong
from drake_nonstop.analysis.separations import Spacing, least_length
from drake_nonstop.mechanics.aircraft import Aircraft, is_stalled
from drake_nonstop.mechanics.rotation import (
    quaternion_conjugate,
    quaternion_product,
    rotation_matrix,
    rotation_vector,
)
from drake_nonstop.mechanics.signals import AircraftState, CarrierStates, Parameters, Pose
from drake_nonstop.model.system import SystemParameters, aircraft_in, overridden
from drake_nonstop.optimization.diagnostics import Diagnostics
from drake_nonstop.optimization.limits import Limit, Of, asked
from drake_nonstop.simulation.aircraft_quantities import AircraftQuantities, has_aircraft
from drake_nonstop.simulation.planned_shortfall import largest_shortfall
from drake_nonstop.simulation.run import Run
from drake_nonstop.simulation.signal_table import UnknownSignalError
from drake_nonstop.systems.tracing import NotFiniteError

# The entries of the signal `diagnostics` that count updates.
_UPDATE_COUNTS = ("updates", "kept", "solved", "relaxed", "held")
_CHUNK = 10_000  # rows that are computed at a time: their temporary arrays are small
_SMALL_TURN = math.cos(0.2)  # of a velocity between two steps
_TURN = 0.1  # s, over which a turn and an acceleration are measured
_SOLVE_TIME_QUANTILES = {"p50": 0.5, "p99": 0.99, "max": 1.0}


class Stall(NamedTuple):
    """An aircraft's stall."""

    time: float  # s
    carrier: int  # from 1 on
    lift: float  # C_L with the gusts' part
    airspeed: float  # m/s


class RunQuantities(Spacing):
    """The quantities of a run that metrics are made from, each computed once.

    k is the number of steps, n that of the carriers.
    """

    def __init__(self, run: Run):
        self.run = run
        self.scenario = run.scenario

    @cached_property
    def time(self) -> NDArray:
        """The instants (k,) of the steps, s."""
        return self.run.steps["time"]

    @property
    def simulated_time(self) -> float:
        """The time of the last step, s."""
        return float(self.time[-1])

    @property
    def wall_time(self) -> float | None:
        """Of the simulation, s; None: unknown."""
        return None if math.isnan(self.run.wall_time) else self.run.wall_time

    @cached_property
    def position_error(self) -> NDArray:
        """The load's distance (samples,) from its reference at 100 Hz, m."""
        return np.linalg.norm(self._load_errors[0], axis=1)

    @cached_property
    def orientation_error(self) -> NDArray:
        """The load's angle (samples,) to its reference at 100 Hz, rad."""
        return np.linalg.norm(self._load_errors[1], axis=1)

    @cached_property
    def reference_delays(self) -> tuple[float, float] | None:
        """How late a governor has the reference at most, and at the end, s; None: there is none."""
        if self.run.scenario.reference_governor is None:
            return None
        if not any(name.endswith(".reference_delay") for name in self.run.signals):
            return 0.0, 0.0  # the trajectory is left as it is
        delays = self.run.signal("reference_delay")
        return float(np.max(delays)), float(delays[-1, 0])

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

    @property
    def has_aircraft(self) -> bool:
        """Whether the carriers are aircraft."""
        return has_aircraft(self.run)

    @cached_property
    def flight(self) -> AircraftQuantities:
        """How the aircraft flew, where the carriers are aircraft."""
        return AircraftQuantities(self.run)

    @cached_property
    def saturated_share(self) -> float | None:
        """The share of the time with a command of any aircraft at its limit; None: unknown."""
        flags = self.run.steps.get("command_saturation")
        if flags is None or self.simulated_time == 0:
            return None
        return self.duration_of(np.any(flags > 0.5, axis=1)) / self.simulated_time

    @cached_property
    def system(self) -> SystemParameters:
        """The simulated load, cables and carriers."""
        return overridden(self.run.scenario.system, self.run.scenario.simulated)

    @property
    def load_weight(self) -> float:
        """N."""
        return self.system.load_mass * self.system.gravity

    @cached_property
    def largest_position_error(self) -> float:
        """The largest distance of the load from its reference, m."""
        return float(np.max(self.position_error))

    @cached_property
    def largest_orientation_error(self) -> float:
        """The largest angle of the load to its reference, rad."""
        return float(np.max(self.orientation_error))

    @cached_property
    def peak_speed(self) -> float:
        """Of any carrier, m/s."""
        return float(np.max(self.speeds))

    @cached_property
    def least_tension(self) -> float:
        """Of any cable, N."""
        return float(np.min(self.tensions))

    @cached_property
    def largest_tension(self) -> float:
        """Of any cable, N."""
        return float(np.max(self.tensions))

    @cached_property
    def slowest_speed(self) -> float:
        """Of any carrier, m/s, also between two steps.

        Where a velocity turns far in a step it changes linearly there. Elsewhere a chord would be
        slower than its arc, and the speed between two steps is within 0.5 % of theirs.
        """
        velocities, speeds = self.carrier_velocities, self.speeds
        least = float(np.min(speeds))
        for start in range(0, len(speeds) - 1, _CHUNK):
            ends = slice(start, start + _CHUNK), slice(start + 1, start + _CHUNK + 1)
            after = velocities[ends[1]]
            before = velocities[ends[0]][: len(after)]
            products = (before * after).sum(axis=-1)
            lengths = speeds[ends[0]][: len(after)] * speeds[ends[1]]
            turns_far = products < _SMALL_TURN * lengths
            if np.any(turns_far):
                turning = np.stack([before[turns_far], after[turns_far]])
                least = min(least, least_length(turning))
        return least

    @cached_property
    def steepest_angle(self) -> float:
        """The largest angle of a carrier's velocity to the horizontal, rad.

        It is where the velocity is, or where the derivative of its slope is zero in between.
        """
        velocities = self.carrier_velocities
        return max(
            _steepest_angle(velocities[i : i + _CHUNK + 1])
            for i in range(0, max(1, len(velocities) - 1), _CHUNK)
        )

    @cached_property
    def largest_acceleration(self) -> float | None:
        """The largest acceleration of a carrier, m/s²; None: unknown."""
        parts = [_norms(accelerations) for _, accelerations in self._carrier_motion()]
        return max((float(np.max(part)) for part in parts), default=None)

    @cached_property
    def sharpest_turn(self) -> tuple[float | None, float | None]:
        """The largest normal acceleration (m/s²) and smallest turn radius (m); None: unknown."""
        acceleration = curvature = 0.0
        is_moving = False
        for velocities, accelerations in self._carrier_motion():
            # v × a is speed × normal acceleration, and stays defined where a carrier stops.
            crossed, speeds = _norms(np.cross(velocities, accelerations)), _norms(velocities)
            moving = speeds > 0
            is_moving |= bool(np.any(moving))
            crossed, speeds = crossed[moving], speeds[moving]
            acceleration = max(acceleration, float(np.max(crossed / speeds, initial=0.0)))
            curvature = max(curvature, float(np.max(crossed / speeds**3, initial=0.0)))
        if not is_moving:
            return None, None
        return acceleration, 1 / curvature if curvature > 0 else None

    def _carrier_motion(self) -> Iterator[tuple[NDArray, NDArray]]:
        """Velocities (k, n, 3), m/s, and accelerations, m/s², over 0.1 s of the path, in parts."""
        time, states = self.run.time, self.run.signal("carrier_state")
        if len(time) < 3:
            return
        apart = max(1, min(round(_TURN / 2 / (time[1] - time[0])), (len(time) - 1) // 2))
        for start in range(apart, len(time) - apart, _CHUNK):
            rows = slice(start - apart, min(start + _CHUNK, len(time) - apart) + apart)
            velocities, times = CarrierStates.view(states[rows]).velocities, time[rows]
            intervals = (times[2 * apart :] - times[: -2 * apart])[:, None, None]
            yield (
                velocities[apart:-apart],
                (velocities[2 * apart :] - velocities[: -2 * apart]) / intervals,
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
    def aircraft(self) -> Aircraft | None:
        """The simulated aircraft, where the carriers are some."""
        return aircraft_in(self.system)

    @cached_property
    def first_stall(self) -> Stall | None:
        """The first stall of an aircraft; None: there was none, or there are no aircraft."""
        shown = self.run.steps.get("aircraft_state")
        if self.aircraft is None or shown is None:
            return None
        stalled = is_stalled(self.aircraft, shown)
        if not np.any(stalled):
            return None
        k = int(np.argmax(np.any(stalled, axis=1)))
        i = int(np.argmax(stalled[k]))
        state = AircraftState.view(shown[k])
        return Stall(
            time=float(self.run.steps["time"][k]),
            carrier=i + 1,
            lift=float(state.lift[i]),
            airspeed=float(state.airspeed[i]),
        )

    @cached_property
    def bounded_speeds(self) -> NDArray:
        """The speeds (k, n), m/s, that ε bounds: of aircraft through the air, else over ground."""
        return self.flight.state.airspeed if self.has_aircraft else self.speeds

    @cached_property
    def time_below_bound(self) -> float:
        """For how long a carrier was below ε, s."""
        return self.duration_of(np.any(self.bounded_speeds < self.speed_bounds[:, None], axis=1))

    @cached_property
    def least_speed_above_bound(self) -> float:
        """The least of any carrier's speed, of `bounded_speeds`, minus ε, m/s."""
        return float(np.min(self.bounded_speeds - self.speed_bounds[:, None]))

    def limited_by(self, limit: Limit) -> NDArray | None:
        """What a limit holds for (k, c), in its unit, of carriers or pairs; None: unknown."""
        if limit.of is Of.SEPARATION:
            pairs = np.array(np.triu_indices(self.carrier_positions.shape[1], 1))
            return in_chunks(
                lambda at: _norms(at[:, pairs[0]] - at[:, pairs[1]]), self.carrier_positions
            )
        if limit.is_of_aircraft:
            flight = self.flight if self.has_aircraft else None
            return None if flight is None else limit.values(flight.aircraft, flight.needs)
        return self.bounded_speeds if limit.of is Of.SPEED else self.tensions

    @property
    def limits(self) -> list[LimitAlong]:
        """The limits that the layer is asked for, of what the run has."""
        rows = [
            (limit, stated, self.limited_by(limit))
            for limit, stated in asked(self.run.scenario.optimization_layer)
        ]
        return [LimitAlong(row, at, self.time, v) for row, at, v in rows if v is not None]

    def extreme_of(self, limit: Limit) -> float | None:
        """What is the closest to a limit in the run, or the farthest beyond it; None: unknown."""
        if limit.of is Of.SEPARATION:
            return self.carrier_separation
        values = self.limited_by(limit)
        return None if values is None else float(values[limit.worst(values)])

    @cached_property
    def missed_limits(self) -> dict[str, float]:
        """How many updates ended without keeping each limit that is counted, by its name."""
        try:
            columns = self.run.columns(["missed_limits"])
        except UnknownSignalError:
            return {}
        return {
            name.removeprefix("missed_limits."): _count(counts[-1])
            for name, counts in columns.items()
            if name.startswith("missed_limits.")
        }

    @cached_property
    def tensions(self) -> NDArray:
        """(k, n), N."""
        return self.run.steps["tensions"]

    @cached_property
    def slack_time(self) -> float:
        """For how long a cable was slack, s."""
        return self.duration_of(np.any(self.tensions <= 0, axis=1))

    @cached_property
    def attachment_positions(self) -> NDArray:
        """Where the cables are attached to the load, (k, n, 3), in W, m."""
        load_states = self.run.steps["load_state"]
        return in_chunks(lambda states: attachment_positions(self.run, states), load_states)

    @cached_property
    def predicted_margin(self) -> float | None:
        """The margin (m/s) that was computed for the optimization layer, if one was."""
        margin = getattr(self.run.diagram, "speed_margin", None)
        return None if margin is None else float(margin.total)

    @cached_property
    def measured_margin(self) -> float | None:
        """By how much a carrier was slower than planned, m/s; None: unknown."""
        try:
            return largest_shortfall(self.run)
        except NotFiniteError:  # no speeds follow from such a reference
            return None

    def share_of_bound(self, speed: float | None) -> float | None:
        """A speed (m/s) in units of the last bound; None where there is none."""
        bound = float(self.speed_bounds[-1])
        return None if speed is None or bound == 0 else speed / bound

    @cached_property
    def update_counts(self) -> dict[str, float]:
        """How many updates of the optimization layer there were, and how they ended."""
        if "diagnostics" not in self.run.steps:
            return dict.fromkeys(_UPDATE_COUNTS, 0)
        diagnostics = Diagnostics.view(self.run.steps["diagnostics"][-1])
        return {name: _count(getattr(diagnostics, name)) for name in _UPDATE_COUNTS}

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


def _count(value: float) -> float:
    """A count in a signal as a whole number; one that is not finite as it is."""
    return int(value) if math.isfinite(value) else float(value)


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


def _steepest_angle(velocities: NDArray) -> float:
    """The largest angle of velocities (k, n, 3) to the horizontal, rad, also between two steps."""
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


def in_chunks(function: Callable[..., NDArray], *arrays: NDArray) -> NDArray:
    """`function(*arrays)`, a few rows at a time; its rows depend on those of the arrays only."""
    starts = range(0, max(len(arrays[0]), 1), _CHUNK)
    parts = [function(*(array[i : i + _CHUNK] for array in arrays)) for i in starts]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


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
