"""Figures that look the same wherever they are drawn; not imported before the first figure."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image


class StyledFigure(Figure):
    """A figure that is drawn and saved with Matplotlib's settings of when it was made.

    Matplotlib asks for many of them, such as those of ticks and of embedded fonts, only then.
    """

    def __init__(self, *arguments: Any, **options: Any):
        self._settings = dict(matplotlib.rcParams.copy())
        del self._settings["backend"]
        super().__init__(*arguments, **options)

    @contextmanager
    def _styled(self) -> Iterator[None]:
        with matplotlib.rc_context():
            dict.update(matplotlib.rcParams, self._settings)  # they were checked when they were set
            yield

    def draw(self, renderer: Any) -> None:  # noqa: D102 - as of Figure
        with self._styled():
            super().draw(renderer)

    def savefig(self, *arguments: Any, **options: Any) -> None:  # noqa: D102
        with self._styled():
            super().savefig(*arguments, **options)

    def png(self) -> bytes:
        """The picture as a PNG file, drawn once, where `savefig` draws twice."""
        shown, resolution = self.get_dpi(), self._settings["savefig.dpi"]
        resolution = shown if resolution == "figure" else resolution
        self.set_dpi(resolution)
        canvas, file = FigureCanvasAgg(self), io.BytesIO()
        canvas.draw()
        self.set_dpi(shown)
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
        picture.save(file, format="PNG", compress_level=1, dpi=(resolution, resolution))
        return file.getvalue()
