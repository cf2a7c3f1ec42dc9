"""The README's pictures: the line task with and without optimization, patterns, aircraft."""

import io
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from drake_nonstop.analysis.aircraft_margins import aircraft_margins
from drake_nonstop.mechanics.distances import segment_distances
from drake_nonstop.mechanics.signals import CarrierStates
from drake_nonstop.run.run import Run
from drake_nonstop.run.run_quantities import (
    RunQuantities,
    attachment_positions,
    carrier_speeds,
)
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.view.bodies import carrier_colour
from drake_nonstop.view.browser import open_browser
from drake_nonstop.view.figure_style import (
    LIMIT,
    PAGE,
    in_paper_style,
    legend_above,
    new_figure,
)
from drake_nonstop.view.task_figures import make_aircraft_margins_figure
from drake_nonstop.view.video import encode_gif, replay_pictures

_VIEW = 640, 460  # pixels, of one page
_SPAN = 6.0, 11.0  # s, of the animation: the load sets off, and comes to its speed
_FRAME_RATE = 12  # 1/s
_TURN = 23  # s, of the patterns
_STILL_TIME = 8.0  # s, about which the still is of the slowest instant
_TASK = "aircraft_transfer"
_FLIGHT = 30.0, 60.0  # s, of the aircraft: the load is fastest in the middle
_CLOSE_VIEW = {"width": 700, "height": 700}  # pixels, of the aircraft


def make_pictures(folder: Path) -> list[Path]:
    """Writes the pictures to a folder, and returns where they are.

    Raises:
        ScenarioError: there is no browser to take them with.
    """
    with open_browser(*_VIEW) as page:
        runs = _runs()
        slow = carrier_speeds(runs[0].signal("carrier_state")).min(axis=1)
        around = np.abs(runs[0].time - _STILL_TIME) < 1.5
        still_time = runs[0].time[around][np.argmin(slow[around])]
        times = [float(still_time), *np.arange(*_SPAN, 1 / _FRAME_RATE)]
        views = [_views(page, run, times) for run in runs]
        flight = simulate(load_scenario(_TASK, [f"simulation_duration={_FLIGHT[1]}"]))
        page.set_viewport_size(_CLOSE_VIEW)
        hardest = _hardest_instant(flight)
        (flying,) = _views(page, flight, [hardest])
    still, *moving = [
        _figure(runs, list(pair), time) for time, *pair in zip(times, *views, strict=True)
    ]
    pictures = {
        "line.png": _png(still, dpi=200),
        "line.gif": encode_gif([_png(figure, dpi=106) for figure in moving], _FRAME_RATE),
        "real_scale.png": _png(_encounters_figure(_patterns()), dpi=200),
        "aircraft.png": _png(_aircraft_figure(flight, flying, hardest), dpi=200),
        "aircraft_check.png": _png(
            make_aircraft_margins_figure(aircraft_margins(load_scenario(_TASK))), dpi=140
        ),
    }
    for name, content in pictures.items():
        (folder / name).write_bytes(content)
    return [folder / name for name in pictures]


def _patterns() -> dict[str, Run]:
    """The real-scale scenarios' patterns above a resting load, for a turn."""
    duration = f"simulation_duration={_TURN}"
    overrides = [duration, "load_trajectory.start_time=30", "engine=compiled"]
    return {
        title: simulate(load_scenario(name, overrides))
        for name, title in (
            ("real_scale_cycle", "the paper's cycle"),
            ("real_scale_carousel", "carousel"),
            ("real_scale_spread", "spread carousel"),
        )
    }


def _runs() -> list[Run]:
    """The line task without and with optimization, a little longer than it is shown."""
    runs = []
    for overrides in (["optimization_layer=!ConstantParameters {}"], []):
        duration = f"simulation_duration={_SPAN[1] + 1.0}"
        runs.append(simulate(load_scenario("line", [duration, *overrides])))
    return runs


def _views(page: Any, run: Run, times: list[float]) -> list[NDArray]:
    """Pictures of the run's replay at some times."""
    pictures = replay_pictures(page, run, times)
    return [matplotlib.image.imread(io.BytesIO(picture)) for picture in pictures]


@in_paper_style
def _figure(runs: list[Run], views: list[NDArray], time: float) -> Figure:
    figure = new_figure((PAGE, 3.5))
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(runs), height_ratios=[3.4, 1], sharey="row")
    for (top, bottom), run, view, title in zip(
        axes.T, runs, views, ("without optimization", "with optimization"), strict=True
    ):
        top.imshow(view)
        top.set_title(title)
        top.set_axis_off()
        shown = (run.steps["time"] >= _SPAN[0]) & (run.steps["time"] <= _SPAN[1])
        times = run.steps["time"][shown]
        for i, speeds in enumerate(carrier_speeds(run.steps["carrier_state"][shown]).T):
            colour = carrier_colour(i)
            bottom.plot(times, speeds, color=colour, linewidth=1.0)
        bounds = RunQuantities(run).speed_bounds
        bottom.plot(times, bounds[shown], **LIMIT)
        bottom.axvline(time, color="0.5", linewidth=1.0)
        bottom.set_xlim(_SPAN)
        bottom.set_ylim(0, 1.1 * max(carrier_speeds(r.steps["carrier_state"]).max() for r in runs))
        bottom.set_xlabel("time (s)")
    axes[1, 0].set_ylabel("speed (m/s),\nbound ε dashed")
    return figure


def _hardest_instant(run: Run) -> float:
    """When an aircraft comes closest to its largest lift, s."""
    time = run.steps["time"]
    lift = RunQuantities(run).aircraft_state.lift.max(axis=1)
    return float(time[np.argmax(np.where(time >= _FLIGHT[0], lift, 0.0))])


@in_paper_style
def _encounters_figure(runs: dict[str, Run]) -> Figure:
    """Orbits above a resting load, and least distances of carriers and of cables, over time.

    There is a column for each of `runs`, which are given by their titles. Cables are drawn at the
    instant at which two of them, or two carriers, are closest.
    """
    figure = new_figure((PAGE, 3.8))
    grid = figure.add_gridspec(2, len(runs), height_ratios=[1.3, 1])
    for k, (title, run) in enumerate(runs.items()):
        carriers = CarrierStates.view(run.signal("carrier_state")).positions
        ends = attachment_positions(run, run.signal("load_state"))
        one, other = np.triu_indices(carriers.shape[1], 1)
        cables = ends[:, one], carriers[:, one], ends[:, other], carriers[:, other]
        apart = np.linalg.norm(cables[1] - cables[3], axis=-1), segment_distances(*cables)
        closest = tuple(distances.min(axis=1) for distances in apart)
        instant = int(np.argmin(np.minimum(*closest)))
        axes = figure.add_subplot(grid[0, k], projection="3d")
        for i in range(carriers.shape[1]):
            axes.plot(*carriers[:, i].T, color=f"C{i}", linewidth=1)
            cable = np.stack([ends[instant, i], carriers[instant, i]])
            axes.plot(*cable.T, color="black", linewidth=0.7)
            axes.plot(*carriers[instant, i], "o", color=f"C{i}", markersize=5)
        axes.set_aspect("equal")
        axes.set_box_aspect(None, zoom=1.25)
        axes.set_title(title)
        axes.set_zlabel("z (m)", labelpad=-4)
        axes.view_init(elev=22, azim=-60)
        axes.tick_params(labelsize=6)
        axes.locator_params(nbins=4)
        lower = figure.add_subplot(grid[1, k])
        for distances, name, colour in zip(
            closest, ("carriers", "cables"), ("C0", "C1"), strict=True
        ):
            shown = np.maximum(distances, 1e-3)  # m: a logarithmic axis has no zero
            lower.semilogy(run.time, shown, label=name, color=colour)
        lower.set_ylim(1e-3, 200)
        lower.set_xlabel("time (s)")
        if k == 0:
            lower.set_ylabel("closest two (m)")
    return legend_above(figure)


@in_paper_style
def _aircraft_figure(run: Run, view: NDArray, time: float) -> Figure:
    """The aircraft at an instant, and their lift, bank and thrust about it."""
    figure = new_figure((PAGE, 3.5))
    FigureCanvasAgg(figure)
    left, right = figure.subfigures(1, 2, width_ratios=[1, 1])
    scene = left.subplots()
    scene.imshow(view)
    scene.set_axis_off()
    quantities = RunQuantities(run)
    state = quantities.aircraft_state
    shown = run.steps["time"] >= _FLIGHT[0]
    panels = right.subplots(3, 1, sharex=True)
    for axes, values, title in (
        (panels[0], state.lift / quantities.aircraft.max_lift, r"$C_L$ / $C_{L,\mathrm{max}}$"),
        (panels[1], np.degrees(state.bank), "bank (°)"),
        (panels[2], state.thrust, "thrust (N)"),
    ):
        for i, column in enumerate(values.T):
            colour = carrier_colour(i)
            label = f"carrier {i + 1}"
            axes.plot(run.steps["time"][shown], column[shown], color=colour, label=label)
        axes.axvline(time, color="0.5", linewidth=1.0)
        axes.set_ylabel(title)
    panels[0].axhline(1, **LIMIT, label="stall")
    panels[2].axhline(0, color="black", linewidth=0.6, label="below it the propeller brakes")
    panels[0].set_ylim(bottom=0)
    panels[-1].set_xlabel("time (s)")
    panels[-1].set_xlim(_FLIGHT)
    return legend_above(figure)


def _png(figure: Figure, dpi: int) -> bytes:
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=dpi)
    return file.getvalue()
