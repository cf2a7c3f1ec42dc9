"""Any signals of any runs over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from drake_nonstop.simulation.signal_table import SignalTable, UnknownSignalError
from drake_nonstop.validation import require
from drake_nonstop.visualization.figure_style import COLOURS, LINE_STYLES, plot, stacked

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

_MOST_PANELS = 20


def make_signal_figure(runs: Mapping[str, SignalTable], signals: Sequence[str]) -> Figure:
    """A panel for each quantity of the signals.

    Each entry has a colour and each run a line style; where there are more runs than line styles
    each line has a colour and style that no other one has.

    Args:
        runs: by what they are called in the legend.
        signals: as of `SignalTable.columns`.

    Raises:
        ScenarioError: no run has such a signal, there are more than 20 panels, or more lines of
            more than three runs in a panel than can be told apart, 36.
    """
    columns = _columns(runs, signals)
    panels: dict[str, list[str]] = {}
    for found in columns.values():
        for name in list(found)[1:]:
            entries = panels.setdefault(_quantity(name), [])
            if name not in entries:
                entries.append(name)
    remedy = f"give fewer signals, with at most {_MOST_PANELS} quantities in all"
    require(len(panels) <= _MOST_PANELS, "--signal", list(signals), remedy)
    are_few = len(runs) <= len(LINE_STYLES)
    most = max(map(len, panels.values())) * len(runs)
    kinds = len(COLOURS) * len(LINE_STYLES)
    remedy = f"at most {kinds} in a panel can be told apart: give fewer runs, or single entries"
    require(are_few or most <= kinds, "--signal", f"{most} lines of {len(runs)} runs", remedy)
    figure, rows = stacked(len(panels), width=8.0)
    for axes, (quantity, names) in zip(rows, panels.items(), strict=True):
        for number, (label, found) in enumerate(columns.items()):
            for k, name in enumerate(names):
                if name not in found:
                    continue
                entry = name.partition(" [")[0].removeprefix(quantity.partition(" [")[0])
                text = " ".join(filter(None, (entry.lstrip("."), label if len(runs) > 1 else "")))
                colour, style = k, number
                if not are_few:
                    style, colour = divmod(number * len(names) + k, len(COLOURS))
                plot(
                    axes,
                    found["time [s]"],
                    found[name],
                    color=COLOURS[colour % len(COLOURS)],
                    linestyle=LINE_STYLES[style % len(LINE_STYLES)],
                    label=text or None,
                )
        axes.set_ylabel(quantity.replace(" [", "\n["), fontsize="small")
        axes.grid(alpha=0.3)
        if axes.get_legend_handles_labels()[1]:
            in_columns = 1 + (len(axes.lines) - 1) // 12
            beside = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5)}
            axes.legend(**beside, fontsize="x-small", ncols=in_columns)
    rows[-1].set_xlabel("time [s]")
    return figure


def _columns(
    runs: Mapping[str, SignalTable], signals: Sequence[str]
) -> dict[str, dict[str, NDArray]]:
    """Of each run the time and the columns of those signals that it has.

    Raises:
        UnknownSignalError: no run has one of the signals.
    """
    found = {label: {"time [s]": run.time} for label, run in runs.items()}
    for signal in signals:
        refusals = []
        for label, run in runs.items():
            try:
                found[label] |= run.columns([signal])
            except UnknownSignalError as error:
                refusals.append(error)
        if refusals and len(refusals) == len(runs):
            raise refusals[0]
    return found


def _quantity(name: str) -> str:
    """What entries share a panel: those of the same part and unit, of all carriers."""
    path, _, unit = name.partition(" [")
    words = path.split(".")
    while len(words) > 1 and (words[-1].isdigit() or words[-1] in "wxyz"):
        words.pop()
    return f"{'.'.join(words)} [{unit}" if unit else ".".join(words)
