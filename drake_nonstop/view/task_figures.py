"""Figures of a task that is checked, not flown: feasible set, formation, limits, needs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.aircraft_margins import AircraftMargins
from drake_nonstop.analysis.flight_envelope import LimitAlong
from drake_nonstop.analysis.speed_check import set_over_time
from drake_nonstop.analysis.task_check import TaskCheck
from drake_nonstop.view.figure_style import (
    COLOURS,
    legend_below,
    limit_style,
    new_figure,
    plot_each,
    stacked,
    titled,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SET, _OUTSIDE = "#cfe3f2", "#f3d9c8"
_DOTS = {"marker": "o", "markersize": 3, "linestyle": "solid"}


def make_check_figure(found: TaskCheck) -> Figure:
    """Returns a figure of ξ and A that keep ε, the plan, its speeds and the formation over time."""
    figure = new_figure((9.0, 9.0))
    (xi, amplitude), (ratios, growth), (shares, elevations) = figure.subplots(3, 2, sharex=True)
    speeds, instants = found.speeds, found.formation.instants[1:]
    for axes, column, label in ((xi, 0, "ξ (rad/s)"), (amplitude, 1, "A (N)")):
        _draw_set(axes, found, column)
        plan = speeds.parameters[:, column]
        axes.plot(speeds.plan_times, plan, color=COLOURS[0], label="plan")
        axes.axhline(found.task.nominal[column], **limit_style(), label="nominal")
        axes.set_ylabel(label)
    xi.legend(fontsize="small")
    if speeds.speed_bound > 0:
        plot_each(ratios, speeds.plan_times, speeds.ratios, linestyle="solid")
        ratios.axhline(1.0, **limit_style())
        ratios.set_ylim(0, None)
    ratios.set_ylabel(
        "v / bound along the plan" if speeds.speed_bound > 0 else "v / bound (there is none)"
    )
    times = [instant.time for instant in instants]
    rates = {"without control": [instant.free.rate for instant in instants]}
    if all(instant.controlled is not None for instant in instants):
        rates["with control"] = [instant.rate for instant in instants]
    for colour, (label, values) in zip(COLOURS[1::-1], rates.items(), strict=False):
        growth.plot(times, values, color=colour, label=label, **_DOTS)
    growth.axhline(0.0, **limit_style())
    growth.legend(fontsize="small")
    growth.set_ylabel("growth of a deviation (1/s)")
    loads = [instant.loads for instant in instants]
    for axes, label, each in (
        (shares, "least share of weight (equal: 1)", [load.shares for load in loads]),
        (elevations, "least elevation (°)", np.degrees([load.elevations for load in loads])),
    ):
        plot_each(axes, times, np.asarray(each), "cable", **_DOTS)
        axes.axhline(0.0, color="black", linewidth=0.5)
        axes.set_ylabel(label)
        axes.set_xlabel("time (s)")
        axes.set_xlim(0, found.task.duration)
    legend_below(figure, shares)
    bound = "bound kept" if speeds.is_feasible else "bound cannot be kept"
    stable = "formation stable" if found.is_stable else "formation unstable"
    limits = ", limits cannot be kept" if speeds.missed else ""
    return titled(figure, f"{found.task.name}: {bound}{limits}, {stable}")


def _draw_set(axes: Axes, found: TaskCheck, column: int) -> None:
    """Draws where a constant ξ (column 0) or A (1), and the plan's other one, keep the bound.

    In this set they keep it at all phases of an orbit. Outside of it a plan may still keep the
    bound at the phases that it flies through.
    """
    drawn = set_over_time(found.task, found.speeds, column)
    if drawn is None:
        return
    for colour, label in ((_SET, "bound kept at all phases"), (_OUTSIDE, "not at all phases")):
        axes.fill_between([], [], color=colour, label=label)
    times, values, ratios = drawn
    axes.contourf(times, values, ratios.T, levels=[0, 1, np.inf], colors=[_OUTSIDE, _SET])
    lines = axes.contour(times, values, ratios.T, levels=[1.0], colors="black", linewidths=0.6)
    axes.clabel(lines, fmt={1.0: "bound"}, fontsize="small")


def make_limits_figure(limits: Sequence[LimitAlong], title: str = "") -> Figure:
    """Returns a figure of a panel per limit: curves of carriers, cables or pairs; limit dashed."""
    figure, panels = stacked(len(limits))
    for axes, along in zip(panels, limits, strict=True):
        plot_each(axes, along.times, along.values, linestyle="solid")
        axes.axhline(along.stated, **limit_style())
        unit = f" ({along.limit.unit})" if along.limit.unit else ""
        axes.set_ylabel(f"{along.limit.words}{unit}")
    return titled(figure, title) if title else figure


def make_aircraft_margins_figure(found: AircraftMargins) -> Figure:
    """Returns a figure of aircraft's needs over the orbit's phase, limits dashed, and distances."""
    phases, needs, limits = np.degrees(found.phases), found.needs, found.limits
    figure = new_figure((9.0, 7.2))
    (lift, airspeed), (bank, climb), (thrust, distances) = figure.subplots(3, 2, sharex=True)

    def draw(axes: Axes, values: NDArray, label: str, limit: float | None = None) -> None:
        """Draws a curve for each carrier, and the limit, with each sign that the values have."""
        plot_each(axes, phases, values, "carrier", linewidth=1.6)
        for sign in (-1, 1):
            if limit is not None and np.any(sign * values > 0):
                axes.axhline(sign * limit, **limit_style())
        axes.set_ylabel(label)

    draw(lift, needs.lift / found.max_lift, "C_L / C_Lmax", limits.lift_share)
    draw(airspeed, needs.airspeed, "airspeed (m/s)", limits.speed_share * found.stall_speed)
    draw(bank, np.degrees(needs.bank), "bank (°)", np.degrees(limits.bank))
    draw(climb, np.degrees(needs.climb), "climb (°)", np.degrees(limits.climb))
    draw(thrust, needs.thrust, "thrust (N)")
    for edge in found.thrust_limits:
        plot_each(thrust, phases, edge, linestyle="--", linewidth=0.7)
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
    legend_below(figure, lift, limit=lift.lines[-1])
    verdict = "flies within all limits" if found.is_flyable else "cannot be flown within the limits"
    wind = np.linalg.norm(found.wind)
    where = f", {wind:.3g} m/s of wind" if wind > 0 else ""
    return titled(figure, f"{found.scenario}{where}: the resting orbit {verdict}")
