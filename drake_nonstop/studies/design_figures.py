"""Figures of designed formations: power against margins, and what a formation can take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from drake_nonstop.studies.design import Design
from drake_nonstop.studies.feasible_region import FeasibleRegion
from drake_nonstop.visualization.figure_style import COLOURS, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MARKERS = {"leaning": "o", "co_rotating": "s"}
KEPT, AT_LIMITS, LOST = "flight within limits", "flight at limits", "stall, collision or loss"
_OUTCOMES = {KEPT: ("o", True), AT_LIMITS: ("o", False), LOST: ("X", True)}  # marker, filled
_ASIDE = 0.02  # of the range of masses
_DOT = {"markersize": 5.5, "markeredgewidth": 1.1}


class RegionFlight(NamedTuple):
    """A simulated flight beside the borders of regions."""

    panel: str
    region: int  # in its panel
    mass: float  # kg, of the load
    wind: float  # m/s
    outcome: str  # `KEPT`, `AT_LIMITS` or `LOST`


def make_pareto_figure(found: Design) -> Figure:
    """Power per mass of the load against the reserve of the margins, and against separation.

    A colour for each number of carriers, a marker for each kind; filled where no other formation
    has less power and no less reserve, and a line through these.
    """
    figure = new_figure((7.0, 3.1))
    left, right = figure.subplots(1, 2, sharey=True)
    numbers = sorted({formation.carriers for formation in found.formations})
    mass = found.request.load_mass
    seen = set()
    for formation in found.formations:
        colour = COLOURS[numbers.index(formation.carriers) % len(COLOURS)]
        kind, is_best = formation.kind, found.is_efficient(formation)
        label = f"{formation.carriers} {kind.replace('_', '-')}"
        style = {
            "marker": _MARKERS[kind],
            "color": colour,
            "markerfacecolor": colour if is_best else "white",
            "linestyle": "none",
            "markersize": 5,
        }
        power = formation.power / mass
        left.plot(
            formation.reserve, power, label=label if label not in seen else None, zorder=3, **style
        )
        right.plot(formation.distances[0], power, zorder=3, **style)
        seen.add(label)
    best = sorted((f.reserve, f.power / mass) for f in found.formations if found.is_efficient(f))
    left.step(*np.transpose(best), where="pre", color="0.6", linewidth=1.0, zorder=1)
    left.set_xlabel("reserve of the margins (1: as asked, 0: at the limits)")
    left.set_ylabel("power per mass of the load (W/kg)")
    right.set_xlabel("carriers apart, at least (m)")
    highest = max(formation.power for formation in found.formations) / mass
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.set_ylim(0, 1.08 * highest)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    figure.legend(loc="outside upper center", ncols=min(5, len(seen)), frameon=False, fontsize=8)
    return figure


def make_region_figure(
    panels: Mapping[str, Sequence[FeasibleRegion]], flown: Sequence[RegionFlight] = ()
) -> Figure:
    """The largest wind over the load's mass at several speeds of the load, and flights.

    Args:
        panels: regions, one for each speed, by the title of their panel.
        flown: simulated flights.
    """
    figure = new_figure((3.4 * len(panels) + 0.4, 3.4))
    row = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (title, regions) in zip(row, panels.items(), strict=True):
        for k, region in enumerate(regions):
            colour = COLOURS[k % len(COLOURS)]
            label = f"load at {region.speed:g} m/s" if region.speed else "load at rest"
            own = label if axes is row[0] else None
            axes.plot(region.masses, region.winds, color=colour, linewidth=1.6, label=own)
            axes.fill_between(region.masses, 0, region.winds, color=colour, alpha=0.10, linewidth=0)
        axes.set_title(title, fontsize="medium")
        axes.set_xlabel("mass of the load (kg)")
        axes.grid(alpha=0.3)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    row[0].set_ylabel("wind (m/s)")
    titles = list(panels)
    counts = [len(regions) for regions in panels.values()]
    masses = [mass for regions in panels.values() for region in regions for mass in region.masses]
    aside = np.ptp(masses) * _ASIDE  # so that flights of the same load cover none of each other
    for flight in flown:
        place = flight.mass + aside * (flight.region - (max(counts) - 1) / 2)
        colour = COLOURS[flight.region % len(COLOURS)]
        marker, filled = _OUTCOMES[flight.outcome]
        face = colour if filled else "white"
        row[titles.index(flight.panel)].plot(
            place, flight.wind, marker, color=colour, markerfacecolor=face, zorder=3, **_DOT
        )
    row[0].set_ylim(0, None)
    for outcome in [name for name in _OUTCOMES if any(f.outcome == name for f in flown)]:
        marker, filled = _OUTCOMES[outcome]
        face = "0.3" if filled else "white"
        row[0].plot([], [], marker, color="0.3", markerfacecolor=face, label=outcome, **_DOT)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return figure
