"""Style of all figures: panels, curves, colours, line styles, title and grid.

Matplotlib is imported with the first figure: its import takes as long as all others together,
and runs without figures do not need it.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

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
LIMIT = {"color": "black", "linestyle": "--", "linewidth": 1.0}  # how a limit is drawn
MOST_POINTS = 20_000  # of a curve
_MOST_NAMED = 12  # curves in a legend below a figure


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
    """An empty figure of that size in inch."""
    require_drawing()
    from matplotlib.figure import Figure

    return Figure(figsize=size, layout="constrained")


def stacked(count: int, width: float = 7.0, height: float = 2.1) -> tuple[Figure, list[Axes]]:
    """A figure with panels over one time axis; width and height of a panel are in inch."""
    figure = new_figure((width, height * count))
    panels = [*figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]]
    panels[-1].set_xlabel("time (s)")
    return figure, panels


def titled(figure: Figure, title: str) -> Figure:
    """The figure, with a title and a grid in all axes."""
    figure.suptitle(title)
    for axes in figure.axes:
        axes.grid(alpha=0.3)
    return figure


def legend_below(figure: Figure, axes: Axes, **more: Any) -> None:
    """A legend below the panels: the first curves of one, and more of them by their names."""
    named = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    shown = dict([*named.items()][:_MOST_NAMED]) | more
    place = {"loc": "outside lower center", "ncols": 6, "fontsize": "small", "frameon": False}
    figure.legend(shown.values(), shown.keys(), **place)


def plot(axes: Axes, x: ArrayLike, values: ArrayLike, **options: Any) -> None:
    """Plots a curve with its lowest and highest values, however long it is."""
    x, values = np.asarray(x), np.asarray(values)
    shown = extreme_samples(values)
    axes.plot(x[shown], values[shown], **{"linewidth": 1.0} | options)


def plot_each(axes: Axes, x: ArrayLike, values: NDArray, name: str = "", **options: Any) -> None:
    """Plots a curve per column; those of the second half dashed, as symmetric ones coincide."""
    for i, column in enumerate(values.T):
        style = LINE_STYLES[i >= values.shape[1] / 2]
        label = f"{name} {i + 1}" if name else None
        colour = COLOURS[i % len(COLOURS)]
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
