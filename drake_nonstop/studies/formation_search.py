"""The search for formations of one number of carriers and kind of orbit, and their flights.

The reserve is the least share of a margin that is kept: 1 where all that are asked for are kept, 0
at a limit of flight. κ is the number of turns of the carriers' phases in a round of them. Variables
are `FormationVariables` (7,), the reserve is their last.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.aircraft_margins import aircraft_margins
from drake_nonstop.analysis.flight_envelope import BowedCables, FlightEnvelope
from drake_nonstop.mechanics.aircraft import stall_speed
from drake_nonstop.mechanics.formation_orbit import CarriedLoad
from drake_nonstop.mechanics.signals import LoadState
from drake_nonstop.model.aircraft import CABLE_DENSITY
from drake_nonstop.model.pattern import EllipticCarouselConfig
from drake_nonstop.planning.formation_program import (
    LEANING,
    FormationProgram,
    FormationTask,
    FormationVariables,
    LoadMotion,
    Margin,
)
from drake_nonstop.planning.limits import Of, asked
from drake_nonstop.run.metrics import compute_metrics
from drake_nonstop.run.outcome import RunOutcome
from drake_nonstop.run.run import RunStopped
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.overrides import as_override, changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.design_request import GRAVITY, LUMPED, DesignRequest
from drake_nonstop.validation import ScenarioError

PEAK = 2.1875  # the largest speed of a septic move, over its mean
_MOST_RESERVE = 2.0  # that is looked for
_SAFE_RESERVE = 1.01  # in place of 1, since extremes lie between phases
_CLOSE = 0.02  # difference of reserves that count as equal
_CANDIDATES = 150  # drawn as starts of a search, which takes the best
_START_TIME, _END_TIME, _REST_TIME = 5.0, 10.0, 60.0  # s, before and after a way; without one
_GUSTS = 3.0  # standard deviations, that a gust may take from an airspeed
_OBSERVERS = (1.0, 0.7, 0.4)  # weights of the aircraft's observers that are tried
# A flight at rest has three parts, of 14 s each, or of a turn where that takes longer. From the
# second to the third part an error, m, may grow by a factor of 1.15; below 1e-4 m it is steady.
_STEADY_PARTS, _STEADY_TIME, _STEADY_GROWTH, _STEADY_ERROR = 3, 14.0, 1.15, 1e-4
# Seeds of gusts in which a formation is flown, and how much stronger these are than those that are
# asked for: other seeds, and longer flights, meet worse ones.
_SEEDS, _STRONGER = 5, 1.25
_LOST = [outcome.value for outcome in list(RunOutcome)[:6]]  # as far as slack cables


@dataclass(frozen=True, kw_only=True, eq=False)
class Formation:
    """The best that was found for one number of carriers and kind of orbit."""

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
class DesignedFormation(Formation):
    """A formation that keeps the margins of a request, and flies."""

    forces: dict[str, float]  # C, A_r, A_t and B, N, by the fields of a pattern
    power: float  # W, that all aircraft draw at rest
    energy: float | None  # Wh/(kg km) at that power and the load's mean speed; None: it rests
    extremes: dict[str, tuple[float, float]]  # of what they need on the way, by name
    separation: float  # m, the least of two carriers, at rest
    cables: BowedCables  # how drag bows them, at rest
    scenario: Scenario  # that flies it


@dataclass(frozen=True, kw_only=True, eq=False)
class Refusal(Formation):
    """Why a number of carriers of a kind has no formation, or none at some reserve."""

    why: str


def load_motions(request: DesignRequest) -> tuple[tuple[LoadMotion, ...], tuple[LoadMotion, ...]]:
    """The load's motions that matter most, and those all along its way; at rest the first.

    The first are, on a way, the fastest, those of the largest accelerations, and two between.
    """
    still = LoadMotion()
    if request.speed == 0:
        return (still,), (still,)
    distance = float(np.linalg.norm(request.displacement))
    direction, time = np.array(request.displacement) / distance, PEAK * distance / request.speed
    place = distance * np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20])
    rates = [place.deriv(order) / time**order for order in range(1, 5)]

    def motion(t: float) -> LoadMotion:
        return LoadMotion(*(float(rate(t)) * direction for rate in rates))

    steep = math.sqrt(0.05)  # from the middle, where the acceleration is the largest
    key = [motion(0.5 + share * steep) for share in (0.0, -1.0, 1.0, -0.5, 0.5)]
    return (still, *key), (still, *map(motion, np.linspace(0, 1, 23)))


def design_task(request: DesignRequest, carriers: int) -> FormationTask:
    """The task of the program."""
    motions, way = load_motions(request)
    own = FlightEnvelope()
    sine, sine_asked = math.sin(own.climb), math.sin(request.climb)
    rows = (
        ("lift", "C_L / C_Lmax", -1, own.lift_share, request.lift_share),
        ("airspeed", "airspeed / stall speed", 1, own.speed_share, request.speed_share),
        ("bank", "bank (rad)", -1, own.bank, request.bank),
        ("bank", "bank (rad)", 1, -own.bank, -request.bank),
        ("climb", "sine of the climb", -1, sine, sine_asked),
        ("climb", "sine of the climb", 1, -sine, -sine_asked),
        ("thrust_above", "thrust left to the largest", 1, 0.0, request.thrust_reserve),
        ("thrust_below", "thrust left to the least", 1, 0.0, request.thrust_reserve),
    )
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
        wind=np.array(request.wind),
        motions=motions,
        way=way,
        margins=tuple(Margin(*row[:4], abs(row[4] - row[3])) for row in rows),
        asked=tuple(asked(request, Of.FLIGHT)),
        separation=request.separation,
        carrier_distance=own.carrier_distance,
        gust=_GUSTS * request.gust,
        cable_safety=request.cable_safety,
        cable_density=CABLE_DENSITY if request.cables == LUMPED else 0.0,
    )


def design_one(
    request: DesignRequest, carriers: int, kind: str
) -> list[DesignedFormation | Refusal]:
    """Formations of falling reserves, each of the least power, or why there is none."""
    return FormationSearch(request, carriers, kind).formations()


class FormationSearch:
    """The search of one number of carriers and kind."""

    def __init__(self, request: DesignRequest, carriers: int, kind: str):
        self.request, self.n, self.kind = request, carriers, kind
        self.task = design_task(request, carriers)
        self.turns = 0 if kind != LEANING else 1 if carriers == 3 else carriers - 2
        least, most = request.cable_length
        lower, upper = [0.05, 0.0, 0.0, 0.0, 0.05], [2.0, 0.0, 0.0, 0.0, 5.0]
        if kind == LEANING:
            lower[1:3] = [0.01, 0.01]
            upper[:4] = [1.5, 1.0, 1.0, 0.6 if carriers > 3 else 0.0]
        self.lower = np.array([*lower, least, -1e3])
        self.upper = np.array([*upper, most, _MOST_RESERVE])
        self.most_reserve = -np.eye(len(self.lower))[-1]  # a cost (7,)
        self._observer: float | None = None  # the observers' weight, once it is known

    def formations(self) -> list[DesignedFormation | Refusal]:
        """See `design_one`."""
        start = self._best_of_starts()
        program = FormationProgram(self.task, self.kind, self.turns)
        best = program.solve(start, self.lower, self.upper, self.most_reserve)
        best = self._with_reserve(program, best)
        if best[-1] < 1:
            return [self._refusal(best, self._missed(program, best))]
        levels = [best[-1], (1 + best[-1]) / 2, _SAFE_RESERVE]
        found: list[DesignedFormation | Refusal] = []
        start = best
        for level in levels[: 1 if best[-1] < 1 + 4 * _CLOSE else 3]:
            values = self._of_least_power(program, start, min(level, best[-1] - _CLOSE / 2))
            if values[-1] < 1:
                if found:
                    continue  # none of less power keeps the margins
                values = best
            start = values
            try:
                found.append(self._flown(program, values))
            except ScenarioError as error:
                found.append(self._refusal(values, f"it cannot be flown: {error!s}"))
        return found

    def _best_of_starts(self) -> NDArray:
        """The variables of the largest reserve, from several starts and over all κ, coarsely."""
        task = dataclasses.replace(self.task, motions=self.task.motions[:2])

        def solved(start: NDArray, turns: int) -> NDArray:
            coarse = FormationProgram(task, self.kind, turns, phases=8)
            values = coarse.solve(start, self.lower, self.upper, self.most_reserve)
            return np.append(values[:-1], min(_MOST_RESERVE, coarse.rows(values)[0].min()))

        random = np.random.default_rng([self.n, self.kind == LEANING])
        program = FormationProgram(task, self.kind, self.turns, phases=4)
        drawn = [self._drawn(random) for _ in range(_CANDIDATES)]
        for start in drawn:
            start[-1] = program.rows(start)[0].min()
        drawn.sort(key=lambda values: -values[-1])
        starts = [solved(start, self.turns) for start in drawn[: self.request.starts]]
        best = max(starts, key=lambda values: values[-1])
        leaning = EllipticCarouselConfig(radial=1.0, tangential=2.0, vertical=1.0)
        for turns in leaning.suitable_turns(self.n):
            if self.kind == LEANING and self.n > 4 and turns != self.turns:
                values = solved(best, turns)
                if values[-1] > best[-1] + _CLOSE:
                    best, self.turns = values, turns
        return best

    def _drawn(self, random: np.random.Generator) -> NDArray:
        """Variables drawn at random, by the closed forms of circles at a constant speed."""
        least, most = self.request.cable_length
        length = math.exp(random.uniform(math.log(least), math.log(most)))
        aircraft = self.task.aircraft
        loaded = 1 + self.task.load.mass / self.n / float(aircraft.mass)
        speed = float(stall_speed(aircraft)) * math.sqrt(loaded) * random.uniform(1.2, 2.0)
        values = np.array([*np.zeros(5), length, 0.0])
        if self.kind == LEANING:
            half_cone = random.uniform(0.03, 0.3)
            lean = half_cone * random.uniform(1.1, 2.0)
            size = math.tan(half_cone) / math.cos(lean)
            radial = size if self.n == 3 else size * math.cos(lean)
            values[:4] = math.tan(lean), radial, size, size * math.sin(lean)
            values[4] = speed / (length * math.sin(half_cone))
        else:
            half_cone = random.uniform(0.2, 1.1)
            values[0] = math.tan(half_cone)
            values[4] = speed / (self.request.load_radius + length * math.sin(half_cone))
        return np.clip(values, self.lower, self.upper)

    def _of_least_power(self, program: FormationProgram, start: NDArray, least: float) -> NDArray:
        """Variables of the least power at a reserve; more is asked for where the way misses it."""
        lower, values = self.lower.copy(), start
        lower[-1] = least
        weight = 1 / max(program.rows(start)[2], 1.0)
        for _ in range(2):
            values = program.solve(start, lower, self.upper, 0 * start, power_weight=weight)
            values = self._with_reserve(program, values)
            lower[-1] += least - values[-1]
            if values[-1] > least - _CLOSE / 4 or lower[-1] > _MOST_RESERVE:
                break
        return values

    def _with_reserve(self, program: FormationProgram, values: NDArray) -> NDArray:
        """The variables with their reserve on the whole way."""
        least = min(program.rows(values)[0].min(), program.on_way(values).min(), _MOST_RESERVE)
        return np.append(values[:-1], least)

    def _missed(self, program: FormationProgram, values: NDArray) -> str:
        """What the best of the refused needs beyond what is asked, in words."""
        kept = zip(program.margins, program.on_way(values), strict=True)
        missed = sorted((share, margin) for margin, share in kept if share < 1)
        return ", ".join(dict.fromkeys(margin.sentence(share) for share, margin in missed))

    def _refusal(self, values: NDArray, why: str) -> Refusal:
        return Refusal(
            kind=self.kind,
            carriers=self.n,
            phase_turns=self.turns,
            variables=FormationVariables(*values.tolist()),
            why=why,
        )

    def _flown(self, program: FormationProgram, values: NDArray) -> DesignedFormation | Refusal:
        """The formation of these variables, or why it does not fly after all."""
        x = FormationVariables(*values.tolist())
        extremes = program.extremes(values)
        scenario = self._scenario(program, x, extremes["airspeed_m_s"])
        margins = aircraft_margins(scenario)
        weights = _OBSERVERS if self._observer is None else (self._observer,)
        for weight in weights:
            tried = changed(scenario, [as_override("carrier_controller.observer", weight)])
            if self._observer is not None or is_steady(tried, 2 * math.pi / x.frequency):
                self._observer = weight
                break
        else:
            return self._refusal(values, "in a flight at rest the load's sway grows")
        if fault := fault_in_flight(tried):
            return self._refusal(values, fault)
        power = self.n * program.rows(values)[2]
        mean_speed = self.request.speed / PEAK
        moved = 3.6 * self.request.load_mass * mean_speed
        return DesignedFormation(
            kind=self.kind,
            carriers=self.n,
            phase_turns=self.turns,
            variables=x,
            forces=self._forces(x),
            power=power,
            energy=power / moved if moved > 0 else None,
            extremes=extremes,
            separation=program.separation(values),
            cables=margins.cables,
            scenario=tried,
        )

    def _forces(self, x: FormationVariables) -> dict[str, float]:
        return {name: self.task.share * getattr(x, name) for name in x._fields[:4]}

    def _scenario(
        self, program: FormationProgram, x: FormationVariables, airspeeds: tuple[float, float]
    ) -> Scenario:
        """The scenario that flies a formation: at rest, along the request's displacement, at rest.

        `airspeeds` are the least and the largest, m/s.
        """
        request, n = self.request, self.n
        angles = 2 * np.pi * np.arange(n) / n
        ring = request.load_radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
        move: dict[str, Any] = {}
        duration = _REST_TIME
        if request.speed > 0:
            distance = float(np.linalg.norm(request.displacement))
            time = round(PEAK * distance / request.speed, 2)
            duration = _START_TIME + time + _END_TIME
            # A quintic's jerk steps, and the carriers' velocities with it, by L_c/g of the step.
            move = {"blend": "c4", "displacement": request.displacement}
            move |= {"start_time": _START_TIME, "move_time": time}
        forces = {name: _rounded(force) for name, force in self._forces(x).items()}
        leans, frequency = self.kind == LEANING, _rounded(x.frequency)
        pattern = {"_tag": "!ConstantSpread", "spread": forces["spread"]}
        trajectory = {"_tag": "!SteadyTurn", "yaw_rate": frequency, **move}
        if leans:
            pattern = {"_tag": "!EllipticCarousel", "phase_turns": self.turns, **forces}
            trajectory = {"_tag": "!RestToRest", **move}
        bound = 0.9 * airspeeds[0]
        if request.gust > 0:  # in which airspeeds may fall to that of the aircraft's own limit
            own = FlightEnvelope().speed_share * float(stall_speed(self.task.aircraft))
            bound = min(bound, own)
        aircraft = program.task.flown_by(x)
        fields: dict[str, Any] = {
            "simulation_duration": duration,
            "system.load_mass": request.load_mass,
            "system.load_inertia": request.inertia,
            "system.load_drag": request.load_drag,
            "system.attachments": (ring.round(9) + 0.0).tolist(),
            "system.cable_length": _rounded(x.cable_length),
            "system.cable_stiffness": request.cable_stiffness,
            "system.cable_diameter": _rounded(float(aircraft.cable_diameter)),
            "system.cable_damping": request.cable_damping,
            "system.aircraft": {k: v for k, v in vars(request.aircraft).items() if v is not None},
            "pattern": pattern,
            "load_trajectory": trajectory,
            "optimization_layer": {
                "_tag": "!ConstantParameters",
                "frequency": frequency,
                "amplitude": float(leans),
                "speed_bound": math.floor(10 * bound) / 10,
            },
            "carrier_controller.frequency": 1.8 if leans else 1.5,
        }
        if request.cables == LUMPED:
            fields["cables"] = {"_tag": "!LumpedCables"}
            fields["carrier_trajectory"] = {"_tag": "!BowedCarrierTrajectory"}
        if request.gust > 0:
            gusts = {"gust": request.gust, "load_gust": request.gust}
            airspeed = round(sum(airspeeds) / 2, 1)
            fields["wind"] = {"_tag": "!GustyWind", "velocity": request.wind, "airspeed": airspeed}
            fields["wind"] |= gusts
        elif np.any(request.wind):
            fields["wind"] = {"_tag": "!SteadyWind", "velocity": request.wind}
        made = load_scenario("aircraft_rest", [as_override(k, v) for k, v in fields.items()])
        about = f"{n} {request.aircraft.model or 'aircraft'}, {self.kind.replace('_', '-')}, hold "
        about += f"{request.load_mass:g} kg on cables of {x.cable_length:.0f} m"
        return dataclasses.replace(made, name=request.name, description=about)


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")


def is_steady(scenario: Scenario, turn: float) -> bool:
    """Whether the load's error does not grow, in a flight at rest whose turns take `turn` s."""
    changes = [
        f"simulation_duration={_STEADY_PARTS * max(_STEADY_TIME, turn)}",
        "load_trajectory.displacement=[0.0, 0.0, 0.0]",
    ]
    try:
        run = simulate(changed(scenario, changes))
    except RunStopped:
        return False
    positions = LoadState.view(run.signal("load_state")).position
    errors = np.linalg.norm(positions - positions[0], axis=1)
    count = len(errors) // _STEADY_PARTS
    before, last = np.max(errors[-2 * count : -count]), np.max(errors[-count:])
    return bool(last < max(_STEADY_GROWTH * before, _STEADY_ERROR))


def fault_in_flight(scenario: Scenario) -> str:
    """What ends a flight on the whole way, or loses the load, in words; "": nothing does.

    Gusts are stronger than those of the scenario, and of several seeds.
    """
    gusts = {name: getattr(scenario.wind, name, 0.0) for name in ("gust", "load_gust")}
    is_gusty = any(gusts.values())
    for seed in range(_SEEDS if is_gusty else 1):
        changes = [as_override(f"wind.{k}", _STRONGER * gust) for k, gust in gusts.items()]
        changes.append(as_override("wind.seed", seed))
        try:
            run = simulate(changed(scenario, changes if is_gusty else []))
        except RunStopped as error:
            run = error.run
        metrics = compute_metrics(run)
        is_lost = metrics["outcome"] in _LOST  # in gusts other limits may be missed
        if is_lost or (not is_gusty and metrics["outcome"] != RunOutcome.OK.value):
            where = f"in gusts {_STRONGER:g} times as strong, of seed {seed}, " if is_gusty else ""
            return where + metrics["reasons"][0]
    return ""
