"""The figures of one run, the paper's own set, and any signals of any runs over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RollPitchYaw

from drake_nonstop.mechanics.aircraft import stall_speed, thrust_limits
from drake_nonstop.mechanics.lumped_cable import nodes_of
from drake_nonstop.mechanics.signals import CarrierStates, LoadState
from drake_nonstop.simulation.run import Run
from drake_nonstop.simulation.run_quantities import (
    RunQuantities,
    attachment_positions,
    carrier_speeds,
    load_errors,
)
from drake_nonstop.simulation.signal_table import SignalTable, UnknownSignalError
from drake_nonstop.validation import require
from drake_nonstop.visualization.figure_style import (
    COLOURS,
    LINE_STYLES,
    extreme_samples,
    new_figure,
    plot,
    plot_each,
    stacked,
    titled,
)
from drake_nonstop.visualization.task_figures import make_limits_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MOST_PANELS = 20  # of a figure of signals


def make_figure(run: Run, name: str) -> Figure:
    """The figure of that name, one of `figure_names`."""
    return _FIGURES[FIGURE_NAMES.index(name)](run)


def plotted(run: Run, names: Sequence[str]) -> Figure:
    """A figure of the run, or its signals; see `Run.plot`."""
    if len(names) == 1 and names[0] in FIGURE_NAMES:
        has = ", ".join(figure_names(run))
        require(names[0] in figure_names(run), "figure", names[0], f"this run has {has}")
        return make_figure(run, names[0])
    require(len(names) > 0, "names", "none", f"give one of {', '.join(FIGURE_NAMES)}, or signals")
    return make_signal_figure({run.scenario.name: run}, names)


def _draw_load_reference(run: Run) -> Figure:
    references = run.signal("reference")
    shown = extreme_samples(references[:, :13])
    quaternions, positions, _, velocities = LoadState.view(references[shown])
    angles = [RollPitchYaw(Quaternion(q / np.linalg.norm(q))).vector() for q in quaternions]
    figure, panels = stacked(3)
    for axes, values, label, names in (
        (panels[0], positions, "position (m)", "xyz"),
        (panels[1], velocities, "velocity (m/s)", "xyz"),
        (panels[2], np.degrees(angles), "orientation (°)", ("roll", "pitch", "yaw")),
    ):
        for column, name, style in zip(values.T, names, LINE_STYLES, strict=True):
            axes.plot(run.time[shown], column, linestyle=style, label=name)
        axes.set_ylabel(label)
        axes.legend(fontsize="small", loc="upper left")
    return titled(figure, "Desired load trajectory")


def _draw_carrier_paths_from_above(run: Run) -> Figure:
    figure, axes = _single("x (m)", "y (m)")
    _draw_from_above(run, axes, np.arange(len(run.time)))
    return titled(figure, "Carrier and load paths seen from above")


def _draw_carrier_paths_zoomed(run: Run) -> Figure:
    speeds = carrier_speeds(run.signal("carrier_state")).min(axis=1)
    slowest = run.time[np.argmin(speeds)]
    turn = 2 * np.pi / max(abs(run.signal("parameters")[np.argmin(speeds), 0]), 1e-9)
    shown = np.flatnonzero(~(np.abs(run.time - slowest) > turn))  # all, where the turn is NaN
    figure, axes = _single("x (m)", "y (m)")
    _draw_from_above(run, axes, shown)
    start, end = run.time[shown[[0, -1]]]
    return titled(
        figure, f"Around the slowest instant ({slowest:.2f} s), from {start:.1f} to {end:.1f} s"
    )


def _draw_load_position_error(run: Run) -> Figure:
    return _draw_error(run, 1e3 * load_errors(run)[0], "position error (mm)", "Load position error")


def _draw_load_orientation_error(run: Run) -> Figure:
    error = 1e3 * load_errors(run)[1]
    return _draw_error(run, error, "orientation error (mrad)", "Load orientation error")


def _draw_carrier_speeds(run: Run) -> Figure:
    figure, axes = _single("time (s)", "carrier speed (m/s)")
    quantities = RunQuantities(run)
    time, bounds = quantities.time, quantities.speed_bounds
    plot_each(axes, time, quantities.speeds, "carrier")
    plot(axes, time, bounds, color="green", linestyle="--", label="bound ε")
    axes.set_ylim(bottom=0)
    axes.legend(ncols=5, fontsize="small")
    return titled(figure, "Carrier speeds")


def _draw_tensions(run: Run) -> Figure:
    figure, axes = _single("time (s)", "tension (N)")
    plot_each(axes, run.steps["time"], run.steps["tensions"], "cable")
    axes.legend(ncols=4, fontsize="small")
    return titled(figure, "Cable tensions")


def _draw_aircraft(run: Run) -> Figure:
    quantities = RunQuantities(run)
    time, state, aircraft = quantities.time, quantities.aircraft_state, quantities.aircraft
    figure, (lift, bank, thrust, airspeed) = stacked(4)
    for axes, values, label in (
        (lift, state.lift / aircraft.max_lift, "$C_L$ / $C_{L,max}$"),
        (bank, np.degrees(state.bank), "bank (°)"),
        (thrust, state.thrust, "thrust (N)"),
        (airspeed, state.airspeed / stall_speed(aircraft), "airspeed / stall speed"),
    ):
        plot_each(axes, time, values, "aircraft")
        axes.set_ylabel(label)
    for limits in thrust_limits(aircraft, state.airspeed):
        plot_each(thrust, time, limits, linewidth=0.7, linestyle=":")
    for axes in (lift, airspeed):
        axes.axhline(1, color="red", linestyle="--", linewidth=1)
    lift.set_ylim(bottom=0)
    lift.legend(ncols=4, fontsize="small")
    return titled(figure, "Aircraft; dashed: stall, dotted: limits of the thrust")


def _draw_limits(run: Run) -> Figure:
    return make_limits_figure(RunQuantities(run).limits, "Limits of the layer, dashed")


def _draw_internal_force_parameters(run: Run) -> Figure:
    figure, panels = stacked(2)
    labels = "frequency ξ (rad/s)", "amplitude A (N)"
    for axes, values, label in zip(panels, run.signal("parameters").T, labels, strict=True):
        plot(axes, run.time, values)
        axes.set_ylabel(label)
    return titled(figure, "Internal-force parameters")


_FIGURES: tuple[Callable[[Run], Figure], ...] = (
    _draw_load_reference,
    _draw_carrier_paths_from_above,
    _draw_carrier_paths_zoomed,
    _draw_load_position_error,
    _draw_load_orientation_error,
    _draw_carrier_speeds,
    _draw_tensions,
    _draw_aircraft,
    _draw_limits,
    _draw_internal_force_parameters,
)
FIGURE_NAMES = tuple(draw.__name__.removeprefix("_draw_") for draw in _FIGURES)
# Figures that some runs have, and whether a run is one of them.
_SOME: dict[str, Callable[[Run], bool]] = {
    "aircraft": lambda run: RunQuantities(run).has_aircraft,
    "limits": lambda run: bool(RunQuantities(run).limits),
}


def figure_names(run: Run) -> list[str]:
    """The figures that a run has, of `FIGURE_NAMES`."""
    return [name for name in FIGURE_NAMES if name not in _SOME or _SOME[name](run)]


def _draw_from_above(run: Run, axes: Axes, shown: NDArray) -> None:
    """Draws paths over the samples `shown`, with load and cables at the last of them."""
    load_states, carrier_states = (run.signal(name) for name in ("load_state", "carrier_state"))
    load = LoadState.view(load_states[shown]).position
    carriers = CarrierStates.view(carrier_states[shown]).positions
    for i in range(carriers.shape[1]):
        path = carriers[extreme_samples(carriers[:, i, :2]), i, :2]
        colour = COLOURS[i % len(COLOURS)]
        axes.plot(*path.T, color=colour, linewidth=0.9, label=f"carrier {i + 1}")
        axes.plot(*carriers[-1, i, :2], "x", color=colour)
    path = load[extreme_samples(load[:, :2]), :2]
    axes.plot(*path.T, color="black", linewidth=1.2, label="load")
    corners = attachment_positions(run, load_states[shown[-1:]])[0]
    axes.plot(*np.vstack([corners, corners[:1]])[:, :2].T, "--", color="black", linewidth=0.9)
    axes.plot(*load[-1, :2], "+", color="black")
    lines = np.stack([corners, carriers[-1]])
    if RunQuantities(run).has_nodes:
        nodes, _ = nodes_of(run.signal("cable_state")[shown[-1]], len(corners))
        lines = np.concatenate([lines[:1], nodes, lines[1:]])
    axes.plot(lines[..., 0], lines[..., 1], color="black", linewidth=0.7)
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _draw_error(run: Run, error: NDArray, label: str, title: str) -> Figure:
    figure, axes = _single("time (s)", label)
    for column, name in zip(error.T, "xyz", strict=True):
        plot(axes, run.time, column, label=name)
    plot(axes, run.time, np.linalg.norm(error, axis=1), color="black", label="norm")
    axes.legend(ncols=4, fontsize="small")
    return titled(figure, title)


def _single(across: str, up: str) -> tuple[Figure, Axes]:
    figure = new_figure((7.0, 4.2))
    axes = figure.subplots()
    axes.set_xlabel(across)
    axes.set_ylabel(up)
    return figure, axes


def make_signal_figure(runs: Mapping[str, SignalTable], signals: Sequence[str]) -> Figure:
    """A panel for each quantity of the signals.

    Each entry has a colour and each run a line style; where there are more runs than line styles
    each line has a colour and style that no other one has.

    Args:
        runs: by what they are called in the legend.
        signals: as of `SignalTable.columns`.

    Raises:
        ScenarioError: no run has such a signal, there are more than 20 panels, or more lines of
            more than three runs in a panel than can be told apart, 36.
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
    are_few = len(runs) <= len(LINE_STYLES)
    most = max(map(len, panels.values())) * len(runs)
    kinds = len(COLOURS) * len(LINE_STYLES)
    remedy = f"at most {kinds} in a panel can be told apart: give fewer runs, or single entries"
    require(are_few or most <= kinds, "--signal", f"{most} lines of {len(runs)} runs", remedy)
    figure, rows = stacked(len(panels), width=8.0)
    for axes, (quantity, names) in zip(rows, panels.items(), strict=True):
        for number, (label, found) in enumerate(columns.items()):
            for k, name in enumerate(names):
                if name not in found:
                    continue
                entry = name.partition(" [")[0].removeprefix(quantity.partition(" [")[0])
                text = " ".join(filter(None, (entry.lstrip("."), label if len(runs) > 1 else "")))
                colour, style = k, number
                if not are_few:
                    style, colour = divmod(number * len(names) + k, len(COLOURS))
                plot(
                    axes,
                    found["time [s]"],
                    found[name],
                    color=COLOURS[colour % len(COLOURS)],
                    linestyle=LINE_STYLES[style % len(LINE_STYLES)],
                    label=text or None,
                )
        axes.set_ylabel(quantity.replace(" [", "\n["), fontsize="small")
        axes.grid(alpha=0.3)
        if axes.get_legend_handles_labels()[1]:
            in_columns = 1 + (len(axes.lines) - 1) // 12
            beside = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5)}
            axes.legend(**beside, fontsize="x-small", ncols=in_columns)
    rows[-1].set_xlabel("time [s]")
    return figure


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
