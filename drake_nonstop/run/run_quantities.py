"""The quantities of a run that metrics and figures are made from."""

import math
from collections.abc import Callable
from functools import cached_property
from itertools import combinations
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import (
    Aircraft,
    FlightNeeds,
    is_stalled,
    thrust_power,
)
from drake_nonstop.mechanics.distances import least_length
from drake_nonstop.mechanics.rotation import (
    quaternion_conjugate,
    quaternion_product,
    rotation_matrix,
    rotation_vector,
)
from drake_nonstop.mechanics.signals import AircraftState, CarrierStates, LoadReference, Pose
from drake_nonstop.model.system import SystemParameters, aircraft_in, breaking_load, overridden
from drake_nonstop.planning.diagnostics import Diagnostics
from drake_nonstop.planning.limits import Limit, Of, asked
from drake_nonstop.planning.margins import FlightRanges, LimitAlong
from drake_nonstop.run.run import Run
from drake_nonstop.run.spacing import Approach, closest_approach, least_cable_distances

# The entries of the signal `diagnostics` that count updates.
_UPDATE_COUNTS = ("updates", "kept", "solved", "relaxed", "held")
_CHUNK = 10_000  # rows that are computed at a time: their temporary arrays are small
_SMALL_TURN = math.cos(0.2)  # cosine of the angle, 0.2 rad, that a velocity turns by in a step
_TURN = 0.1  # s, over which turn radii and accelerations are measured
_UNTOLD = 0.1  # m/s, of a wind that is missed on average
_MOVING = 1e-6  # m/s; slower, the load's reference rests; the least airspeed to divide by
_J_PER_KG_M = 1 / 3.6  # 1 J/(kg m) in Wh/(kg km)


class Event(NamedTuple):
    """The first time at which an aircraft or a cable is beyond what it can do."""

    time: float  # s
    number: int  # of the aircraft or the cable, from 1 on
    value: float  # of its lift coefficient, or its tension, N


class RunQuantities:
    """The quantities of a run that metrics and figures are made from, each computed once.

    k is the number of steps of the integrator, n that of the carriers; samples are at 100 Hz. Where
    the carriers are aircraft, their quantities are those of the simulated ones, which need not be
    those that the controllers believe. The power of an aircraft is that of its thrust, T V, zero
    for a thrust below zero; over the aircraft's efficiency it is taken from the battery.
    """

    def __init__(self, run: Run):
        self.run = run
        self.scenario = run.scenario

    @cached_property
    def time(self) -> NDArray:
        """The times (k,) of the steps, s."""
        return self.run.steps["time"]

    @cached_property
    def load_positions(self) -> NDArray:
        """The load's positions (k, 3) at the steps, m."""
        return Pose.view(self.run.steps["load_state"]).position

    @cached_property
    def _errors(self) -> tuple[NDArray, NDArray]:
        return load_errors(self.run)

    @cached_property
    def _tilt_and_yaw(self) -> tuple[NDArray, NDArray]:
        return tilt_and_yaw(self._errors[1])

    @cached_property
    def position_error(self) -> NDArray:
        """The load's distance (samples,) from its reference at 100 Hz, m."""
        return _norms(self._errors[0])

    @cached_property
    def orientation_error(self) -> NDArray:
        """The load's angle (samples,) to its reference at 100 Hz, rad."""
        return _norms(self._errors[1])

    @property
    def tilt_error(self) -> NDArray:
        """The angle (samples,) of the load's z axis to its reference's at 100 Hz, rad."""
        return self._tilt_and_yaw[0]

    @cached_property
    def yaw_error(self) -> NDArray:
        """The load's turn (samples,) about its z axis from its reference at 100 Hz, rad."""
        return np.abs(self._tilt_and_yaw[1])

    @property
    def reference_delay(self) -> float | None:
        """The governor's largest delay of the reference, s; None: no governor."""
        if self.scenario.reference_governor is None:
            return None
        if not self.run.has("reference_delay"):
            return 0.0  # the trajectory is left as it is
        return float(np.max(self.run.signal("reference_delay")))

    @cached_property
    def carrier_positions(self) -> NDArray:
        """The carriers' positions (k, n, 3), in W, m."""
        return laid_apart(CarrierStates.view(self.run.steps["carrier_state"]).positions)

    @cached_property
    def carrier_velocities(self) -> NDArray:
        """The carriers' velocities (k, n, 3), in W, m/s."""
        return laid_apart(CarrierStates.view(self.run.steps["carrier_state"]).velocities)

    @cached_property
    def speeds(self) -> NDArray:
        """The carriers' speeds (k, n), m/s."""
        return _in_chunks(_norms, self.carrier_velocities)

    @cached_property
    def speed_bounds(self) -> NDArray:
        """The speed bound ε (k,), m/s, that was asked for; it may change during a live run."""
        if "speed_bound" in self.run.steps:
            return self.run.steps["speed_bound"][:, 0]
        return np.full(len(self.time), self.scenario.speed_bound)

    @property
    def largest_margin_share(self) -> float:
        """The largest measured margin of plans above the speed bound, over it; 0: there is none."""
        if not (self.run.has("measured_margin") and self.run.has("speed_bound")):
            return 0.0
        margin, bound = map(self.run.signal, ("measured_margin", "speed_bound"))
        is_bound = bound > 0
        return float(np.max(margin[is_bound] / bound[is_bound], initial=0.0))

    @cached_property
    def saturated_share(self) -> float | None:
        """The share of the time with a command of any aircraft at its limit; None: unknown."""
        flags = self.run.steps.get("command_saturation")
        if flags is None or self.time[-1] == 0:
            return None
        return self.duration_of(np.any(flags > 0.5, axis=1)) / float(self.time[-1])

    @cached_property
    def system(self) -> SystemParameters:
        """The simulated load, cables and carriers."""
        return simulated_system(self.run)

    @cached_property
    def slowest_speed(self) -> float:
        """The least speed of any carrier, m/s, also between two steps.

        A velocity that turns by more than 0.2 rad in a step is taken to change linearly in it.
        Elsewhere the least speed at steps counts: it is within 0.5 % of that between them, which a
        linear change would make too small.
        """

        def turns_far(before: NDArray, after: NDArray, slow: NDArray, fast: NDArray) -> NDArray:
            return (before * after).sum(axis=-1) < _SMALL_TURN * slow * fast

        velocities, speeds = self.carrier_velocities, self.speeds
        before, after = velocities[:-1], velocities[1:]
        far = _in_chunks(turns_far, before, after, speeds[:-1], speeds[1:])
        between = least_length(np.stack([before[far], after[far]])) if np.any(far) else math.inf
        return min(float(np.min(speeds)), between)

    @cached_property
    def largest_acceleration(self) -> float | None:
        """Carriers' largest acceleration, m/s², each over 0.1 s of the path; None: unknown."""
        time, states = self.run.time, self.run.signal("carrier_state")
        if len(time) < 3:
            return None
        apart = max(1, min(round(_TURN / (time[1] - time[0])), len(time) - 1))
        changes = states[apart:] - states[:-apart]
        accelerations = (
            CarrierStates.view(changes).velocities / (time[apart:] - time[:-apart])[:, None, None]
        )
        return float(np.max(_norms(accelerations)))

    @cached_property
    def has_aircraft(self) -> bool:
        """Whether the carriers are aircraft and the run has their state."""
        return self.system.aircraft is not None and self.run.has("aircraft_state")

    @cached_property
    def aircraft(self) -> Aircraft:
        """Parameters of the simulated aircraft; only where `has_aircraft`."""
        aircraft = aircraft_in(self.system)
        assert aircraft is not None
        return aircraft

    @cached_property
    def aircraft_state(self) -> AircraftState:
        """Lift coefficient, bank (rad), thrust (N) and airspeed (m/s), (k, n) each."""
        return AircraftState.view(self.run.steps["aircraft_state"])

    @cached_property
    def aircraft_needs(self) -> FlightNeeds:
        """`FlightNeeds`, (k, n) each, as flown, for the limits of aircraft; the force is NaN.

        The climb angle is that through the air; winds change linearly between samples.
        """
        rise, state = self.carrier_velocities[..., 2], self.aircraft_state
        if self.run.has("wind"):
            winds = self.run.signal("wind")[:, 2::3].T
            rise = rise - np.transpose([np.interp(self.time, self.run.time, w) for w in winds])
        return FlightNeeds(
            airspeed=state.airspeed,
            force=np.full(rise.shape, np.nan),
            lift=state.lift,
            bank=state.bank,
            climb=np.arcsin((rise / np.maximum(state.airspeed, _MOVING)).clip(-1, 1)),
            thrust=state.thrust,
        )

    @cached_property
    def ranges(self) -> FlightRanges:
        """The least and the largest values of `aircraft_needs`."""
        return FlightRanges.of(self.aircraft, self.aircraft_needs)

    @cached_property
    def thrust_powers(self) -> NDArray:
        """The power of each aircraft's thrust (samples, n), at 100 Hz, W."""
        state = AircraftState.view(self.run.signal("aircraft_state"))
        return thrust_power(state.thrust, state.airspeed)

    @property
    def energy_per_mass_and_distance(self) -> float | None:
        """Energy from all batteries per mass of the load and length of its way, Wh/(kg km).

        It counts while the load's reference moves, along its path; None where it always rests.
        """
        speeds = _norms(LoadReference.view(self.run.signal("reference")).velocity)
        moves = speeds > _MOVING
        if not np.any(moves):
            return None
        power = self.thrust_powers[moves].sum(axis=1).mean() / self.aircraft.efficiency
        return float(_J_PER_KG_M * power / (self.system.load_mass * speeds[moves].mean()))

    @cached_property
    def first_stall(self) -> Event | None:
        """The first stall of an aircraft, with its C_L; None: there was none."""
        if not self.has_aircraft:
            return None
        stalled = is_stalled(self.aircraft, self.run.steps["aircraft_state"])
        return _first(stalled, self.aircraft_state.lift, self.time)

    @cached_property
    def bounded_speeds(self) -> NDArray:
        """The speeds (k, n), m/s, that ε bounds: airspeeds of aircraft, else speeds in W."""
        return self.aircraft_state.airspeed if self.has_aircraft else self.speeds

    @cached_property
    def time_below_bound(self) -> float:
        """The time for which any carrier was below ε, s."""
        return self.duration_of(np.any(self.bounded_speeds < self.speed_bounds[:, None], axis=1))

    def limited_by(self, limit: Limit) -> NDArray | None:
        """Quantity of a limit (k, c), in its unit, of carriers, cables or pairs; None: unknown."""
        if limit.of is Of.SEPARATION:
            one, other = np.triu_indices(self.carrier_positions.shape[1], 1)
            return _in_chunks(lambda at: _norms(at[:, one] - at[:, other]), self.carrier_positions)
        if limit.is_of_aircraft:
            if not self.has_aircraft:
                return None
            return limit.values(self.aircraft, self.aircraft_needs)
        return self.bounded_speeds if limit.of is Of.SPEED else self.tensions

    @property
    def limits(self) -> list[LimitAlong]:
        """The limits asked of the optimization layer, with their values in the run, where known."""
        rows = [
            (limit, stated, self.limited_by(limit))
            for limit, stated in asked(self.scenario.optimization_layer)
        ]
        return [LimitAlong(row, at, self.time, v) for row, at, v in rows if v is not None]

    def extreme_of(self, limit: Limit) -> float | None:
        """The run's value closest to a limit, or farthest beyond, in its unit; None: unknown."""
        if limit.of is Of.SEPARATION:
            return self.carrier_separation
        values = self.limited_by(limit)
        return None if values is None else float(values[limit.worst(values)])

    @cached_property
    def tensions(self) -> NDArray:
        """The tensions of the cables (k, n), N."""
        return self.run.steps["tensions"]

    @cached_property
    def first_break(self) -> Event | None:
        """The first tension beyond a cable's breaking load, at either end; None: there was none."""
        ends = [(self.time, self.tensions)]
        if self.run.has("carrier_cable_forces"):  # with nodes both ends differ
            forces = self.run.signal("carrier_cable_forces")
            tensions = _in_chunks(lambda rows: _norms(rows.reshape(len(rows), -1, 3)), forces)
            ends.append((self.run.time, tensions))
        bears = breaking_load(self.system)
        found = [_first(tensions > bears, tensions, times) for times, tensions in ends]
        return min((event for event in found if event is not None), default=None)

    @cached_property
    def has_nodes(self) -> bool:
        """Whether the cables have nodes, which the run has the state of."""
        return self.run.has("cable_state")

    @cached_property
    def bows(self) -> NDArray:
        """The largest distance (samples, n), m, of a cable's nodes from the line between its ends.

        Only where `has_nodes`.
        """

        def of_rows(nodes: NDArray, load: NDArray, carriers: NDArray) -> NDArray:
            low, high = attachment_positions(self.run, load), CarrierStates.view(carriers).positions
            positions = nodes[:, : nodes.shape[1] // 2].reshape(len(nodes), -1, *low.shape[1:])
            chords = high - low
            apart = _norms(np.cross(positions - low[:, None], chords[:, None]))
            return apart.max(axis=1) / _norms(chords)

        signals = map(self.run.signal, ("cable_state", "load_state", "carrier_state"))
        return _in_chunks(of_rows, *signals)

    @cached_property
    def slack_time(self) -> float:
        """The time for which any cable was slack, s."""
        return self.duration_of(np.any(self.tensions <= 0, axis=1))

    @property
    def misfit(self) -> str:
        """What unlike lengths and attachments can take from a cable, if it is all that it carries.

        Height and tilt of the load take up their part.
        """
        believed, plant = self.scenario.system, self.system
        cables, places = self.carrier_positions - self.attachment_positions, believed.attachments
        axes = rotation_matrix(Pose.view(self.run.steps["load_state"]).quaternion)
        shifts = np.subtract(plant.attachments, places) @ axes.swapaxes(1, 2)
        errors = (shifts * cables).sum(axis=-1) / _norms(cables)
        errors += np.subtract(plant.cable_length, believed.cable_length)
        level = np.insert(places, 2, 1.0, axis=1)[:, :3]
        misfits = errors - errors @ (level @ np.linalg.pinv(level))
        taken, carried = np.max(misfits * plant.cable_stiffness), np.mean(self.tensions)
        told = (
            f", as lengths and attachments up to {1e3 * np.max(np.abs(misfits)):.2g} mm beside the "
            f"model's can take {taken:.2g} N from a cable, of {carried:.2g} N on average"
        )
        return told if taken > carried else ""

    @property
    def untold_wind(self) -> str:
        """The mean wind at the load that the controllers miss, if there is any to speak of."""
        if not (self.run.has("mean_wind") and self.run.has("wind_estimate")):
            return ""
        mean = _norms(self.run.signal("mean_wind") - self.run.signal("wind_estimate")).mean()
        told = f", where the controllers missed {mean:.2g} m/s of the wind (see wind_estimator)"
        return told if mean > _UNTOLD else ""

    @property
    def most_saturated(self) -> str:
        """The aircraft's command that is at its limits for the longest time, and its mean then."""
        if not self.run.has("aircraft_command"):
            return ""
        held = self.run.signal("command_saturation") > 0.5
        k = int(np.argmax(held.sum(axis=0)))
        channel, carrier = divmod(k, len(self.system.attachments))
        part = AircraftState.layout.parts[channel]
        value = self.run.signal("aircraft_command")[held[:, k], k].mean()
        shown = f"{value:.3g} {part.unit}".strip()
        return f", most of all the {part.name} of carrier {carrier + 1}, at {shown} on average"

    @cached_property
    def attachment_positions(self) -> NDArray:
        """The points of the load that the cables are attached to, (k, n, 3), in W, m."""
        load_states = self.run.steps["load_state"]
        return _in_chunks(lambda states: attachment_positions(self.run, states), load_states)

    @property
    def cable_points(self) -> NDArray:
        """Points that cables are straight between, from the load on, (points, k, n, 3), in W, m.

        Nodes are known at 100 Hz, and linear in between.
        """
        ends = self.attachment_positions, self.carrier_positions
        if not self.has_nodes:
            return np.stack(ends)
        nodes = np.split(self.run.signal("cable_state"), 2, axis=1)[0]
        columns = [np.interp(self.time, self.run.time, column) for column in nodes.T]
        positions = np.stack(columns, axis=1).reshape(len(self.time), -1, *ends[0].shape[1:])
        return np.concatenate([ends[:1], positions.swapaxes(0, 1), ends[1:]])

    @cached_property
    def approaches(self) -> list[Approach]:
        """How near load, cables and carriers come to each obstacle, the worst first.

        The load is the frame between its attachments and its centre of mass.
        """
        if not self.scenario.obstacles:
            return []
        corners = np.concatenate([self.attachment_positions, self.load_positions[:, None]], axis=1)
        edges = corners[:, np.transpose(np.triu_indices(corners.shape[1], 1))]
        cables = np.stack([self.cable_points[:-1], self.cable_points[1:]], axis=-2)
        carriers = np.stack(2 * [self.carrier_positions], axis=-2)
        moved = {"load": edges[:, None], "cable": np.moveaxis(cables, 0, 2)}
        found = [
            closest_approach(kind, bodies, self.time, obstacle.name, obstacle.shape())
            for obstacle in self.scenario.obstacles
            for kind, bodies in (moved | {"carrier": carriers[:, :, None]}).items()
        ]
        return sorted(found, key=attrgetter("order"))

    def obstacle_distance(self, kind: str = "") -> float | None:
        """The least distance from an obstacle, of bodies of a kind, m; None: there are none."""
        return min((a.distance for a in self.approaches if kind in ("", a.kind)), default=None)

    @property
    def reach(self) -> float:
        """The distance of a carrier from the load, as `RunLimits` has it, m."""
        radii = np.linalg.norm(self.system.attachments, axis=1)
        return float(np.max(radii)) + float(np.max(self.system.cable_length))

    @cached_property
    def carrier_separation(self) -> float:
        """The least distance of two carriers, m, also between two steps."""
        positions = self.carrier_positions
        pairs = combinations(range(positions.shape[1]), 2)
        return min(least_length(positions[:, i] - positions[:, j]) for i, j in pairs)

    @cached_property
    def cable_separations(self) -> NDArray:
        """The least distance of each two cables (pairs,), m, also between two steps."""
        return least_cable_distances(self.attachment_positions, self.carrier_positions)

    @property
    def cable_separation_share(self) -> float:
        """The least distance of two cables over that of their attachments, which it cannot exceed.

        Cables that are attached at one point are left out.
        """
        pairs = combinations(np.array(self.system.attachments), 2)
        apart = np.array([np.linalg.norm(a - b) for a, b in pairs])
        shares = self.cable_separations[apart > 0] / apart[apart > 0]
        return float(np.min(shares, initial=math.inf))

    @cached_property
    def update_counts(self) -> dict[str, float]:
        """The number of updates of the optimization layer, and of those that ended in each way."""
        if "diagnostics" not in self.run.steps:
            return dict.fromkeys(_UPDATE_COUNTS, 0)
        diagnostics = Diagnostics.view(self.run.steps["diagnostics"][-1])
        counts = {name: float(getattr(diagnostics, name)) for name in _UPDATE_COUNTS}
        return {name: int(n) if math.isfinite(n) else n for name, n in counts.items()}

    def solve_time(self, share: float) -> float | None:
        """The quantile `share`, 0 to 1, of updates' wall times, ms; None: nothing was solved."""
        times = self.run.solve_times
        return 1e3 * float(np.quantile(times, share)) if len(times) else None

    def duration_of(self, condition: NDArray) -> float:
        """The time, s, for which a condition (k,) holds: at a step for half of both intervals."""
        if len(self.time) < 2:
            return 0.0
        intervals = np.diff(self.time)
        weights = np.concatenate([intervals, [0.0]]) + np.concatenate([[0.0], intervals])
        return float(np.sum(weights[condition]) / 2)


def _first(is_beyond: NDArray, values: NDArray, times: NDArray) -> Event | None:
    """The first of k instants at which a condition (k, n) holds; None: there is none."""
    if not np.any(is_beyond):
        return None
    k = int(np.argmax(np.any(is_beyond, axis=1)))
    i = int(np.argmax(is_beyond[k]))
    return Event(float(times[k]), i + 1, float(values[k, i]))


def load_errors(run: Run) -> tuple[NDArray, NDArray]:
    """Position (m, in W) and orientation (rad) errors of the load, (samples, 3) each.

    The orientation error is the rotation vector from the reference to the load, in L; its
    norm is the angle between the two.
    """
    errors = _in_chunks(_load_errors, run.signal("load_state"), run.signal("reference"))
    return errors[:, :3], errors[:, 3:]


def tilt_and_yaw(rotations: NDArray) -> tuple[NDArray, NDArray]:
    """The two parts (k,) of rotation vectors (k, 3): a turn about z, and then one that tilts z."""
    half = _norms(rotations) / 2
    x, y, z = (np.sinc(half / np.pi)[:, None] * rotations / 2).T
    return 2 * np.arcsin(np.minimum(np.hypot(x, y), 1.0)), 2 * np.arctan2(z, np.cos(half))


def _load_errors(load_states: NDArray, references: NDArray) -> NDArray:
    """[position error, orientation error] (k, 6), as of `load_errors`."""
    state, reference = Pose.view(load_states), Pose.view(references)
    inverse = quaternion_conjugate(reference.quaternion)
    rotation = rotation_vector(quaternion_product(inverse, state.quaternion))
    return np.hstack([state.position - reference.position, rotation])


def carrier_speeds(carrier_state: NDArray) -> NDArray:
    """Speeds (k, n) in m/s of carrier states (k, 6n)."""
    return _in_chunks(_norms, CarrierStates.view(carrier_state).velocities)


def laid_apart(vectors: NDArray) -> NDArray:
    """The same vectors (…, 3) with their components apart in memory: several times faster."""
    return np.moveaxis(np.moveaxis(vectors, -1, 0).copy(), 0, -1)


def _norms(vectors: NDArray) -> NDArray:
    return np.linalg.norm(vectors, axis=-1)


def _in_chunks(function: Callable[..., NDArray], *arrays: NDArray) -> NDArray:
    """Returns `function(*arrays)`, which has to work row by row, computed in chunks of rows."""
    starts = range(0, max(len(arrays[0]), 1), _CHUNK)
    parts = [function(*(array[i : i + _CHUNK] for array in arrays)) for i in starts]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def attachment_positions(run: Run, load_states: NDArray) -> NDArray:
    """The simulated attachment points (k, n, 3), in W, m, for load states (k, 13)."""
    quaternions, positions = Pose.view(load_states)
    R_WL = rotation_matrix(quaternions)
    return positions[:, None] + np.array(simulated_system(run).attachments) @ R_WL.swapaxes(1, 2)


def simulated_system(run: Run) -> SystemParameters:
    """The load, cables and carriers that were simulated."""
    return overridden(run.scenario.system, run.scenario.simulated)
