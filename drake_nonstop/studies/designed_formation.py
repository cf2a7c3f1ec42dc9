"""A designed formation: what its aircraft need and miss, at rest and on the way, and its scenario.

What they need is by the exact inverse of their dynamics, at phases of a turn and instants of the
way.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.flight_envelope import BowedCables, FlightEnvelope, FlightRanges
from drake_nonstop.mechanics.aircraft import (
    FlightNeeds,
    drawn_power,
    flight_needs,
    stall_speed,
    thrust_limits,
)
from drake_nonstop.mechanics.formation_orbit import CarriedLoad
from drake_nonstop.model.aircraft import CABLE_DENSITY
from drake_nonstop.planning.formation_program import (
    AIRSPEED_IN_GUSTS,
    ASKED_MARGIN,
    LEANING,
    LIFT_IN_GUSTS,
    DesignLimits,
    FlightMargins,
    FormationProgram,
    FormationTask,
    FormationVariables,
    LoadMotion,
)
from drake_nonstop.planning.limits import Of, asked
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.overrides import as_override
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.design_request import GRAVITY, LUMPED, DesignRequest

PEAK = 2.1875  # the largest speed of a septic move, over its mean
MOST_RESERVE = 2.0  # that is looked for
KEY_INSTANTS, INSTANTS = 6, 24  # of the way
_COARSE, _FINE = 24, 90  # phases of a turn
_DOUBLINGS, _HALVINGS = 8, 20
_OF_RANGE = " of its range"
_START_TIME, _END_TIME, _REST_TIME = 5.0, 10.0, 60.0  # s, before and after a way; without one
_GUSTS = 3.0  # standard deviations, that a gust may take from an airspeed
_ENVELOPE = FlightEnvelope()
OTHER_MARGINS = {  # by the names of the program's rows
    "share": "the least force of a cable",
    "apart_reach": "the distance of carriers beside the length of their cables",
    "cables": "the distance of cables",
}


class FlightExtremes(NamedTuple):
    """Needs of a formation's aircraft over all carriers, phases and the load's way."""

    ranges: FlightRanges
    bank: float  # rad, the largest, to either side
    climb: float  # rad, the largest, up or down
    thrust_above: float  # of the range of thrust, left above, the least
    thrust_below: float  # left below
    power: float  # W, that an aircraft draws from its battery, the mean at rest
    # Airspeeds that gusts leave, over those where C_L is at its own limit, and over the least one.
    in_gusts: tuple[float, float]
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
        if not self.limit:
            return f"{self.what} not up to {reached}"
        return f"{self.what} {reached} ({self.limit})"


class Missed(NamedTuple):
    """A quantity beyond what is asked of it."""

    beyond: float  # of the margin
    name: str
    text: str  # with its value


def load_motions(request: DesignRequest, count: int) -> tuple[LoadMotion, ...]:
    """The load at rest and, where it moves, at instants of its way.

    6 are those that matter most: at rest, the fastest, those of the largest accelerations, and two
    between. Others are evenly apart from the first, where the snap is the largest, to the last.
    """
    still = LoadMotion(np.zeros(3), np.zeros(3))
    if request.speed == 0:
        return (still,)
    way = np.array(request.displacement)
    distance = float(np.linalg.norm(way))
    if count == KEY_INSTANTS:
        steep = math.sqrt(0.05)  # from the middle, where the acceleration is the largest
        instants = [0.5 + share * steep for share in (0.0, -1.0, 1.0, -0.5, 0.5)]
    else:
        instants = [k / (count - 2) for k in range(count - 1)]
    motions = [still]
    for t in instants:  # of s(t) = 35 t⁴ − 84 t⁵ + 70 t⁶ − 20 t⁷
        u, side = t * (1 - t), 1 - 2 * t
        rates = 140 * u**3, 420 * u**2 * side, 840 * u * (1 - 5 * u), 840 * side * (1 - 10 * u)
        times = [PEAK**order * distance ** (order - 1) for order in range(1, 5)]
        motion = [way / distance * rate / time for rate, time in zip(rates, times, strict=True)]
        motions.append(LoadMotion(*motion))
    return tuple(motions)


def design_task(request: DesignRequest, carriers: int, count: int = KEY_INSTANTS) -> FormationTask:
    """The task of the program, with a number of instants on the way, as of `load_motions`."""
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
            own=FlightMargins(*(getattr(_ENVELOPE, name, 0.0) for name in FlightMargins._fields)),
            wanted=FlightMargins(*(getattr(request, name) for name in FlightMargins._fields)),
            carrier_distance=_ENVELOPE.carrier_distance,
            separation=request.separation,
            asked=tuple(asked(request, Of.FLIGHT)),
        ),
        gust=_GUSTS * request.gust,
        cable_safety=request.cable_safety,
        cable_density=CABLE_DENSITY if request.cables == LUMPED else 0.0,
    )


def design_bounds(request: DesignRequest, carriers: int, kind: str) -> tuple[NDArray, NDArray]:
    """The least and the largest `FormationVariables` (10,) that are looked for.

    The load's mass and speed and the wind are those of the request.
    """
    fixed = [request.load_mass, float(np.linalg.norm(request.wind)), request.speed]
    least, most = request.cable_length
    lower, upper = [0.05, 0.0, 0.0, 0.0, 0.05], [2.0, 0.0, 0.0, 0.0, 5.0]
    if kind == LEANING:
        lower[1:3] = [0.01, 0.01]
        upper[:4] = [1.5, 1.0, 1.0, 0.6 if carriers > 3 else 0.0]
    return np.array([*lower, least, *fixed, -1e3]), np.array([*upper, most, *fixed, MOST_RESERVE])


def formation_needs(
    task: FormationTask, kind: str, x: FormationVariables, phases: int = _FINE
) -> Iterator[FlightNeeds]:
    """Needs of all aircraft at phases of a turn, for each motion."""
    aircraft = task.flown_by(x)
    angles = task.angles(kind, phases)
    for motion in task.motions:
        orbit = task.orbit(kind, x, angles, motion.at(x.speed))
        yield flight_needs(aircraft, task.needed_force(aircraft, orbit), orbit.velocities)


def flight_of(
    task: FormationTask, kind: str, x: FormationVariables, phases: int = _FINE
) -> FlightExtremes:
    """The extremes of what the aircraft need; the power is that of the first motion."""
    aircraft = task.aircraft
    found = list(formation_needs(task, kind, x, phases))
    needs = FlightNeeds(*map(np.concatenate, zip(*found, strict=True)))
    thrust, (least, most) = needs.thrust, thrust_limits(aircraft, needs.airspeed)
    at_rest = found[0]
    values = [(limit, limit.values(aircraft, needs)) for limit, _ in task.limits.asked]
    left, own = 1 - task.gust / needs.airspeed, task.limits.own
    of_lift = np.sqrt(np.maximum(needs.lift, 1e-6) / (own.lift_share * aircraft.max_lift))
    least_airspeed = own.speed_share * stall_speed(aircraft)
    return FlightExtremes(
        FlightRanges.of(aircraft, needs),
        bank=float(np.max(np.abs(needs.bank))),
        climb=float(np.max(np.abs(needs.climb))),
        thrust_above=float(np.min((most - thrust) / (most - least))),
        thrust_below=float(np.min((thrust - least) / (most - least))),
        power=float(np.mean(drawn_power(aircraft, at_rest.thrust, at_rest.airspeed))),
        in_gusts=(
            float(np.min(left / of_lift)),
            float(np.min(needs.airspeed * left) / least_airspeed),
        ),
        asked=tuple(float(each[limit.worst(each)]) for limit, each in values),
    )


def missed_limits(
    task: FormationTask, flight: FlightExtremes, reserve: float = 0.0
) -> list[Missed]:
    """Quantities beyond the limits, the farthest first; with a reserve of 1 beyond the margins."""
    rows = []
    count = len(flight.asked) + (2 if task.gust > 0 else 0)
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


class _Quantity(NamedTuple):
    """Needs of aircraft that have a margin."""

    words: str
    field: str  # of `FlightMargins`
    side: int  # of its limit; 1: at most
    value: Callable[[FlightExtremes], float]
    unit: str = ""
    factor: float = 1.0  # from the field's unit to that


_DEGREE, _PERCENT = math.degrees(1.0), "%" + _OF_RANGE
QUANTITIES = (
    _Quantity("C_L / C_Lmax", "lift_share", 1, lambda flight: flight.ranges.lift_share[1]),
    _Quantity(
        "airspeed / stall speed", "speed_share", -1, lambda flight: flight.ranges.over_stall[0]
    ),
    _Quantity("bank", "bank", 1, lambda flight: flight.bank, "deg", _DEGREE),
    _Quantity("climb or descent", "climb", 1, lambda flight: flight.climb, "deg", _DEGREE),
    *(
        _Quantity(f"thrust left to the {end}", "thrust_reserve", -1, value, _PERCENT, 100.0)
        for end, value in (
            ("largest", lambda flight: flight.thrust_above),
            ("least", lambda flight: flight.thrust_below),
        )
    ),
)


def _rows_of(
    task: FormationTask, flight: FlightExtremes
) -> Iterator[tuple[str, float, float, float, int, str]]:
    """Of each quantity: its name, value, limit and margin, the limit's side, and the unit.

    Those of the limits that are asked for, and of gusts, come first.
    """
    limits = task.limits
    for (row, stated), value in zip(limits.asked, flight.asked, strict=True):
        margin = ASKED_MARGIN * stated
        yield row.words, value, stated - row.side * margin, margin, -row.side, row.unit
    if task.gust > 0:
        for name, value in zip((LIFT_IN_GUSTS, AIRSPEED_IN_GUSTS), flight.in_gusts, strict=True):
            yield name, value, 1 - ASKED_MARGIN, ASKED_MARGIN, -1, ""
    for each in QUANTITIES:
        limit, wanted = (getattr(bounds, each.field) for bounds in (limits.own, limits.wanted))
        value, limit, margin = (
            each.factor * number for number in (each.value(flight), limit, abs(limit - wanted))
        )
        yield each.words, value, limit, margin, each.side, each.unit


def breaking_points(
    task: FormationTask, kind: str, x: FormationVariables, phase_turns: int, phases: int = _COARSE
) -> Iterator[Break]:
    """How far the wind, the load and its speed may grow, each alone, before a limit is missed.

    The forces of the pattern stay as they are, in N. The wind grows in its direction, or where
    there is none against the load's way. The distances of carriers and of cables, and the least
    force of a cable, are those at rest.
    """
    program = FormationProgram(task.with_motions(1), kind, phase_turns, phases=phases)
    beside = np.flatnonzero(np.isin(program.row_names, list(OTHER_MARGINS)))

    def missed(what: str, value: float) -> list[str]:
        grown = with_load(x, value) if what == "mass" else x._replace(**{what: value})
        flight = flight_of(task, kind, grown, phases=phases)
        found = [each.name for each in missed_limits(task, flight)]
        rows = program.rows(np.array(grown))[0][beside]
        if np.min(rows) < 0:
            found.append(OTHER_MARGINS[str(program.row_names[beside[np.argmin(rows)]])])
        return found

    is_resting = len(task.motions) == 1
    wind = "wind" if is_resting or x.wind != 0 else "wind against the load's way"
    for what, name, unit, first in (
        ("wind", wind, "m/s", max(1.0, 2 * x.wind)),
        ("mass", "load", "kg", 1.5 * x.mass),
        ("speed", "speed", "m/s", max(1.0, 2 * x.speed)),
    )[: 2 if is_resting else 3]:
        low, high = getattr(x, what), first
        for _ in range(_DOUBLINGS):
            last = missed(what, high)
            if last:
                break
            low, high = high, 2 * high
        for _ in range(_HALVINGS if last else 0):
            middle = (low + high) / 2
            found = missed(what, middle)
            low, high, last = (low, middle, found) if found else (middle, high, last)
            if high - low < 1e-3 * high:
                break
        yield Break(name, unit, low, last[0] if last else "")


def with_load(x: FormationVariables, mass: float) -> FormationVariables:
    """The same forces in N, rates and cables, under a load of another mass in kg."""
    ratio = x.mass / mass
    return x._replace(mass=mass, **{name: ratio * getattr(x, name) for name in x._fields[:4]})


@dataclass(frozen=True, kw_only=True, eq=False)
class _Found:
    """Result for one number of carriers and kind."""

    kind: str  # leaning or co_rotating
    carriers: int  # n
    phase_turns: int  # κ; 0 for a co-rotating one
    variables: FormationVariables  # of the program, forces in shares of f₀

    @property
    def reserve(self) -> float:
        """Of the margins: 1 where those of the request are just kept, 0 at the limits."""
        return self.variables.reserve

    @property
    def name(self) -> str:
        """Such as "3 co-rotating"."""
        return f"{self.carriers} {self.kind.replace('_', '-')}"


@dataclass(frozen=True, kw_only=True, eq=False)
class DesignedFormation(_Found):
    """A formation that keeps the margins of a request."""

    flight: FlightExtremes  # at rest and on the way
    distances: tuple[float, float]  # m, the least of two carriers and of two cables, at rest
    cables: BowedCables  # how drag bows them, at rest
    growth: float  # 1/s, of a deviation of the load, the largest at rest and on the way
    breaks: tuple[Break, ...]  # as wind, load and speed grow
    scenario: Scenario  # that flies it

    @property
    def power(self) -> float:
        """W, that all aircraft draw at rest."""
        return self.carriers * self.flight.power

    @property
    def energy(self) -> float | None:
        """Wh/(kg km) from all batteries, with the power at rest and the load's mean speed.

        None where it rests.
        """
        mean_speed = self.variables.speed / PEAK
        return self.power / (3.6 * self.variables.mass * mean_speed) if mean_speed > 0 else None

    @property
    def forces(self) -> dict[str, float]:
        """C, A_r, A_t and B, N, by the fields of a pattern."""
        return _forces(self.variables, self.carriers)


def _forces(x: FormationVariables, carriers: int) -> dict[str, float]:
    share = x.mass * GRAVITY / carriers  # f₀, N, the load's weight for each cable
    return {name: share * getattr(x, name) for name in x._fields[:4]}


@dataclass(frozen=True, kw_only=True, eq=False)
class Refusal(_Found):
    """Why a number of carriers of a kind does not keep the margins; its variables are the best."""

    missed: str = ""  # what its aircraft need beyond what is asked, in words
    remedy: str = ""  # what would help, which was tried
    fault: str = ""  # what forbids one that keeps the margins, such as a load that sways

    @property
    def sentence(self) -> str:
        """Why there is no such formation, and what would help."""
        if self.fault:
            return f"not at {self.reserve:.3g} of the margins: {self.fault}"
        remedy = f"; give {self.remedy}" if self.remedy else ""
        return f"none; the best misses {self.missed}{remedy}"


def formation_scenario(
    request: DesignRequest,
    kind: str,
    carriers: int,
    phase_turns: int,
    x: FormationVariables,
    flight: FlightExtremes,
) -> Scenario:
    """The scenario that flies a formation: at rest, along the request's displacement, at rest."""
    angles = 2 * np.pi * np.arange(carriers) / carriers
    ring = request.load_radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    frequency, slowest = _rounded(x.frequency), flight.ranges.airspeed[0]
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
    forces = {name: _rounded(force) for name, force in _forces(x, carriers).items()}
    if kind == LEANING:
        pattern = {"_tag": "!EllipticCarousel", "phase_turns": phase_turns, **forces}
        trajectory = {"_tag": "!RestToRest", **move}
    else:
        pattern = {"_tag": "!ConstantSpread", "spread": forces["spread"]}
        trajectory = {"_tag": "!SteadyTurn", "yaw_rate": frequency, **move}
    aircraft = {k: v for k, v in vars(request.aircraft).items() if v is not None}
    bound = 0.9 * slowest
    if request.gust > 0:  # in which airspeeds may fall to that of the aircraft's own limit
        task = design_task(request, carriers, 1)
        bound = min(bound, task.limits.own.speed_share * float(stall_speed(task.aircraft)))
    fields: dict[str, Any] = {
        "simulation_duration": duration,
        "system.load_mass": request.load_mass,
        "system.load_inertia": request.inertia,
        "system.load_drag": request.load_drag,
        "system.attachments": (ring.round(9) + 0.0).tolist(),
        "system.cable_length": _rounded(x.cable_length),
        "system.cable_stiffness": request.cable_stiffness,
        "system.cable_diameter": _rounded(
            float(design_task(request, carriers, INSTANTS).flown_by(x).cable_diameter)
        ),
        "system.cable_damping": request.cable_damping,
        "system.aircraft": aircraft,
        "pattern": pattern,
        "load_trajectory": trajectory,
        "optimization_layer": {
            "_tag": "!ConstantParameters",
            "frequency": frequency,
            "amplitude": 1.0 if kind == LEANING else 0.0,
            "speed_bound": math.floor(10 * bound) / 10,
        },
        "carrier_controller.frequency": 1.8 if kind == LEANING else 1.5,
    }
    if request.cables == LUMPED:
        fields["cables"] = {"_tag": "!LumpedCables"}
        fields["carrier_trajectory"] = {"_tag": "!BowedCarrierTrajectory"}
    if request.gust > 0:
        gusts = {"gust": request.gust, "load_gust": request.gust}
        airspeed = round(sum(flight.ranges.airspeed) / 2, 1)
        fields["wind"] = {"_tag": "!GustyWind", "velocity": request.wind, "airspeed": airspeed}
        fields["wind"] |= gusts
    elif np.any(request.wind):
        fields["wind"] = {"_tag": "!SteadyWind", "velocity": request.wind}
    made = load_scenario("aircraft_rest", [as_override(k, v) for k, v in fields.items()])
    kind = kind.replace("_", "-")
    about = f"{carriers} {request.aircraft_name}, {kind}, hold {request.load_mass:g} kg on cables"
    return dataclasses.replace(
        made, name=request.name, description=f"{about} of {x.cable_length:.0f} m"
    )


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")
