"""The program that designs a formation of aircraft above a load that rests or moves.

One program for both kinds: orbits that lean, above a load that does not turn, and level ones of
carriers that turn with the load. What the aircraft need is the exact inverse of their dynamics at
phases of the orbit, at every carrier, in the wind and with the load's velocity and acceleration.
One function has it of numbers, at many phases at once, and of symbols, with exact gradients.
"""

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.solvers import MathematicalProgram, SnoptSolver, SolverOptions

from drake_nonstop.mechanics.aircraft import (
    Aircraft,
    FlightNeeds,
    drawn_power,
    flight_needs,
    needed_force,
    pressure_force,
    stall_speed,
    thrust_limits,
)
from drake_nonstop.mechanics.cable import positive_part
from drake_nonstop.mechanics.formation_orbit import CarriedLoad, FormationShape, carrier_orbit
from drake_nonstop.mechanics.planned_orbit import OrbitMotion
from drake_nonstop.model.system import diameter_of
from drake_nonstop.planning.limits import Limit
from drake_nonstop.planning.nonlinear_program import evaluated
from drake_nonstop.systems.tracing import TracedFunction

KINDS = LEANING, CO_ROTATING = "leaning", "co_rotating"


class FormationVariables(NamedTuple):
    """Variables of the program (7,). Forces are shares of f₀ = M g/n, the load's per cable."""

    spread: float  # C/f₀
    radial: float  # A_r/f₀
    tangential: float  # A_t/f₀
    vertical: float  # B/f₀
    frequency: float  # ξ, rad/s
    cable_length: float  # m
    reserve: float  # t, of the margins: at 1 all that are asked for are kept, at 0 the limits


_SIZE = len(FormationVariables._fields)


class LoadMotion(NamedTuple):
    """The load's motion at an instant of its way."""

    velocity: NDArray = np.zeros(3)  # (3,), m/s
    acceleration: NDArray = np.zeros(3)  # (3,), m/s²
    jerk: NDArray = np.zeros(3)  # (3,), m/s³
    snap: NDArray = np.zeros(3)  # (3,), m/s⁴


_REST = LoadMotion()


class Margin(NamedTuple):
    """A limit of a quantity, and how far from it a formation is asked to stay."""

    quantity: str  # of those that `FormationProgram` has
    words: str
    side: int  # 1: the limit is the least value, -1: the largest
    limit: float
    size: float  # of the margin, in the limit's unit

    def kept(self, value: Any) -> Any:
        """The share of the margin that a value keeps: 1 all of it, 0 at the limit."""
        return self.side * (value - self.limit) / self.size

    def sentence(self, share: float, wanted: float = 1.0) -> str:
        """The value that keeps so much of the margin, beside the one that keeps what is wanted."""
        value, bound = (self.limit + self.side * part * self.size for part in (share, wanted))
        return (
            f"{self.words} {value:.3g} ({'at least' if self.side > 0 else 'at most'} {bound:.3g})"
        )


@dataclass(frozen=True, kw_only=True)
class FormationTask:
    """Task that a formation is designed for.

    Attributes:
        aircraft: of any cable length.
        load: what it carries.
        wind: (3,), m/s.
        motions: of the load where it matters most, at rest among them.
        way: motions of the load all along its way.
        margins: of what the aircraft need.
        asked: rows of the table of limits that hold beside, with their values.
        separation: m, of carriers, at least.
        carrier_distance: of the reach, below which two carriers collide.
        gust: m/s, along the flight, which may take so much of an airspeed before the aircraft's
            answer; lift and airspeed are then within their own limits.
        cable_safety: breaking load over the largest tension; 0: the diameter is the aircraft's.
        cable_density: kg/m³; 0: the mass of cables does not count.
    """

    aircraft: Aircraft
    load: CarriedLoad
    wind: NDArray
    motions: tuple[LoadMotion, ...]
    way: tuple[LoadMotion, ...]
    margins: tuple[Margin, ...]
    asked: tuple[tuple[Limit, float], ...] = ()
    separation: float
    carrier_distance: float
    gust: float = 0.0
    cable_safety: float = 0.0
    cable_density: float = 0.0

    def angles(self, kind: str, phases: int) -> NDArray:
        """The azimuths of all carriers, and their phases (2, k), at phases of a turn."""
        turn, places = (2 * np.pi * np.arange(k) / k for k in (phases, self.load.carriers))
        if kind != LEANING:
            return np.stack([turn, np.zeros(phases)])
        return np.stack([np.repeat(places, phases), np.tile(turn, len(places))])

    @property
    def share(self) -> Any:
        """f₀, N."""
        return self.load.mass * self.load.gravity / self.load.carriers

    def flown_by(self, x: FormationVariables) -> Aircraft:
        """The aircraft, with the drag of its cable in the polar.

        The cable's diameter follows from no less than the largest tension: with the largest force
        of the pattern in each direction, and the largest sideward force on the load.
        """
        diameter = self.aircraft.cable_diameter
        if self.cable_safety > 0:
            load = self.load
            fastest, steepest = (
                max(float(np.linalg.norm(motion[order])) for motion in self.way)
                for order in range(2)
            )
            air = fastest + float(np.linalg.norm(self.wind))
            aside = load.mass * steepest + load.drag * air
            level = x.spread + x.radial + aside / (load.carriers * self.share)
            squares = level * level + x.tangential * x.tangential + (1 + x.vertical) ** 2
            diameter = diameter_of(self.cable_safety * self.share * np.sqrt(squares))
        return self.aircraft._replace(cable_length=x.cable_length, cable_diameter=diameter)

    def needed_force(self, aircraft: Aircraft, motion: OrbitMotion) -> NDArray:
        """The `needed_force` (k, 3), N, of an aircraft `flown_by` the formation.

        It bears its cable's weight, and the inertia of one whose end at the load is at rest.
        """
        area = np.pi / 4 * aircraft.cable_diameter * aircraft.cable_diameter
        mass = self.cable_density * area * aircraft.cable_length
        of_cable = mass * (motion.accelerations / 2 + aircraft.gravity * np.eye(3)[2])
        return needed_force(aircraft, motion.accelerations, motion.forces + of_cable)

    def orbit(
        self,
        kind: str,
        x: FormationVariables,
        angles: NDArray,
        motion: LoadMotion = _REST,
        wind: NDArray = _REST.velocity,
    ) -> OrbitMotion:
        """The motion (k, 3) of carriers at azimuths and phases (2, k), of numbers or symbols.

        By default the load rests in still air.
        """
        nothing = 0 * x.frequency
        sizes = [*(self.share * size for size in x[:4]), x.frequency, nothing, x.cable_length]
        if kind != LEANING:
            sizes[1:6] = [nothing] * 4 + [x.frequency]
        return carrier_orbit(
            FormationShape(*sizes),
            self.load,
            angles[0],
            angles[1],
            air_velocity=motion.velocity - wind,
            acceleration=motion.acceleration,
            jerk=motion.jerk,
            snap=motion.snap,
        )


# Of a distance that is asked for, below it, and of a run's limit, above it: a whole margin.
_SEPARATION_MARGIN, _REACH_MARGIN = 0.2, 0.1
_ASKED_MARGIN = 0.1  # likewise, of a limit that is asked for, and of what gusts leave
_LEAST_SHARE = 0.3  # of f₀, that a cable always carries
_LARGEST_ANGLE = 0.55  # rad, of attack; a command stays at 0.6
_COARSE, _FINE = 24, 90  # phases of a turn, of the program and of a formation that it finds
_LIKELY = 3.0  # of a reserve: a row farther from it hardly matters
_ROUNDS = 4  # of adding rows that do
_TOLERANCE = 2e-3  # of a reserve
_CROSSING, _CROSSING_MARGIN = 0.85, 0.015  # see `_pair_rows`
_LEAST = 1e-18  # m², beside a squared distance that may vanish


class FormationProgram:
    """The program of a task, a kind of formation and a κ.

    The rows are the shares of the margins that are kept: 1 where all is, 0 at the limit. They
    are those of all carriers at phases of a turn, of the load's motions, and of all pairs of
    carriers where the load rests in still air.

    Args:
        task: what is designed for.
        kind: one of `KINDS`.
        phase_turns: κ.
        phases: of a turn.

    Attributes:
        margins: what the rows are of, those of pairs last.
    """

    def __init__(
        self, task: FormationTask, kind: str, phase_turns: int = 0, *, phases: int = _COARSE
    ):
        self.task, self.kind, self.phase_turns = task, kind, phase_turns
        margins = [
            *task.margins,
            Margin("share", "least force of a cable / f0", 1, 0, _LEAST_SHARE),
        ]
        for limit, value in task.asked:
            size = _ASKED_MARGIN * value
            margin = Margin("", limit.words, limit.side, value - limit.side * size, size)
            margins += limit.margin_count * [margin]
        if task.gust > 0:
            for quantity in ("lift", "airspeed"):
                words = f"{quantity} in gusts, of its limit"
                margins.append(Margin(quantity, words, 1, 1 - _ASKED_MARGIN, _ASKED_MARGIN))
        size = _SEPARATION_MARGIN * task.separation
        self.margins = (
            *margins,
            Margin("", "carriers apart, m,", 1, task.separation - size, size),
            Margin("", "carriers apart / the least of their reach", 1, 1.0, _REACH_MARGIN),
            Margin("", "crossing of cables", 1, 0.0, _CROSSING_MARGIN),
        )
        self._of_carrier = self._traced(self._carrier_rows, [2, 12])
        self._of_pair = self._traced(self._pair_rows, [4])
        n = task.load.carriers
        turn, places = (2 * np.pi * np.arange(k) / k for k in (_COARSE, n))
        angles = task.angles(kind, phases).T
        self._samples = [(pair, np.concatenate(each)) for each in task.motions for pair in angles]
        self._per_motion = len(angles)
        self._neighbours = [
            (np.array([0.0, step, angle, angle + phase_turns * step]),)
            for step in places[1 : n // 2 + 1]
            for angle in (turn if kind == LEANING else turn[:1])
        ]

    def _traced(self, function: Callable, sizes: list[int]) -> TracedFunction:
        """One of the two functions below, with its Jacobian by the variables."""
        # The search tries speeds of km/s, too: any finite number will do.
        asked = [(limit.field, value) for limit, value in self.task.asked]
        return TracedFunction(
            function,
            [_SIZE, *sizes],
            name=lambda: "design",
            largest=1e100,
            jacobian_of=0,
            key=(
                *(function.__name__, self.kind, asked),
                dataclasses.replace(self.task, asked=(), motions=()),
            ),
        )

    def quantities(
        self, x: FormationVariables, angles: NDArray, motion: LoadMotion
    ) -> tuple[FlightNeeds, dict[str, Any]]:
        """What carriers at azimuths and phases (2, k) need, and its quantities (k,), by name."""
        aircraft = self.task.flown_by(x)
        orbit = self.task.orbit(self.kind, x, angles, motion, self.task.wind)
        velocity, force = orbit.velocities, self.task.needed_force(aircraft, orbit)
        needed = flight_needs(aircraft, force, velocity)
        airspeed, thrust = needed.airspeed, needed.thrust
        least, most = thrust_limits(aircraft, airspeed)
        # Beyond the command's largest angle, where the command alone would not change.
        along = (force * velocity).sum(axis=-1) / airspeed
        across = np.sqrt((force * force).sum(axis=-1) - along * along + 1e-9)
        most_lift = aircraft.lift_at_zero_angle + aircraft.lift_slope * _LARGEST_ANGLE
        beyond = positive_part(across / pressure_force(aircraft, airspeed) - most_lift)
        return needed, {
            "lift": (needed.lift + beyond) / aircraft.max_lift,
            "airspeed": airspeed / stall_speed(aircraft),
            "bank": needed.bank,
            "climb": velocity[:, 2] / airspeed,
            "thrust_above": (most - thrust) / (most - least),
            "thrust_below": (thrust - least) / (most - least),
            "share": orbit.forces[:, 2] / self.task.share,
            "power": drawn_power(aircraft, thrust, airspeed),
        }

    def rows_of_carriers(
        self, x: FormationVariables, angles: NDArray, motion: LoadMotion
    ) -> tuple[list[Any], Any]:
        """The rows (k,) of carriers, in the order of `margins`, and their power (k,), W."""
        task = self.task
        needed, found = self.quantities(x, angles, motion)
        count = len(task.margins) + 1
        rows = [margin.kept(found[margin.quantity]) for margin in self.margins[:count]]
        for limit, value in task.asked:
            # Margins of squares: by a share of the limit they change by twice of that.
            margins = limit.margins(task.flown_by(x), needed, value)
            rows += [1 + margin / (2 * _ASKED_MARGIN) for margin in margins]
        if task.gust > 0:
            own = {margin.quantity: margin.limit for margin in task.margins}
            left = 1 - task.gust / needed.airspeed  # of the airspeed
            lift = np.sqrt(positive_part(found["lift"]) / own["lift"] + 1e-6)
            shares = left / lift, left * found["airspeed"] / own["airspeed"]
            rows += [1 + (share - 1) / _ASKED_MARGIN for share in shares]
        return rows, found["power"]

    def _carrier_rows(self, values: NDArray, angles: NDArray, motion: NDArray) -> NDArray:
        """The rows of one carrier, and its power, W, at [azimuth, phase] and a `LoadMotion`."""
        moved = LoadMotion(*(motion[i : i + 3] for i in range(0, 12, 3)))
        rows, power = self.rows_of_carriers(_variables(values), angles.reshape(2, 1), moved)
        return np.concatenate([*rows, power])

    def _pair_rows(self, values: NDArray, angles: NDArray) -> NDArray:
        """The rows of two carriers, and their distance, m, above a load at rest in still air.

        `angles` (4,) are their azimuths and their phases. Of the slopes of two cables against the
        vertical, d their difference and u the direction from one attachment to the other, the last
        row asks for u·d + 0.85 |d| above zero. With u·d = -0.85 |d| the cables come as close as
        half the distance of their attachments; with u·d = -|d| they meet.
        """
        x, radius = _variables(values), self.task.load.radius
        places = self.task.orbit(self.kind, x, angles.reshape(2, 2)).positions
        ends = radius * np.stack([np.cos(angles[:2]), np.sin(angles[:2])], axis=1)
        level = places[:, :2]
        leans = (level - ends) / places[:, 2:]
        gap = np.concatenate([level[0] - level[1], places[0, 2:] - places[1, 2:]])
        distance = np.sqrt((gap * gap).sum(keepdims=True) + _LEAST)
        way, lean = ends[0] - ends[1], leans[0] - leans[1]
        way = way / np.sqrt((way * way).sum(keepdims=True))
        size = np.sqrt((lean * lean).sum(keepdims=True) + 1e-8)
        reach = self.task.carrier_distance * (radius + x.cable_length)
        crossing = (way * lean).sum(keepdims=True) + _CROSSING * size
        found = distance, distance / reach, crossing
        rows = [margin.kept(each) for margin, each in zip(self.margins[-3:], found, strict=True)]
        return np.concatenate([*rows, distance])

    def rows(self, values: NDArray) -> tuple[NDArray, NDArray, float, NDArray]:
        """The rows (m,), their gradients (m, 7), one aircraft's mean power, W, and its (7,)."""
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

    def separation(self, values: NDArray) -> float:
        """The least distance, m, of two carriers above a load at rest in still air."""
        return float(_evaluated(self._of_pair, values, self._neighbours)[0][-1].min())

    def on_way(self, values: NDArray, phases: int = _FINE) -> NDArray:
        """The least of each of the `margins` (r,), at fine phases all along the load's way."""
        x, angles = FormationVariables(*values), self.task.angles(self.kind, phases)
        found = [self.rows_of_carriers(x, angles, motion)[0] for motion in self.task.way]
        beside = _evaluated(self._of_pair, values, self._neighbours)[0][:-1].min(axis=1)
        return np.concatenate([np.min(found, axis=(0, 2)), beside])

    def extremes(self, values: NDArray, phases: int = _FINE) -> dict[str, tuple[float, float]]:
        """The least and the largest of each quantity, airspeed and thrust on the way, by name."""
        x, angles = FormationVariables(*values), self.task.angles(self.kind, phases)
        columns: dict[str, list[NDArray]] = {}
        for motion in self.task.way:
            needed, found = self.quantities(x, angles, motion)
            found |= {"airspeed_m_s": needed.airspeed, "thrust_N": needed.thrust}
            for name, column in found.items():
                columns.setdefault(name, []).append(column)
        return {name: (float(np.min(c)), float(np.max(c))) for name, c in columns.items()}

    def solve(
        self,
        start: NDArray,
        lower: NDArray,
        upper: NDArray,
        cost: NDArray,
        *,
        power_weight: float = 0.0,
    ) -> NDArray:
        """The variables (7,) of the least cost @ x + weight P with no row below the reserve.

        Only rows that come near the reserve are given to the solver, as they turn up.

        Args:
            start: the variables to begin with.
            lower: bounds (7,); those that are equal to the upper ones are constants.
            upper: bounds (7,).
            cost: (7,).
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
    """The outputs (o, k) at k samples, and their gradients (o, k, 7) by the variables."""
    found = [tuple(map(np.copy, function(values, *sample))) for sample in samples]
    outputs, gradients = map(np.array, zip(*found, strict=True))
    return outputs.T, gradients.swapaxes(0, 1)
