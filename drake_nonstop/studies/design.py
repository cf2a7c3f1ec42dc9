"""Formations of aircraft for a load: found, described, and as scenarios that fly."""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.aircraft_margins import (
    AircraftMargins,
    FlightLimits,
    aircraft_margins,
    aircraft_needs,
)
from drake_nonstop.analysis.bowed_cables import BowedCables
from drake_nonstop.analysis.formation import find_formation
from drake_nonstop.analysis.task import task_of
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.mechanics.aircraft import (
    airspeed_over_loaded_stall,
    drawn_power,
    stall_speed,
    thrust_limits,
    thrust_share,
)
from drake_nonstop.mechanics.formation_orbit import CarriedLoad, FormationShape, carrier_orbit
from drake_nonstop.mechanics.planned_orbit import FlightNeeds
from drake_nonstop.mechanics.signals import POSE_SIZE
from drake_nonstop.model.pattern import EllipticCarouselConfig
from drake_nonstop.optimization.formation_program import (
    ASKED_MARGIN,
    LEANING,
    DesignLimits,
    FormationProgram,
    FormationTask,
    FormationVariables,
    LoadMotion,
)
from drake_nonstop.optimization.limits import Of, asked
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.overrides import as_override, changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.simulation.run import RunStopped, StepCheck
from drake_nonstop.studies.design_request import (
    GRAVITY,
    DesignRequest,
    dump_request,
    read_request_text,
)
from drake_nonstop.studies.run_all import Progress, fly, no_progress, run_all
from drake_nonstop.systems.tracing import TracedFunction
from drake_nonstop.validation import ScenarioError, message_of

PEAK = 2.1875  # the largest speed of a septic move, over its mean
_START_TIME, _END_TIME, _REST_TIME = 5.0, 10.0, 60.0  # s, before and after a way; without one
_CANDIDATES = 150  # of a search's starts, of which the best are taken
_COARSE, _FINE, _EXACT = 8, 24, 90  # phases of a turn
_INSTANTS, _KEY_INSTANTS = 24, 6  # of the way
_MOST_RESERVE = 2.0  # that is looked for
_ROUND = 1.01  # of the reserve, since extremes lie between phases
_CLOSE = 0.02  # of reserves that are the same
_LEAST_POWER = 1.0  # W, that others are compared with: in an updraught aircraft need none
_DOUBLINGS, _HALVINGS = 8, 20
_OF_RANGE = " of its range"
_OBSERVERS = (1.0, 0.7, 0.4)  # weights that are tried
# A flight at rest has three parts of 14 s or a turn. From the second to the third one an error, m,
# that is larger than the least may grow by 1.15.
_STEADY_PARTS, _STEADY_TIME, _STEADY_GROWTH, _STEADY_ERROR = 3, 14.0, 1.15, 1e-4
_EASED = 0.97  # of a margin that is kept, which is asked for instead
_OTHER_MARGINS = {  # by the names of the program's rows
    "share": "the least force of a cable",
    "apart_reach": "the distance of carriers beside the length of their cables",
    "cables": "the distance of cables",
}


class FlightExtremes(NamedTuple):
    """What the aircraft of a formation need, over all carriers, phases and the load's way."""

    lift_share: float  # of C_Lmax, the largest
    airspeed_min: float  # m/s
    airspeed_max: float  # m/s
    over_loaded_stall: float  # of the airspeed, over the stall speed with cable and bank, the least
    bank: float  # rad, the largest, to either side
    climb: float  # rad, the largest, up or down
    thrust_min: float  # N
    thrust_max: float  # N
    thrust_share_min: float  # of the largest thrust at that airspeed
    thrust_share_max: float
    thrust_above: float  # of the range of thrust, left above, the least
    thrust_below: float  # left below
    power: float  # W, that an aircraft draws from its battery, the mean at rest
    asked: tuple[float, ...] = ()  # of each limit that is asked for, what is closest to it


class Break(NamedTuple):
    """How far one thing may grow, alone, and the limit that is then missed first."""

    what: str  # wind, with its direction, load or speed
    unit: str
    value: float  # the largest that was looked at, where it misses no limit
    limit: str  # "": there is none

    @property
    def text(self) -> str:
        """Such as "load 14.2 kg (bank)"."""
        reached = f"{self.value:.3g} {self.unit}"
        return (
            f"{self.what} {reached} ({self.limit})"
            if self.limit
            else (f"{self.what} not up to {reached}")
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class DesignedFormation:
    """A formation that keeps the margins of a request.

    Attributes:
        kind: leaning or co_rotating.
        carriers: n.
        phase_turns: κ; 0 for a co-rotating one.
        variables: of the program, forces in shares of f₀.
        flight: what the aircraft need at rest and on the way.
        distances: m, the least of two carriers and of two cables, at rest.
        cables: what its straight cables leave out, at rest.
        growth: 1/s, of a deviation of the load, the largest at rest and on the way.
        stall_speed: m/s.
        breaks: what breaks first as wind, load and speed grow.
        energy: Wh/(kg km) from all batteries, with the power at rest and the load's mean speed;
            None where it rests.
        scenario: that flies it.
    """

    kind: str
    carriers: int
    phase_turns: int
    variables: FormationVariables
    flight: FlightExtremes
    distances: tuple[float, float]
    cables: BowedCables
    growth: float
    stall_speed: float
    breaks: tuple[Break, ...]
    energy: float | None
    scenario: Scenario

    @property
    def reserve(self) -> float:
        """Of the margins: 1 where those of the request are just kept, 0 at the limits."""
        return self.variables.reserve

    @property
    def power(self) -> float:
        """W, that all aircraft draw at rest."""
        return self.carriers * self.flight.power

    @property
    def share(self) -> float:
        """f₀, N, the load's weight for each cable."""
        return self.variables.mass * GRAVITY / self.carriers

    @property
    def forces(self) -> dict[str, float]:
        """C, A_r, A_t and B, N, by the fields of a pattern."""
        x = self.variables
        names = ("spread", "radial", "tangential", "vertical")
        return {name: self.share * getattr(x, name) for name in names}


@dataclass(frozen=True, kw_only=True)
class Refusal:
    """Why a number of carriers of a kind does not keep the margins.

    Attributes:
        kind: leaning or co_rotating.
        carriers: n.
        reserve: of the best that was found; below 1.
        missed: what its aircraft need beyond what is asked, in words; "" where that is kept.
        fault: what forbids a formation that keeps the margins, such as a load that sways.
        remedy: what would help, which was tried; "" where nothing did.
        phase_turns: κ of the best that was found; 0 for a co-rotating one.
        variables: of the best that was found, forces in shares of f₀.
    """

    kind: str
    carriers: int
    phase_turns: int
    variables: FormationVariables
    reserve: float
    missed: str
    remedy: str
    fault: str = ""

    @property
    def sentence(self) -> str:
        """Why there is no such formation, and what would help."""
        if self.fault:
            return f"not at {self.reserve:.3g} of the margins: {self.fault}"
        remedy = f"; give {self.remedy}" if self.remedy else ""
        return f"none; the best misses {self.missed}{remedy}"


@dataclass(frozen=True, kw_only=True)
class Design:
    """What was found for a request.

    Attributes:
        request: as given.
        formations: that keep its margins, the least power first.
        refusals: of other numbers of carriers and kinds, or of some margins of the same.
    """

    request: DesignRequest
    formations: tuple[DesignedFormation, ...]
    refusals: tuple[Refusal, ...]

    def is_efficient(self, formation: DesignedFormation) -> bool:
        """Whether no other one has less power and, to 0.02, no less reserve."""
        return not any(
            other.power < formation.power and other.reserve > formation.reserve - _CLOSE
            for other in self.formations
        )

    @property
    def verdict(self) -> str:
        """A sentence: how many there are, or which limit forbids them and what would help."""
        if self.formations:
            return f"{len(self.formations)} formations keep the margins"
        best = max(self.refusals, key=lambda refusal: refusal.reserve)
        tried = sorted({refusal.carriers for refusal in self.refusals})
        remedies = [r for r in (best, *self.refusals) if r.remedy]
        remedy = "nothing that was tried helps"
        if remedies:
            other = "" if remedies[0] is best else f" for {_about(remedies[0])}"
            remedy = f"give {remedies[0].remedy}{other}"
        why = f"misses {best.missed}"
        if best.fault:
            why = f"keeps them, but {best.fault}"
        elif best.reserve >= 0:
            why = f"though within the limits, {why}"
        return (
            f"request.carriers = {tried}: no formation of {self.request.aircraft_name} keeps the "
            f"margins and flies; the best, {_about(best)}, {why}; {remedy}"
        )


def _about(refusal: Refusal) -> str:
    return f"{refusal.carriers} {refusal.kind.replace('_', '-')}"


def design(request: DesignRequest, progress: Progress = no_progress) -> Design:
    """The formations for a request, found in a process per core.

    Of each number of carriers and kind they are those of the least power at rising margins. Each
    is checked by `aircraft_margins` and is stable at rest and on the way.

    Raises:
        ScenarioError: the request cannot be used, or a process died.
        KeyboardInterrupt: Ctrl-C.
    """
    request.check()
    _require_buildable(request)
    text = dump_request(request)
    keys = [(n, kind) for n in request.carriers for kind in request.kinds]
    found: dict[tuple[int, str], Any] = {}

    def failed(key: tuple[int, str], error: str) -> Any:
        raise ScenarioError(f"design, {key[0]} carriers {key[1]}: {error}")

    run_all(
        design_one,
        keys,
        lambda key: (text, *key),
        found.__setitem__,
        failed,
        what="designing",
        progress=progress,
    )
    formations = [f for key in keys for f in found[key] if isinstance(f, DesignedFormation)]
    formations.sort(key=lambda formation: formation.power)
    named = [
        dataclasses.replace(f, scenario=_renamed(f.scenario, f"{request.name}_{k + 1}"))
        for k, f in enumerate(formations)
    ]
    refusals = [r for key in keys for r in found[key] if isinstance(r, Refusal)]
    return Design(request=request, formations=tuple(named), refusals=tuple(refusals))


def _require_buildable(request: DesignRequest) -> None:
    """Checks that there is a loop for the request's load, of any formation."""
    n, kind = request.carriers[0], request.kinds[0]
    lower, upper = design_bounds(request, n, kind)
    x = FormationVariables(*map(float, np.where(upper > lower, 0.9 * lower + 0.1 * upper, lower)))
    flight = flight_of(design_task(request, n, _KEY_INSTANTS), kind, x, phases=1)
    try:
        scenario = formation_scenario(request, kind, n, max(n - 2, 1), x, flight)
        make_nonstop(scenario, at_equilibrium=False)
    except ScenarioError as error:
        remedy = "change what this follows from in the request"
        raise ScenarioError(
            f"request: no loop flies its load; {message_of(error)}; {remedy}"
        ) from None


def _renamed(scenario: Scenario, name: str) -> Scenario:
    return dataclasses.replace(scenario, name=name)


def design_one(text: str, carriers: int, kind: str) -> list[DesignedFormation | Refusal]:
    """The formations of one number of carriers and kind, or why there is none.

    Args:
        text: of the request, by `dump_request`.
        carriers: n.
        kind: leaning or co_rotating.
    """
    return _Search(read_request_text(text), carriers, kind).formations()


def load_motions(request: DesignRequest, count: int) -> tuple[LoadMotion, ...]:
    """The load at rest and, where it moves, at the instants of its way that matter most.

    Args:
        request: with a displacement.
        count: of instants; 6: at rest, the fastest, those of the largest accelerations, and two
            between; else at rest, and evenly from the first instant to the last, where the snap is
            the largest.
    """
    nothing = np.zeros(3)
    still = LoadMotion(nothing, nothing)
    if request.speed == 0:
        return (still,)
    way = np.array(request.displacement)
    distance = float(np.linalg.norm(way))
    if count == _KEY_INSTANTS:
        steep = math.sqrt(0.05)  # from the middle, where the acceleration is the largest
        instants = [0.5 + share * steep for share in (0.0, -1.0, 1.0, -0.5, 0.5)]
    else:
        instants = [k / (count - 2) for k in range(count - 1)]
    motions = [still]
    for t in instants:  # of s(t) = 35 t⁴ − 84 t⁵ + 70 t⁶ − 20 t⁷
        u, side = t * (1 - t), 1 - 2 * t
        rates = 140 * u**3, 420 * u**2 * side, 840 * u * (1 - 5 * u), 840 * side * (1 - 10 * u)
        motions.append(
            LoadMotion(
                *(
                    way / distance * rate / (PEAK**order * distance ** (order - 1))
                    for order, rate in enumerate(rates, start=1)
                )
            )
        )
    return tuple(motions)


def design_task(request: DesignRequest, carriers: int, count: int = _KEY_INSTANTS) -> FormationTask:
    """What the program is given.

    Args:
        request: what is asked for.
        carriers: n.
        count: of instants on the way, as of `load_motions`.
    """
    own = FlightLimits()
    wind = np.array(request.wind)
    along = wind if np.any(wind) else -np.array(request.displacement)
    size = float(np.linalg.norm(along))
    return FormationTask(
        aircraft=request.check(),
        load=CarriedLoad(
            mass=request.load_mass,
            drag=request.load_drag,
            gravity=GRAVITY,
            carriers=carriers,
            radius=request.load_radius,
            compliance=1 / request.cable_stiffness,
        ),
        wind=along / size if size > 0 else np.array([1.0, 0.0, 0.0]),
        motions=load_motions(request, count),
        limits=DesignLimits(
            lift_share=own.lift_share,
            speed_share=own.speed_share,
            bank=own.bank,
            climb=own.climb,
            carrier_distance=own.carrier_distance,
            lift_margin=own.lift_share - request.lift_share,
            speed_margin=request.speed_share - own.speed_share,
            bank_margin=own.bank - request.bank,
            climb_margin=own.climb - request.climb,
            thrust_margin=request.thrust_reserve,
            separation=request.separation,
            asked=tuple(asked(request, Of.FLIGHT)),
        ),
    )


def design_bounds(request: DesignRequest, carriers: int, kind: str) -> tuple[NDArray, NDArray]:
    """The least and the largest `FormationVariables` (10,) that are looked for.

    The load's mass and speed and the wind are those of the request.
    """
    wind = float(np.linalg.norm(request.wind))
    fixed = [request.load_mass, wind, request.speed]
    least, most = request.cable_length
    if kind == LEANING:
        lower = [0.05, 0.01, 0.01, 0.0, 0.05, least, *fixed, -1e3]
        upper = [1.5, 1.0, 1.0, 0.6 if carriers > 3 else 0.0, 5.0, most, *fixed, _MOST_RESERVE]
    else:
        lower = [0.05, 0.0, 0.0, 0.0, 0.05, least, *fixed, -1e3]
        upper = [2.0, 0.0, 0.0, 0.0, 5.0, most, *fixed, _MOST_RESERVE]
    return np.array(lower), np.array(upper)


def formation_needs(
    task: FormationTask, kind: str, x: FormationVariables, phases: int = _EXACT
) -> Iterator[FlightNeeds]:
    """What all aircraft need at phases of a turn, for each motion."""
    n = task.load.carriers
    turn, places = (2 * np.pi * np.arange(k) / k for k in (phases, n))
    if kind == LEANING:
        azimuths, angles = np.repeat(places, phases), np.tile(turn, n)
    else:
        azimuths, angles = turn, np.zeros(phases)
    load = task.load._replace(mass=x.mass)
    aircraft = task.aircraft._replace(cable_length=x.cable_length)
    for motion in task.motions:
        velocity, acceleration, jerk, snap = motion.at(x.speed)
        air = velocity - x.wind * task.wind
        orbit = carrier_orbit(
            formation_shape(task, kind, x),
            load,
            azimuths,
            angles,
            air_velocity=air,
            acceleration=acceleration,
            jerk=jerk,
            snap=snap,
        )
        yield aircraft_needs(aircraft, orbit, -air)  # type: ignore[arg-type]


def formation_shape(task: FormationTask, kind: str, x: FormationVariables) -> FormationShape:
    """The formation's forces in N, and its rates."""
    share = x.mass * GRAVITY / task.load.carriers
    is_leaning = kind == LEANING
    return FormationShape(
        share * x.spread,
        share * x.radial,
        share * x.tangential,
        share * x.vertical,
        x.frequency if is_leaning else 0.0,
        0.0 if is_leaning else x.frequency,
        x.cable_length,
    )


def flight_of(
    task: FormationTask, kind: str, x: FormationVariables, phases: int = _EXACT
) -> FlightExtremes:
    """The extremes of what the aircraft need; the power is that of the first motion."""
    found = list(formation_needs(task, kind, x, phases))
    needs = FlightNeeds(*map(np.concatenate, zip(*found, strict=True)))
    least, most = thrust_limits(task.aircraft, needs.airspeed)
    at_rest = found[0]
    shares = thrust_share(task.aircraft, needs.thrust, needs.airspeed)
    over_stall = airspeed_over_loaded_stall(task.aircraft, needs.airspeed, needs.lift, needs.thrust)
    return FlightExtremes(
        lift_share=float(np.max(needs.lift)) / float(task.aircraft.max_lift),
        airspeed_min=float(np.min(needs.airspeed)),
        airspeed_max=float(np.max(needs.airspeed)),
        over_loaded_stall=float(np.min(over_stall)),
        bank=float(np.max(np.abs(needs.bank))),
        climb=float(np.max(np.abs(needs.climb))),
        thrust_min=float(np.min(needs.thrust)),
        thrust_max=float(np.max(needs.thrust)),
        thrust_share_min=float(np.min(shares)),
        thrust_share_max=float(np.max(shares)),
        thrust_above=float(np.min((most - needs.thrust) / (most - least))),
        thrust_below=float(np.min((needs.thrust - least) / (most - least))),
        power=float(np.mean(drawn_power(task.aircraft, at_rest.thrust, at_rest.airspeed))),
        asked=tuple(
            float(values[limit.worst(values)])
            for limit, _ in task.limits.asked
            for values in [limit.values(task.aircraft, needs)]
        ),
    )


class Missed(NamedTuple):
    """A quantity beyond what is asked of it."""

    beyond: float  # of the margin
    name: str
    text: str  # with its value


def missed_limits(
    task: FormationTask, flight: FlightExtremes, reserve: float = 0.0
) -> list[Missed]:
    """What is beyond the limits, the farthest first; with a reserve of 1 beyond the margins."""
    rows = []
    count = len(flight.asked)
    for k, (name, value, limit, margin, side, unit) in enumerate(_rows_of(task, flight)):
        wanted_reserve = 1.0 if k < count else reserve  # what is asked for is no margin
        least = limit - side * wanted_reserve * margin
        beyond = side * (value - least) / margin
        if beyond > 1e-4:
            bound = "at most" if side > 0 else "at least"
            found, wanted = (f"{number:.3g} {unit}".rstrip() for number in (value, least))
            text = f"{name} {found} ({bound} {wanted.removesuffix(_OF_RANGE)})"
            rows.append(Missed(beyond, name, text))
    return sorted(rows, reverse=True)


def reserve_of(task: FormationTask, flight: FlightExtremes) -> float:
    """The least margin over what is asked of it: 1 where all are kept, 0 at a limit."""
    return min(
        side * (limit - value) / margin
        for _, value, limit, margin, side, _ in _rows_of(task, flight)
    )


def _rows_of(
    task: FormationTask, flight: FlightExtremes
) -> Iterator[tuple[str, float, float, float, int, str]]:
    """Of each quantity: its name, value, limit and margin, the limit's side, and the unit.

    Those of the limits that are asked for come first.
    """
    for (row, stated), value in zip(task.limits.asked, flight.asked, strict=True):
        margin = ASKED_MARGIN * stated
        yield row.words, value, stated - row.side * margin, margin, -row.side, row.unit
    limits, slowest = task.limits, float(stall_speed(task.aircraft))
    lift, speed = limits.lift_share, limits.speed_share
    airspeed = flight.airspeed_min / slowest
    yield "C_L / C_Lmax", flight.lift_share, lift, limits.lift_margin, 1, ""
    yield "airspeed / stall speed", airspeed, speed, limits.speed_margin, -1, ""
    for name, value, limit, margin in (
        ("bank", flight.bank, limits.bank, limits.bank_margin),
        ("climb or descent", flight.climb, limits.climb, limits.climb_margin),
    ):
        degrees = [math.degrees(angle) for angle in (value, limit, margin)]
        yield name, degrees[0], degrees[1], degrees[2], 1, "deg"
    for name, value in (("largest", flight.thrust_above), ("least", flight.thrust_below)):
        margin = 100 * limits.thrust_margin
        yield f"thrust left to the {name}", 100 * value, 0.0, margin, -1, "%" + _OF_RANGE


def breaking_points(
    task: FormationTask,
    kind: str,
    x: FormationVariables,
    phase_turns: int,
    phases: int = _FINE,
) -> Iterator[Break]:
    """How far the wind, the load and its speed may grow, each alone, before a limit is missed.

    The forces of the pattern stay as they are, in N. The wind grows in its direction, or where
    there is none against the load's way. The distances of carriers and of cables, and the least
    force of a cable, are those at rest.

    Args:
        task: of the instants of the way at which the limits are looked at.
        kind: one of `KINDS`.
        x: the formation.
        phase_turns: κ.
        phases: of a turn.
    """

    def grown(what: str, value: float) -> FormationVariables:
        return with_load(x, value) if what == "mass" else x._replace(**{what: value})

    program = FormationProgram(task.with_motions(1), kind, phase_turns, phases=phases)
    beside = np.flatnonzero(np.isin(program.row_names, list(_OTHER_MARGINS)))

    def missed(what: str, value: float) -> list[str]:
        values = grown(what, value)
        flight = flight_of(task, kind, values, phases=phases)
        found = [each.name for each in missed_limits(task, flight)]
        rows = program.rows(np.array(values))[0][beside]
        if np.min(rows) < 0:
            found.append(_OTHER_MARGINS[str(program.row_names[beside[np.argmin(rows)]])])
        return found

    is_along = len(task.motions) > 1 and x.wind == 0
    wind = "wind against the load's way" if is_along else "wind"
    for what, name, unit, first in (
        ("wind", wind, "m/s", max(1.0, 2 * x.wind)),
        ("mass", "load", "kg", 1.5 * x.mass),
        ("speed", "speed", "m/s", max(1.0, 2 * x.speed)),
    ):
        if what == "speed" and len(task.motions) == 1:
            continue
        low, high, last = getattr(x, what), first, []
        for _ in range(_DOUBLINGS):
            last = missed(what, high)
            if last:
                break
            low, high = high, 2 * high
        else:
            yield Break(name, unit, low, "")
            continue
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            found = missed(what, middle)
            if found:
                high, last = middle, found
            else:
                low = middle
            if high - low < 1e-3 * high:
                break
        yield Break(name, unit, low, last[0])


def with_load(x: FormationVariables, mass: float) -> FormationVariables:
    """The same forces in N, rates and cables, under a load of another mass in kg."""
    ratio = x.mass / mass
    forces = {name: ratio * getattr(x, name) for name in x._fields[:4]}
    return x._replace(mass=mass, **forces)


class _Search:
    """The search of one number of carriers and kind."""

    def __init__(self, request: DesignRequest, carriers: int, kind: str):
        self.request, self.n, self.kind = request, carriers, kind
        self.task = design_task(request, carriers)
        self.way = design_task(request, carriers, _INSTANTS)
        self.random = np.random.default_rng([request.seed, carriers, kind == LEANING])
        self.turns = 1 if carriers == 3 else carriers - 2
        if kind != LEANING:
            self.turns = 0
        self.lower, self.upper = design_bounds(request, carriers, kind)
        self.trace: TracedFunction | None = None
        self.observer: float | None = None  # the weight, once it is known
        self.most_reserve = -np.eye(len(self.lower))[-1]

    def formations(self) -> list[DesignedFormation | Refusal]:
        """Those at rising reserves, each of the least power, or why there is none."""
        best = self._most_reserve()
        program = FormationProgram(self.task, self.kind, self.turns, trace=self.trace)
        best = program.solve(best, self.lower, self.upper, self.most_reserve)
        best = self._with_true_reserve(program, best, everywhere=True)
        if best[-1] < 1:
            return [self._refusal(program, best)]
        found: list[DesignedFormation | Refusal] = []
        levels = [_ROUND, (1 + best[-1]) / 2, best[-1]]
        if best[-1] < 1 + 4 * _CLOSE:
            levels = [best[-1]]
        start = best
        for k, level in enumerate(reversed(levels)):
            least = level - (_CLOSE / 2 if level == best[-1] else 0.0)
            values = self._of_least_power(program, start, least)
            if values[-1] < 1:
                if k > 0:
                    continue  # of less power there is none
                values = start
            start = values
            try:
                found.append(self._described(values))
            except ScenarioError as error:
                fault = f"it cannot be judged: {message_of(error)}"
                found.append(self._refused(values, fault=fault))
        return found

    def _of_least_power(self, program: FormationProgram, start: NDArray, least: float) -> NDArray:
        """The variables of the least power at a reserve; where it is missed on the way, at more."""
        lower, nothing = self.lower.copy(), np.zeros(len(self.lower))
        lower[-1] = least
        values = start
        for _ in range(2):
            power = max(program.rows(start)[2], _LEAST_POWER)
            values = program.solve(start, lower, self.upper, nothing, power_weight=1 / power)
            values = self._with_true_reserve(program, values, everywhere=True)
            lower[-1] += least - values[-1]
            if values[-1] > least - _CLOSE / 4 or lower[-1] > _MOST_RESERVE:
                break
        return values

    def _with_true_reserve(
        self, program: FormationProgram, values: NDArray, *, everywhere: bool = False
    ) -> NDArray:
        """With the reserve as it is, at the program's instants or everywhere on the way."""
        values = values.copy()
        reserve = float(program.rows(values)[0].min())
        if everywhere:
            x = FormationVariables(*map(float, values))
            found = reserve_of(self.task, flight_of(self.way, self.kind, x))
            reserve = min(reserve, found)
        values[-1] = min(_MOST_RESERVE, reserve)
        return values

    def _most_reserve(self) -> NDArray:
        """The variables of the largest reserve, from several starts, at coarse phases."""
        coarse = FormationProgram(self.task.with_motions(2), self.kind, self.turns, phases=_COARSE)
        self.trace = coarse.trace
        resting = FormationProgram(
            self.task.with_motions(1), self.kind, self.turns, phases=6, trace=self.trace
        )
        drawn = [self._drawn() for _ in range(_CANDIDATES)]
        drawn.sort(key=lambda values: -resting.rows(values)[0].min())
        found: list[NDArray] = []
        for start in drawn[: self.request.starts]:
            start[-1] = resting.rows(start)[0].min()
            values = coarse.solve(start, self.lower, self.upper, self.most_reserve)
            found.append(self._with_true_reserve(coarse, values))
            if found[-1][-1] >= _MOST_RESERVE - _CLOSE:
                break
        best = max(found, key=lambda values: values[-1])
        return self._with_best_turns(best)

    def _with_best_turns(self, best: NDArray) -> NDArray:
        """The variables of the largest reserve with any κ, which is taken."""
        if self.kind != LEANING or self.n < 5 or best[-1] >= _MOST_RESERVE - _CLOSE:
            return best
        sizes = {"radial": 1.0, "tangential": 2.0, "vertical": 1.0}
        for turns in EllipticCarouselConfig().suitable_turns(self.n, **sizes):
            if turns == self.turns:
                continue
            program = self._coarse(turns)
            values = program.solve(best, self.lower, self.upper, self.most_reserve)
            values = self._with_true_reserve(program, values)
            if values[-1] > best[-1] + _CLOSE:
                best, self.turns = values, turns
        return best

    def _coarse(self, turns: int) -> FormationProgram:
        task = self.task.with_motions(2)
        return FormationProgram(task, self.kind, turns, phases=_COARSE, trace=self.trace)

    def _drawn(self) -> NDArray:
        """A start, by the closed forms of circles of a constant speed."""
        random, task = self.random, self.task
        least, most = self.request.cable_length
        length = math.exp(random.uniform(math.log(least), math.log(most)))
        ratio = task.load.mass / self.n / float(task.aircraft.mass)
        speed = float(stall_speed(task.aircraft)) * math.sqrt(1 + ratio) * random.uniform(1.2, 2.0)
        values = np.concatenate([np.zeros(5), [length], self.lower[6:9], [0.0]])
        if self.kind == LEANING:
            half_cone = random.uniform(0.03, 0.3)
            lean = half_cone * random.uniform(1.1, 2.0)
            size = math.tan(half_cone) / math.cos(lean)
            values[:4] = math.tan(lean), size * math.cos(lean), size, size * math.sin(lean)
            if self.n == 3:
                values[2] = values[1]
            radius = length * math.sin(half_cone)
        else:
            half_cone = random.uniform(0.2, 1.1)
            values[0] = math.tan(half_cone)
            radius = self.request.load_radius + length * math.sin(half_cone)
        values[4] = speed / radius
        return np.clip(values, self.lower, self.upper)

    def _described(self, values: NDArray) -> DesignedFormation | Refusal:
        """The formation of these variables, or why it is none after all."""
        x = FormationVariables(*map(float, values))
        request = self.request
        flight = flight_of(self.way, self.kind, x)
        scenario = formation_scenario(request, self.kind, self.n, self.turns, x, flight)
        margins = aircraft_margins(scenario)
        if not margins.is_flyable:
            fault = ", ".join(margin.sentence for margin in margins.missed)
            return self._refused(values, fault=fault)
        formation = find_formation(task_of(scenario), count=4)
        if not formation.is_stable:
            fault = f"a deviation of the load grows by {formation.worst.rate:.2g} 1/s"
            return self._refused(values, fault=fault)
        steadied = self._steadied(scenario, margins.turn)
        if steadied is None:
            return self._refused(values, fault="in a flight at rest the load's sway grows")
        mean_speed = request.speed / PEAK
        energy = None
        if mean_speed > 0:
            energy = self.n * flight.power / (3.6 * request.load_mass * mean_speed)
        return DesignedFormation(
            kind=self.kind,
            carriers=self.n,
            phase_turns=self.turns,
            variables=x,
            flight=flight,
            distances=_distances(margins),
            cables=margins.ranges.cables,
            growth=max(instant.rate for instant in formation.instants),
            stall_speed=float(stall_speed(self.task.aircraft)),
            breaks=tuple(breaking_points(self.way, self.kind, x, self.turns)),
            energy=energy,
            scenario=steadied,
        )

    def _steadied(self, scenario: Scenario, turn: float) -> Scenario | None:
        """With the largest weight of the aircraft's observers at which the load's sway fades.

        They hold the carriers on their references, and then nothing but the load's controller damps
        it. The first formation is flown at rest for that; the others have the same weight.
        """
        weights = _OBSERVERS if self.observer is None else (self.observer,)
        for weight in weights:
            tried = changed(scenario, [as_override("carrier_controller.observer", weight)])
            if self.observer is not None or _is_steady(tried, turn):
                self.observer = weight
                return tried
        return None

    def _refusal(self, program: FormationProgram, best: NDArray) -> Refusal:
        x = FormationVariables(*map(float, best))
        flight = flight_of(self.way, self.kind, x)
        missed = [each.text for each in missed_limits(self.task, flight, 1.0)]
        apart = float(program.separations(best)[0].min())
        if apart < 0.999 * self.request.separation:
            missed.append(f"carriers {apart:.3g} m apart (at least {self.request.separation:g} m)")
        if not missed:
            name = program.closest_row(best)
            share = f"{best[-1]:.3g} of its margin (at least 1)"
            missed = [f"{_OTHER_MARGINS.get(name, name)} with {share}"]
        remedy = self._remedy(program, best) or self._smaller_margins(flight, apart, best[-1])
        return self._refused(best, ", ".join(missed), remedy)

    def _refused(
        self, best: NDArray, missed: str = "", remedy: str = "", fault: str = ""
    ) -> Refusal:
        return Refusal(
            kind=self.kind,
            carriers=self.n,
            phase_turns=self.turns,
            variables=FormationVariables(*map(float, best)),
            reserve=float(best[-1]),
            missed=missed,
            remedy=remedy,
            fault=fault,
        )

    def _remedy(self, program: FormationProgram, best: NDArray) -> str:
        """What alone would help, each tried: longer cables, a lighter load, less wind or speed."""
        request = self.request
        for index, sign, limit in (
            (5, 1, max(500.0, 2 * request.cable_length[1])),
            (6, -1, 0.02 * request.load_mass),
            (7, -1, 0.0),
            (8, -1, 0.0),
        ):
            if best[index] == limit:
                continue
            lower, upper = self.lower.copy(), self.upper.copy()
            (upper if sign > 0 else lower)[index] = limit
            eased = program.solve(best, lower, upper, self.most_reserve)
            eased = self._with_true_reserve(program, eased, everywhere=True)
            if eased[-1] < _ROUND:
                continue
            lower[-1] = _ROUND
            cost = np.zeros(len(lower))
            cost[index] = sign / max(best[index], 1.0)
            found = program.solve(eased, lower, upper, cost)
            if self._with_true_reserve(program, found, everywhere=True)[-1] < 1:
                found = eased
            value = float(found[index])
            if index == 5:
                return f"request.cable_length = [{request.cable_length[0]:g}, {_up(value)}]"
            if index == 6:
                return f"request.load_mass = {_down(value)} or less"
            if index == 7:
                share = value / best[7]
                wind = [float(_down(share * part)) + 0.0 for part in request.wind]
                return f"request.wind = {wind} or weaker"
            return f"request.speed = {_down(value)} or less"
        return ""

    def _smaller_margins(self, flight: FlightExtremes, apart: float, reserve: float) -> str:
        """The margins that the best formation keeps, in place of those that it misses."""
        if reserve < _CLOSE:
            return ""
        request, limits = self.request, self.task.limits
        slowest = float(stall_speed(self.task.aircraft))
        thrust_left = min(flight.thrust_above, flight.thrust_below)
        fields = []
        for name, value, limit, side in (
            ("lift_share", flight.lift_share, limits.lift_share, 1),
            ("speed_share", flight.airspeed_min / slowest, limits.speed_share, -1),
            ("bank", flight.bank, limits.bank, 1),
            ("climb", flight.climb, limits.climb, 1),
            ("thrust_reserve", thrust_left, 0.0, -1),
            ("separation", apart, 0.0, -1),
        ):
            eased = limit + _EASED * (value - limit)
            if side * (eased - getattr(request, name)) > 0:
                fields.append(f"request.{name} = {eased:.4g}")
        return " and ".join(fields)


def _is_steady(scenario: Scenario, turn: float) -> bool:
    """Whether the load's error does not grow from one turn (s) to the next, in a flight at rest."""
    part = max(_STEADY_TIME, turn)
    changes = [
        f"simulation_duration={_STEADY_PARTS * part}",
        "load_trajectory.displacement=[0.0, 0.0, 0.0]",
    ]
    try:
        run = fly(changed(scenario, changes), check_step=StepCheck.NOTHING)
    except RunStopped:
        return False
    if run.stopped:
        return False
    positions = run.signal("load_state")[:, POSE_SIZE - 3 : POSE_SIZE]
    errors = np.linalg.norm(positions - positions[0], axis=1)
    count = len(errors) // _STEADY_PARTS
    before, last = np.max(errors[-2 * count : -count]), np.max(errors[-count:])
    return bool(last < max(_STEADY_GROWTH * before, _STEADY_ERROR))


def _up(value: float) -> str:
    return f"{math.ceil(value * 1.01):d}"


def _down(value: float) -> str:
    """One percent nearer to zero, of three digits that do not round away from it."""
    if value == 0:
        return "0"
    digit = 10.0 ** (math.floor(math.log10(abs(value))) - 2)
    return f"{math.copysign(math.floor(0.99 * abs(value) / digit) * digit, value):.3g}"


def _distances(margins: AircraftMargins) -> tuple[float, float]:
    return float(margins.carrier_distance.min()), float(margins.cable_distance.min())


def formation_scenario(
    request: DesignRequest,
    kind: str,
    carriers: int,
    phase_turns: int,
    x: FormationVariables,
    flight: FlightExtremes,
) -> Scenario:
    """The scenario that flies a formation: at rest, along the request's displacement, at rest."""
    share = x.mass * GRAVITY / carriers
    angles = 2 * np.pi * np.arange(carriers) / carriers
    ring = request.load_radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    frequency = _rounded(x.frequency)
    move: dict[str, Any] = {}
    duration = _REST_TIME
    if request.speed > 0:
        distance = float(np.linalg.norm(request.displacement))
        time = round(PEAK * distance / request.speed, 2)
        duration = _START_TIME + time + _END_TIME
        # A quintic's jerk steps, and the carriers' velocities with it, by L_c/g of the step.
        move = {
            "blend": "c4",
            "displacement": request.displacement,
            "start_time": _START_TIME,
            "move_time": time,
        }
    forces = {name: _rounded(share * getattr(x, name)) for name in x._fields[:4]}
    if kind == LEANING:
        pattern = {"_tag": "!EllipticCarousel", "phase_turns": phase_turns, **forces}
        trajectory = {"_tag": "!RestToRest", **move}
    else:
        pattern = {"_tag": "!ConstantSpread", "spread": forces["spread"]}
        trajectory = {"_tag": "!SteadyTurn", "yaw_rate": frequency, **move}
    aircraft = {k: v for k, v in vars(request.aircraft).items() if v is not None}
    fields: dict[str, Any] = {
        "simulation_duration": duration,
        "system.load_mass": request.load_mass,
        "system.load_inertia": request.inertia,
        "system.load_drag": request.load_drag,
        "system.attachments": (ring.round(9) + 0.0).tolist(),
        "system.cable_length": _rounded(x.cable_length),
        "system.cable_stiffness": request.cable_stiffness,
        "system.cable_damping": request.cable_damping,
        "system.aircraft": aircraft,
        "pattern": pattern,
        "load_trajectory": trajectory,
        "optimization_layer": {
            "_tag": "!ConstantParameters",
            "frequency": frequency,
            "amplitude": 1.0 if kind == LEANING else 0.0,
            "speed_bound": math.floor(9 * flight.airspeed_min) / 10,
        },
        "carrier_controller.frequency": 1.8 if kind == LEANING else 1.5,
    }
    if np.any(request.wind):
        fields["wind"] = {"_tag": "!SteadyWind", "velocity": request.wind}
    made = load_scenario("aircraft_rest", [as_override(k, v) for k, v in fields.items()])
    kind = kind.replace("_", "-")
    about = f"{carriers} {request.aircraft_name}, {kind}, hold {request.load_mass:g} kg on cables"
    return dataclasses.replace(
        made, name=request.name, description=f"{about} of {x.cable_length:.0f} m"
    )


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")


def design_dictionary(found: Design) -> dict[str, Any]:
    """For a JSON file; keys end in their units."""
    return {
        "is_feasible": bool(found.formations),
        "verdict": found.verdict,
        "formations": [_dictionary(found, formation) for formation in found.formations],
        "refusals": [
            vars(refusal) | {"variables": refusal.variables._asdict()} for refusal in found.refusals
        ],
    }


def _dictionary(found: Design, formation: DesignedFormation) -> dict[str, Any]:
    flight, x = formation.flight, formation.variables
    return {
        "scenario": formation.scenario.name,
        "kind": formation.kind,
        "carriers": formation.carriers,
        "phase_turns": formation.phase_turns,
        "is_efficient": found.is_efficient(formation),
        "reserve": formation.reserve,
        "cable_length_m": x.cable_length,
        "frequency_rad_s": x.frequency,
        **{f"{name}_N": value for name, value in formation.forces.items()},
        "lift_share": flight.lift_share,
        "airspeed_min_m_s": flight.airspeed_min,
        "airspeed_max_m_s": flight.airspeed_max,
        "airspeed_over_stall_min": flight.airspeed_min / formation.stall_speed,
        "airspeed_over_loaded_stall_min": flight.over_loaded_stall,
        "bank_rad": flight.bank,
        "climb_rad": flight.climb,
        "thrust_min_N": flight.thrust_min,
        "thrust_max_N": flight.thrust_max,
        "thrust_share_min": flight.thrust_share_min,
        "thrust_share_max": flight.thrust_share_max,
        "thrust_share_left_above": flight.thrust_above,
        "thrust_share_left_below": flight.thrust_below,
        "power_drawn_W": formation.power,
        "energy_Wh_per_kg_km": formation.energy,
        "carriers_apart_m": formation.distances[0],
        "cables_apart_m": formation.distances[1],
        "cables": formation.cables.dictionary,
        "growth_1_s": formation.growth,
        "breaks_first": [
            {
                "grows": each.what,
                "unit": each.unit,
                "value": each.value,
                "limit": each.limit or None,
            }
            for each in formation.breaks
        ],
    }


def design_table(found: Design) -> str:
    """A line for each formation, and what breaks it first, for a terminal."""
    rows: list[Sequence[str]] = [
        (
            *("", "n", "kind", "L_c m", "C N", "A_r N", "A_t N", "B N", "kappa", "xi rad/s"),
            *("C_L", "V m/s", "V / V_s", "loaded", "bank", "climb", "thrust N", "T %"),
            *("apart m", "cables m", "W", "Wh/kg km", "reserve"),
        )
    ]
    for f in found.formations:
        flight, x = f.flight, f.variables
        rows.append(
            (
                f.scenario.name + ("*" if found.is_efficient(f) else ""),
                str(f.carriers),
                f.kind,
                f"{x.cable_length:.0f}",
                *(f"{value:.2f}" for value in f.forces.values()),
                str(f.phase_turns),
                f"{x.frequency:.3f}",
                f"{flight.lift_share:.2f}",
                f"{flight.airspeed_min:.1f}-{flight.airspeed_max:.1f}",
                f"{flight.airspeed_min / f.stall_speed:.2f}",
                f"{flight.over_loaded_stall:.2f}",
                f"{math.degrees(flight.bank):.0f}",
                f"{math.degrees(flight.climb):.0f}",
                f"{flight.thrust_min:.1f}-{flight.thrust_max:.1f}",
                f"{100 * flight.thrust_share_min:.0f}-{100 * flight.thrust_share_max:.0f}",
                f"{f.distances[0]:.1f}",
                f"{f.distances[1]:.2f}",
                f"{f.power:.0f}",
                "" if f.energy is None else f"{f.energy:.1f}",
                f"{f.reserve:.2f}",
            )
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    for f in found.formations:
        lines.append(f"{f.scenario.name}: breaks first at {', '.join(b.text for b in f.breaks)}")
    lines += [f"{f.scenario.name}: real cables {f.cables.text}" for f in found.formations]
    warned = [f for f in found.formations if f.cables.warning]
    if warned:
        names = ", ".join(f.scenario.name for f in warned)
        most = max(warned, key=lambda f: f.cables.difference)
        lines.append(f"{names}: {most.cables.warning}")
    lines += [
        f"{refusal.carriers} {refusal.kind}: {refusal.sentence}" for refusal in found.refusals
    ]
    return "\n".join(lines)
