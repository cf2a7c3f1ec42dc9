"""Style of all figures: style sheet, size, units, panels, curves, colours, legend, title and grid.

Matplotlib is imported with the first figure: its import takes as long as all others together,
and runs without figures do not need it.
"""

from __future__ import annotations

import functools
import math
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drake_nonstop.validation import require

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (  # Okabe and Ito's, which the colour-blind can tell apart, and four darker ones
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"),
    *("#7f5f3f", "#882255", "#117733", "#332288", "#999933", "#888888"),
)
LINE_STYLES = ("solid", (0, (5, 4)), (0, (1, 2)))  # of coinciding curves, so that all are seen
MOST_POINTS = 20_000  # of a curve
MOST_NAMED = 12  # curves of carriers in a legend: that many colours are different
FORMATS = ("png", "pdf", "svg")  # of files with figures
WIDTHS = {"single": 3.5, "double": 7.16}  # inch, of a column of a paper (IEEE), and of two
_SHEET = "drake_nonstop.view.paper"  # as Matplotlib names paper.mplstyle
_STACKED = 0.55  # of a single panel's height, that of each of several
_LOWEST, _TALLEST = 0.6, 1.5  # of a single panel's height, that of one with a slope
_LABELS = 0.3  # inch, the height of labels below a panel
_PREFIXES = ((0, ""), (3, "m"), (6, "µ"), (9, "n"))  # of SI units, by the digits that they move
_PREFIXED = re.compile(r"(m|rad|N|s|W|V|Pa|J)(?!\w)")  # units that they stand before


class FigureLook(NamedTuple):
    """Looks of a run's figures, as of `Run.plot`."""

    style: str | Path | None = None
    width: str | None = None

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Has figures made within look like this, whatever Matplotlib is set to outside.

        Raises:
            ScenarioError: there is no such style or width.
        """
        require_drawing()
        import matplotlib
        import matplotlib.style

        is_width = self.width is None or (isinstance(self.width, str) and self.width in WIDTHS)
        require(is_width, "width", self.width, f"give {' or '.join(WIDTHS)}")
        with matplotlib.rc_context():
            try:
                dict.update(matplotlib.rcParams, _sheet())
                matplotlib.style.use(self.style or {})
            except (OSError, TypeError, ValueError):
                remedy = "give a file or one of `matplotlib.style.available`, such as ggplot"
                require(False, "style", self.style, remedy)
            remedy = "its text.usetex needs LaTeX: install it, or give a style without that"
            has_text = not matplotlib.rcParams["text.usetex"] or shutil.which("latex")
            require(bool(has_text), "style", self.style, remedy)
            width, height = matplotlib.rcParams["figure.figsize"]
            matplotlib.rcParams["figure.figsize"] = WIDTHS.get(self.width or "", width), height
            yield


@functools.cache
def _sheet() -> dict[str, Any]:
    """The settings of Matplotlib's default style with paper.mplstyle over them."""
    import matplotlib.style

    with matplotlib.rc_context():
        matplotlib.style.use(["default", _SHEET])
        settings = dict(matplotlib.rcParams.copy())
    del settings["backend"]
    return settings


def require_drawing() -> None:
    """Raises ScenarioError where Matplotlib is not imported with the backend that is set."""
    backend = os.environ.get("MPLBACKEND")
    if backend:
        try:
            import matplotlib  # noqa: F401
        except ValueError:
            remedy = "give a backend of Matplotlib, such as agg, or unset the variable"
            require(False, "MPLBACKEND", backend, remedy)


def new_figure(size: tuple[float, float]) -> Figure:
    """An empty figure of that size in inch, which keeps the style that it is made in."""
    require_drawing()
    from drake_nonstop.view.styled_figure import StyledFigure

    return StyledFigure(figsize=size, layout="constrained", dpi=150)


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


def stacked(count: int) -> tuple[Figure, list[Axes]]:
    """A figure with panels over one time axis, as wide as the style has it."""
    from matplotlib import rcParams

    width, height = rcParams["figure.figsize"]
    figure = new_figure((width, height * max(1.0, _STACKED * count)))
    panels = [*figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]]
    panels[-1].set_xlabel("time (s)")
    return figure, panels


def colours() -> list[str]:
    """The style's colours, which curves have in turn; COLOURS in place of Matplotlib's default."""
    from matplotlib import rcParams, rcParamsDefault

    cycle = rcParams["axes.prop_cycle"]
    own = cycle.by_key().get("color") if cycle != rcParamsDefault["axes.prop_cycle"] else None
    return own or list(COLOURS)


def ink() -> str:
    """The style's colour of text, black where paper is white."""
    from matplotlib import rcParams

    return rcParams["text.color"]


def limit_style() -> dict[str, Any]:
    """How a limit is drawn."""
    return {"color": ink(), "linestyle": "--", "linewidth": 1.0}


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


def titled(figure: Figure, title: str) -> Figure:
    """The figure, with a title and a grid in all axes."""
    figure.suptitle(title)
    for axes in figure.axes:
        axes.grid(alpha=0.3)
    return figure


def legend_below(figure: Figure, axes: Axes, **more: Any) -> None:
    """A legend below the panels: the curves of one, and more of them by their names."""
    shown = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True)) | more
    place = {"loc": "outside lower center", "ncols": 6, "fontsize": "small", "frameon": False}
    figure.legend(shown.values(), shown.keys(), **place)


def legend_above(figure: Figure, axes: Axes | None = None) -> Figure:
    """The figure, grown by a legend above its panels, or above one: it covers nothing."""
    named: dict[str, Any] = {}
    for each in figure.axes if axes is None else [axes]:
        named |= dict(zip(*each.get_legend_handles_labels()[::-1], strict=True))
    above: dict[str, Any] = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0)}
    place = {"loc": "outside upper center", "borderaxespad": 0} if axes is None else above
    for rows in range(1, 1 + len(named)):  # until it fits into the width
        columns = math.ceil(len(named) / rows)
        legend = (axes or figure).legend(named.values(), named.keys(), ncols=columns, **place)
        box = legend.get_window_extent()
        if box.width < (1.0 if axes is None else 0.8) * figure.bbox.width or columns == 1:
            figure.set_figheight(figure.get_figheight() + box.height / figure.dpi)
            break
        legend.remove()
    return figure


def plot(axes: Axes, x: ArrayLike, values: ArrayLike, **options: Any) -> None:
    """Plots a curve with its lowest and highest values, however long it is."""
    x, values = np.asarray(x), np.asarray(values)
    shown = extreme_samples(values)
    axes.plot(x[shown], values[shown], **options)


def plot_each(axes: Axes, x: ArrayLike, values: NDArray, name: str = "", **options: Any) -> None:
    """Plots a curve per column; those of the second half dashed, as symmetric ones coincide.

    The first twelve have the name and a number in the legend.
    """
    palette = colours()
    for i, column in enumerate(values.T):
        style = LINE_STYLES[i >= values.shape[1] / 2]
        label = f"{name} {i + 1}" if name and i < MOST_NAMED else None
        colour = palette[i % len(palette)]
        plot(axes, x, column, **{"color": colour, "linestyle": style, "label": label} | options)


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
    length = -(-count // ((most - 2) // (2 * columns.shape[1]) - 1))  # of a stretch
    whole = count // length * length
    stretches = columns[:whole].reshape(-1, length, columns.shape[1])
    starts = length * np.arange(len(stretches))[:, None]
    chosen = [starts + extreme(stretches, axis=1) for extreme in (np.argmin, np.argmax)]
    if whole < count:
        chosen += [
            whole + extreme(columns[whole:], axis=0)[None] for extreme in (np.argmin, np.argmax)
        ]
    return np.unique(np.concatenate([[0, count - 1], *(each.ravel() for each in chosen)]))
