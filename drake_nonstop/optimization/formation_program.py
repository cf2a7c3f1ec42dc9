"""The program that designs a formation of aircraft above a load that rests or moves.

One program for both kinds: orbits that lean, above a load that does not turn, and level ones of
carriers that turn with the load. What the aircraft need is the exact inverse of their dynamics at
phases of the orbit, at every carrier, in the wind and with the load's velocity and acceleration;
it is traced once, with exact gradients.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.solvers import MathematicalProgram, SnoptSolver, SolverOptions

from drake_nonstop.mechanics.aircraft import (
    Aircraft,
    drawn_power,
    flight_needs,
    needed_force,
    stall_speed,
    thrust_limits,
)
from drake_nonstop.mechanics.cable import positive_part
from drake_nonstop.mechanics.formation_orbit import CarriedLoad, FormationShape, carrier_orbit
from drake_nonstop.optimization.limits import Limit
from drake_nonstop.systems.tracing import TracedFunction

LEANING, CO_ROTATING = "leaning", "co_rotating"
KINDS = (LEANING, CO_ROTATING)


class FormationVariables(NamedTuple):
    """What the program may choose (10,). Forces are shares of f₀ = M g/n, the load's per cable."""

    spread: float  # C/f₀
    radial: float  # A_r/f₀
    tangential: float  # A_t/f₀
    vertical: float  # B/f₀
    frequency: float  # ξ, rad/s
    cable_length: float  # m
    mass: float  # M, kg, of the load
    wind: float  # m/s
    speed: float  # m/s, the largest of the load
    reserve: float  # t, of the margins: at 1 all that are asked for are kept, at 0 the limits


_SIZE = len(FormationVariables._fields)
_AIR = slice(7, 9)  # wind and speed
_MOTION_SIZE = 12  # of a `LoadMotion`
# Names of rows: for the separation that is asked for, the reach, and the cables.
_APART, _APART_REACH, _CABLES = "apart", "apart_reach", "cables"


class LoadMotion(NamedTuple):
    """An instant of the load's way, for a largest speed of 1 m/s."""

    velocity: NDArray  # (3,), m/s
    acceleration: NDArray  # (3,), m/s², which grows with the square of the speed
    jerk: NDArray = np.zeros(3)  # (3,), m/s³, with its cube
    snap: NDArray = np.zeros(3)  # (3,), m/s⁴, with its fourth power

    def at(self, speed: Any) -> tuple[Any, Any, Any, Any]:
        """Velocity, acceleration, jerk and snap (3,) each for a largest speed in m/s."""
        square = speed * speed
        return (
            speed * self.velocity,
            square * self.acceleration,
            square * speed * self.jerk,
            square * square * self.snap,
        )


class DesignLimits(NamedTuple):
    """Beyond which a formation cannot be flown, and how far from there it is to stay."""

    lift_share: float  # of C_Lmax
    speed_share: float  # of the stall speed
    bank: float  # rad
    climb: float  # rad
    carrier_distance: float  # of the reach
    lift_margin: float  # of C_Lmax
    speed_margin: float  # of the stall speed
    bank_margin: float  # rad
    climb_margin: float  # rad
    thrust_margin: float  # of the range of thrust at that airspeed, at either end
    separation: float  # m, of carriers
    asked: tuple[tuple[Limit, float], ...] = ()  # rows of the table of limits, with their values


@dataclass(frozen=True, kw_only=True)
class FormationTask:
    """What a formation is designed for.

    Attributes:
        aircraft: of any cable length.
        load: of any mass.
        wind: the wind's direction (3,), of length 1.
        motions: of the load, at rest among them.
        limits: and margins.
    """

    aircraft: Aircraft
    load: CarriedLoad
    wind: NDArray
    motions: tuple[LoadMotion, ...]
    limits: DesignLimits

    def with_motions(self, count: int) -> "FormationTask":
        """The same with the first motions only."""
        return dataclasses.replace(self, motions=self.motions[:count])


# What one carrier needs at one phase, and where it is.
NEEDS = (
    "lift",  # of C_Lmax
    "airspeed",  # of the stall speed
    "bank",  # rad
    "climb",  # sine of the angle
    "thrust_above",  # from the thrust to the largest, of the range at that airspeed
    "thrust_below",  # to the least
    "share",  # of f₀, the vertical force of its cable
    "thrust",  # N
    "power",  # W, drawn
    *("x", "y", "z"),  # m, beside the load
)
# Of a distance that is asked for, below it, and of a run's limit, above it: a whole margin.
_SEPARATION_MARGIN, _REACH_MARGIN = 0.2, 0.1
ASKED_MARGIN = 0.1  # likewise, of a limit that is asked for
_LEAST_SHARE = 0.3  # of f₀, that a cable always carries
_LARGEST_ANGLE = 0.55  # rad, of attack; a command stays at 0.6
_FINE = 24  # phases of a turn
_LIKELY = 3.0  # of a reserve: a row farther from it hardly matters
_ROUNDS = 4  # of adding rows that do
_TOLERANCE = 2e-3  # of a reserve
# Of the slopes of two cables against the vertical, d their difference and u the direction from one
# attachment to the other: u·d + 0.85 |d| above this. With u·d = -0.85 |d| the cables come as close
# as half the distance of their attachments; with u·d = -|d| they meet.
_CROSSING, _CROSSING_MARGIN = 0.85, 0.015


def _trace(task: FormationTask, kind: str) -> TracedFunction:
    """`NEEDS` of the variables, [azimuth, phase], and a `LoadMotion` (12,).

    After them the margins of the limits that are asked for.
    """
    is_leaning = kind == LEANING

    def needs(values: NDArray, angles: NDArray, motion: NDArray) -> NDArray:
        x: Any = FormationVariables(*(values[i : i + 1] for i in range(_SIZE)))  # type: ignore[arg-type]
        share = x.mass * task.load.gravity / task.load.carriers
        nothing = 0 * share
        shape = FormationShape(
            spread=share * x.spread,
            radial=share * x.radial if is_leaning else nothing,
            tangential=share * x.tangential if is_leaning else nothing,
            vertical=share * x.vertical if is_leaning else nothing,
            frequency=x.frequency if is_leaning else nothing,
            yaw_rate=nothing if is_leaning else x.frequency,
            cable_length=x.cable_length,
        )
        aircraft = task.aircraft._replace(cable_length=x.cable_length)
        load = task.load._replace(mass=x.mass)
        moved = LoadMotion(*(motion[i : i + 3] for i in range(0, _MOTION_SIZE, 3)))
        velocity, acceleration, jerk, snap = moved.at(x.speed)
        air_velocity = velocity - x.wind * task.wind
        orbit = carrier_orbit(
            shape,
            load,
            angles[:1],
            angles[1:],
            air_velocity=air_velocity,
            acceleration=acceleration,
            jerk=jerk,
            snap=snap,
        )
        velocity = orbit.velocities + air_velocity
        force = needed_force(aircraft, orbit.accelerations, orbit.cable_forces)
        needed = flight_needs(aircraft, force, velocity)
        airspeed = needed.airspeed
        least, most = thrust_limits(aircraft, airspeed)
        asked = [
            margin
            for limit, value in task.limits.asked
            for margin in limit.margins(aircraft, needed, value)
        ]
        # Beyond the command's largest angle, where the command alone would not change.
        along = (force * velocity).sum(axis=-1) / airspeed
        across = np.sqrt((force * force).sum(axis=-1) - along * along + 1e-9)
        pressure = aircraft.air_density / 2 * airspeed * airspeed * aircraft.wing_area
        most_lift = aircraft.lift_at_zero_angle + aircraft.lift_slope * _LARGEST_ANGLE
        beyond = positive_part(across / pressure - most_lift)
        return np.concatenate(
            [
                (needed.lift + beyond) / aircraft.max_lift,
                airspeed / stall_speed(aircraft),
                needed.bank,
                velocity[:, 2] / airspeed,
                (most - needed.thrust) / (most - least),
                (needed.thrust - least) / (most - least),
                orbit.cable_forces[:, 2] / share,
                needed.thrust,
                drawn_power(aircraft, needed.thrust, airspeed),
                orbit.positions.ravel(),
                *asked,
            ]
        )

    sizes = [_SIZE, 2, _MOTION_SIZE]
    # The search tries speeds of km/s, too: any finite number will do.
    return TracedFunction(needs, sizes, name=lambda: "design", largest=1e100, jacobian_of=0)


class FormationProgram:
    """The program of a task, a kind of formation and a κ.

    The rows are the margins over what is asked of each: 1 where it is kept, 0 at the limit. They
    are those of all carriers at phases of a turn, of the load's motions, and of all pairs of
    carriers where the load rests in still air.

    Args:
        task: what is designed for.
        kind: one of `KINDS`.
        phase_turns: κ.
        phases: of a turn.
        trace: that of another program of the same task and kind.

    Attributes:
        row_names: (m,), of the quantities.
    """

    def __init__(
        self,
        task: FormationTask,
        kind: str,
        phase_turns: int = 0,
        *,
        phases: int = _FINE,
        trace: TracedFunction | None = None,
    ):
        self.task, self.kind, self.phase_turns = task, kind, phase_turns
        self.trace = trace or _trace(task, kind)
        is_leaning = kind == LEANING
        n = task.load.carriers
        turn = 2 * np.pi * np.arange(phases) / phases
        places = 2 * np.pi * np.arange(n) / n
        between = 2 * np.pi * np.arange(_FINE) / _FINE
        pairs = [(p, a) for p in places for a in turn] if is_leaning else [(a, 0.0) for a in turn]
        self._samples = [
            (np.array(angles), np.concatenate(motion))
            for motion in task.motions
            for angles in pairs
        ]
        self._per_motion = len(pairs)
        self._neighbours = [
            (np.array([0.0, angle]), np.array([step, angle + phase_turns * step]))
            for step in places[1 : n // 2 + 1]
            for angle in (between if is_leaning else between[:1])
        ]
        self._asked = [
            limit.words for limit, _ in task.limits.asked for _ in range(limit.margin_count)
        ]
        names = np.repeat(
            [*(name for name, *_ in self._limits()), *self._asked], len(self._samples)
        )
        apart = np.repeat([_APART, _APART_REACH, _CABLES], len(self._neighbours))
        self.row_names: NDArray = np.concatenate([names, apart])

    def _limits(self) -> list[tuple[str, int, float, float]]:
        """Of each quantity of one carrier: its name, the side of its limit, the limit, a margin."""
        limits = self.task.limits
        climb = math.sin(limits.climb)
        climb_margin = climb - math.sin(limits.climb - limits.climb_margin)
        return [
            ("lift", -1, limits.lift_share, limits.lift_margin),
            ("airspeed", 1, limits.speed_share, limits.speed_margin),
            ("bank", -1, limits.bank, limits.bank_margin),
            ("bank", 1, -limits.bank, limits.bank_margin),
            ("climb", -1, climb, climb_margin),
            ("climb", 1, -climb, climb_margin),
            ("thrust_above", 1, 0.0, limits.thrust_margin),
            ("thrust_below", 1, 0.0, limits.thrust_margin),
            ("share", 1, 0.0, _LEAST_SHARE),
        ]

    def needs(self, values: NDArray) -> tuple[NDArray, NDArray]:
        """`NEEDS` (k, 12) of all samples, and their gradients (k, 12, 10).

        After them the margins of the limits that are asked for.
        """
        found = np.empty((len(self._samples), len(NEEDS) + len(self._asked)))
        gradients = np.empty((*found.shape, _SIZE))
        for k, (angles, motion) in enumerate(self._samples):
            found[k], gradients[k] = self.trace(values, angles, motion)
        return found, gradients

    def rows(self, values: NDArray) -> tuple[NDArray, NDArray, float, NDArray]:
        """The rows (m,), their gradients (m, 10), one aircraft's mean power, W, and its (10,)."""
        needs, slopes = self.needs(values)
        rows, gradients = [], []
        for name, sign, limit, margin in self._limits():
            column = NEEDS.index(name)
            rows.append(sign * (needs[:, column] - limit) / margin)
            gradients.append(sign * slopes[:, column] / margin)
        for column in range(len(NEEDS), needs.shape[1]):
            # Margins of squares: by a share of the limit they change by twice of that.
            rows.append(1 + needs[:, column] / (2 * ASKED_MARGIN))
            gradients.append(slopes[:, column] / (2 * ASKED_MARGIN))
        distances, changes, clearances, clearance_changes = self._beside(values)
        reach = self.task.load.radius + values[5]
        share = self.task.limits.carrier_distance
        for least, slope, kept, margin in (
            (self.task.limits.separation, 0.0, 1.0, _SEPARATION_MARGIN),
            (share * reach, share, 0.0, _REACH_MARGIN),
        ):
            ratio = distances / least
            rows.append(kept + (ratio - 1) / margin)
            change = changes / least
            change[:, 5] -= ratio * slope / least
            gradients.append(change / margin)
        rows.append(clearances / _CROSSING_MARGIN)
        gradients.append(clearance_changes / _CROSSING_MARGIN)
        power, at_rest = NEEDS.index("power"), slice(self._per_motion)
        return (
            np.concatenate(rows),
            np.concatenate(gradients),
            float(needs[at_rest, power].mean()),
            slopes[at_rest, power].mean(axis=0),
        )

    def closest_row(self, values: NDArray) -> str:
        """The name of the quantity that is the closest to its limit."""
        return str(self.row_names[np.argmin(self.rows(values)[0])])

    def separations(self, values: NDArray) -> tuple[NDArray, NDArray]:
        """The distances (p,), m, of pairs above a load at rest in still air, and gradients."""
        return self._beside(values)[:2]

    def _beside(self, values: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """`separations`, and what tells of `_CROSSING` how near two cables come, with gradients."""
        count, radius = len(self._neighbours), self.task.load.radius
        distances, clearances = np.empty(count), np.empty(count)
        slopes, clearance_slopes = np.empty((count, _SIZE)), np.empty((count, _SIZE))
        rest = np.zeros(_MOTION_SIZE)
        values = values.copy()
        values[_AIR] = 0.0
        for k, pair in enumerate(self._neighbours):
            places, changes, leans, lean_changes, ends = [], [], [], [], []
            for angles in pair:
                found, gradient = self.trace(values, angles, rest)
                at = slice(NEEDS.index("x"), len(NEEDS))
                place, change = found[at].copy(), gradient[at].copy()
                end = radius * np.array([math.cos(angles[0]), math.sin(angles[0])])
                lean = (place[:2] - end) / place[2]
                places.append(place)
                changes.append(change)
                ends.append(end)
                leans.append(lean)
                lean_changes.append((change[:2] - np.outer(lean, change[2])) / place[2])
            gap = places[0] - places[1]
            distances[k] = np.linalg.norm(gap)
            slopes[k] = gap @ (changes[0] - changes[1]) / max(distances[k], 1e-9)
            way: NDArray = ends[0] - ends[1]
            way /= np.linalg.norm(way)
            lean = leans[0] - leans[1]
            size = math.sqrt(lean @ lean + 1e-8)
            clearances[k] = way @ lean + _CROSSING * size
            slope = way + _CROSSING * lean / size
            clearance_slopes[k] = slope @ (lean_changes[0] - lean_changes[1])
        slopes[:, _AIR] = clearance_slopes[:, _AIR] = 0.0
        return distances, slopes, clearances, clearance_slopes

    def solve(
        self,
        start: NDArray,
        lower: NDArray,
        upper: NDArray,
        cost: NDArray,
        *,
        power_weight: float = 0.0,
    ) -> NDArray:
        """The variables (10,) of the least cost @ x + weight P with no row below the reserve.

        Only rows that come near the reserve are given to the solver, as they turn up.

        Args:
            start: the variables to begin with.
            lower: bounds (10,); those that are equal to the upper ones are constants.
            upper: bounds (10,).
            cost: (10,).
            power_weight: 1/W, of one aircraft's mean power.

        Returns:
            The variables, whether or not the rows are at the reserve there.
        """
        values = np.clip(start, lower, upper)
        rows = self.rows(values)[0]
        counts = rows < max(values[-1], rows.min()) + _LIKELY
        for _ in range(_ROUNDS):
            values = self._solve(values, lower, upper, cost, power_weight, np.flatnonzero(counts))
            rows = self.rows(values)[0]
            missed = (rows < values[-1] - _TOLERANCE) & ~counts
            if not np.any(missed):
                break
            counts |= rows < values[-1] + _LIKELY / 3
        return values

    def _solve(self, start, lower, upper, cost, power_weight, counting) -> NDArray:
        program = MathematicalProgram()
        scale = np.where(upper > 10, upper, 1.0)
        x = program.NewContinuousVariables(_SIZE, "x")
        program.AddBoundingBoxConstraint(lower / scale, upper / scale, x)
        if np.any(cost):
            program.AddLinearCost(cost * scale, 0.0, x)
        known: list[tuple[bytes, tuple]] = []

        def at(y: NDArray) -> tuple:
            key = y.tobytes()
            if not known or known[0][0] != key:
                known[:] = [(key, self.rows(y * scale))]
            return known[0][1]

        # Drake calls these with floats or with AutoDiffXd, and wants the same back.
        def margins(y: NDArray) -> NDArray:
            is_float = y.dtype == float
            number = y if is_float else ExtractValue(y)[:, 0]
            rows, gradients, _, _ = at(number)
            left = rows[counting] - number[-1]
            if is_float:
                return left
            slopes = gradients[counting] * scale
            slopes[:, -1] -= 1
            return InitializeAutoDiff(left, slopes @ ExtractGradient(y))

        def power(y: NDArray) -> AutoDiffXd | float:
            is_float = y.dtype == float
            _, _, value, slope = at(y if is_float else ExtractValue(y)[:, 0])
            if is_float:
                return power_weight * value
            gradient = power_weight * slope * scale
            return AutoDiffXd(power_weight * value, gradient @ ExtractGradient(y))

        zero = np.zeros(len(counting))
        program.AddConstraint(margins, zero, zero + np.inf, vars=x)
        if power_weight:
            program.AddCost(power, vars=x)
        if self.kind == LEANING and self.task.load.carriers == 3:  # only circles have no wrench
            program.AddLinearEqualityConstraint(np.array([[1.0, -1.0]]), [0.0], x[1:3])
        result = SnoptSolver().Solve(program, start / scale, _options())
        found: NDArray = result.get_x_val() * scale
        return np.clip(found, lower, upper) if np.all(np.isfinite(found)) else start


def _options() -> SolverOptions:
    options = SolverOptions()
    snopt = SnoptSolver.id()
    options.SetOption(snopt, "Major iterations limit", 100)
    options.SetOption(snopt, "Major feasibility tolerance", 1e-5)
    options.SetOption(snopt, "Major optimality tolerance", 1e-4)
    return options
