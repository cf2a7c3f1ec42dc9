"""The program that designs a formation of aircraft above a load that rests or moves.

One program for both kinds: orbits that lean, above a load that does not turn, and level ones of
carriers that turn with the load. What the aircraft need is the exact inverse of their dynamics at
phases of the orbit, at every carrier, in the wind and with the load's velocity and acceleration;
it is traced once, with exact gradients.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.solvers import MathematicalProgram, SnoptSolver, SolverOptions

from drake_nonstop.mechanics.aircraft import (
    Aircraft,
    drawn_power,
    flight_needs,
    needed_force,
    pressure_force,
    stall_speed,
    thrust_limits,
)
from drake_nonstop.mechanics.cable import positive_part
from drake_nonstop.mechanics.formation_orbit import (
    CarriedLoad,
    FormationShape,
    carrier_orbit,
)
from drake_nonstop.mechanics.planned_orbit import OrbitMotion
from drake_nonstop.model.system import diameter_of
from drake_nonstop.planning.limits import Limit
from drake_nonstop.planning.nonlinear_program import evaluated
from drake_nonstop.systems.tracing import TracedFunction

LEANING, CO_ROTATING = "leaning", "co_rotating"
KINDS = (LEANING, CO_ROTATING)
# Of the airspeed that is left in gusts, over the least one.
LIFT_IN_GUSTS, AIRSPEED_IN_GUSTS = "airspeed in gusts / that of C_L", "airspeed in gusts / least"


class FormationVariables(NamedTuple):
    """Variables of the program (10,). Forces are shares of f₀ = M g/n, the load's per cable."""

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
_MOTION_SIZE = 12  # of a `LoadMotion`


class LoadMotion(NamedTuple):
    """An instant of the load's way, for a largest speed of 1 m/s."""

    velocity: NDArray  # (3,), m/s
    acceleration: NDArray  # (3,), m/s², which grows with the square of the speed
    jerk: NDArray = np.zeros(3)  # (3,), m/s³, with its cube
    snap: NDArray = np.zeros(3)  # (3,), m/s⁴, with its fourth power

    def at(self, speed: Any) -> "LoadMotion":
        """That of a largest speed in m/s."""
        square = speed * speed
        return LoadMotion(
            speed * self.velocity,
            square * self.acceleration,
            square * speed * self.jerk,
            square * square * self.snap,
        )


class FlightMargins(NamedTuple):
    """Bounds of what aircraft need, each to one side."""

    lift_share: float  # of C_Lmax, at most
    speed_share: float  # of the stall speed, at least
    bank: float  # rad, at most
    climb: float  # rad, at most
    thrust_reserve: float  # of the range of thrust at that airspeed, at least, at either end


class DesignLimits(NamedTuple):
    """Beyond which a formation cannot be flown, and where it is to stay."""

    own: FlightMargins
    wanted: FlightMargins
    carrier_distance: float  # of the reach
    separation: float  # m, of carriers
    asked: tuple[tuple[Limit, float], ...] = ()  # rows of the table of limits, with their values


@dataclass(frozen=True, kw_only=True)
class FormationTask:
    """Task that a formation is designed for.

    Attributes:
        aircraft: of any cable length.
        load: of any mass.
        wind: the wind's direction (3,), of length 1.
        motions: of the load, at rest among them.
        limits: and margins.
        gust: m/s, along the flight, which may take so much of an airspeed before the aircraft's
            answer; lift and airspeed are then within their own limits.
        cable_safety: breaking load over the largest tension; 0: the diameter is the aircraft's.
        cable_density: kg/m³; 0: the mass of cables does not count.
    """

    aircraft: Aircraft
    load: CarriedLoad
    wind: NDArray
    motions: tuple[LoadMotion, ...]
    limits: DesignLimits
    gust: float = 0.0
    cable_safety: float = 0.0
    cable_density: float = 0.0

    def with_motions(self, count: int) -> "FormationTask":
        """The same with the first motions only."""
        return dataclasses.replace(self, motions=self.motions[:count])

    def angles(self, kind: str, phases: int) -> NDArray:
        """The azimuths of all carriers, and then their phases, at phases of a turn."""
        turn, places = (2 * np.pi * np.arange(k) / k for k in (phases, self.load.carriers))
        if kind != LEANING:
            return np.concatenate([turn, np.zeros(phases)])
        return np.concatenate([np.repeat(places, phases), np.tile(turn, len(places))])

    def share(self, x: FormationVariables) -> Any:
        """f₀, N."""
        return x.mass * self.load.gravity / self.load.carriers

    def flown_by(self, x: FormationVariables) -> Aircraft:
        """The aircraft, with the drag of its cable in the polar.

        The cable's diameter follows from no less than the largest tension: with the largest force
        of the pattern in each direction, and the largest sideward force on the load.
        """
        diameter = self.aircraft.cable_diameter
        if self.cable_safety > 0:
            load = self.load
            fastest, steepest = (
                max(float(np.linalg.norm(motion[order])) for motion in self.motions)
                for order in range(2)
            )
            moved = x.mass * steepest * x.speed * x.speed
            aside = moved + load.drag * (fastest * x.speed + x.wind)
            level = x.spread + x.radial + aside / (load.carriers * self.share(x))
            squares = level * level + x.tangential * x.tangential + (1 + x.vertical) ** 2
            diameter = diameter_of(self.cable_safety * self.share(x) * np.sqrt(squares))
        return self.aircraft._replace(cable_length=x.cable_length, cable_diameter=diameter)

    def built(self, x: FormationVariables) -> "FormationTask":
        """The task of the cables that a formation has, whatever becomes of it."""
        return dataclasses.replace(self, aircraft=self.flown_by(x), cable_safety=0.0)

    def needed_force(self, aircraft: Aircraft, motion: OrbitMotion) -> NDArray:
        """The `needed_force` (k, 3), N, of an aircraft `flown_by` the formation.

        It bears its cable's weight, and the inertia of one whose end at the load is at rest.
        """
        area = np.pi / 4 * aircraft.cable_diameter * aircraft.cable_diameter
        mass = self.cable_density * area * aircraft.cable_length
        of_cable = mass * (motion.accelerations / 2 + aircraft.gravity * np.eye(3)[2])
        return needed_force(aircraft, motion.accelerations, motion.forces + of_cable)

    def orbit(
        self, kind: str, x: FormationVariables, angles: NDArray, load_motion: LoadMotion
    ) -> OrbitMotion:
        """The motion (k, 3) of carriers at [azimuths, phases] (2k,), of numbers or symbols.

        Of variables that are numbers or arrays (1,), and a load that moves at their speed.
        """
        share, nothing = self.share(x), 0 * x.mass
        sizes = [*(share * size for size in x[:4]), x.frequency, nothing, x.cable_length]
        if kind != LEANING:
            sizes[1:6] = [nothing] * 4 + [x.frequency]
        velocity, acceleration, jerk, snap = load_motion
        azimuths, phases = np.split(angles, 2)
        return carrier_orbit(
            FormationShape(*sizes),
            self.load._replace(mass=x.mass),
            azimuths,
            phases,
            air_velocity=velocity - x.wind * self.wind,
            acceleration=acceleration,
            jerk=jerk,
            snap=snap,
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
_CROSSING, _CROSSING_MARGIN = 0.85, 0.015  # see `_pair_rows`
_LEAST = 1e-18  # m², beside a squared distance that may vanish


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

    Attributes:
        row_names: (m,), of the quantities.
    """

    def __init__(
        self, task: FormationTask, kind: str, phase_turns: int = 0, *, phases: int = _FINE
    ):
        self.task, self.kind, self.phase_turns = task, kind, phase_turns
        own, wanted = task.limits.own, task.limits.wanted
        margins = FlightMargins(*(abs(a - b) for a, b in zip(own, wanted, strict=True)))
        climb = math.sin(own.climb)
        climb_margin = climb - math.sin(wanted.climb)
        # Of each quantity its name, the side of its limit, the limit, and the margin from it.
        self._limits = [
            ("lift", -1, own.lift_share, margins.lift_share),
            ("airspeed", 1, own.speed_share, margins.speed_share),
            ("bank", -1, own.bank, margins.bank),
            ("bank", 1, -own.bank, margins.bank),
            ("climb", -1, climb, climb_margin),
            ("climb", 1, -climb, climb_margin),
            ("thrust_above", 1, own.thrust_reserve, margins.thrust_reserve),
            ("thrust_below", 1, own.thrust_reserve, margins.thrust_reserve),
            ("share", 1, 0.0, _LEAST_SHARE),
        ]
        asked = [limit.words for limit, _ in task.limits.asked for _ in range(limit.margin_count)]
        in_gusts = [LIFT_IN_GUSTS, AIRSPEED_IN_GUSTS] if task.gust > 0 else []
        names = [*(name for name, *_ in self._limits), *asked, *in_gusts]
        self._of_carrier = self._traced(self._carrier_rows, [2, _MOTION_SIZE])
        self._of_pair = self._traced(self._pair_rows, [4])
        n = task.load.carriers
        turn, places = (2 * np.pi * np.arange(k) / k for k in (_FINE, n))
        pairs = task.angles(kind, phases).reshape(2, -1).T
        self._samples = [
            (angles, np.concatenate(motion)) for motion in task.motions for angles in pairs
        ]
        self._per_motion = len(pairs)
        self._neighbours = [
            (np.array([0.0, step, angle, angle + phase_turns * step]),)
            for step in places[1 : n // 2 + 1]
            for angle in (turn if kind == LEANING else turn[:1])
        ]
        apart = np.repeat(["apart", "apart_reach", "cables"], len(self._neighbours))
        self.row_names: NDArray = np.concatenate([np.repeat(names, len(self._samples)), apart])

    def _traced(self, function: Callable, sizes: list[int]) -> TracedFunction:
        """One of the two functions below, with its Jacobian by the variables."""
        task, limits = self.task, self.task.limits
        asked = [(limit.field, value) for limit, value in limits.asked]
        motions = task.motions if task.cable_safety > 0 else ()
        of_task = task.aircraft, task.load, task.wind, task.gust, task.cable_safety
        # The search tries speeds of km/s, too: any finite number will do.
        return TracedFunction(
            function,
            [_SIZE, *sizes],
            name=lambda: "design",
            largest=1e100,
            jacobian_of=0,
            key=(
                *(function.__name__, self.kind, *of_task, task.cable_density, motions),
                *(limits._replace(asked=()), asked),
            ),
        )

    def _carrier_rows(self, values: NDArray, angles: NDArray, motion: NDArray) -> NDArray:
        """The rows of one carrier, and its power, W, at [azimuth, phase] and a `LoadMotion`."""
        x = _variables(values)
        moved = LoadMotion(*(motion[i : i + 3] for i in range(0, _MOTION_SIZE, 3)))
        aircraft = self.task.flown_by(x)
        orbit = self.task.orbit(self.kind, x, angles, moved.at(x.speed))
        velocity = orbit.velocities
        force = self.task.needed_force(aircraft, orbit)
        needed = flight_needs(aircraft, force, velocity)
        airspeed, thrust = needed.airspeed, needed.thrust
        least, most = thrust_limits(aircraft, airspeed)
        # Beyond the command's largest angle, where the command alone would not change.
        along = (force * velocity).sum(axis=-1) / airspeed
        across = np.sqrt((force * force).sum(axis=-1) - along * along + 1e-9)
        most_lift = aircraft.lift_at_zero_angle + aircraft.lift_slope * _LARGEST_ANGLE
        beyond = positive_part(across / pressure_force(aircraft, airspeed) - most_lift)
        quantities = {
            "lift": (needed.lift + beyond) / aircraft.max_lift,
            "airspeed": airspeed / stall_speed(aircraft),
            "bank": needed.bank,
            "climb": velocity[:, 2] / airspeed,
            "thrust_above": (most - thrust) / (most - least),
            "thrust_below": (thrust - least) / (most - least),
            "share": orbit.forces[:, 2] / self.task.share(x),
        }
        rows = [
            side * (quantities[name] - limit) / margin for name, side, limit, margin in self._limits
        ]
        for limit, value in self.task.limits.asked:
            # Margins of squares: by a share of the limit they change by twice of that.
            margins = limit.margins(aircraft, needed, value)
            rows += [1 + margin / (2 * ASKED_MARGIN) for margin in margins]
        if self.task.gust > 0:
            own = self.task.limits.own
            left = 1 - self.task.gust / airspeed  # of the airspeed
            lift = np.sqrt(positive_part(quantities["lift"]) / own.lift_share + 1e-6)
            shares = left / lift, left * quantities["airspeed"] / own.speed_share
            rows += [1 + (share - 1) / ASKED_MARGIN for share in shares]
        return np.concatenate([*rows, drawn_power(aircraft, thrust, airspeed)])

    def _pair_rows(self, values: NDArray, angles: NDArray) -> NDArray:
        """The rows of two carriers, and their distance, m, above a load at rest in still air.

        `angles` (4,) are their azimuths and their phases. Of the slopes of two cables against the
        vertical, d their difference and u the direction from one attachment to the other, the last
        row asks for u·d + 0.85 |d| above zero. With u·d = -0.85 |d| the cables come as close as
        half the distance of their attachments; with u·d = -|d| they meet.
        """
        x = _variables(values)._replace(wind=np.zeros(1))
        task, limits = self.task, self.task.limits
        places = task.orbit(self.kind, x, angles, LoadMotion(*np.zeros((4, 3)))).positions
        ends = task.load.radius * np.stack([np.cos(angles[:2]), np.sin(angles[:2])], axis=1)
        level = places[:, :2]
        leans = (level - ends) / places[:, 2:]
        gap = np.concatenate([level[0] - level[1], places[0, 2:] - places[1, 2:]])
        distance = np.sqrt((gap * gap).sum(keepdims=True) + _LEAST)
        way, lean = ends[0] - ends[1], leans[0] - leans[1]
        way = way / np.sqrt((way * way).sum(keepdims=True))
        size = np.sqrt((lean * lean).sum(keepdims=True) + 1e-8)
        reach = limits.carrier_distance * (task.load.radius + x.cable_length)
        return np.concatenate(
            [
                1 + (distance / limits.separation - 1) / _SEPARATION_MARGIN,
                (distance / reach - 1) / _REACH_MARGIN,
                ((way * lean).sum(keepdims=True) + _CROSSING * size) / _CROSSING_MARGIN,
                distance,
            ]
        )

    def rows(self, values: NDArray) -> tuple[NDArray, NDArray, float, NDArray]:
        """The rows (m,), their gradients (m, 10), one aircraft's mean power, W, and its (10,)."""
        (*rows, power), (*gradients, power_gradient) = _evaluated(
            self._of_carrier, values, self._samples
        )
        (*beside, _), (*beside_gradients, _) = _evaluated(self._of_pair, values, self._neighbours)
        at_rest = slice(self._per_motion)
        return (
            np.concatenate([*rows, *beside]),
            np.concatenate([*gradients, *beside_gradients]),
            float(power[at_rest].mean()),
            power_gradient[at_rest].mean(axis=0),
        )

    def separations(self, values: NDArray) -> NDArray:
        """The distances (p,), m, of pairs above a load at rest in still air."""
        return _evaluated(self._of_pair, values, self._neighbours)[0][-1]

    def closest_row(self, values: NDArray) -> str:
        """The name of the quantity that is the closest to its limit."""
        return str(self.row_names[np.argmin(self.rows(values)[0])])

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

        @functools.lru_cache(maxsize=1)  # for constraint and cost
        def everything(numbers: bytes) -> tuple[NDArray, NDArray]:
            """The rows above the reserve, then the weighted power, and their gradients."""
            y = np.frombuffer(numbers)
            rows, gradients, power, slope = self.rows(y * scale)
            values = np.append(rows[counting] - y[-1], power_weight * power)
            slopes = np.vstack([gradients[counting], power_weight * slope]) * scale
            slopes[:-1, -1] -= 1
            return values, slopes

        def part(y: NDArray, of: slice) -> Any:
            return evaluated(lambda number: [e[of] for e in everything(number.tobytes())], y)

        zero = np.zeros(len(counting))
        program.AddConstraint(lambda y: part(y, slice(0, -1)), zero, zero + np.inf, vars=x)
        if power_weight:
            program.AddCost(lambda y: part(y, slice(-1, None))[0], vars=x)
        if self.kind == LEANING and self.task.load.carriers == 3:  # only circles have no wrench
            program.AddLinearEqualityConstraint(np.array([[1.0, -1.0]]), [0.0], x[1:3])
        options, snopt = SolverOptions(), SnoptSolver.id()
        options.SetOption(snopt, "Major iterations limit", 100)
        options.SetOption(snopt, "Major feasibility tolerance", 1e-5)
        options.SetOption(snopt, "Major optimality tolerance", 1e-4)
        result = SnoptSolver().Solve(program, start / scale, options)
        found: NDArray = result.get_x_val() * scale
        return np.clip(found, lower, upper) if np.all(np.isfinite(found)) else start


def _variables(values: NDArray) -> Any:
    """The variables, each an array (1,)."""
    return FormationVariables(*(values[i : i + 1] for i in range(_SIZE)))  # type: ignore[arg-type]


def _evaluated(function: TracedFunction, values: NDArray, samples: list) -> tuple[NDArray, NDArray]:
    """The outputs (o, k) at k samples, and their gradients (o, k, 10) by the variables."""
    found = [tuple(map(np.copy, function(values, *sample))) for sample in samples]
    outputs, gradients = map(np.array, zip(*found, strict=True))
    return outputs.T, gradients.swapaxes(0, 1)
