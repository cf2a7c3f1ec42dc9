"""Figures of paths: load and carriers seen from above, and in space at several instants."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.lumped_cable import nodes_of
from drake_nonstop.mechanics.rounded_box import outline_in
from drake_nonstop.mechanics.signals import CarrierStates, LoadState
from drake_nonstop.run.run import Run
from drake_nonstop.run.run_quantities import (
    RunQuantities,
    attachment_positions,
    carrier_speeds,
)
from drake_nonstop.scenario.obstacles import Obstacle
from drake_nonstop.view.figure_style import (
    MOST_NAMED,
    colours,
    extreme_samples,
    fitting_unit,
    ink,
    legend_above,
    single,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_INSTANTS = 5
_ELEVATION, _AZIMUTH = np.radians([28.0, -65.0])  # of the view, from the way that the load takes
_REST = 0.1  # of the farthest carrier's distance: a load that moves less rests
_NEAR = 0.2  # of the picture's width: a load that moves less has one label
_SCALE = 0.15  # of what is shown, at most: length of the axes
_FROM_ABOVE = np.eye(2, 3)


def draw_carrier_paths_from_above(run: Run) -> Figure:
    """Paths of load and carriers, with load and cables at the end."""
    rows = np.arange(len(run.time))
    return _draw_paths(run, rows, rows[-1:])


def draw_carrier_paths_zoomed(run: Run) -> Figure:
    """Paths for a turn before and after the instant of the slowest carrier, which has a ring."""
    speeds = carrier_speeds(run.signal("carrier_state"))
    row, carrier = map(int, np.unravel_index(np.argmin(speeds), speeds.shape))
    turn = 2 * np.pi / max(abs(run.signal("parameters")[row, 0]), 1e-9)
    # All, where the turn is NaN.
    rows = np.flatnonzero(~(np.abs(run.time - run.time[row]) > turn))
    return _draw_paths(run, rows, rows[-1:], slowest=(row, carrier))


def draw_snapshots(run: Run, count: int = _INSTANTS) -> Figure:
    """Load, cables and carriers at instants from the first to the last, over their paths.

    Between the instants the load moves by equal lengths; where it rests, they are equal times. The
    view is parallel, from the right of the load's way; x, y and z have the length beside them.
    """
    load = np.nan_to_num(LoadState.view(run.signal("load_state")).position, posinf=0, neginf=0)
    carriers = CarrierStates.view(run.signal("carrier_state")).positions
    reach = np.linalg.norm(carriers[0] - load[0], axis=1).max()
    if np.ptp(load, axis=0).max() < _REST * reach:
        load = np.zeros_like(load)
    return _draw_paths(run, np.arange(len(load)), instants_along(load, count), view_beside(load))


def _draw_paths(
    run: Run, shown: NDArray, instants: NDArray, view: NDArray = _FROM_ABOVE, slowest: tuple = ()
) -> Figure:
    """Draws paths over the samples `shown`, and load, cables and carriers at those `instants`.

    `view` has the page's directions to the right and up (2, 3); `slowest` are the sample and the
    carrier that a ring marks. The load is drawn by its attachments.
    """
    from matplotlib import rcParams
    from matplotlib.patches import Polygon
    from matplotlib.patheffects import withStroke

    load_states, carrier_states = run.signal("load_state"), run.signal("carrier_state")
    positions = CarrierStates.view(carrier_states).positions
    factor, unit = fitting_unit("m", positions)
    to_page = factor * view.T
    load, carriers = LoadState.view(load_states).position @ to_page, positions @ to_page
    corners = attachment_positions(run, load_states[instants]) @ to_page  # (instants, n, 2)
    cables = [corners[:, None], carriers[instants, None]]
    if RunQuantities(run).has_nodes:
        states = run.signal("cable_state")[instants]
        nodes = np.stack([nodes_of(state, corners.shape[1])[0] for state in states])
        cables.insert(1, nodes @ to_page)
    points = np.concatenate(cables, axis=1)  # (instants, points of a cable, n, 2)
    drawn = np.concatenate([e.reshape(-1, 2) for e in (load[shown], carriers[shown], points)])
    finite = np.isfinite(drawn).all(axis=1)  # not so where a run stopped
    drawn = drawn[finite] if finite.any() else np.eye(2)
    outlines = [factor * outline_in(each.shape(), view) for each in _bounded_obstacles(run)]
    # Those that are wider than all else are cut off.
    whole = [each for each in outlines if np.ptp(each, axis=0).max() <= np.ptp(drawn, axis=0).max()]
    drawn = np.concatenate([drawn, *whole])
    width, height = np.ptp(drawn, axis=0)
    figure, axes = single(f"x ({unit})", f"y ({unit})", height / max(width, 1e-9))
    own = {"color": run.scenario.scene.obstacle_colour, "alpha": 0.5, "linewidth": 0, "zorder": 1}
    for outline in outlines:
        axes.add_artist(Polygon(outline, label="obstacle", **own))
    axes.update_datalim(drawn)
    palette = colours()
    for i in range(carriers.shape[1]):
        colour = palette[i % len(palette)]
        path = carriers[shown, i]
        axes.plot(*path[extreme_samples(path)].T, color=colour, alpha=0.5, linewidth=0.6)
        axes.plot(*points[:, :, i].transpose(2, 1, 0), color="0.3", linewidth=0.6)
        label = f"carrier {i + 1}" if i < MOST_NAMED else None
        axes.plot(*carriers[instants, i].T, "o", color=colour, label=label, zorder=4)
    path = load[shown]
    axes.plot(*path[extreme_samples(path)].T, color=ink(), label="load", zorder=3)
    for outline in corners:
        axes.fill(*outline.T, facecolor="0.6", edgecolor=ink(), alpha=0.4)
    if slowest:
        ring = {"color": ink(), "fillstyle": "none", "markersize": 7, "linestyle": "none"}
        label = f"slowest, {run.time[slowest[0]]:.2f} s"
        axes.plot(*carriers[slowest], marker="o", label=label, zorder=5, **ring)
    axes.margins(0.05)
    axes.set_aspect("equal", adjustable="datalim")
    if view is not _FROM_ABOVE:
        axes.set_axis_off()
        halo = withStroke(linewidth=1.5, foreground=rcParams["figure.facecolor"])
        below = {"xytext": (0, -2), "textcoords": "offset points", "va": "top", "ha": "center"}
        below |= {"fontsize": "small", "path_effects": [halo]}
        rests = np.ptp(load[instants], axis=0).max() < _NEAR * width
        groups = [slice(None)] if rests else [slice(k, k + 1) for k in range(len(instants))]
        for group in groups:
            place = load[instants[group][0], 0], corners[group, :, 1].min()
            text = ", ".join(f"{time:.3g}" for time in run.time[instants[group]])
            axes.annotate(f"{text} s", place, **below, zorder=5)
        _draw_directions(axes, view, drawn, unit)
    return legend_above(figure)


def _bounded_obstacles(run: Run) -> list[Obstacle]:
    """All obstacles but the ground, which would be all of the page."""
    return [each for each in run.scenario.obstacles if np.isfinite(each.shape().half).all()]


def _draw_directions(axes: Axes, view: NDArray, drawn: NDArray, unit: str) -> None:
    """Draws x, y and z with their length in the corner that is farthest from the points `drawn`.

    `view` has the page's directions (2, 3), `drawn` is (k, 2) in the unit.
    """
    longest = _SCALE * np.ptp(drawn, axis=0).max()
    digit = 10.0 ** np.floor(np.log10(longest))
    length = max(k * digit for k in (1, 2, 5) if k * digit <= longest)
    ends = 1.4 * length * np.vstack([np.zeros(2), view.T])
    low, high = drawn.min(axis=0) - ends.min(axis=0), drawn.max(axis=0) - ends.max(axis=0)
    corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
    seen = drawn[extreme_samples(drawn)] - ends.mean(axis=0)
    origin = corners[np.argmax(np.linalg.norm(seen - corners[:, None], axis=-1).min(axis=1))]
    line = {"linewidth": 0.7, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 5}
    for direction, name in zip(length * view.T, "xyz", strict=True):
        axes.annotate("", origin + direction, origin, arrowprops=line | {"arrowstyle": "-|>"})
        axes.text(*(origin + 1.25 * direction), name, style="italic", ha="center", va="center")
    middle = origin + 0.5 * length * view[:, 2]
    axes.text(*middle, f"{length:g} {unit} ", fontsize="small", ha="right", va="center")
    axes.update_datalim(origin + ends)


def instants_along(load: NDArray, count: int) -> NDArray:
    """The rows of `count` instants, for positions (k, 3) of the load, m; equal: it rests."""
    lengths = np.linalg.norm(np.diff(load, axis=0, prepend=load[:1]), axis=1)
    travelled = np.cumsum(lengths) if lengths.any() else np.arange(len(load))
    return np.searchsorted(travelled, np.linspace(0, travelled[-1], count))


def view_beside(load: NDArray) -> NDArray:
    """The page's directions to the right and up (2, 3), for positions (k, 3) of the load, m."""
    x, y = (load[-1] - load[0])[:2]
    angles = np.arctan2(y, x) + _AZIMUTH, _ELEVATION
    (sin, rise), (cos, level) = np.sin(angles), np.cos(angles)
    return np.array([[-sin, cos, 0], [-cos * rise, -sin * rise, level]])
