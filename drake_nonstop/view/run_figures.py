"""The figures of one run, the paper's own set, and any signals of any runs over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import stall_speed, thrust_limits
from drake_nonstop.run.run import Run
from drake_nonstop.run.run_quantities import RunQuantities, load_errors, tilt_and_yaw
from drake_nonstop.run.signal_table import SignalTable
from drake_nonstop.validation import require
from drake_nonstop.view.figure_style import (
    LIMIT,
    LINE_STYLES,
    THRUST_RANGE,
    fitting_unit,
    in_paper_style,
    keep_plausible,
    legend_above,
    plot,
    plot_each,
    single,
    stacked,
)
from drake_nonstop.view.path_figures import draw_carrier_paths_from_above, draw_snapshots
from drake_nonstop.view.task_figures import make_limits_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_PANELS = 20  # of a figure of signals
_PLAUSIBLE_ERROR = 0.2  # m or rad: no smaller error of a run that diverged is cut off


def figure_names(run: Run) -> list[str]:
    """The figures that a run has, of `FIGURES`."""
    return [name for name in FIGURES if name not in _SOME or _SOME[name](run)]


@in_paper_style
def make_figure(run: Run, *names: str) -> Figure:
    """The figure of that name, one of `FIGURES`, or the run's signals of these names.

    Raises:
        ScenarioError: the run has no such figure or signal.
    """
    require(len(names) > 0, "names", "none", f"give one of {', '.join(FIGURES)}, or signals")
    if len(names) > 1 or names[0] not in FIGURES:
        return make_signal_figure({run.scenario.name: run}, names)
    has = figure_names(run)
    require(names[0] in has, "figure", names[0], f"this run has {', '.join(has)}")
    return FIGURES[names[0]](run)


def _draw_load_errors(run: Run) -> Figure:
    figure, panels = stacked(2)
    shift, turn = load_errors(run)
    tilt, yaw = tilt_and_yaw(turn)
    shifts = zip("xyz", shift.T, ("C0", "C1", "C2"), strict=True)
    norm = "norm", np.linalg.norm(shift, axis=1), "black"
    for axes, name, unit, lines in (
        (panels[0], "position", "m", [*shifts, norm]),
        (panels[1], "orientation", "rad", [("tilt", tilt, "C3"), ("yaw", yaw, "C4")]),
    ):
        factor, fitting = fitting_unit(unit, *(values for _, values, _ in lines))
        for label, values, colour in lines:
            plot(axes, run.time, factor * values, label=label, color=colour)
        axes.set_ylabel(f"{name}\nerror ({fitting})")
        if run.stopped:
            keep_plausible(axes, factor * _PLAUSIBLE_ERROR)
    return legend_above(figure)


def _draw_carrier_speeds(run: Run) -> Figure:
    figure, axes = single("time (s)", "carrier speed (m/s)")
    quantities = RunQuantities(run)
    time, bounds = quantities.time, quantities.speed_bounds
    plot_each(axes, time, quantities.speeds, "carrier")
    plot(axes, time, bounds, **LIMIT, label="bound ε")
    axes.set_ylim(bottom=0)
    return _finished(run, figure)


def _draw_tensions(run: Run) -> Figure:
    factor, unit = fitting_unit("N", run.steps["tensions"])
    figure, axes = single("time (s)", f"tension ({unit})")
    plot_each(axes, run.steps["time"], factor * run.steps["tensions"], "cable")
    return _finished(run, figure)


def _draw_aircraft(run: Run) -> Figure:
    quantities = RunQuantities(run)
    time, state, aircraft = quantities.time, quantities.aircraft_state, quantities.aircraft
    figure, (lift, bank, thrust, airspeed) = stacked(4)
    for axes, values, label in (
        (lift, state.lift / aircraft.max_lift, r"$C_L$ / $C_{L,\mathrm{max}}$"),
        (bank, np.degrees(state.bank), "bank (°)"),
        (thrust, state.thrust, "thrust (N)"),
        (airspeed, state.airspeed / stall_speed(aircraft), "airspeed / stall"),
    ):
        plot_each(axes, time, values, "aircraft")
        axes.set_ylabel(label)
    for limits in thrust_limits(aircraft, state.airspeed):
        plot_each(thrust, time, limits, linewidth=0.7, linestyle=":")
    thrust.plot([], [], color="0.4", linewidth=0.7, linestyle=":", label=THRUST_RANGE)
    for axes in (lift, airspeed):
        axes.axhline(1, **LIMIT, label="stall")
    lift.set_ylim(bottom=0)
    return _finished(run, figure)


def _draw_limits(run: Run) -> Figure:
    return _finished(run, make_limits_figure(RunQuantities(run).limits))


def _draw_internal_force_parameters(run: Run) -> Figure:
    figure, panels = stacked(2)
    labels = "frequency ξ (rad/s)", "amplitude A (N)"
    for axes, values, label in zip(panels, run.signal("parameters").T, labels, strict=True):
        plot(axes, run.time, values)
        axes.set_ylabel(label)
    return _finished(run, figure)


def _finished(run: Run, figure: Figure) -> Figure:
    """The figure with its legend; of a run that ended early without what hides its other values."""
    for axes in figure.axes if run.stopped else ():
        keep_plausible(axes)
    return legend_above(figure)


FIGURES: dict[str, Callable[[Run], Figure]] = {
    "carrier_paths_from_above": draw_carrier_paths_from_above,
    "snapshots": draw_snapshots,
    "load_errors": _draw_load_errors,
    "carrier_speeds": _draw_carrier_speeds,
    "tensions": _draw_tensions,
    "aircraft": _draw_aircraft,
    "limits": _draw_limits,
    "internal_force_parameters": _draw_internal_force_parameters,
}
# Figures that some runs have, and whether a run is one of them.
_SOME: dict[str, Callable[[Run], bool]] = {
    "aircraft": lambda run: RunQuantities(run).has_aircraft,
    "limits": lambda run: bool(RunQuantities(run).limits),
}


@in_paper_style
def make_signal_figure(runs: Mapping[str, SignalTable], signals: Sequence[str]) -> Figure:
    """A panel for each quantity of the signals: a colour for each entry, a line style for each run.

    More than three runs have colours of their own.

    Args:
        runs: by what they are called in the legend.
        signals: as of `SignalTable.columns`.

    Raises:
        ScenarioError: a run has no such signal, or there are more than 20 panels.
    """
    columns = {label: run.columns([*signals]) for label, run in runs.items()}
    panels: dict[str, list[str]] = {}
    for name in dict.fromkeys(name for found in columns.values() for name in list(found)[1:]):
        panels.setdefault(_quantity(name), []).append(name)
    remedy = f"give fewer signals, with at most {_MOST_PANELS} quantities in all"
    require(len(panels) <= _MOST_PANELS, "--signal", list(signals), remedy)
    figure, rows = stacked(len(panels))
    for axes, (quantity, names) in zip(rows, panels.items(), strict=True):
        _draw_quantity(axes, quantity, names, columns)
        if any(getattr(run, "stopped", "") for run in runs.values()):
            keep_plausible(axes)
    return legend_above(figure)


def _draw_quantity(
    axes: Axes, quantity: str, names: Sequence[str], columns: dict[str, dict[str, NDArray]]
) -> None:
    """Draws the entries of these names, of all runs that have them, and names the quantity."""
    title, _, unit = quantity.partition(" [")
    values = [found[name] for found in columns.values() for name in names if name in found]
    factor, unit = fitting_unit(unit.removesuffix("]"), *values)
    for run, (label, found) in enumerate(columns.items()):
        first = run * len(names) if len(columns) > len(LINE_STYLES) else 0
        for k, name in enumerate(names, first):
            if name in found:
                entry = name.partition(" [")[0].removeprefix(title).lstrip(".")
                text = " ".join(filter(None, (entry, label if len(columns) > 1 else "")))
                options = {"color": f"C{k}", "label": text or None}
                line = LINE_STYLES[run % len(LINE_STYLES)]
                plot(axes, found["time [s]"], factor * found[name], linestyle=line, **options)
    axes.set_ylabel(f"{title}\n({unit})" if unit else title)


def _quantity(name: str) -> str:
    """Key of a panel: entries of the same part and unit, of all carriers, share it."""
    path, _, unit = name.partition(" [")
    words = path.split(".")
    while len(words) > 1 and (words[-1].isdigit() or words[-1] in "wxyz"):
        words.pop()
    return f"{'.'.join(words)} [{unit}" if unit else ".".join(words)
