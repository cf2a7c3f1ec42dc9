"""Any signals of any runs over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from drake_nonstop.simulation.run import Run
from drake_nonstop.validation import require
from drake_nonstop.visualization.decimation import extreme_samples
from drake_nonstop.visualization.figure_style import COLOURS, LINE_STYLES, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDTH, _HEIGHT = 8.0, 2.2  # inch, of a panel
_MOST_PANELS = 20


def make_signal_figure(runs: Mapping[str, Run], signals: Sequence[str]) -> Figure:
    """A panel for each quantity of the signals, a colour for each entry, a line style for each run.

    Args:
        runs: by what they are called in the legend.
        signals: as of `Run.columns`.

    Raises:
        ScenarioError: a run has no such signal, or there are more than 20 panels.
    """
    columns = {label: run.columns(signals) for label, run in runs.items()}
    panels: dict[str, list[str]] = {}
    for found in columns.values():
        for name in list(found)[1:]:
            entries = panels.setdefault(_quantity(name), [])
            if name not in entries:
                entries.append(name)
    remedy = f"give fewer signals, with at most {_MOST_PANELS} quantities in all"
    require(len(panels) <= _MOST_PANELS, "--signal", list(signals), remedy)
    figure = new_figure((_WIDTH, _HEIGHT * len(panels) + 0.5))
    rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (quantity, names) in zip(rows, panels.items(), strict=True):
        for number, (label, found) in enumerate(columns.items()):
            time = found["time [s]"]
            for k, name in enumerate(names):
                if name not in found:
                    continue
                shown = extreme_samples(found[name])
                entry = name.partition(" [")[0].removeprefix(quantity.partition(" [")[0])
                text = " ".join(filter(None, (entry.lstrip("."), label if len(runs) > 1 else "")))
                axes.plot(
                    time[shown],
                    found[name][shown],
                    color=COLOURS[k % len(COLOURS)],
                    linestyle=LINE_STYLES[number % len(LINE_STYLES)],
                    linewidth=1.0,
                    label=text or None,
                )
        axes.set_ylabel(quantity.replace(" [", "\n["), fontsize="small")
        axes.grid(alpha=0.3)
        if axes.get_legend_handles_labels()[1]:
            count = len(axes.lines)
            axes.legend(
                loc="center left",
                bbox_to_anchor=(1.0, 0.5),
                fontsize="x-small",
                ncols=1 + (count - 1) // 12,
            )
    rows[-1].set_xlabel("time [s]")
    return figure


def _quantity(name: str) -> str:
    """What entries share a panel: those of the same part and unit, of all carriers."""
    path, _, unit = name.partition(" [")
    words = path.split(".")
    while len(words) > 1 and (words[-1].isdigit() or words[-1] in "wxyz"):
        words.pop()
    return f"{'.'.join(words)} [{unit}" if unit else ".".join(words)
