"""The figures of a run: the paper's own set.

Matplotlib is imported with the first figure: it takes as long as all of the rest, and runs
without figures do not need it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RollPitchYaw

from drake_nonstop.simulation.metrics import (
    attachment_positions,
    carrier_speeds,
    closest_cables,
    closest_carriers,
    load_errors,
    speed_bounds,
)
from drake_nonstop.simulation.simulate import Run
from drake_nonstop.studies.margins import Margin
from drake_nonstop.studies.robustness import Case

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIZE = (7.0, 4.2)  # inch
_COLOURS = (  # Okabe and Ito's, made for the colour-blind too, and four darker ones
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"),
    *("#7f5f3f", "#882255", "#117733", "#332288", "#999933", "#888888"),
)
_OVERLAID = ("solid", (0, (5, 4)), (0, (1, 2)))  # lines of coinciding curves, all to be seen


def make_margins_figure(title: str, margins: Sequence[Margin]) -> Figure:
    """The growth per s of the loop's least stable mode over each parameter, stable below 0."""
    figure = _figure((2.6 * len(margins), 3.4))
    for margin, axes in zip(margins, figure.subplots(1, len(margins), sharey=True), strict=True):
        axes.axhline(0, color="0.6", linewidth=0.8)
        axes.axvline(margin.nominal, color="0.6", linestyle=":")
        low = margin.values[0] if margin.low is None else margin.low
        high = margin.values[-1] if margin.high is None else margin.high
        axes.axvspan(low, high, color="#18a048", alpha=0.15, linewidth=0)
        axes.plot(margin.values, margin.rates, "o-", markersize=3, color="C0")
        if margin.values[0] > 0:
            axes.set_xscale("log")
            ticks = [margin.values[0], margin.nominal, margin.values[-1]]
            axes.set_xticks(ticks, [f"{tick:.3g}" for tick in ticks])
            axes.minorticks_off()
        axes.set_yscale("symlog", linthresh=0.1)
        axes.set_xlabel(f"{margin.name} ({margin.unit})")
    figure.axes[0].set_ylabel("growth of the least stable mode (1/s)")
    figure.suptitle(title)
    return figure


def make_robustness_figure(title: str, cases: Sequence[Case]) -> Figure:
    """Position error and speed margin over the level of each error, a column per error."""
    names = list(dict.fromkeys(case.error for case in cases if case.unit))
    figure = _figure((2.1 * len(names), 5.0))
    axes = figure.subplots(2, len(names), sharey="row", squeeze=False)
    for name, (top, bottom) in zip(names, axes.T, strict=True):
        shown = sorted((c for c in cases if c.error in ("none", name)), key=lambda c: c.level)
        levels = [case.level for case in shown]
        top.plot(levels, [1e3 * case.position_error_mean for case in shown], "o-", markersize=3)
        bottom.plot(levels, [case.speed_margin for case in shown], "o-", markersize=3)
        bottom.axhline(0, color="green", linestyle="--")
        top.set_title(name, fontsize="medium")
        unit = next(case.unit for case in cases if case.error == name)
        bottom.set_xlabel(unit.split(" (")[0])
    axes[0, 0].set_ylabel("mean position error (mm)")
    axes[1, 0].set_ylabel("slowest speed − ε (m/s)")
    axes[0, 0].set_yscale("log")
    figure.suptitle(title)
    return figure


def make_overlay_figure(
    title: str,
    label: str,
    curves: Mapping[str, tuple[NDArray, NDArray]],
    *,
    framed: Collection[str],
    bound: tuple[NDArray, NDArray] | None = None,
    is_logarithmic: bool = False,
) -> Figure:
    """The same quantity in several runs: the first black and thick, earlier ones above later.

    Args:
        title: of the figure.
        label: of the quantity, with its unit.
        curves: times (k,) in s and values (k,) by the run's name.
        framed: the names of those that the axes are made for.
        bound: times and values of a bound.
        is_logarithmic: whether the quantity, which is not negative, is better so.
    """
    figure = _figure((9.0, 4.2))
    axes = figure.subplots()
    for i, (name, (times, values)) in enumerate(curves.items()):
        if i == 0:
            axes.plot(times, values, color="black", linewidth=3, label=name, zorder=2)
            continue
        turn, colour = divmod(i - 1, len(_COLOURS))
        axes.plot(
            times,
            values,
            color=_COLOURS[colour],
            linestyle=_OVERLAID[turn % len(_OVERLAID)],
            linewidth=1.2,
            label=name,
            zorder=3 + 1 / i,
        )
    if bound is not None:
        axes.plot(*bound, color="green", linestyle="--", linewidth=1.5, label="bound ε", zorder=9)
    extremes = [
        (values.min(), values.max()) for name, (_, values) in curves.items() if name in framed
    ]
    lowest, highest = min(low for low, _ in extremes), max(high for _, high in extremes)
    if is_logarithmic and highest > 0:
        least = min(np.median(values) for name, (_, values) in curves.items() if name in framed)
        axes.set_yscale("log")
        axes.set_ylim(max(least / 5, 1e-6 * highest), 1.5 * highest)
    else:
        axes.set_ylim(min(0.0, lowest), 1.05 * max(highest, 1e-9))
    axes.set_xlim(0, max(times[-1] for times, _ in curves.values()))
    axes.set_xlabel("time (s)")
    axes.set_ylabel(label)
    figure.legend(loc="outside right upper", fontsize="small", frameon=False)
    return _finished(figure, title)


def make_encounters_figure(runs: dict[str, Run]) -> Figure:
    """Orbits above a resting load and how close carriers and cables come, a column per run.

    `runs` by their titles. The cables are those at the instant at which two of them, or two
    carriers, are closest.
    """
    figure = _figure((3.6 * len(runs), 5.6))
    grid = figure.add_gridspec(2, len(runs), height_ratios=[1.3, 1])
    for k, (title, run) in enumerate(runs.items()):
        states = run.signal("carrier_state")
        carriers = states[:, : states.shape[1] // 2].reshape(len(states), -1, 3)
        ends = attachment_positions(run, run.signal("load_state"))
        closest = closest_carriers(carriers), closest_cables(ends, carriers)
        instant = int(np.argmin(np.minimum(*closest)))
        axes: Axes = figure.add_subplot(grid[0, k], projection="3d")
        for i in range(carriers.shape[1]):
            axes.plot(*carriers[:, i].T, color=f"C{i}", linewidth=1)
            cable = np.stack([ends[instant, i], carriers[instant, i]])
            axes.plot(*cable.T, color="black", linewidth=0.7)
            axes.plot(*carriers[instant, i], "o", color=f"C{i}", markersize=5)
        axes.set_aspect("equal")
        axes.set_box_aspect(None, zoom=1.25)
        axes.set_title(title, fontsize="medium")
        axes.set_zlabel("z (m)", fontsize="x-small", labelpad=-4)
        axes.view_init(elev=22, azim=-60)
        axes.tick_params(labelsize="x-small")
        axes.locator_params(nbins=4)
        lower = figure.add_subplot(grid[1, k])
        for distances, name, colour in zip(
            closest, ("carriers", "cables"), ("C0", "C1"), strict=True
        ):
            shown = np.maximum(distances, 1e-3)  # m: a logarithmic axis has no zero
            lower.semilogy(run.time, shown, label=name, color=colour, linewidth=1.2)
        lower.set_ylim(1e-3, 200)
        lower.set_xlabel("time (s)")
        lower.grid(alpha=0.3)
        if k == 0:
            lower.set_ylabel("closest two (m)")
            lower.legend(fontsize="small")
    return figure


def make_run_time_figure(results: Mapping[str, Any]) -> Figure:
    """Where the wall time of a run goes: who calls whom, and the time in each block itself.

    In the upper panel a box's bar stands below the one whose call led to it, as wide as it
    took with all that it called; what is bare below a bar is time in the box itself.

    Args:
        results: of `benchmarks.running.benchmark_run`.
    """
    blocks, frames = results["blocks"], results["frames"]
    names = [block["name"] for block in blocks]
    colours = dict.fromkeys(names, "0.55") | dict(zip(names, _COLOURS, strict=False))
    total, root = results["timed_s"], frames["box"]
    figure = _figure((10.0, 1.2 + 0.35 * (_depth(frames) + len(names) + 1)), layout=None)
    figure.set_layout_engine("constrained")
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
    """A bar from `start` (%) on, and what it called in the rows below it."""
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
    if width > 0.85 * len(name):  # % that its characters take
        axes.text(start + width / 2, row + 0.5, name, ha="center", va="center", fontsize="small")
    for child in frame["children"]:
        _draw_frame(axes, child, colours, total, start=start, row=row + 1)
        start += 100 * _seconds(child) / total


def _seconds(frame: Mapping[str, Any]) -> float:
    return frame["seconds"] + sum(map(_seconds, frame["children"]))


def make_scale_figure(results: Mapping[str, Any]) -> Figure:
    """Wall time per step and real-time factor over the number of carriers.

    Args:
        results: of `benchmarks.scaling.benchmark_scale`.
    """
    runs = results["runs"]
    counts = np.array([run["n"] for run in runs])
    figure = _figure((9.0, 4.2))
    left, right = figure.subplots(1, 2)
    costs, low, high = (
        np.array([1e6 * run[f"{which}wall_per_step_s"] for run in runs])
        for which in ("", "lowest_", "highest_")
    )
    left.errorbar(counts, costs, [costs - low, high - costs], fmt="o-", capsize=3, label="measured")
    left.plot(counts, costs[0] * counts / counts[0], ":", color="0.5", label="in proportion to n")
    left.set_ylabel("wall time per step (µs)")
    left.legend(fontsize="small")
    right.plot(counts, [run["real_time_factor"] for run in runs], "o-")
    right.axhline(1, color="green", linestyle="--")
    right.set_ylabel("real-time factor")
    for axes in (left, right):
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xticks(counts, [str(n) for n in counts])
        axes.minorticks_off()
        from matplotlib.ticker import LogLocator

        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_xlabel("carriers")
    return _finished(figure, f"{results['scenario']}, scaled: n^{results['exponent']:.2f}")


def make_success_figure(
    title: str,
    succeeded: NDArray,
    *,
    across: tuple[str, NDArray],
    up: tuple[str, NDArray],
    panels: tuple[str, NDArray],
    bins: int = 5,
) -> Figure:
    """The share of runs that succeeded over two drawn values, a map for each value of a third.

    Args:
        title: of the figure.
        succeeded: whether each run did (runs,).
        across: label and values (runs,) of the horizontal axis; values are put into bins.
        up: likewise of the vertical axis.
        panels: label and values (runs,), a map for each that there is.
        bins: along each axis.
    """
    levels = np.unique(panels[1])
    figure = _figure((2.6 * len(levels) + 1.4, 3.6))
    edges = [np.linspace(values.min(), values.max(), bins + 1) for _, values in (across, up)]
    all_axes = figure.subplots(1, len(levels), sharey=True, squeeze=False)[0]
    for axes, level in zip(all_axes, levels, strict=True):
        chosen = panels[1] == level
        counts, hits = (
            np.histogram2d(across[1][which], up[1][which], bins=edges)[0].T
            for which in (chosen, chosen & succeeded)
        )
        shares = np.ma.masked_array(hits / np.maximum(counts, 1), counts == 0)
        shown = axes.pcolormesh(*edges, shares, cmap="viridis", vmin=0, vmax=1)
        centres = [(edge[:-1] + edge[1:]) / 2 for edge in edges]
        for i, j in np.argwhere(counts > 0):
            axes.text(
                centres[0][j],
                centres[1][i],
                f"{shares[i, j]:.0%}\nof {counts[i, j]:.0f}",
                ha="center",
                va="center",
                fontsize="xx-small",
                color="black" if shares[i, j] > 0.6 else "white",
            )
        axes.set_title(f"{panels[0]}: {level:g}", fontsize="medium")
        axes.set_xlabel(across[0], fontsize="small")
    all_axes[0].set_ylabel(up[0], fontsize="small")
    figure.colorbar(shown, ax=list(all_axes), label="share that succeeded")
    figure.suptitle(title)
    return figure


def make_figures(run: Run) -> dict[str, Figure]:
    """A figure per name, the name telling what it shows."""
    return {name: draw(run) for name, draw in zip(FIGURE_NAMES, _FIGURES, strict=True)}


def _draw_load_reference(run: Run) -> Figure:
    reference = run.signal("reference")
    angles = [RollPitchYaw(Quaternion(q / np.linalg.norm(q))).vector() for q in reference[:, :4]]
    figure, panels = _stacked(3)
    for axes, values, label, names in (
        (panels[0], reference[:, 4:7], "position (m)", "xyz"),
        (panels[1], reference[:, 10:13], "velocity (m/s)", "xyz"),
        (panels[2], np.degrees(angles), "orientation (°)", ("roll", "pitch", "yaw")),
    ):
        for column, name, style in zip(values.T, names, _OVERLAID, strict=True):
            axes.plot(run.time, column, linestyle=style, label=name)
        axes.set_ylabel(label)
        axes.legend(fontsize="small", loc="upper left")
    return _finished(figure, "Desired load trajectory")


def _draw_carrier_paths_from_above(run: Run) -> Figure:
    figure, axes = _single()
    _draw_from_above(run, axes, np.arange(len(run.time)))
    return _finished(figure, "Carrier and load paths seen from above")


def _draw_carrier_paths_zoomed(run: Run) -> Figure:
    speeds = carrier_speeds(run.signal("carrier_state")).min(axis=1)
    slowest = run.time[np.argmin(speeds)]
    turn = 2 * np.pi / run.signal("parameters")[np.argmin(speeds), 0]
    shown = np.flatnonzero(np.abs(run.time - slowest) <= turn)
    figure, axes = _single()
    _draw_from_above(run, axes, shown)
    start, end = run.time[shown[[0, -1]]]
    return _finished(
        figure, f"Around the slowest instant ({slowest:.2f} s), from {start:.1f} to {end:.1f} s"
    )


def _draw_load_position_error(run: Run) -> Figure:
    error, _ = load_errors(run)
    return _draw_error(run.time, 1e3 * error, "position error (mm)", "Load position error")


def _draw_load_orientation_error(run: Run) -> Figure:
    _, error = load_errors(run)
    return _draw_error(run.time, 1e3 * error, "orientation error (mrad)", "Load orientation error")


def _draw_carrier_speeds(run: Run) -> Figure:
    figure, axes = _single()
    speeds = carrier_speeds(run.steps["carrier_state"])
    _plot_each(axes, run.steps["time"], speeds, "carrier")
    bounds = speed_bounds(run)
    axes.plot(run.steps["time"], bounds, color="green", linestyle="--", label="bound ε")
    axes.set_ylim(bottom=0)
    axes.set_xlabel("time (s)")
    axes.set_ylabel("carrier speed (m/s)")
    axes.legend(ncols=5, fontsize="small")
    return _finished(figure, "Carrier speeds")


def _draw_tensions(run: Run) -> Figure:
    figure, axes = _single()
    _plot_each(axes, run.steps["time"], run.steps["tensions"], "cable")
    axes.set_xlabel("time (s)")
    axes.set_ylabel("tension (N)")
    axes.legend(ncols=4, fontsize="small")
    return _finished(figure, "Cable tensions")


def _draw_internal_force_parameters(run: Run) -> Figure:
    figure, (top, bottom) = _stacked(2)
    parameters = run.signal("parameters")
    top.plot(run.time, parameters[:, 0], color="C3")
    top.set_ylabel("frequency ξ (rad/s)")
    bottom.plot(run.time, parameters[:, 1], color="C4")
    bottom.set_ylabel("amplitude A (N)")
    return _finished(figure, "Internal-force parameters")


_FIGURES: tuple[Callable[[Run], Figure], ...] = (
    _draw_load_reference,
    _draw_carrier_paths_from_above,
    _draw_carrier_paths_zoomed,
    _draw_load_position_error,
    _draw_load_orientation_error,
    _draw_carrier_speeds,
    _draw_tensions,
    _draw_internal_force_parameters,
)


FIGURE_NAMES = tuple(draw.__name__.removeprefix("_draw_") for draw in _FIGURES)


def _draw_from_above(run: Run, axes: Axes, shown: NDArray) -> None:
    """Paths of load and carriers over some samples, with load and cables at the last one."""
    load = run.signal("load_state")[shown]
    carriers = run.signal("carrier_state")[shown]
    n = carriers.shape[1] // 6
    carriers = carriers[:, : 3 * n].reshape(-1, n, 3)
    for i in range(n):
        axes.plot(*carriers[:, i, :2].T, color=f"C{i}", linewidth=0.9, label=f"carrier {i + 1}")
        axes.plot(*carriers[-1, i, :2], "x", color=f"C{i}")
    axes.plot(*load[:, 4:6].T, color="black", linewidth=1.2, label="load")
    corners = attachment_positions(run, load[-1:])[0]
    axes.plot(*np.vstack([corners, corners[:1]])[:, :2].T, "--", color="black", linewidth=0.9)
    axes.plot(*load[-1, 4:6], "+", color="black")
    for corner, carrier in zip(corners, carriers[-1], strict=True):
        axes.plot(*np.stack([corner, carrier])[:, :2].T, color="black", linewidth=0.7)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _draw_error(time: NDArray, error: NDArray, label: str, title: str) -> Figure:
    figure, axes = _single()
    axes.plot(time, error, label=["x", "y", "z"], linewidth=1)
    axes.plot(time, np.linalg.norm(error, axis=1), color="black", label="norm", linewidth=1)
    axes.set_xlabel("time (s)")
    axes.set_ylabel(label)
    axes.legend(ncols=4, fontsize="small")
    return _finished(figure, title)


def _plot_each(axes: Axes, time: NDArray, values: NDArray, name: str) -> None:
    """A curve per column; the second half dashed, since symmetric ones coincide."""
    for i, column in enumerate(values.T):
        style = (0, (4, 3)) if i >= values.shape[1] / 2 else "solid"
        axes.plot(
            time, column, color=f"C{i}", linewidth=1, linestyle=style, label=f"{name} {i + 1}"
        )


def _figure(size: tuple[float, float], layout: str | None = "constrained") -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=size, layout=layout)


def _single() -> tuple[Figure, Axes]:
    figure = _figure(_SIZE)
    return figure, figure.subplots()


def _stacked(count: int) -> tuple[Figure, list[Axes]]:
    figure = _figure((_SIZE[0], 2.1 * count))
    axes = list(figure.subplots(count, 1, sharex=True))
    axes[-1].set_xlabel("time (s)")
    return figure, axes


def _finished(figure: Figure, title: str) -> Figure:
    figure.suptitle(title)
    for axes in figure.axes:
        axes.grid(alpha=0.3)
    return figure
