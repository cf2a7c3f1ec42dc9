"""The figures of one run, the paper's own set, and any signals of any runs over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RollPitchYaw

from drake_nonstop.mechanics.aircraft import stall_speed, thrust_limits
from drake_nonstop.mechanics.signals import LoadState
from drake_nonstop.run.run import Run
from drake_nonstop.run.run_quantities import RunQuantities, load_errors
from drake_nonstop.run.signal_table import SignalTable, UnknownSignalError
from drake_nonstop.validation import require
from drake_nonstop.view.figure_style import (
    LINE_STYLES,
    FigureLook,
    colours,
    extreme_samples,
    fitting_unit,
    ink,
    legend_above,
    limit_style,
    plot,
    plot_each,
    single,
    stacked,
)
from drake_nonstop.view.path_figures import (
    draw_carrier_paths_from_above,
    draw_carrier_paths_zoomed,
    draw_snapshots,
)
from drake_nonstop.view.task_figures import make_limits_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_PANELS = 20  # of a figure of signals
_LOOK = FigureLook()


def make_figure(run: Run, name: str, look: FigureLook = _LOOK) -> Figure:
    """The figure of that name, one of `figure_names`.

    Raises:
        ScenarioError: there is no such style or width.
    """
    with look.applied():
        return _FIGURES[FIGURE_NAMES.index(name)](run)


def plotted(run: Run, names: Sequence[str], look: FigureLook) -> Figure:
    """A figure of the run, or its signals; see `Run.plot`."""
    if len(names) == 1 and names[0] in FIGURE_NAMES:
        has = ", ".join(figure_names(run))
        require(names[0] in figure_names(run), "figure", names[0], f"this run has {has}")
        return make_figure(run, names[0], look)
    require(len(names) > 0, "names", "none", f"give one of {', '.join(FIGURE_NAMES)}, or signals")
    return make_signal_figure({run.scenario.name: run}, names, look)


def _draw_load_reference(run: Run) -> Figure:
    references = run.signal("reference")
    shown = extreme_samples(references[:, :13])
    quaternions, positions, _, velocities = LoadState.view(references[shown])
    angles = [RollPitchYaw(Quaternion(q / np.linalg.norm(q))).vector() for q in quaternions]
    figure, panels = stacked(3)
    for axes, values, label, unit in (
        (panels[0], positions, "position", "m"),
        (panels[1], velocities, "velocity", "m/s"),
        (panels[2], np.degrees(angles), "attitude", "°"),
    ):
        factor, fitting = fitting_unit(unit, values)
        names = "x, roll", "y, pitch", "z, yaw"
        for column, name, style in zip(values.T, names, LINE_STYLES, strict=True):
            axes.plot(run.time[shown], factor * column, linestyle=style, label=name)
        axes.set_ylabel(f"{label} ({fitting})")
    return legend_above(figure)


def _draw_load_position_error(run: Run) -> Figure:
    return _draw_error(run, load_errors(run)[0], "position error", "m")


def _draw_load_orientation_error(run: Run) -> Figure:
    return _draw_error(run, load_errors(run)[1], "orientation error", "rad")


def _draw_carrier_speeds(run: Run) -> Figure:
    figure, axes = single("time (s)", "carrier speed (m/s)")
    quantities = RunQuantities(run)
    time, bounds = quantities.time, quantities.speed_bounds
    plot_each(axes, time, quantities.speeds, "carrier")
    plot(axes, time, bounds, **limit_style(), label=r"bound $\varepsilon$")
    axes.set_ylim(bottom=0)
    return legend_above(figure)


def _draw_tensions(run: Run) -> Figure:
    factor, unit = fitting_unit("N", run.steps["tensions"])
    figure, axes = single("time (s)", f"tension ({unit})")
    plot_each(axes, run.steps["time"], factor * run.steps["tensions"], "cable")
    return legend_above(figure)


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
    for axes in (lift, airspeed):
        axes.axhline(1, **limit_style())
    lift.set_ylim(bottom=0)
    return legend_above(figure)


def _draw_limits(run: Run) -> Figure:
    return make_limits_figure(RunQuantities(run).limits)


def _draw_internal_force_parameters(run: Run) -> Figure:
    figure, panels = stacked(2)
    labels = r"frequency $\xi$ (rad/s)", "amplitude $A$ (N)"
    for axes, values, label in zip(panels, run.signal("parameters").T, labels, strict=True):
        plot(axes, run.time, values)
        axes.set_ylabel(label)
    return figure


_FIGURES: tuple[Callable[[Run], Figure], ...] = (
    _draw_load_reference,
    draw_carrier_paths_from_above,
    draw_carrier_paths_zoomed,
    _draw_load_position_error,
    _draw_load_orientation_error,
    _draw_carrier_speeds,
    _draw_tensions,
    _draw_aircraft,
    _draw_limits,
    _draw_internal_force_parameters,
    draw_snapshots,
)
FIGURE_NAMES = tuple(draw.__name__.partition("draw_")[2] for draw in _FIGURES)
# Figures that some runs have, and whether a run is one of them.
_SOME: dict[str, Callable[[Run], bool]] = {
    "aircraft": lambda run: RunQuantities(run).has_aircraft,
    "limits": lambda run: bool(RunQuantities(run).limits),
}


def figure_names(run: Run) -> list[str]:
    """The figures that a run has, of `FIGURE_NAMES`."""
    return [name for name in FIGURE_NAMES if name not in _SOME or _SOME[name](run)]


def _draw_error(run: Run, error: NDArray, name: str, unit: str) -> Figure:
    norm = np.linalg.norm(error, axis=1)
    factor, unit = fitting_unit(unit, norm)
    figure, axes = single("time (s)", f"{name} ({unit})")
    for column, label in zip(error.T, "xyz", strict=True):
        plot(axes, run.time, factor * column, label=label)
    plot(axes, run.time, factor * norm, color=ink(), label="norm")
    return legend_above(figure)


def make_signal_figure(
    runs: Mapping[str, SignalTable], signals: Sequence[str], look: FigureLook = _LOOK
) -> Figure:
    """A panel for each quantity of the signals.

    Each entry has a colour and each run a line style; where there are more runs than line styles
    each line has a colour and style that no other one has.

    Args:
        runs: by what they are called in the legend.
        signals: as of `SignalTable.columns`.
        look: style and width.

    Raises:
        ScenarioError: no run has such a signal, there are more than 20 panels, or more lines of
            more than three runs in a panel than can be told apart, 36; or as of `make_figure`.
    """
    columns = _columns(runs, signals)
    panels: dict[str, list[str]] = {}
    for found in columns.values():
        for name in list(found)[1:]:
            entries = panels.setdefault(_quantity(name), [])
            if name not in entries:
                entries.append(name)
    remedy = f"give fewer signals, with at most {_MOST_PANELS} quantities in all"
    require(len(panels) <= _MOST_PANELS, "--signal", list(signals), remedy)
    with look.applied():
        figure, rows = stacked(len(panels))
        for axes, (quantity, names) in zip(rows, panels.items(), strict=True):
            _draw_quantity(axes, quantity, names, columns)
        labels = {tuple(axes.get_legend_handles_labels()[1]) for axes in rows}
        for axes in [None] if len(labels) == 1 else rows:
            legend_above(figure, axes)
    return figure


def _draw_quantity(
    axes: Axes, quantity: str, names: Sequence[str], columns: dict[str, dict[str, NDArray]]
) -> None:
    """Draws the entries of these names, of all runs that have them, and names the quantity."""
    palette = colours()
    are_few = len(columns) <= len(LINE_STYLES)
    most, kinds = len(names) * len(columns), len(palette) * len(LINE_STYLES)
    remedy = f"at most {kinds} in a panel can be told apart: give fewer runs, or single entries"
    require(are_few or most <= kinds, "--signal", f"{most} lines of {len(columns)} runs", remedy)
    title, _, unit = quantity.partition(" [")
    values = [found[name] for found in columns.values() for name in names if name in found]
    factor, unit = fitting_unit(unit.removesuffix("]"), *values)
    for number, (label, found) in enumerate(columns.items()):
        for k, name in enumerate(names):
            if name not in found:
                continue
            entry = name.partition(" [")[0].removeprefix(title)
            text = " ".join(filter(None, (entry.lstrip("."), label if len(columns) > 1 else "")))
            apart = divmod(number * len(names) + k, len(palette))
            style, colour = (number, k) if are_few else apart
            line = LINE_STYLES[style % len(LINE_STYLES)]
            options = {"color": palette[colour % len(palette)], "linestyle": line}
            plot(axes, found["time [s]"], factor * found[name], label=text or None, **options)
    axes.set_ylabel(f"{title}\n({unit})" if unit else title)


def _columns(
    runs: Mapping[str, SignalTable], signals: Sequence[str]
) -> dict[str, dict[str, NDArray]]:
    """Of each run the time and the columns of those signals that it has.

    Raises:
        UnknownSignalError: no run has one of the signals.
    """
    found = {label: {"time [s]": run.time} for label, run in runs.items()}
    for signal in signals:
        refusals = []
        for label, run in runs.items():
            try:
                found[label] |= run.columns([signal])
            except UnknownSignalError as error:
                refusals.append(error)
        if refusals and len(refusals) == len(runs):
            raise refusals[0]
    return found


def _quantity(name: str) -> str:
    """Key of a panel: entries of the same part and unit, of all carriers, share it."""
    path, _, unit = name.partition(" [")
    words = path.split(".")
    while len(words) > 1 and (words[-1].isdigit() or words[-1] in "wxyz"):
        words.pop()
    return f"{'.'.join(words)} [{unit}" if unit else ".".join(words)
