"""Figures of designed formations: power against margins, and what a formation can take."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from drake_nonstop.studies.design import Design
from drake_nonstop.studies.feasible_region import FeasibleRegion
from drake_nonstop.visualization.figure_style import COLOURS, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MARKERS = {"leaning": "o", "co_rotating": "s"}


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
    title: str,
    regions: Sequence[FeasibleRegion],
    flown: Sequence[tuple[int, float, float, bool]] = (),
) -> Figure:
    """The largest wind over the load's mass at several speeds of the load, and flights.

    Args:
        title: of the figure.
        regions: one for each speed.
        flown: the region, mass (kg), wind (m/s) and success of simulated flights.
    """
    figure = new_figure((5.2, 3.6))
    axes = figure.subplots()
    for k, region in enumerate(regions):
        colour = COLOURS[k % len(COLOURS)]
        axes.plot(region.masses, region.winds, color=colour, label=f"{region.speed:g} m/s")
        axes.fill_between(region.masses, 0, region.winds, color=colour, alpha=0.12, linewidth=0)
    for k, mass, wind, is_ok in flown:
        colour = COLOURS[k % len(COLOURS)]
        face = colour if is_ok else "white"
        marker = "o" if is_ok else "X"
        axes.plot(mass, wind, marker, color=colour, markerfacecolor=face, markersize=6, zorder=3)
    axes.set_xlabel("mass of the load (kg)")
    axes.set_ylabel("largest wind (m/s)")
    axes.set_ylim(0, None)
    axes.grid(alpha=0.3)
    axes.legend(title="speed of the load", frameon=False, fontsize=8)
    axes.set_title(title, fontsize="medium")
    return figure
