"""Figures that compare runs: margins, errors and variants."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.studies.robustness import POSITION_ERROR_MEAN, Case
from drake_nonstop.studies.stability_ranges import Margin
from drake_nonstop.view.figure_style import COLOURS, LINE_STYLES, new_figure, titled

if TYPE_CHECKING:
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
