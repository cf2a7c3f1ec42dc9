"""Formations of aircraft for a load, of several numbers and kinds, as a table and a dictionary."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.planning.formation_program import FormationVariables
from drake_nonstop.studies.design_request import MARGIN, POWER, DesignRequest
from drake_nonstop.studies.designed_formation import (
    DesignedFormation,
    Refusal,
    design_bounds,
    design_task,
    flight_of,
    formation_scenario,
)
from drake_nonstop.studies.formation_search import design_one
from drake_nonstop.studies.journal import StudyInterrupted
from drake_nonstop.studies.run_all import Progress, no_progress, run_all
from drake_nonstop.validation import ScenarioError, message_of

_CLOSE = 0.02  # of reserves that are the same
_COLUMNS = {  # of the table, with formats of the entries of `design_dictionary`
    "": "{scenario}{star}",
    "n": "{carriers}",
    "kind": "{kind}",
    "L_c m": "{cable_length_m:.0f}",
    "C N": "{spread_N:.2f}",
    "A_r N": "{radial_N:.2f}",
    "A_t N": "{tangential_N:.2f}",
    "B N": "{vertical_N:.2f}",
    "kappa": "{phase_turns}",
    "xi rad/s": "{frequency_rad_s:.3f}",
    "C_L": "{lift_share:.2f}",
    "V m/s": "{airspeed_min_m_s:.1f}-{airspeed_max_m_s:.1f}",
    "V / V_s": "{airspeed_over_stall_min:.2f}",
    "loaded": "{airspeed_over_loaded_stall_min:.2f}",
    "bank": "{bank:.0f}",
    "climb": "{climb:.0f}",
    "thrust N": "{thrust_min_N:.1f}-{thrust_max_N:.1f}",
    "T %": "{least:.0f}-{most:.0f}",
    "apart m": "{carriers_apart_m:.1f}",
    "cables m": "{cables_apart_m:.2f}",
    "W": "{power_drawn_W:.0f}",
    "Wh/kg km": "{energy}",
    "reserve": "{reserve:.2f}",
}


@dataclass(frozen=True, kw_only=True)
class Design:
    """Result for a request, or for a part of its kinds and numbers of carriers."""

    request: DesignRequest
    formations: tuple[DesignedFormation, ...]  # that keep its margins, in the request's order
    refusals: tuple[Refusal, ...]  # of other carriers and kinds, or of some margins of the same

    def is_efficient(self, formation: DesignedFormation) -> bool:
        """Whether no other one has less power and, to 0.02, no less reserve."""
        return not any(
            other.power < formation.power and other.reserve > formation.reserve - _CLOSE
            for other in self.formations
        )

    @property
    def best(self) -> str:
        """The first formation in a few words."""
        if not self.formations:
            return "none yet keeps the margins"
        first = self.formations[0]
        return f"the best has {first.name}, reserve {first.reserve:.2f}, {first.power:.0f} W"

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
            other = "" if remedies[0] is best else f" for {remedies[0].name}"
            remedy = f"give {remedies[0].remedy}{other}"
        why = f"misses {best.missed}"
        if best.fault:
            why = f"keeps them, but {best.fault}"
        elif best.reserve >= 0:
            why = f"though within the limits, {why}"
        return (
            f"request.carriers = {tried}: no formation of {self.request.aircraft_name} keeps the "
            f"margins and flies; the best, {best.name}, {why}; {remedy}"
        )


ORDERS: dict[str, Callable[[DesignedFormation], float]] = {
    MARGIN: lambda formation: -formation.reserve,
    POWER: lambda formation: formation.power,
}


def design(request: DesignRequest, progress: Progress = no_progress) -> Design:
    """The formations for a request, found in a process per core.

    Of each number of carriers and kind they are those of the least power at rising margins. Each
    is checked by `aircraft_margins` and is stable at rest and on the way.

    Raises:
        ScenarioError: the request cannot be used, or a process died.
        StudyInterrupted: Ctrl-C; its `found` is the Design of what was searched.
    """
    request.check()
    _require_buildable(request)
    keys = [(n, kind) for n in request.carriers for kind in request.kinds]
    found: dict[tuple[int, str], Any] = {}

    def failed(key: tuple[int, str], error: str) -> Any:
        raise ScenarioError(f"design, {key[0]} carriers {key[1]}: {error}")

    def so_far() -> Design:
        results = [each for key in keys for each in found.get(key, ())]
        formations = [each for each in results if isinstance(each, DesignedFormation)]
        formations.sort(key=ORDERS[request.first])
        for k, formation in enumerate(formations, 1):
            formation.scenario.name = f"{request.name}_{k}"
        refusals = tuple(each for each in results if isinstance(each, Refusal))
        return Design(request=request, formations=tuple(formations), refusals=refusals)

    try:
        run_all(
            design_one,
            keys,
            lambda key: (request, *key),
            found.__setitem__,
            failed,
            what=lambda: f"designing: {so_far().best}",
            progress=progress,
        )
    except KeyboardInterrupt:
        said = f"{len(found)} of {len(keys)} kinds and numbers of carriers were searched"
        interrupted = StudyInterrupted(said)
        interrupted.found = so_far()
        raise interrupted from None
    return so_far()


def _require_buildable(request: DesignRequest) -> None:
    """Checks that there is a loop for the request's load, of any formation."""
    n, kind = request.carriers[0], request.kinds[0]
    lower, upper = design_bounds(request, n, kind)
    x = FormationVariables(*map(float, np.where(upper > lower, 0.9 * lower + 0.1 * upper, lower)))
    flight = flight_of(design_task(request, n), kind, x, phases=1)
    try:
        scenario = formation_scenario(request, kind, n, max(n - 2, 1), x, flight)
        make_nonstop(scenario, at_equilibrium=False)
    except ScenarioError as error:
        remedy = "change what this follows from in the request"
        raise ScenarioError(
            f"request: no loop flies its load; {message_of(error)}; {remedy}"
        ) from None


def design_dictionary(found: Design) -> dict[str, Any]:
    """For a JSON file; keys end in their units."""
    return {
        "is_feasible": bool(found.formations),
        "verdict": found.verdict,
        "formations": [_dictionary(found, formation) for formation in found.formations],
        "refusals": [
            vars(refusal) | {"variables": refusal.variables._asdict(), "reserve": refusal.reserve}
            for refusal in found.refusals
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
        "lift_share": flight.ranges.lift_share[1],
        "airspeed_min_m_s": flight.ranges.airspeed[0],
        "airspeed_max_m_s": flight.ranges.airspeed[1],
        "airspeed_over_stall_min": flight.ranges.over_stall[0],
        "airspeed_over_loaded_stall_min": flight.ranges.over_loaded_stall[0],
        "bank_rad": flight.bank,
        "climb_rad": flight.climb,
        "thrust_min_N": flight.ranges.thrust[0],
        "thrust_max_N": flight.ranges.thrust[1],
        "thrust_share_min": flight.ranges.thrust_share[0],
        "thrust_share_max": flight.ranges.thrust_share[1],
        "thrust_share_left_above": flight.thrust_above,
        "thrust_share_left_below": flight.thrust_below,
        "power_drawn_W": formation.power,
        "energy_Wh_per_kg_km": formation.energy,
        "carriers_apart_m": formation.distances[0],
        "cables_apart_m": formation.distances[1],
        "cables": formation.cables.dictionary,
        "growth_1_s": formation.growth,
        "breaks_first": [
            {"grows": what, "unit": unit, "value": value, "limit": limit or None}
            for what, unit, value, limit in formation.breaks
        ],
    }


def design_table(found: Design) -> str:
    """A line for each formation, and what breaks it first, for a terminal."""
    rows = [list(_COLUMNS)]
    for f in found.formations:
        told, energy = _dictionary(found, f), f.energy
        told |= {
            "star": "*" if told["is_efficient"] else "",
            "bank": math.degrees(f.flight.bank),
            "climb": math.degrees(f.flight.climb),
            "least": 100 * f.flight.ranges.thrust_share[0],
            "most": 100 * f.flight.ranges.thrust_share[1],
            "energy": "" if energy is None else f"{energy:.1f}",
        }
        rows.append([text.format(**told) for text in _COLUMNS.values()])
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
