"""The figure of a study: a metric over a factor of numbers, or in a row per setting."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.run.metrics import Metric
from drake_nonstop.studies.summary import Summary, interval, name_of
from drake_nonstop.view.figure_style import (
    LIMIT,
    LINE_STYLES,
    MOST_NAMED,
    in_paper_style,
    legend_above,
    new_figure,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ROW, _EDGES = 0.24, 1.0  # inch, of a figure with a row per setting


@in_paper_style
def make_study_figure(summary: Summary, metric: Metric) -> Figure:
    """The metric's mean with 95 % over seeds: lines over a factor of numbers with bands, or rows.

    Lines are drawn where a factor has three numbers or more in each combination of the others.
    """
    values = summary.values(metric.path) * metric.quantity.scale
    across = _axis(summary)
    if across is not None:
        return _lines(summary, metric, values, across)
    return _rows(summary, metric, values)


def _axis(summary: Summary) -> str | None:
    """The last factor that lines are drawn over; None: there is none."""
    for name in reversed(summary.factors):
        levels = [setting.factors.get(name) for setting in summary.settings]
        is_number = all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in levels)
        lines = _groups(summary, name).values()
        are_whole = {len(line) for line in lines} == {len({*map(str, levels)})}
        if is_number and are_whole and len(levels) > 2 * len(lines) and len(lines) <= MOST_NAMED:
            return name
    return None


def _groups(summary: Summary, across: str) -> dict[str, list[int]]:
    """The settings of each line, by the levels of the other factors."""
    groups: dict[str, list[int]] = {}
    for k, setting in enumerate(summary.settings):
        others = {name: v for name, v in setting.factors.items() if name != across}
        groups.setdefault(name_of(others), []).append(k)
    return groups


def _lines(summary: Summary, metric: Metric, values: NDArray, across: str) -> Figure:
    """A line for each combination of the other factors, with a band."""
    figure = new_figure((5.2, 3.6))
    axes = figure.subplots()
    mean, _, half = interval(values)
    styles = itertools.product(LINE_STYLES, map("C{}".format, range(MOST_NAMED)))
    for (others, chosen), (line, colour) in zip(
        _groups(summary, across).items(), styles, strict=False
    ):
        chosen = sorted(chosen, key=lambda k: summary.settings[k].factors[across])
        x = [summary.settings[k].factors[across] for k in chosen]
        style = {"color": colour, "linestyle": line, "marker": "o", "markersize": 3}
        axes.plot(x, mean[chosen], label=others, **style)
        low, high = mean[chosen] - half[chosen], mean[chosen] + half[chosen]
        axes.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0)
    axes.margins(x=0.05)
    axes.set(xlabel=across, ylabel=metric.heading)
    return legend_above(figure) if len(_groups(summary, across)) > 1 else figure


def _rows(summary: Summary, metric: Metric, values: NDArray) -> Figure:
    """A row for each setting: the runs as dots, the mean with its interval."""
    names = [setting.name for setting in summary.settings]
    width = 3.6 + 0.075 * max(map(len, names))
    figure = new_figure((width, _EDGES + _ROW * len(names)))
    axes = figure.subplots()
    mean, _, half = interval(values)
    places = np.arange(len(names))
    seeds = np.repeat(places, values.shape[1]).reshape(values.shape)
    if values.shape[1] > 1:
        axes.plot(values.ravel(), seeds.ravel(), ".", color="0.7", markersize=3, zorder=1)
    half = np.where(np.isnan(half), 0.0, half)
    axes.errorbar(mean, places, xerr=half, fmt="o", markersize=4, color="C0", capsize=2)
    if not np.isnan(mean[0]):
        axes.axvline(mean[0], zorder=0, **LIMIT)
    for place in places[np.isnan(mean)]:
        told = summary.outcome(int(place))
        about = {"transform": axes.get_yaxis_transform(), "va": "center", "color": "black"}
        axes.text(0.02, place, told, fontsize="small", **about)
    known = mean[np.isfinite(mean)]
    if len(known) > 1 and known.min() > 0 and known.max() > 100 * np.median(known):
        axes.set_xscale("log")
    axes.set_yticks(places, names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.margins(x=0.05)
    axes.set_xlabel(metric.heading)
    return figure
