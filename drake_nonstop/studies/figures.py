"""Figures that compare runs: margins, errors, variants, drawn values and patterns."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.separations import closest_cables, closest_carriers
from drake_nonstop.mechanics.signals import CarrierStates
from drake_nonstop.simulation.run import Run
from drake_nonstop.simulation.run_quantities import attachment_positions
from drake_nonstop.studies.robustness import POSITION_ERROR_MEAN, Case
from drake_nonstop.studies.stability_ranges import Margin
from drake_nonstop.visualization.figure_style import COLOURS, LINE_STYLES, new_figure, titled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def make_margins_figure(title: str, margins: Sequence[Margin]) -> Figure:
    """The growth rate of the loop's least stable mode over each parameter; stable below 0.

    Values with which there is no such loop are dashed.
    """
    figure = new_figure((2.6 * len(margins), 3.4))
    for margin, axes in zip(margins, figure.subplots(1, len(margins), sharey=True), strict=True):
        axes.axhline(0, color="0.6", linewidth=0.8)
        axes.axvline(margin.nominal, color="0.6", linestyle=":")
        first, *_, last = sorted([*margin.values, *margin.refused])
        low, high = (margin.values or [first])[0], (margin.values or [last])[-1]
        low = low if margin.low is None else margin.low
        high = high if margin.high is None else margin.high
        axes.axvspan(low, high, color="#18a048", alpha=0.15, linewidth=0)
        axes.plot(margin.values, margin.rates, "o-", markersize=3, color="C0")
        for value in margin.refused:
            axes.axvline(value, color="0.3", linestyle="--", linewidth=0.8)
        if first > 0:
            axes.set_xscale("log")
            ticks = [first, margin.nominal, last]
            axes.set_xticks(ticks, [f"{tick:.3g}" for tick in ticks])
            axes.minorticks_off()
        axes.set_yscale("symlog", linthresh=0.1)
        axes.set_xlabel(f"{margin.name} ({margin.unit})")
    figure.axes[0].set_ylabel("growth of the least stable mode (1/s)")
    figure.suptitle(title)
    return figure


def make_robustness_figure(title: str, cases: Sequence[Case]) -> Figure:
    """Position error and speed margin over the size of each error, a column per error."""
    names = list(dict.fromkeys(case.error for case in cases if case.unit))
    figure = new_figure((2.1 * len(names), 5.0))
    axes = figure.subplots(2, len(names), sharey="row", squeeze=False)
    for name, (top, bottom) in zip(names, axes.T, strict=True):
        shown = sorted((c for c in cases if c.error in ("none", name)), key=lambda c: c.level)
        levels = [case.level for case in shown]
        errors = [case.shown(POSITION_ERROR_MEAN) for case in shown]
        top.plot(levels, errors, "o-", markersize=3)
        bottom.plot(levels, [case.speed_margin for case in shown], "o-", markersize=3)
        bottom.axhline(0, color="green", linestyle="--")
        top.set_title(name, fontsize="medium")
        unit = next(case.unit for case in cases if case.error == name)
        bottom.set_xlabel(unit.split(" (")[0])
    axes[0, 0].set_ylabel(POSITION_ERROR_MEAN.heading)
    axes[1, 0].set_ylabel("slowest speed − ε (m/s)")
    axes[0, 0].set_yscale("log")
    figure.suptitle(title)
    return figure


def make_overlay_figure(
    title: str,
    label: str,
    curves: Mapping[str, tuple[NDArray, NDArray]],
    *,
    framed: Collection[str],
    bound: tuple[NDArray, NDArray] | None = None,
    is_logarithmic: bool = False,
) -> Figure:
    """The same quantity in several runs: the first black and thick, the others above it.

    Curves are times (k,) in s and values (k,) by the run's name, and so is a bound; `framed` names
    the runs that set the limits of the vertical axis, which is logarithmic only where no value is
    negative.
    """
    figure = new_figure((9.0, 4.2))
    axes = figure.subplots()
    for i, (name, (times, values)) in enumerate(curves.items()):
        style: dict[str, Any] = {"color": "black", "linewidth": 3, "zorder": 2}
        if i > 0:
            number, colour = divmod(i - 1, len(COLOURS))
            line = LINE_STYLES[number % len(LINE_STYLES)]
            style = {"color": COLOURS[colour], "linestyle": line, "linewidth": 1.2}
            style["zorder"] = 3 + 1 / i
        axes.plot(times, values, label=name, **style)
    if bound is not None:
        axes.plot(*bound, color="green", linestyle="--", linewidth=1.5, label="bound ε", zorder=9)
    shown = [values for name, (_, values) in curves.items() if name in framed]
    lowest, highest = min(map(np.min, shown)), max(map(np.max, shown))
    if is_logarithmic and highest > 0:
        least = min(map(np.median, shown))
        axes.set_yscale("log")
        axes.set_ylim(max(least / 5, 1e-6 * highest), 1.5 * highest)
    else:
        axes.set_ylim(min(0.0, lowest), 1.05 * max(highest, 1e-9))
    axes.set_xlim(0, max(times[-1] for times, _ in curves.values()))
    axes.set_xlabel("time (s)")
    axes.set_ylabel(label)
    figure.legend(loc="outside right upper", fontsize="small", frameon=False)
    return titled(figure, title)


def make_success_figure(
    title: str,
    succeeded: NDArray,
    *,
    across: tuple[str, NDArray],
    up: tuple[str, NDArray],
    panels: tuple[str, NDArray],
    bins: int = 5,
) -> Figure:
    """The share of runs that succeeded over two drawn values, a panel for each value of a third.

    There are a label and values (runs,) each: of the horizontal and the vertical axis, which are
    put into bins, and of the panels. `succeeded` (runs,) says it of each run.
    """
    levels = np.unique(panels[1])
    figure = new_figure((2.6 * len(levels) + 1.4, 3.6))
    edges = [np.linspace(values.min(), values.max(), bins + 1) for _, values in (across, up)]
    all_axes = figure.subplots(1, len(levels), sharey=True, squeeze=False)[0]
    for axes, level in zip(all_axes, levels, strict=True):
        chosen = panels[1] == level
        counts, hits = (
            np.histogram2d(across[1][which], up[1][which], bins=edges)[0].T
            for which in (chosen, chosen & succeeded)
        )
        shares = np.ma.masked_array(hits / np.maximum(counts, 1), counts == 0)
        shown = axes.pcolormesh(*edges, shares, cmap="viridis", vmin=0, vmax=1)
        columns, rows = ((edge[:-1] + edge[1:]) / 2 for edge in edges)
        style = {"ha": "center", "va": "center", "fontsize": "xx-small"}
        for i, j in np.argwhere(counts > 0):
            text = f"{shares[i, j]:.0%}\nof {counts[i, j]:.0f}"
            colour = "black" if shares[i, j] > 0.6 else "white"
            axes.text(columns[j], rows[i], text, color=colour, **style)
        axes.set_title(f"{panels[0]}: {level:g}", fontsize="medium")
        axes.set_xlabel(across[0], fontsize="small")
    all_axes[0].set_ylabel(up[0], fontsize="small")
    figure.colorbar(shown, ax=list(all_axes), label="share that succeeded")
    figure.suptitle(title)
    return figure


def make_encounters_figure(runs: dict[str, Run]) -> Figure:
    """Orbits above a resting load, and least distances of carriers and of cables, over time.

    There is a column for each of `runs`, which are given by their titles. Cables are drawn at the
    instant at which two of them, or two carriers, are closest.
    """
    figure = new_figure((3.6 * len(runs), 5.6))
    grid = figure.add_gridspec(2, len(runs), height_ratios=[1.3, 1])
    for k, (title, run) in enumerate(runs.items()):
        carriers = CarrierStates.view(run.signal("carrier_state")).positions
        ends = attachment_positions(run, run.signal("load_state"))
        closest = closest_carriers(carriers), closest_cables(ends, carriers)
        instant = int(np.argmin(np.minimum(*closest)))
        axes: Axes = figure.add_subplot(grid[0, k], projection="3d")
        for i in range(carriers.shape[1]):
            axes.plot(*carriers[:, i].T, color=f"C{i}", linewidth=1)
            cable = np.stack([ends[instant, i], carriers[instant, i]])
            axes.plot(*cable.T, color="black", linewidth=0.7)
            axes.plot(*carriers[instant, i], "o", color=f"C{i}", markersize=5)
        axes.set_aspect("equal")
        axes.set_box_aspect(None, zoom=1.25)
        axes.set_title(title, fontsize="medium")
        axes.set_zlabel("z (m)", fontsize="x-small", labelpad=-4)
        axes.view_init(elev=22, azim=-60)
        axes.tick_params(labelsize="x-small")
        axes.locator_params(nbins=4)
        lower = figure.add_subplot(grid[1, k])
        for distances, name, colour in zip(
            closest, ("carriers", "cables"), ("C0", "C1"), strict=True
        ):
            shown = np.maximum(distances, 1e-3)  # m: a logarithmic axis has no zero
            lower.semilogy(run.time, shown, label=name, color=colour, linewidth=1.2)
        lower.set_ylim(1e-3, 200)
        lower.set_xlabel("time (s)")
        lower.grid(alpha=0.3)
        if k == 0:
            lower.set_ylabel("closest two (m)")
            lower.legend(fontsize="small")
    return figure
