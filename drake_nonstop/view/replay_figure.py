"""The control figure of a replay: the drawing of the run's diagram, with values of its wires."""

import base64
import gzip
import html
import json
import re
from importlib import resources
from string import Template

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.signal_layouts import Entry, numbered_entries
from drake_nonstop.run.run import Run
from drake_nonstop.view.drawing import draw_diagram

_MOST_ROWS = 1_200
_DROPPED_BITS = 11  # of the 23 of a mantissa: numbers are shown with three digits
_PLACE = re.compile(r"(\.([wxyz]|\d+))+$")  # of an entry in its part


def figure_of(run: Run, samples: NDArray) -> str:
    """The figure in HTML; its wires have the values at these samples (k,), or at fewer of them."""
    samples = samples[:: -(-len(samples) // _MOST_ROWS)]
    signals, count = {}, 0
    for name, values in run.signals.items():
        entries = run.entries.get(name) or numbered_entries(name, values.shape[1])
        names = [entry.name.partition(".")[2] or entry.name for entry in entries]
        signals[name] = {
            "first": count,
            "entries": [*zip(names, (entry.unit for entry in entries), strict=True)],
            "brief": _brief(entries),
        }
        count += values.shape[1]
    times = (run.time[samples] - run.time[samples[0]]).tolist()
    data = json.dumps({"times": times, "signals": signals}).replace("</", "<\\/")
    table = np.hstack([values[samples] for values in run.signals.values()])
    drawing = draw_diagram(run.diagram)
    page = resources.files("drake_nonstop.view").joinpath("replay_figure.html")
    return Template(page.read_text(encoding="utf-8")).substitute(
        drawing=drawing[drawing.index("<svg") :],
        options="".join(f"<option>{html.escape(name)}</option>" for name in signals),
        data=data,
        values=_packed(table),
    )


def _brief(entries: tuple[Entry, ...]) -> list[int]:
    """The columns of the first part that has a unit, or else of the first one."""
    parts: dict[tuple[str, str], list[int]] = {}
    for column, entry in enumerate(entries):
        parts.setdefault((_PLACE.sub("", entry.name), entry.unit), []).append(column)
    return next(
        (columns for (_, unit), columns in parts.items() if unit), next(iter(parts.values()))
    )


def _packed(table: NDArray) -> str:
    """Numbers, column by column, as the first bytes of all, the second bytes, and so on.

    They are those of little-endian floats of four bytes, compressed, in base64.
    """
    half = np.uint32(1 << (_DROPPED_BITS - 1))
    bits = np.asfortranarray(np.nan_to_num(table).astype("<f4")).ravel("F").view("<u4")
    rounded = (bits + half) >> _DROPPED_BITS << _DROPPED_BITS
    planes = rounded.view(np.uint8).reshape(-1, 4).T
    return base64.b64encode(gzip.compress(planes.tobytes(), 6, mtime=0)).decode()
