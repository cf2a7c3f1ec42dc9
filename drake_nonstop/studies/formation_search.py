"""The search for formations of one number of carriers and kind, for one load or many.

The reserve is the least of all margins over what is asked of each: 1 where all that are asked for
are kept, 0 at a limit of flight. κ is the number of turns of the carriers' phases in a round of
them. The way is the load's, along the request's displacement; it has a motion per instant, the
first at rest. Variables are `FormationVariables` (10,), the reserve is their last.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.aircraft_margins import aircraft_margins
from drake_nonstop.analysis.flight_envelope import flight_envelope_of
from drake_nonstop.analysis.formation import find_formation
from drake_nonstop.analysis.limit import RunOutcome
from drake_nonstop.analysis.speed_check import check_speeds
from drake_nonstop.analysis.task import task_of
from drake_nonstop.analysis.task_check import flight_of_plan
from drake_nonstop.mechanics.aircraft import stall_speed
from drake_nonstop.mechanics.signals import POSE_SIZE
from drake_nonstop.model.pattern import EllipticCarouselConfig
from drake_nonstop.planning.formation_program import (
    LEANING,
    FormationProgram,
    FormationVariables,
)
from drake_nonstop.run.outcome import judge
from drake_nonstop.run.run import RunStopped
from drake_nonstop.run.run_quantities import RunQuantities
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.overrides import as_override, changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.design_request import LUMPED, DesignRequest
from drake_nonstop.studies.designed_formation import (
    INSTANTS,
    KEY_INSTANTS,
    MOST_RESERVE,
    OTHER_MARGINS,
    QUANTITIES,
    DesignedFormation,
    FlightExtremes,
    Refusal,
    breaking_points,
    design_bounds,
    design_task,
    flight_of,
    formation_scenario,
    missed_limits,
    reserve_of,
)
from drake_nonstop.validation import ScenarioError, message_of

_CANDIDATES = 150  # drawn as starts of a search, which takes the best
_COARSE, _FINE = 8, 24  # numbers of phases in a turn
_SAFE_RESERVE = 1.01  # in place of 1, since extremes lie between phases
_CLOSE = 0.02  # difference of reserves that count as equal
_LEAST_POWER = 1.0  # W, the least to scale powers by: in an updraught aircraft need none
_OBSERVERS = (1.0, 0.7, 0.4)  # weights of the aircraft's observers that are tried
# A flight at rest has three parts, of 14 s each, or of a turn where that takes longer. From the
# second to the third part an error, m, may grow by a factor of 1.15; below 1e-4 m it is steady.
_STEADY_PARTS, _STEADY_TIME, _STEADY_GROWTH, _STEADY_ERROR = 3, 14.0, 1.15, 1e-4
# Seeds of gusts in which a formation is flown, and how much stronger these are than those that are
# asked for: other seeds, and longer flights, meet worse ones.
_SEEDS, _STRONGER = 5, 1.25
_LOST = list(RunOutcome)[: list(RunOutcome).index(RunOutcome.BOUND_MISSED)]
_STRONGEST = 20.0  # m/s, the strongest wind that is tried for a region
_TOLERANCE = 0.05  # of the reserve, which is 0 at the border of a region
_MASS, _WIND, _RESERVE = map(FormationVariables._fields.index, ("mass", "wind", "reserve"))
_EASED = 0.97  # share of a margin that is kept; so much is proposed in its place


def design_one(
    request: DesignRequest, carriers: int, kind: str
) -> list[DesignedFormation | Refusal]:
    """Returns the formations of one number of carriers and kind, or why there is none."""
    return FormationSearch(request, carriers, kind).formations()


class FormationSearch:
    """The search of one number of carriers and kind; `turns` is κ, None: the usual one first."""

    def __init__(self, request: DesignRequest, carriers: int, kind: str, turns: int | None = None):
        self.request, self.n, self.kind = request, carriers, kind
        # The task with the instants of the way that matter most, and with many along it.
        self.task, self.way = (
            design_task(request, carriers, count) for count in (KEY_INSTANTS, INSTANTS)
        )
        self.random = np.random.default_rng([request.seed, carriers, kind == LEANING])
        if turns is None:
            turns = 0 if kind != LEANING else 1 if carriers == 3 else carriers - 2
        self.turns = turns
        self.lower, self.upper = design_bounds(request, carriers, kind)
        self.most_reserve = -np.eye(len(self.lower))[-1]  # a cost (10,)
        self._observer: float | None = None  # the observers' weight, once it is known

    def program(
        self, motions: int = KEY_INSTANTS, phases: int = _FINE, turns: int | None = None
    ) -> FormationProgram:
        """Returns the program of the first `motions`, with so many `phases` of a turn, and κ."""
        task, turns = self.task.with_motions(motions), self.turns if turns is None else turns
        return FormationProgram(task, self.kind, turns, phases=phases)

    def formations(self) -> list[DesignedFormation | Refusal]:
        """Returns formations of falling reserves, each of the least power, or why there is none."""
        start = self._best_of_starts()
        program = self.program()
        best = self._of_most_reserve(program, start, everywhere=True)
        if best[-1] < 1:
            return [self._refusal_of_best(program, best)]
        found: list[DesignedFormation | Refusal] = []
        levels = [_SAFE_RESERVE, (1 + best[-1]) / 2, best[-1]]
        if best[-1] < 1 + 4 * _CLOSE:
            levels = [best[-1]]
        start = best
        for k, level in enumerate(reversed(levels)):
            least = level - (_CLOSE / 2 if level == best[-1] else 0.0)
            values = self._of_least_power(program, start, least)
            if values[-1] < 1:
                if k > 0:
                    continue  # none of less power keeps the margins
                values = start
            start = values
            try:
                found.append(self._described(values))
            except ScenarioError as error:
                found.append(self._refusal(values, f"it cannot be judged: {message_of(error)}"))
        return found

    def _best_of_starts(self) -> NDArray:
        """The variables of the largest reserve, from several starts and over all κ, coarsely."""
        coarse, resting = self.program(2, _COARSE), self.program(1, 6)
        drawn = [self._drawn() for _ in range(_CANDIDATES)]
        drawn.sort(key=lambda values: -resting.rows(values)[0].min())
        found: list[NDArray] = []
        for start in drawn[: self.request.starts]:
            start[-1] = resting.rows(start)[0].min()
            found.append(self._of_most_reserve(coarse, start))
            if found[-1][-1] >= MOST_RESERVE - _CLOSE:
                break
        best = max(found, key=lambda values: values[-1])
        if self.kind != LEANING or self.n < 5 or best[-1] >= MOST_RESERVE - _CLOSE:
            return best
        leaning = EllipticCarouselConfig(radial=1.0, tangential=2.0, vertical=1.0)
        for turns in leaning.suitable_turns(self.n):
            if turns != self.turns:
                values = self._of_most_reserve(self.program(2, _COARSE, turns), best)
                if values[-1] > best[-1] + _CLOSE:
                    best, self.turns = values, turns
        return best

    def _drawn(self) -> NDArray:
        """Variables drawn at random, by the closed forms of circles at a constant speed."""
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

    def _of_most_reserve(
        self, program: FormationProgram, start: NDArray, *, everywhere: bool = False
    ) -> NDArray:
        values = program.solve(start, self.lower, self.upper, self.most_reserve)
        return self.with_true_reserve(program, values, everywhere=everywhere)

    def _of_least_power(self, program: FormationProgram, start: NDArray, least: float) -> NDArray:
        """Variables of the least power at a reserve; more is asked for where the way misses it."""
        lower, nothing = self.lower.copy(), np.zeros(len(self.lower))
        lower[-1] = least
        values = start
        for _ in range(2):
            power = max(program.rows(start)[2], _LEAST_POWER)
            values = program.solve(start, lower, self.upper, nothing, power_weight=1 / power)
            values = self.with_true_reserve(program, values)
            lower[-1] += least - values[-1]
            if values[-1] > least - _CLOSE / 4 or lower[-1] > MOST_RESERVE:
                break
        return values

    def with_true_reserve(
        self, program: FormationProgram, values: NDArray, *, everywhere: bool = True
    ) -> NDArray:
        """Returns variables with their reserve at the program's instants, or on the whole way."""
        values = values.copy()
        reserve = float(program.rows(values)[0].min())
        if everywhere:
            flight = flight_of(self.way, self.kind, variables_of(values))
            reserve = min(reserve, reserve_of(self.task, flight))
        values[-1] = min(MOST_RESERVE, reserve)
        return values

    def _described(self, values: NDArray) -> DesignedFormation | Refusal:
        """The formation of these variables, or why it cannot be flown after all."""
        x = variables_of(values)
        flight = flight_of(self.way, self.kind, x)
        scenario = formation_scenario(self.request, self.kind, self.n, self.turns, x, flight)
        margins = aircraft_margins(scenario)
        if not margins.is_flyable:
            return self._refusal(values, ", ".join(margin.sentence for margin in margins.missed))
        task = task_of(scenario)
        if self.request.cables == LUMPED:
            limits = flight_envelope_of(scenario)
            on_way = flight_of_plan(task, check_speeds(task), limits)
            if on_way is not None and not on_way.is_flyable:
                return self._refusal(values, f"on bowed cables {on_way.verdict}")
        formation = find_formation(task, count=4)
        if not formation.is_stable:
            rate = formation.worst.rate
            return self._refusal(values, f"a deviation of the load grows by {rate:.2g} 1/s")
        steadied = self._steadied(scenario, margins.turn)
        if steadied is None:
            return self._refusal(values, "in a flight at rest the load's sway grows")
        if self.request.gust > 0 and (fault := _fault_in_gusts(steadied)):
            return self._refusal(values, fault)
        distances = float(margins.carrier_distance.min()), float(margins.cable_distance.min())
        return DesignedFormation(
            kind=self.kind,
            carriers=self.n,
            phase_turns=self.turns,
            variables=x,
            flight=flight,
            distances=distances,
            cables=margins.cables,
            growth=max(instant.rate for instant in formation.instants),
            breaks=tuple(breaking_points(self.way.built(x), self.kind, x, self.turns)),
            scenario=steadied,
        )

    def _steadied(self, scenario: Scenario, turn: float) -> Scenario | None:
        """The scenario with the largest weight of observers that lets the load's sway fade, if any.

        Observers hold the carriers on their references, so that the load's controller alone damps
        the sway. The first formation is flown at rest for that; the others have the same weight.
        """
        weights = _OBSERVERS if self._observer is None else (self._observer,)
        for weight in weights:
            tried = changed(scenario, [as_override("carrier_controller.observer", weight)])
            if self._observer is not None or _is_steady(tried, turn):
                self._observer = weight
                return tried
        return None

    def _refusal_of_best(self, program: FormationProgram, best: NDArray) -> Refusal:
        flight = flight_of(self.way, self.kind, variables_of(best))
        missed = [each.text for each in missed_limits(self.task, flight, 1.0)]
        apart = float(program.separations(best).min())
        if apart < 0.999 * self.request.separation:
            missed.append(f"carriers {apart:.3g} m apart (at least {self.request.separation:g} m)")
        if not missed:
            name = program.closest_row(best)
            share = f"{best[-1]:.3g} of its margin (at least 1)"
            missed = [f"{OTHER_MARGINS.get(name, name)} with {share}"]
        remedy = self._remedy(program, best) or self._smaller_margins(flight, apart, best[-1])
        return self._refusal(best, missed=", ".join(missed), remedy=remedy)

    def _refusal(
        self, best: NDArray, fault: str = "", *, missed: str = "", remedy: str = ""
    ) -> Refusal:
        return Refusal(
            kind=self.kind,
            carriers=self.n,
            phase_turns=self.turns,
            variables=variables_of(best),
            missed=missed,
            remedy=remedy,
            fault=fault,
        )

    def _remedy(self, program: FormationProgram, best: NDArray) -> str:
        """Text of the first remedy: longer cables, a lighter load, less wind or less speed."""
        request = self.request
        for field, sign, limit in (
            ("cable_length", 1, max(500.0, 2 * request.cable_length[1])),
            ("mass", -1, 0.02 * request.load_mass),
            ("wind", -1, 0.0),
            ("speed", -1, 0.0),
        ):
            index = FormationVariables._fields.index(field)
            if best[index] == limit:
                continue
            lower, upper = self.lower.copy(), self.upper.copy()
            (upper if sign > 0 else lower)[index] = limit
            eased = program.solve(best, lower, upper, self.most_reserve)
            eased = self.with_true_reserve(program, eased)
            if eased[-1] < _SAFE_RESERVE:
                continue
            lower[-1] = _SAFE_RESERVE
            cost = np.zeros(len(lower))
            cost[index] = sign / max(best[index], 1.0)
            found = program.solve(eased, lower, upper, cost)
            if self.with_true_reserve(program, found)[-1] < 1:
                found = eased
            value = float(found[index])
            if field == "cable_length":
                return f"request.cable_length = [{request.cable_length[0]:g}, {_up(value)}]"
            if field == "mass":
                return f"request.load_mass = {_down(value)} or less"
            if field == "wind":
                share = value / best[index]
                wind = [float(_down(share * part)) + 0.0 for part in request.wind]
                return f"request.wind = {wind} or weaker"
            return f"request.speed = {_down(value)} or less"
        return ""

    def _smaller_margins(self, flight: FlightExtremes, apart: float, reserve: float) -> str:
        """Text of the margins that the best formation keeps, in place of those that it misses."""
        if reserve < _CLOSE:
            return ""
        rows = [
            (each.field, each.value(flight), getattr(self.task.limits.own, each.field), each.side)
            for each in QUANTITIES
        ]
        fields: dict[str, float] = {}
        for name, value, limit, side in [*rows, ("separation", apart, 0.0, -1)]:
            eased = limit + _EASED * (value - limit)
            if side * (eased - getattr(self.request, name)) > 0:
                fields[name] = min(eased, fields.get(name, eased))
        return " and ".join(f"request.{name} = {eased:.4g}" for name, eased in fields.items())


def variables_of(values: NDArray) -> FormationVariables:
    """Returns the variables (10,) with their names."""
    return FormationVariables(*values.tolist())


def _is_steady(scenario: Scenario, turn: float) -> bool:
    """Whether the load's error does not grow, in a flight at rest whose turns take `turn` s."""
    part = max(_STEADY_TIME, turn)
    changes = [
        f"simulation_duration={_STEADY_PARTS * part}",
        "load_trajectory.displacement=[0.0, 0.0, 0.0]",
    ]
    try:
        run = simulate(changed(scenario, changes))
    except RunStopped:
        return False
    if run.stopped:
        return False
    positions = run.signal("load_state")[:, POSE_SIZE - 3 : POSE_SIZE]
    errors = np.linalg.norm(positions - positions[0], axis=1)
    count = len(errors) // _STEADY_PARTS
    before, last = np.max(errors[-2 * count : -count]), np.max(errors[-count:])
    return bool(last < max(_STEADY_GROWTH * before, _STEADY_ERROR))


def _fault_in_gusts(scenario: Scenario, strength: float = _STRONGER) -> str:
    """What ends a flight in so strong gusts, or loses the load, in words; "": nothing does."""
    strong = [
        as_override(f"wind.{name}", strength * getattr(scenario.wind, name))
        for name in ("gust", "load_gust")
    ]
    for seed in range(_SEEDS):
        in_gusts = changed(scenario, [*strong, as_override("wind.seed", seed)])
        try:
            run = simulate(in_gusts)
        except RunStopped as error:
            run = error.run
        judgement = judge(RunQuantities(run))
        if judgement.outcome in _LOST:
            return f"in gusts {strength:g} times as strong, of seed {seed}, {judgement.reasons[0]}"
    return ""


def _up(value: float) -> str:
    """Text of one percent more, rounded up to a whole number."""
    return f"{math.ceil(value * 1.01):d}"


def _down(value: float) -> str:
    """Text of one percent nearer to zero, of three digits, rounded toward zero."""
    if value == 0:
        return "0"
    digit = 10.0 ** (math.floor(math.log10(abs(value))) - 2)
    return f"{math.copysign(math.floor(0.99 * abs(value) / digit) * digit, value):.3g}"


@dataclass(frozen=True, kw_only=True, eq=False)
class FeasibleRegion:
    """The largest wind in which formations fly, over the load's mass.

    Attributes:
        speed: m/s, the largest of the load on its way.
        masses: (k,), kg, of the load.
        winds: (k,), m/s; nan where no formation was found.
        limits: (k,), the limit that is missed first in more wind.
        formations: (k,), those that fly in these winds; None where none was found.
    """

    speed: float
    masses: NDArray
    winds: NDArray
    limits: tuple[str, ...]
    formations: tuple[FormationVariables | None, ...]


class _Redesign:
    """Formations like a given one for other loads and winds, at a load's largest speed, m/s."""

    def __init__(self, request: DesignRequest, formation: DesignedFormation, speed: float):
        at_speed = dataclasses.replace(request, speed=speed)
        shape = formation.carriers, formation.kind, formation.phase_turns
        self.search = FormationSearch(at_speed, *shape)
        self.program = self.search.program()

    def solved(self, start: NDArray, maximized: int, **bounds: tuple[float, float]) -> NDArray:
        """The variables with the largest entry `maximized`, an index, for the mass of `start`."""
        lower, upper = self.search.lower.copy(), self.search.upper.copy()
        lower[_MASS] = upper[_MASS] = start[_MASS]
        for name, (least, most) in bounds.items():
            index = FormationVariables._fields.index(name)
            lower[index], upper[index] = least, most
        values = self.program.solve(start, lower, upper, -np.eye(len(start))[maximized])
        return self.search.with_true_reserve(self.program, values)

    def in_wind(self, start: NDArray, wind: float) -> NDArray:
        """The variables of the largest reserve in a wind, m/s."""
        return self.solved(start, _RESERVE, wind=(wind, wind))

    def in_most_wind(self, start: NDArray) -> NDArray | None:
        """The variables that keep the limits in the strongest wind; None: not found."""
        for share in (1.0, 0.7, 0.3, 0.0):
            found = start if share == 1 else self.in_wind(start, share * start[_WIND])
            least = 0.0
            for _ in range(3):  # between the program's instants the reserve is less
                found = self.solved(found, _WIND, wind=(0.0, _STRONGEST), reserve=(least, least))
                if abs(found[_RESERVE]) < _TOLERANCE:
                    return found
                least -= found[_RESERVE]
        return None


def redesigned_region(
    request: DesignRequest, formation: DesignedFormation, masses: Sequence[float], speed: float
) -> FeasibleRegion:
    """Returns the winds that aircraft can fly in, designed anew for each load's mass and wind.

    The cables' forces, ξ and, in the request's range, the cables' lengths are those that keep the
    limits in the strongest wind, at rest and on the way; found from mass to mass, from that of the
    request on. In more wind a limit of the aircraft or of their controllers is missed: of lift,
    airspeed, bank, climb or thrust. The wind has the direction of the request's, or is against the
    load's way. `formation` was found for the request; its kind, n and κ stay. Masses are in rising
    order, in kg, the load's largest speed is in m/s.
    """
    redesign = _Redesign(request, formation, speed)
    found: dict[float, FormationVariables] = {}
    heavier = [mass for mass in masses if mass >= request.load_mass]
    lighter = [mass for mass in reversed(masses) if mass < request.load_mass]
    for one_way in (heavier, lighter):
        start = formation.variables
        for mass in one_way:
            values = redesign.in_most_wind(np.array(start._replace(mass=mass, speed=speed)))
            if values is not None:
                found[mass] = start = variables_of(values)
    rows = [found.get(mass) for mass in masses]
    return FeasibleRegion(
        speed=speed,
        masses=np.array(masses),
        winds=np.array([np.nan if x is None else x.wind for x in rows]),
        limits=tuple("" if x is None else redesign.program.closest_row(np.array(x)) for x in rows),
        formations=tuple(rows),
    )


def redesigned_scenario(
    request: DesignRequest, formation: DesignedFormation, beside: FormationVariables, wind: float
) -> Scenario:
    """Returns the scenario of the formation with the largest reserve in a wind, m/s.

    The load's mass and speed are those of `beside`, such as a formation of a `FeasibleRegion`.
    """
    redesign = _Redesign(request, formation, beside.speed)
    x = variables_of(redesign.in_wind(np.array(beside), wind))
    asked = dataclasses.replace(
        request,
        load_mass=x.mass,
        speed=x.speed,
        wind=(wind * redesign.search.task.wind).tolist(),
    )
    flight = flight_of(redesign.search.way, formation.kind, x)
    shape = formation.kind, formation.carriers, formation.phase_turns
    scenario = formation_scenario(asked, *shape, x, flight)
    scenario.carrier_controller = formation.scenario.carrier_controller
    # No bound on airspeeds: beyond the border they are expected to be too low.
    scenario.optimization_layer.speed_bound = 0.0
    return scenario
