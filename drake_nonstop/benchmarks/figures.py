"""A figure of the time of a run in each block."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from drake_nonstop.view.figure_style import COLOURS, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def make_run_time_figure(results: Mapping[str, Any]) -> Figure:
    """The wall time of a run by block: as a flame graph, and the time in each block itself.

    In the upper panel the bar of a box is below that of its caller, and its width is the time
    of the box with all that it called. Below it, the width that no other bar covers is the time
    in the box itself.

    Args:
        results: returned by `benchmarks.running.benchmark_run`.
    """
    blocks, frames = results["blocks"], results["frames"]
    names = [block["name"] for block in blocks]
    colours = dict.fromkeys(names, "0.55") | dict(zip(names, COLOURS, strict=False))
    total, root = results["timed_s"], frames["box"]
    figure = new_figure((10.0, 1.2 + 0.35 * (_depth(frames) + len(names) + 1)))
    upper, lower = figure.subplots(2, 1, height_ratios=[_depth(frames), len(names) + 1])
    _draw_frame(upper, frames, {root: "0.8"} | colours, total, start=0.0, row=0)
    upper.set_ylim(_depth(frames), 0)
    upper.set_yticks([])
    upper.set_xlim(0, 100)
    upper.set_xlabel("of the time with timers (%), each bar with all that it called")
    shares = [100 * block["share"] for block in blocks] + [100 * results["outside_share"]]
    shades = [*(colours[name] for name in names), "0.8"]
    bars = lower.barh([*names, "Drake, logs"], shares, color=shades, alpha=0.7)
    times = [1e6 * total * share / 100 / results["steps"] for share in shares]
    texts = [f"{share:.1f} %, {us:.0f} µs" for share, us in zip(shares, times, strict=True)]
    lower.bar_label(bars, texts, padding=3, fontsize="small")
    lower.set_xlim(0, 1.18 * max(shares))
    lower.invert_yaxis()
    lower.set_xlabel("of the time with timers (%), in the block itself; per step of the integrator")
    figure.suptitle(
        f"{results['scenario']}: {results['real_time_factor']['median']:.1f} × real time"
    )
    return figure


def _depth(frame: Mapping[str, Any]) -> int:
    return 1 + max(map(_depth, frame["children"]), default=0)


def _draw_frame(
    axes: Axes,
    frame: Mapping[str, Any],
    colours: Mapping[str, str],
    total: float,
    *,
    start: float,
    row: int,
) -> None:
    """Draws a bar from `start` (%), and those of its callees in the rows below it."""
    width = 100 * _seconds(frame) / total
    axes.barh(
        row + 0.5,
        width,
        height=1.0,
        left=start,
        color=colours[frame["box"]],
        alpha=0.7,
        edgecolor="white",
        linewidth=0.7,
    )
    name = frame["box"] if row else "the run"
    if width > 0.85 * len(name):  # %, about what its characters take
        axes.text(start + width / 2, row + 0.5, name, ha="center", va="center", fontsize="small")
    for child in frame["children"]:
        _draw_frame(axes, child, colours, total, start=start, row=row + 1)
        start += 100 * _seconds(child) / total


def _seconds(frame: Mapping[str, Any]) -> float:
    return frame["seconds"] + sum(map(_seconds, frame["children"]))
