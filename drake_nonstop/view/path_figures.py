"""Figures of paths: load and carriers seen from above, and in space at several instants."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.lumped_cable import nodes_of
from drake_nonstop.mechanics.rounded_box import outline_in
from drake_nonstop.mechanics.signals import CarrierStates, LoadState
from drake_nonstop.run.run import Run
from drake_nonstop.run.run_quantities import RunQuantities, attachment_positions
from drake_nonstop.view.bodies import OBSTACLE_COLOUR
from drake_nonstop.view.figure_style import (
    MOST_NAMED,
    extreme_samples,
    fitting_unit,
    legend_above,
    plausible_range,
    single,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_INSTANTS = 5
_ELEVATION, _AZIMUTH = np.radians([28.0, -65.0])  # of the view, from the way that the load takes
_REST = 0.1  # of the farthest carrier's distance: a load that moves less rests
_SCALE = 0.15  # of what is shown, at most: length of the axes
_LIGHTEST, _DARKEST = 0.15, 0.5  # opacity of the load at the first instant and the last
_DIRECTIONS = 180  # of which a hull has the farthest points
_FROM_ABOVE = np.eye(2, 3)


def draw_carrier_paths_from_above(run: Run) -> Figure:
    """Paths of load and carriers, with load and cables at the end."""
    return _draw_paths(run, np.array([len(run.time) - 1]), _FROM_ABOVE)


def draw_snapshots(run: Run) -> Figure:
    """Load, cables and carriers at instants from the first to the last, over their paths.

    Between the instants the load moves by equal lengths; where it rests, they are equal times. The
    later, the darker the load. The view is parallel, from the right of the load's way; x, y and z
    have the length beside them.
    """
    load = np.nan_to_num(LoadState.view(run.signal("load_state")).position, posinf=0, neginf=0)
    carriers = CarrierStates.view(run.signal("carrier_state")).positions
    reach = np.linalg.norm(carriers[0] - load[0], axis=1).max()
    if np.ptp(load, axis=0).max() < _REST * reach:
        load = np.zeros_like(load)
    return _draw_paths(run, instants_along(load, _INSTANTS), view_beside(load))


def _draw_paths(run: Run, instants: NDArray, view: NDArray) -> Figure:
    """Draws the paths, and load, cables and carriers at those samples.

    `view` has the page's directions to the right and up (2, 3). The load is the hull of its
    attachments.
    """
    from matplotlib.patches import Polygon

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
    drawn = np.concatenate([each.reshape(-1, 2) for each in (load, carriers, points)])
    finite = np.isfinite(drawn).all(axis=1)  # not so where a run stopped
    drawn = drawn[finite] if finite.any() else np.eye(2)
    if run.stopped:
        low, high = plausible_range(drawn, 2 * np.ptp(corners[0], axis=0).max())
        drawn = drawn[((low <= drawn) & (drawn <= high)).all(axis=1)]
        for each in (load, carriers, points, corners):
            each[((each < low) | (each > high)).any(axis=-1)] = np.nan
    shapes = [each.shape() for each in run.scenario.obstacles]
    # All but the ground, which would be all of the page.
    outlines = [factor * outline_in(each, view) for each in shapes if np.isfinite(each.half).all()]
    # Those that are wider than all else are cut off.
    whole = [each for each in outlines if np.ptp(each, axis=0).max() <= np.ptp(drawn, axis=0).max()]
    drawn = np.concatenate([drawn, *whole])
    width, height = np.ptp(drawn, axis=0)
    figure, axes = single(f"x ({unit})", f"y ({unit})", height / max(width, 1e-9))
    own = {"color": OBSTACLE_COLOUR, "alpha": 0.5, "linewidth": 0, "zorder": 1}
    for outline in outlines:
        axes.add_artist(Polygon(outline, label="obstacle", **own))
    axes.update_datalim(drawn)
    for i in range(carriers.shape[1]):
        colour, path = f"C{i}", carriers[:, i]
        axes.plot(*path[extreme_samples(path)].T, color=colour, alpha=0.5, linewidth=0.6)
        axes.plot(*points[:, :, i].transpose(2, 1, 0), color="0.3", linewidth=0.6)
        label = f"carrier {i + 1}" if i < MOST_NAMED else None
        axes.plot(*carriers[instants, i].T, "o", color=colour, label=label, zorder=4)
    times = ", ".join(f"{time:.3g}" for time in run.time[instants])
    label = f"load, at {times} s"
    axes.plot(*load[extreme_samples(load)].T, color="black", label=label, zorder=3)
    for path in (load, *carriers.swapaxes(0, 1)):
        is_shown = np.isfinite(path).all(axis=1)
        left = path[:-1][is_shown[:-1] & ~is_shown[1:]]
        label = "path goes on" if len(left) else None
        axes.plot(*left.T, "x", color="black", label=label, zorder=5)
    shades = np.linspace(_DARKEST, _LIGHTEST, len(corners))[::-1]
    for outline, alpha in zip(corners, shades, strict=True):
        axes.fill(*_hull(outline).T, facecolor="0.2", edgecolor="black", alpha=alpha)
    axes.margins(0.05)
    axes.set_aspect("equal", adjustable="datalim")
    if view is not _FROM_ABOVE:
        axes.set_axis_off()
        _draw_directions(axes, view, drawn, unit)
    return legend_above(figure)


def _hull(points: NDArray) -> NDArray:
    """Of points (n, 2) on the page the farthest in each direction, one after the other."""
    angles = np.linspace(0, 2 * np.pi, _DIRECTIONS)
    return points[np.argmax(points @ [np.cos(angles), np.sin(angles)], axis=0)]


def _draw_directions(axes: Axes, view: NDArray, drawn: NDArray, unit: str) -> None:
    """Draws x, y and z with their length below the points `drawn` (k, 2), in the unit.

    `view` has the page's directions (2, 3).
    """
    longest = _SCALE * np.ptp(drawn, axis=0).max()
    digit = 10.0 ** np.floor(np.log10(longest))
    length = max(k * digit for k in (1, 2, 5) if k * digit <= longest)
    origin = drawn.min(axis=0) - 1.4 * length * np.maximum(view.T, 0).max(axis=0)
    line = {"linewidth": 0.7, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 5}
    for direction, name in zip(length * view.T, "xyz", strict=True):
        axes.annotate("", origin + direction, origin, arrowprops=line | {"arrowstyle": "-|>"})
        axes.text(*(origin + 1.25 * direction), name, style="italic", ha="center", va="center")
    middle = origin + 0.5 * length * view[:, 2]
    axes.text(*middle, f"{length:g} {unit} ", fontsize="small", ha="right", va="center")
    axes.update_datalim(origin + 1.4 * length * np.vstack([np.zeros(2), view.T]))


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
