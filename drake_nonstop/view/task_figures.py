"""Figures of a scenario that is checked: feasible set, flights, limits, needs of aircraft."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.aircraft_margins import AircraftMargins
from drake_nonstop.analysis.feasible_parameters import set_over_time
from drake_nonstop.analysis.task import Task
from drake_nonstop.analysis.verdict import ScenarioCheck
from drake_nonstop.planning.margins import LimitAlong
from drake_nonstop.view.figure_style import (
    LIMIT,
    PAGE,
    THRUST_RANGE,
    in_paper_style,
    legend_above,
    new_figure,
    plot_each,
    stacked,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SET, _OUTSIDE = "#cfe3f2", "#f3d9c8"


@in_paper_style
def make_check_figure(found: ScenarioCheck) -> Figure:
    """Returns a figure of ξ and A that keep ε, those flown, and the flights' speeds and errors."""
    figure = new_figure((PAGE, 4.4))
    (xi, amplitude), (ratios, errors) = figure.subplots(2, 2, sharex=True)
    flown = [(each.name, each.history) for each in found.flights if each.history is not None]
    if flown and found.task is not None:
        for axes, column in ((xi, 0), (amplitude, 1)):
            _draw_set(axes, found.task, (flown[0][1].times, flown[0][1].parameters), column)
    for k, (name, history) in enumerate(flown):
        own: dict[str, Any] = {"color": f"C{k}"}
        xi.plot(history.times, history.parameters[:, 0], label=name, **own)
        amplitude.plot(history.times, history.parameters[:, 1], **own)
        if np.any(history.speed_bounds > 0):
            share = history.speeds.min(axis=1) / np.maximum(history.speed_bounds, 1e-12)
            ratios.plot(history.step_times, share, **own)
        errors.semilogy(history.times, np.maximum(history.position_error, 1e-9), **own)
    ratios.axhline(1.0, **LIMIT)
    ratios.set_ylim(0, None)
    for axes, label in (
        (xi, "ξ (rad/s)"),
        (amplitude, "A (N)"),
        (ratios, "slowest carrier: v / bound"),
        (errors, "load from its reference (m)"),
    ):
        axes.set_ylabel(label)
        axes.set_xlim(0, found.scenario.simulation_duration)
    for axes in (ratios, errors):
        axes.set_xlabel("time (s)")
    return legend_above(figure, f"{found.scenario.name}: {found.outcome.value}")


def _draw_set(axes: Axes, task: Task, flown: tuple[NDArray, NDArray], column: int) -> None:
    """Draws where a constant ξ (column 0) or A (1), and the other one as flown, keep the bound.

    In this set they keep it at all phases of an orbit. Outside of it a plan may still keep the
    bound at the phases that it flies through.
    """
    drawn = set_over_time(task, flown, column)
    if drawn is None:
        return
    for colour, label in ((_SET, "bound kept at all phases"), (_OUTSIDE, "not at all phases")):
        axes.fill_between([], [], color=colour, label=label)
    times, values, ratios = drawn
    axes.contourf(times, values, ratios.T, levels=[0, 1, np.inf], colors=[_OUTSIDE, _SET])


@in_paper_style
def make_limits_figure(limits: Sequence[LimitAlong]) -> Figure:
    """Returns a figure of a panel per limit: curves of carriers, cables or pairs; limit dashed."""
    figure, panels = stacked(len(limits))
    for axes, along in zip(panels, limits, strict=True):
        plot_each(axes, along.times, along.values, linestyle="solid")
        axes.axhline(along.stated, **LIMIT)
        unit = f" ({along.limit.unit})" if along.limit.unit else ""
        axes.set_ylabel(f"{along.limit.words}{unit}")
    return figure


@in_paper_style
def make_aircraft_margins_figure(found: AircraftMargins) -> Figure:
    """Returns a figure of aircraft's needs over the orbit's phase, limits dashed, and distances."""
    phases, needs, limits = np.degrees(found.phases), found.needs, found.limits
    figure = new_figure((PAGE, 5.4))
    (lift, airspeed), (bank, climb), (thrust, distances) = figure.subplots(3, 2, sharex=True)
    for axes, values, label, limit in (
        (lift, needs.lift / found.max_lift, r"$C_L$ / $C_{L,\mathrm{max}}$", limits.lift_share),
        (airspeed, needs.airspeed, "airspeed (m/s)", limits.speed_share * found.stall_speed),
        (bank, np.degrees(needs.bank), "bank (°)", np.degrees(limits.bank)),
        (climb, np.degrees(needs.climb), "climb (°)", np.degrees(limits.climb)),
        (thrust, needs.thrust, "thrust (N)", None),
    ):
        plot_each(axes, phases, values, "carrier")
        for sign in (-1, 1):  # of those that the values have
            if limit is not None and np.any(sign * values > 0):
                axes.axhline(sign * limit, **LIMIT, label="limit")
        axes.set_ylabel(label)
    for edge in found.thrust_limits:
        plot_each(thrust, phases, edge, linestyle=":", linewidth=0.7)
    thrust.plot([], [], color="0.4", linewidth=0.7, linestyle=":", label=THRUST_RANGE)
    for margin in (each for each in found.margins if each.unit == "m"):
        is_carriers = margin.name.startswith("carriers")
        values = found.carrier_distance if is_carriers else found.cable_distance
        colour = "0.2" if is_carriers else "0.6"
        distances.semilogy(phases, np.maximum(values, 1e-3), color=colour, label=margin.name)
        if margin.limit > 0:
            distances.axhline(margin.limit, color=colour, linestyle="--")
    distances.set_ylabel("closest two (m)")
    for axes in (thrust, distances):
        axes.set_xlabel("phase (°)")
        axes.set_xlim(phases[0], phases[-1])
        axes.set_xticks(np.arange(0, phases[-1] + 1, 60 * (1 + phases[-1] // 720)))
    verdict = "flies within all limits" if found.is_flyable else "cannot be flown within the limits"
    wind = np.linalg.norm(found.wind)
    where = f", {wind:.3g} m/s of wind" if wind > 0 else ""
    return legend_above(figure, f"{found.scenario}{where}: the resting orbit {verdict}")
