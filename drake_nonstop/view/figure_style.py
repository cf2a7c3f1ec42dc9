"""What all figures share: size, units, panels, curves and legends.

Matplotlib is imported with the first figure: its import takes as long as all others together,
and runs without figures do not need it.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Made = TypeVar("Made", bound=Callable[..., Any])

LIMIT: dict[str, Any] = {"color": "black", "linestyle": "--", "linewidth": 1.0}  # how it is drawn
THRUST_RANGE = "least and largest thrust (below 0 the propeller brakes)"  # of a legend
LINE_STYLES = ("solid", (0, (5, 4)), (0, (1, 2)))  # of coinciding curves, so that all are seen
MOST_POINTS = 20_000  # of a curve
MOST_NAMED = 12  # curves of carriers in a legend: that many colours, C0 to C11, are different
FORMATS = ("png", "pdf", "svg")  # of files with figures
PAGE = 7.16  # inch, of two columns of a paper (IEEE); the style has the width of one
_STACKED = 0.55  # of a single panel's height, that of each of several
_LOWEST, _TALLEST = 0.6, 1.5  # of a single panel's height, that of one with a slope
_LABELS = 0.3  # inch, the height of labels below a panel
_USUAL_SHARE, _PLAUSIBLE = 0.8, 10  # of a run's values; of their deviation from the median
_PREFIXES = ((0, ""), (3, "m"), (6, "µ"), (9, "n"))  # of SI units, by the digits that they move
_PREFIXED = re.compile(r"(m|rad|N|s|W|V|Pa|J)(?!\w)")  # units that they stand before


def in_paper_style(make: Made) -> Made:
    """The function, whose figures are made in the paper's style."""

    @functools.wraps(make)
    def made(*arguments: Any, **options: Any) -> Any:
        from drake_nonstop.view.paper_figure import paper_style

        with paper_style():
            return make(*arguments, **options)

    return made  # type: ignore[return-value]


@in_paper_style
def new_figure(size: tuple[float, float]) -> Figure:
    """An empty figure of that size in inch."""
    from drake_nonstop.view.paper_figure import PaperFigure

    return PaperFigure(figsize=size, layout="constrained")


def stacked(count: int) -> tuple[Figure, list[Axes]]:
    """A figure of a column's width, with panels over one time axis."""
    from matplotlib import rcParams

    width, height = rcParams["figure.figsize"]
    figure = new_figure((width, height * max(1.0, _STACKED * count)))
    panels = [*figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]]
    panels[-1].set_xlabel("time (s)")
    return figure, panels


def single(across: str, up: str, slope: float | None = None) -> tuple[Figure, Axes]:
    """A figure with one panel and its labels, with `slope` as high as what it shows.

    `slope` is the height of that over its width; None: the figure has the style's size.
    """
    figure, (axes,) = stacked(1)
    if slope is not None:
        width, height = figure.get_size_inches()
        figure.set_figheight(np.clip(width * slope + _LABELS, _LOWEST * height, _TALLEST * height))
    axes.set(xlabel=across, ylabel=up)
    return figure, axes


def fitting_unit(unit: str, *values: ArrayLike) -> tuple[float, str]:
    """The unit in which the largest of the values, in SI units, is 0.1 or more, if it can be.

    It comes after the factor to multiply the values by: (1e6, "µm").
    """
    sizes = np.abs(np.concatenate([np.ravel(each) for each in values]))
    largest = np.max(sizes[np.isfinite(sizes)], initial=0.0)
    for digits, prefix in _PREFIXES if _PREFIXED.match(unit) else ():
        if largest >= 0.1 * 10.0**-digits:
            return 10.0**digits, prefix + unit
    return 1.0, unit


def legend_above(figure: Figure, title: str | None = None) -> Figure:
    """The figure, grown by a title and a legend above its panels, which cover nothing."""
    named: dict[str, Any] = {}
    for axes in figure.axes:
        named |= dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    place: dict[str, Any] = {"loc": "outside upper center", "borderaxespad": 0, "title": title}
    for rows in range(1, 1 + len(named)):  # until it fits into the width
        columns = math.ceil(len(named) / rows)
        legend = figure.legend(named.values(), named.keys(), ncols=columns, **place)
        box = legend.get_window_extent()
        if box.width < figure.bbox.width or columns == 1:
            figure.set_figheight(figure.get_figheight() + box.height / figure.dpi)
            break
        legend.remove()
    return figure


def plausible_range(values: NDArray, least: ArrayLike = 0.0) -> tuple[NDArray, NDArray]:
    """The ends of the plausible values of each column, for a run that diverged.

    They are ten times as far from the median as four fifths of the values, or `least`.
    """
    middle = np.median(values, axis=0)
    usual = np.quantile(np.abs(values - middle), _USUAL_SHARE, axis=0)
    reach = np.maximum(_PLAUSIBLE * usual, least)
    return middle - reach, middle + reach


def keep_plausible(axes: Axes, least: float = 0.0) -> None:
    """Cuts off values that would hide all others, with a mark that has the farthest of them."""
    lines = [line for line in axes.lines if len(line.get_xdata()) > 2]  # not those of limits
    points = np.concatenate([np.zeros((0, 2)), *(line.get_xydata() for line in lines)])
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) == 0:
        return
    values = points[:, 1]
    low, high = plausible_range(values, max(least, abs(np.median(values))))
    shown = values[(low <= values) & (values <= high)]
    if len(shown) == len(values):
        return
    room = 0.05 * np.ptp(shown)
    axes.set_ylim(max(low, shown.min() - room), min(high, shown.max() + room))
    for farthest, is_above in ((np.argmin(values), False), (np.argmax(values), True)):
        if not low <= values[farthest] <= high:
            place = points[farthest, 0], axes.get_ylim()[is_above]
            axes.plot(*place, "^" if is_above else "v", color="black", clip_on=False, zorder=5)
            text: dict[str, Any] = {"ha": "right", "va": "top" if is_above else "bottom"}
            text["bbox"] = {"facecolor": "white", "edgecolor": "none", "pad": 1}
            text |= {"textcoords": "offset points", "xytext": (-6, -3 if is_above else 3)}
            axes.annotate(f"to {values[farthest]:.2g}", place, **text)


def plot(axes: Axes, x: ArrayLike, values: ArrayLike, **options: Any) -> None:
    """Plots a curve with its lowest and highest values, however long it is."""
    x, values = np.asarray(x), np.asarray(values)
    shown = extreme_samples(values)
    axes.plot(x[shown], values[shown], **options)


def plot_each(axes: Axes, x: ArrayLike, values: NDArray, name: str = "", **options: Any) -> None:
    """Plots a curve per column; those of the second half dashed, as symmetric ones coincide.

    The first twelve have the name and a number in the legend.
    """
    for i, column in enumerate(values.T):
        style = LINE_STYLES[i >= values.shape[1] / 2]
        label = f"{name} {i + 1}" if name and i < MOST_NAMED else None
        plot(axes, x, column, **{"color": f"C{i}", "linestyle": style, "label": label} | options)


def extreme_samples(values: NDArray, most: int = MOST_POINTS) -> NDArray:
    """Indices, in order, of at most `most` samples of a curve that look like all of them.

    Where there are more, they are the first, the last, and the lowest and highest of each
    column in every stretch of the curve. A sample that is not a number counts as both.

    Args:
        values: (k,), or (k, columns) of a curve in more than one dimension.
        most: at least 2 + 4 columns.
    """
    count = len(values)
    if count <= most:
        return np.arange(count)
    columns = values.reshape(count, -1)
    parts = (most - 2) // (2 * columns.shape[1])
    edges = np.linspace(0, count, parts + 1).astype(int)
    chosen = [
        start + extreme(columns[start:end], axis=0)
        for start, end in pairwise(edges)
        for extreme in (np.argmin, np.argmax)
    ]
    return np.unique(np.concatenate([[0, count - 1], *chosen]))
