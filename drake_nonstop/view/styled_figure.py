"""Figures that look the same wherever they are drawn; not imported before the first figure."""

from typing import Any

import matplotlib
from matplotlib.figure import Figure


class StyledFigure(Figure):
    """A figure that is drawn and saved with Matplotlib's settings of when it was made.

    Matplotlib asks for many of them, such as those of ticks and of embedded fonts, only then.
    """

    def __init__(self, *arguments: Any, **options: Any):
        self._settings = {k: v for k, v in matplotlib.rcParams.items() if k != "backend"}
        super().__init__(*arguments, **options)

    def draw(self, renderer: Any) -> None:  # noqa: D102 - as of Figure
        with matplotlib.rc_context(self._settings):
            super().draw(renderer)

    def savefig(self, *arguments: Any, **options: Any) -> None:  # noqa: D102
        with matplotlib.rc_context(self._settings):
            super().savefig(*arguments, **options)
