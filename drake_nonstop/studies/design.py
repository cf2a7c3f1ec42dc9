"""Formations of aircraft for a load, of several numbers and kinds, as a table."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from drake_nonstop.studies.design_request import MARGIN, DesignRequest
from drake_nonstop.studies.formation_search import DesignedFormation, Refusal, design_one
from drake_nonstop.studies.workers import Progress, no_progress, results_of
from drake_nonstop.validation import ScenarioError

# Columns of the table: of each the heading, the format, and the value.
_COLUMNS: dict[str, tuple[str, str, Callable[[DesignedFormation], Any]]] = {
    "carriers": ("n", "d", lambda f: f.carriers),
    "kind": ("kind", "s", lambda f: f.kind),
    "cable_length_m": ("L_c m", ".0f", lambda f: f.variables.cable_length),
    "spread_N": ("C N", ".2f", lambda f: f.forces["spread"]),
    "radial_N": ("A_r N", ".2f", lambda f: f.forces["radial"]),
    "tangential_N": ("A_t N", ".2f", lambda f: f.forces["tangential"]),
    "vertical_N": ("B N", ".2f", lambda f: f.forces["vertical"]),
    "phase_turns": ("kappa", "d", lambda f: f.phase_turns),
    "frequency_rad_s": ("xi rad/s", ".3f", lambda f: f.variables.frequency),
    "lift_share_max": ("C_L", ".2f", lambda f: f.extremes["lift"][1]),
    "airspeed_min_m_s": ("V m/s", ".1f", lambda f: f.extremes["airspeed_m_s"][0]),
    "airspeed_max_m_s": ("to", ".1f", lambda f: f.extremes["airspeed_m_s"][1]),
    "airspeed_over_stall_min": ("V / V_s", ".2f", lambda f: f.extremes["airspeed"][0]),
    "bank_max_rad": ("bank", ".2f", lambda f: np.max(np.abs(f.extremes["bank"]))),
    "sine_of_climb_max": ("climb", ".2f", lambda f: np.max(np.abs(f.extremes["climb"]))),
    "thrust_min_N": ("T N", ".1f", lambda f: f.extremes["thrust_N"][0]),
    "thrust_max_N": ("to", ".1f", lambda f: f.extremes["thrust_N"][1]),
    "carriers_apart_m": ("apart m", ".1f", lambda f: f.separation),
    "power_drawn_W": ("W", ".0f", lambda f: f.power),
    "energy_Wh_per_kg_km": ("Wh/kg km", ".1f", lambda f: f.energy),
    "reserve": ("reserve", ".2f", lambda f: f.reserve),
}


@dataclass(frozen=True, kw_only=True)
class Design:
    """Result for a request, or for a part of its kinds and numbers of carriers."""

    request: DesignRequest
    formations: tuple[DesignedFormation, ...]  # that keep its margins, in the request's order
    refusals: tuple[Refusal, ...]  # of other carriers and kinds, or of some margins of the same

    @property
    def verdict(self) -> str:
        """A sentence: how many there are, or which limit forbids them and what would help."""
        if self.formations:
            return f"{len(self.formations)} formations keep the margins"
        best = max(self.refusals, key=lambda refusal: refusal.reserve)
        return (
            f"request.carriers = {self.request.carriers}: no formation keeps the margins and "
            f"flies; the best, {best.name}, is at {best.reserve:.3g} of them: {best.why}; give "
            "longer cables, a lighter load, less wind or speed, or smaller margins"
        )

    @property
    def dictionary(self) -> dict[str, Any]:
        """All of it, for a JSON file; keys end in their units."""
        return {
            "is_feasible": bool(self.formations),
            "verdict": self.verdict,
            "formations": [
                {
                    "scenario": formation.scenario.name,
                    **{key: value(formation) for key, (*_, value) in _COLUMNS.items()},
                    "cables": formation.cables.dictionary,
                }
                for formation in self.formations
            ],
            "refusals": [
                vars(refusal) | {"variables": refusal.variables._asdict()}
                for refusal in self.refusals
            ],
        }

    def __str__(self) -> str:
        """A line for each formation, and what breaks it first, for a terminal."""
        rows = [["", *(heading for heading, *_ in _COLUMNS.values())]]
        for f in self.formations:
            cells = (
                "" if (value := of(f)) is None else f"{value:{form}}"
                for _, form, of in _COLUMNS.values()
            )
            rows.append([f.scenario.name, *cells])
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        for f in self.formations:
            lines.append(f"{f.scenario.name}: real cables {f.cables.text}")
        if self.formations:
            worst = max((f.cables for f in self.formations), key=lambda cables: cables.difference)
            lines += [worst.warning] if worst.warning else []
        for refusal in self.refusals:
            about = f"{refusal.carriers} {refusal.kind}, at {refusal.reserve:.3g} of the margins"
            lines.append(f"{about}: {refusal.why}")
        return "\n".join(lines)


def design(
    request: DesignRequest, progress: Progress = no_progress, executor: Executor | None = None
) -> Design:
    """Finds formations for a request, in a process per core or by an executor as of `study`.

    For each number of carriers and each kind of pattern they have the least power at rising
    margins. Each formation has been flown.

    Raises:
        ScenarioError: the request or the executor cannot be used, or a process died.
    """
    request.check()
    batches = [[(request, n, kind)] for n in request.carriers for kind in request.kinds]
    found = {}
    for ((_, *key),), answers in results_of(_designed, batches, executor):
        if isinstance(answers, str):
            raise ScenarioError(f"design, {key[0]} carriers {key[1]}: {answers}")
        found[tuple(key)] = answers[0]
        progress("designing", len(found) / len(batches))
    results = [each for ((_, *key),) in batches for each in found[tuple(key)]]
    formations = [each for each in results if isinstance(each, DesignedFormation)]
    formations.sort(key=lambda f: -f.reserve if request.first == MARGIN else f.power)
    for k, formation in enumerate(formations, 1):
        formation.scenario.name = f"{request.name}_{k}"
    refusals = tuple(each for each in results if isinstance(each, Refusal))
    return Design(request=request, formations=tuple(formations), refusals=refusals)


def _designed(calls: list[Any]) -> list[Any]:
    return [design_one(*call) for call in calls]
