"""What all figures share: an empty figure, colours, line styles, title and grid.

Matplotlib is imported with the first figure: its import takes as long as all others together,
and runs without figures do not need it.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from drake_nonstop.validation import require

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = (  # Okabe and Ito's, which the colour-blind can tell apart, and four darker ones
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"),
    *("#7f5f3f", "#882255", "#117733", "#332288", "#999933", "#888888"),
)
LINE_STYLES = ("solid", (0, (5, 4)), (0, (1, 2)))  # of coinciding curves, so that all are seen


def require_drawing() -> None:
    """Raises ScenarioError where Matplotlib is not imported with the backend that is set."""
    backend = os.environ.get("MPLBACKEND")
    if backend:
        try:
            import matplotlib  # noqa: F401
        except ValueError:
            remedy = "give a backend of Matplotlib, such as agg, or unset the variable"
            require(False, "MPLBACKEND", backend, remedy)


def new_figure(size: tuple[float, float], layout: str | None = "constrained") -> Figure:
    """An empty figure of that size in inch."""
    require_drawing()
    from matplotlib.figure import Figure

    return Figure(figsize=size, layout=layout)


def titled(figure: Figure, title: str) -> Figure:
    """The figure, with a title and a grid in all axes."""
    figure.suptitle(title)
    for axes in figure.axes:
        axes.grid(alpha=0.3)
    return figure
