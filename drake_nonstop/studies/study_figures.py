"""The figure of a study: a metric over a factor of numbers, or in a row per setting."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from drake_nonstop.run.metrics import Metric
from drake_nonstop.studies.summary import Summary, name_of
from drake_nonstop.view.figure_style import (
    LIMIT,
    LINE_STYLES,
    MOST_NAMED,
    PAGE,
    in_paper_style,
    legend_above,
    single,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ROW, _EDGES = 0.24, 0.5  # inch, of a figure with a row per setting
_LONGEST = 38  # characters of a name for which a column's width has room


@in_paper_style
def make_study_figure(summary: Summary, metric: Metric) -> Figure:
    """The metric's mean with 95 % over seeds: lines over a factor of numbers with bands, or rows.

    Lines are drawn where a factor has three numbers or more in each combination of the others, and
    where these are few.
    """
    for across in reversed(summary.factors):
        levels = {setting.factors[across] for setting in summary.settings}
        count = len(summary.settings) // len(levels)
        is_number = all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in levels)
        if is_number and len(levels) > 2 and count <= MOST_NAMED:
            return _lines(summary, metric, across)
    return _rows(summary, metric)


def _lines(summary: Summary, metric: Metric, across: str) -> Figure:
    """A line for each combination of the other factors, with a band."""
    figure, axes = single(across, metric.heading)
    mean, _, half = _shown(summary, metric)
    lines: dict[str, list[int]] = {}
    for k, setting in enumerate(summary.settings):
        others = {factor: level for factor, level in setting.factors.items() if factor != across}
        lines.setdefault(name_of(others), []).append(k)
    for number, (name, chosen) in enumerate(lines.items()):
        colour, line = f"C{number}", LINE_STYLES[number % len(LINE_STYLES)]
        curve: dict[str, Any] = {"linestyle": line, "marker": "o", "markersize": 3}
        chosen = sorted(chosen, key=lambda k: summary.settings[k].factors[across])
        x = [summary.settings[k].factors[across] for k in chosen]
        axes.plot(x, mean[chosen], color=colour, label=name, **curve)
        low, high = mean[chosen] - half[chosen], mean[chosen] + half[chosen]
        axes.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0)
    axes.margins(x=0.05)
    return legend_above(figure) if len(lines) > 1 else figure


def _rows(summary: Summary, metric: Metric) -> Figure:
    """A row for each setting: the runs as dots, the mean with its interval."""
    names = [setting.name for setting in summary.settings]
    figure, axes = single(metric.heading, "")
    if max(map(len, names)) > _LONGEST:
        figure.set_figwidth(PAGE)
    figure.set_figheight(_EDGES + _ROW * len(names))
    mean, values, half = _shown(summary, metric)
    places = np.arange(len(names))
    if summary.seeds > 1:
        seeds = np.repeat(places, summary.seeds)
        axes.plot(values, seeds, ".", color="0.7", markersize=3, zorder=1)
    half = np.where(np.isnan(half), 0.0, half)
    axes.errorbar(mean, places, xerr=half, fmt="o", markersize=4, color="C0", capsize=2)
    if not np.isnan(mean[0]):
        axes.axvline(mean[0], zorder=0, **LIMIT)
    told = summary.outcomes()
    for place in places[np.isnan(mean)]:
        across = axes.get_yaxis_transform()
        axes.text(0.02, place, told[place], fontsize="small", va="center", transform=across)
    known = mean[np.isfinite(mean)]
    if len(known) > 1 and known.min() > 0 and known.max() > 100 * np.median(known):
        axes.set_xscale("log")
    axes.set_yticks(places, names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.margins(x=0.05)
    return figure


def _shown(summary: Summary, metric: Metric) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The means, the values of all runs, and half of the intervals, in the unit that is shown."""
    tables = summary.statistics["mean"], summary.values, summary.statistics["half"]
    mean, values, half = (metric.scale * each[metric.path].to_numpy() for each in tables)
    return mean, values, half
