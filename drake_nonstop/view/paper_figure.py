"""The paper's style, and figures that have it wherever they are drawn and saved."""

import functools
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

_OF_SCREENS = 200  # pixels per inch


@contextmanager
def paper_style() -> Iterator[None]:
    """Has Matplotlib make and draw what is within in the style of paper.mplstyle."""
    with matplotlib.rc_context():
        dict.update(matplotlib.rcParams, _sheet())  # of a file: its values are checked
        yield


@functools.cache
def _sheet() -> dict[str, Any]:
    file = Path(__file__).with_name("paper.mplstyle")
    settings = dict(matplotlib.rc_params_from_file(file, use_default_template=True))
    del settings["backend"]
    return settings


class PaperFigure(Figure):
    """A figure whose ticks, fonts and files, which are made late, have this style, too."""

    def draw(self, renderer: Any) -> None:  # noqa: D102 - as of Figure
        with paper_style():
            super().draw(renderer)

    def savefig(self, *arguments: Any, **options: Any) -> None:  # noqa: D102
        with paper_style():
            super().savefig(*arguments, **options)

    def write(self, file: BinaryIO, kind: str) -> None:
        """Saves it as "png", "pdf" or "svg".

        A PNG is for screens: it has fewer pixels than that of `savefig`, which draws twice.
        """
        if kind != "png":
            self.savefig(file, format=kind)
            return
        self.set_dpi(_OF_SCREENS)
        FigureCanvasAgg(self).print_png(file, pil_kwargs={"compress_level": 1})

    def _repr_png_(self) -> bytes:
        """What a notebook shows where the figure is the result of a cell."""
        file = io.BytesIO()
        self.savefig(file, format="png", dpi=180)
        return file.getvalue()
