"""The figure of what a layer is asked to keep within limits, along a flight or a plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from drake_nonstop.analysis.limit_along import LimitAlong
from drake_nonstop.visualization.decimation import extreme_samples
from drake_nonstop.visualization.figure_style import new_figure, titled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDTH, _HEIGHT = 7.0, 2.1  # inch, of a panel


def make_limits_figure(limits: Sequence[LimitAlong], title: str) -> Figure:
    """A panel for each limit: a curve per carrier, cable or pair, and the limit, dashed."""
    figure = new_figure((_WIDTH, _HEIGHT * len(limits)))
    panels = figure.subplots(len(limits), 1, sharex=True, squeeze=False)[:, 0]
    for axes, along in zip(panels, limits, strict=True):
        for values in along.values.T:
            shown = extreme_samples(values)
            axes.plot(along.times[shown], values[shown], linewidth=1)
        axes.axhline(along.stated, color="black", linestyle="--", linewidth=1)
        unit = f" ({along.limit.unit})" if along.limit.unit else ""
        axes.set_ylabel(f"{along.limit.words}{unit}")
    panels[-1].set_xlabel("time (s)")
    return titled(figure, title)
