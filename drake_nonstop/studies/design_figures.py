"""Figures of designed formations: power against margins, and what a formation can take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from drake_nonstop.studies.design import Design
from drake_nonstop.studies.formation_search import FeasibleRegion
from drake_nonstop.view.figure_style import COLOURS, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MARKERS = {"leaning": "o", "co_rotating": "s"}
KEPT, AT_LIMITS, LOST = "flight within limits", "flight at limits", "stall, collision or loss"
_OUTCOMES = {KEPT: ("o", True), AT_LIMITS: ("o", False), LOST: ("X", True)}  # marker, filled
_ASIDE = 0.02  # of the range of masses


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
    labels: dict[str, None] = {}
    for formation in found.formations:
        colour = COLOURS[numbers.index(formation.carriers) % len(COLOURS)]
        style = {
            "marker": _MARKERS[formation.kind],
            "color": colour,
            "markerfacecolor": colour if found.is_efficient(formation) else "white",
            "linestyle": "none",
            "markersize": 5,
            "zorder": 3,
        }
        power, name = formation.power / mass, formation.name
        label = None if name in labels else name
        left.plot(formation.reserve, power, label=label, **style)
        right.plot(formation.distances[0], power, **style)
        labels[name] = None
    best = sorted((f.reserve, f.power / mass) for f in found.formations if found.is_efficient(f))
    left.step(*np.transpose(best), where="pre", color="0.6", linewidth=1.0, zorder=1)
    left.set_xlabel("reserve of the margins (1: as asked, 0: at the limits)")
    left.set_ylabel("power per mass of the load (W/kg)")
    right.set_xlabel("carriers apart, at least (m)")
    left.set_ylim(0, 1.08 * max(formation.power for formation in found.formations) / mass)
    for axes in (left, right):
        _open(axes)
    figure.legend(loc="outside upper center", ncols=min(5, len(labels)), frameon=False, fontsize=8)
    return figure


def _open(axes: Axes) -> None:
    """Axes with a grid, and without the upper and the right spine."""
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)


def make_region_figure(
    panels: Mapping[str, Sequence[FeasibleRegion]], flown: Sequence[RegionFlight] = ()
) -> Figure:
    """The largest wind over the load's mass at several speeds of the load, and simulated flights.

    `panels` are regions, one for each speed, by the title of their panel.
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
        _open(axes)
    row[0].set_ylabel("wind (m/s)")

    def dot(axes: Axes, x: Any, y: Any, outcome: str, colour: str, **style: Any) -> None:
        marker, filled = _OUTCOMES[outcome]
        style |= {"markerfacecolor": colour if filled else "white", "markersize": 5.5}
        axes.plot(x, y, marker, color=colour, markeredgewidth=1.1, **style)

    masses = [mass for regions in panels.values() for region in regions for mass in region.masses]
    most = max(map(len, panels.values()))
    aside = np.ptp(masses) * _ASIDE  # so that flights of the same load cover none of each other
    for flight in flown:
        place = flight.mass + aside * (flight.region - (most - 1) / 2)
        axes, colour = row[list(panels).index(flight.panel)], COLOURS[flight.region % len(COLOURS)]
        dot(axes, place, flight.wind, flight.outcome, colour, zorder=3)
    row[0].set_ylim(0, None)
    for outcome in _OUTCOMES:
        if any(flight.outcome == outcome for flight in flown):
            dot(row[0], [], [], outcome, "0.3", label=outcome)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return figure
