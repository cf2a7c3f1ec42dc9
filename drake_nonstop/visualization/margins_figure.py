"""The figure of what aircraft need on an orbit, over its phase."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.aircraft_margins import AircraftMargins
from drake_nonstop.visualization.figure_style import COLOURS, new_figure, titled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_NAMED = 12  # carriers in the legend


def make_aircraft_margins_figure(found: AircraftMargins) -> Figure:
    """What each aircraft needs over the phase, its limits dashed, and the least distances."""
    phases, needs, limits = np.degrees(found.phases), found.needs, found.limits
    figure = new_figure((9.0, 7.2))
    (lift, airspeed), (bank, climb), (thrust, distances) = figure.subplots(3, 2, sharex=True)
    _draw_each(lift, phases, needs.lift / found.max_lift, "C_L / C_Lmax", limits.lift_share)
    slowest = limits.speed_share * found.stall_speed
    _draw_each(airspeed, phases, needs.airspeed, "airspeed (m/s)", slowest)
    _draw_each(bank, phases, np.degrees(needs.bank), "bank (°)", np.degrees(limits.bank))
    _draw_each(climb, phases, np.degrees(needs.climb), "climb (°)", np.degrees(limits.climb))
    _draw_each(thrust, phases, needs.thrust, "thrust (N)")
    for i, (least, most) in enumerate(zip(*(edge.T for edge in found.thrust_limits), strict=True)):
        for edge in (least, most):
            colour = COLOURS[i % len(COLOURS)]
            thrust.plot(phases, edge, color=colour, linestyle="--", linewidth=0.7)
    for margin in found.margins:
        if margin.unit == "m":
            is_carriers = margin.name.startswith("carriers")
            values = found.carrier_distance if is_carriers else found.cable_distance
            colour = COLOURS[0 if is_carriers else 1]
            distances.semilogy(phases, np.maximum(values, 1e-3), color=colour, label=margin.name)
            if margin.limit > 0:
                distances.axhline(margin.limit, color=colour, linestyle="--", linewidth=0.9)
    distances.set_ylabel("closest two (m)")
    distances.legend(fontsize="small")
    for axes in (thrust, distances):
        axes.set_xlabel("phase (°)")
        axes.set_xlim(phases[0], phases[-1])
        axes.set_xticks(np.arange(0, phases[-1] + 1, 60 * (1 + phases[-1] // 720)))
    curves, names = lift.get_legend_handles_labels()
    figure.legend(
        [*curves[:_MOST_NAMED], lift.lines[-1]],
        [*names[:_MOST_NAMED], "limit"],
        loc="outside lower center",
        ncols=6,
        fontsize="small",
        frameon=False,
    )
    verdict = "flies within all limits" if found.is_flyable else "cannot be flown within the limits"
    wind = np.linalg.norm(found.wind.velocity)
    where = f", {wind:.3g} m/s of wind" if wind > 0 else ""
    return titled(figure, f"{found.scenario}{where}: the resting orbit {verdict}")


def _draw_each(
    axes: Axes, phases: NDArray, values: NDArray, label: str, limit: float | None = None
) -> None:
    """A curve for each carrier, and the limit, on both sides where there are values."""
    for i, curve in enumerate(values.T):
        style = "solid" if i < values.shape[1] / 2 else (0, (3, 5))  # symmetric ones coincide
        colour, name = COLOURS[i % len(COLOURS)], f"carrier {i + 1}"
        axes.plot(phases, curve, color=colour, linestyle=style, linewidth=1.6, label=name)
    if limit is not None:
        for sign in (-1, 1):
            if np.any(sign * values > 0):
                axes.axhline(sign * limit, color="black", linestyle="--", linewidth=1.0)
    axes.set_ylabel(label)
