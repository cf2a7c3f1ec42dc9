"""The figure of a task's feasible set over time, with its plan, and of its formation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.speed_check import set_over_time
from drake_nonstop.analysis.task_check import TaskCheck
from drake_nonstop.visualization.figure_style import COLOURS, new_figure, titled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_NAMED = 12  # cables in the legend
_SET, _OUTSIDE = "#cfe3f2", "#f3d9c8"


def make_check_figure(found: TaskCheck) -> Figure:
    """The ξ and A that keep the bound at each instant, the plan, its speeds and the formation."""
    figure = new_figure((9.0, 9.0))
    (xi, amplitude), (speeds, growth), (shares, elevations) = figure.subplots(3, 2, sharex=True)
    of_speeds = found.speeds
    parameters = of_speeds.parameters
    for axes, column, label in ((xi, 0, "ξ (rad/s)"), (amplitude, 1, "A (N)")):
        _draw_set(axes, found, column)
        axes.plot(of_speeds.plan_times, parameters[:, column], color=COLOURS[0], label="plan")
        nominal = found.task.nominal[column]
        axes.axhline(nominal, color="black", linestyle="--", linewidth=0.9, label="nominal")
        axes.set_ylabel(label)
    xi.legend(fontsize="small")
    _draw_speeds(speeds, found)
    _draw_growth(growth, found)
    instants = found.formation.instants[1:]
    times = [instant.time for instant in instants]
    _draw_each(shares, times, np.array([i.loads.shares for i in instants]))
    shares.set_ylabel("least share of weight (equal: 1)")
    _draw_each(elevations, times, np.degrees([i.loads.elevations for i in instants]))
    elevations.set_ylabel("least elevation (°)")
    for axes in (shares, elevations):
        axes.set_xlabel("time (s)")
        axes.set_xlim(0, found.task.duration)
    curves, names = shares.get_legend_handles_labels()
    figure.legend(
        curves[:_MOST_NAMED],
        names[:_MOST_NAMED],
        loc="outside lower center",
        ncols=6,
        fontsize="small",
        frameon=False,
    )
    bound = "bound kept" if of_speeds.is_feasible else "bound cannot be kept"
    stable = "formation stable" if found.is_stable else "formation unstable"
    limits = ", limits cannot be kept" if of_speeds.missed else ""
    return titled(figure, f"{found.task.name}: {bound}{limits}, {stable}")


def _draw_set(axes: Axes, found: TaskCheck, column: int) -> None:
    """Where a constant ξ, or A, beside the plan's other one keeps the bound at all phases.

    Outside of it a plan keeps the bound at the phases which come, if at all.
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


def _draw_speeds(axes: Axes, found: TaskCheck) -> None:
    speeds = found.speeds
    if speeds.speed_bound == 0:
        axes.set_ylabel("v / bound (there is none)")
        return
    for i, curve in enumerate(speeds.ratios.T):
        axes.plot(speeds.plan_times, curve, color=COLOURS[i % len(COLOURS)], linewidth=1.0)
    axes.axhline(1.0, color="black", linestyle="--", linewidth=1.0)
    axes.set_ylim(0, None)
    axes.set_ylabel("v / bound along the plan")


def _draw_growth(axes: Axes, found: TaskCheck) -> None:
    instants = found.formation.instants[1:]
    times = [instant.time for instant in instants]
    free = [instant.free.rate for instant in instants]
    axes.plot(times, free, "o-", color=COLOURS[1], markersize=3, label="without control")
    if all(instant.controlled is not None for instant in instants):
        rates = [instant.rate for instant in instants]
        axes.plot(times, rates, "o-", color=COLOURS[0], markersize=3, label="with control")
    axes.axhline(0.0, color="black", linestyle="--", linewidth=1.0)
    axes.legend(fontsize="small")
    axes.set_ylabel("growth of a deviation (1/s)")


def _draw_each(axes: Axes, times: list[float], values: NDArray) -> None:
    """A curve for each cable."""
    for i, curve in enumerate(values.T):
        colour = COLOURS[i % len(COLOURS)]
        axes.plot(times, curve, "o-", color=colour, markersize=3, label=f"cable {i + 1}")
    axes.axhline(0.0, color="black", linewidth=0.5)
