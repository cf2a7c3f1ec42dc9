"""The replay of a run: an animated 3D scene in one HTML file that opens offline."""

import base64
import contextlib
import gzip
import html
import itertools
import math
import re
from collections.abc import Sequence
from importlib import resources
from string import Template

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import MeshcatAnimation

from drake_nonstop.mechanics.signals import SIGNAL_PERIOD, AircraftState
from drake_nonstop.run.run import Run
from drake_nonstop.run.run_quantities import RunQuantities, carrier_speeds
from drake_nonstop.run.signal_table import UnknownSignalError
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.view.bodies import (
    AXIS_COLOURS,
    CABLE_COLOURS,
    GOAL_COLOUR,
    LOAD_COLOUR,
    MARK_COLOURS,
    OBSTACLE_COLOUR,
    REFERENCE_COLOUR,
    SLACK_COLOUR,
    Snapshot,
    stall_shares,
)
from drake_nonstop.view.canvas import RecordingCanvas
from drake_nonstop.view.figure_style import MOST_POINTS, extreme_samples
from drake_nonstop.view.meshcat_server import start_hidden_meshcat
from drake_nonstop.view.nonstop_visualizer import NonstopVisualizer
from drake_nonstop.view.replay_figure import figure_of
from drake_nonstop.view.scene import COLOURED_FROM, MARK_RANGE, TENSION_RANGE, Scene

_FRAME_RATE = 12.5  # 1/s; the page interpolates between frames
_MOST_POSES = 45_000  # in all frames, half of those of carriers, cables and loads: below 20 MB
_MOST_FRAMES = 3_000  # of a page that is written in a few seconds
# How Meshcat writes what the page tells the viewer.
_COMMAND = re.compile(
    r'fetch\("data:application/octet-binary;base64,([\w+/=]+)"\)'
    r"\s*\.then\(res => res\.arrayBuffer\(\)\)"
)
_LARGE = 20_000  # characters of a command


class Replay(str):
    """A page in HTML, which a notebook shows in a frame where it is the result of a cell."""

    def _repr_html_(self) -> str:
        return (
            f'<iframe title="Replay" loading="lazy" srcdoc="{html.escape(self)}" '
            'style="width: 100%; height: 28em; border: 0"></iframe>'
        )


def record_replay(run: Run, *, frame_rate: float | None = None, has_figure: bool = True) -> Replay:
    """The run as a Meshcat recording (see `Scene`) in an HTML page that loads nothing else.

    The recording ends before the first sample that is not finite.

    Args:
        run: returned by `simulate`, or carried by a RunStopped or RunInterrupted.
        frame_rate: frames per second of simulated time, at most those of the signals; the page
            interpolates between them. Without it 12.5, or fewer beyond four minutes and where the
            page would be larger than 20 MB.
        has_figure: whether the control figure is beside the scene, with the values of its wires.

    Raises:
        ScenarioError: a field of the scenario's scene is out of range.
    """
    n = len(run.scenario.system.attachments)
    nodes = run.signal("cable_state").shape[1] // (6 * n) if RunQuantities(run).has_nodes else 0
    scene = Scene(run.scenario, nodes)
    if frame_rate is None:  # a whole part of the signals'
        poses = n * (1 + scene.pieces) // 2 + 1
        most = max(min(_MOST_POSES // poses, _MOST_FRAMES), 1)
        stride = max(round(1 / (SIGNAL_PERIOD * _FRAME_RATE)), math.ceil(len(run.time) / most))
        frame_rate = 1 / (SIGNAL_PERIOD * stride)
    frame_rate = min(frame_rate, 1 / SIGNAL_PERIOD)
    samples = np.unique(np.floor(run.time * frame_rate + 1e-6), return_index=True)[1]
    snapshots = _snapshots(run, samples)
    page = _COMMAND.sub(_compressed, _recorded(scene, snapshots, frame_rate))
    if not snapshots:
        return Replay(page)
    body, end = page.rsplit("</body>", 1)
    overlay = _overlay(run, scene, snapshots)
    if has_figure and run.diagram:
        overlay += figure_of(run, samples[: len(snapshots)])
    return Replay(f"{body}{overlay}</body>{end}")


def _recorded(scene: Scene, snapshots: list[Snapshot], frame_rate: float) -> str:
    """Meshcat's page of the recording."""
    meshcat, _ = start_hidden_meshcat()
    if snapshots:
        path = np.array([snapshot.reference.position for snapshot in snapshots])
        carriers = np.array([snapshot.carriers.positions for snapshot in snapshots])
        scene.set_stage(meshcat, path, carriers)
        scene.draw(meshcat)
        scene.draw_task(meshcat, snapshots)
        canvas = RecordingCanvas(MeshcatAnimation(frame_rate))
        for frame, snapshot in enumerate(snapshots):
            canvas.frame = frame
            scene.show(canvas, snapshot)
        canvas.finish()
        meshcat.SetAnimation(canvas.animation)
    return meshcat.StaticHtml()


def _compressed(command: re.Match[str]) -> str:
    """A command of the page, compressed where it is large, as the animation is."""
    if len(command[1]) < _LARGE:
        return command[0]
    data = base64.b64encode(gzip.compress(base64.b64decode(command[1]), 6, mtime=0)).decode()
    return (
        f'fetch("data:application/gzip;base64,{data}")\n    .then(res => new Response('
        'res.body.pipeThrough(new DecompressionStream("gzip"))).arrayBuffer())'
    )


def _snapshots(run: Run, samples: NDArray) -> list[Snapshot]:
    """The run at some of its samples, up to the first that cannot be shown."""
    signals = {"speed_bound": np.full((len(run.time), 1), run.scenario.speed_bound)}
    for name in NonstopVisualizer.reads:
        with contextlib.suppress(UnknownSignalError):
            signals[name] = run.signal(name)
    instants = (
        Snapshot.from_signals(
            run.time[sample], **{name: values[sample] for name, values in signals.items()}
        )
        for sample in samples
    )
    return [*itertools.takewhile(lambda snapshot: snapshot.is_finite, instants)]


def legend(scenario: Scenario, *, has_aircraft: bool = False, square: float = 0.0) -> str:
    """The legend of the scene in HTML, with axes as long as a `square` of the grid, m, if not 0."""
    marks = f"carrier's speed, from {MARK_RANGE:g} ε down to ε"
    if has_aircraft:
        marks = f"wing, from {COLOURED_FROM:g} of the stall up to it"
    colours: list[tuple[Sequence[str], str]] = [
        (MARK_COLOURS[::-1], marks),
        (CABLE_COLOURS, f"tension, up to {TENSION_RANGE:g} × weight / carriers"),
        ([SLACK_COLOUR] * 2, "slack cable"),
        ([LOAD_COLOUR] * 2, "load and its path"),
        ([REFERENCE_COLOUR] * 2, "reference: the desired pose and its path"),
        ([GOAL_COLOUR] * 2, "goal: the last reference"),
    ]
    if square:
        colours.append((AXIS_COLOURS, f"x, y, z: {square:g} m each, as a square of the grid"))
    if scenario.obstacles:
        colours.append(([OBSTACLE_COLOUR] * 2, "obstacle"))
    swatch = '<span><span class="swatch" style="background:linear-gradient(to right,{})"></span>{}'
    return "".join(swatch.format(",".join(names), text) + "</span>" for names, text in colours)


def _overlay(run: Run, scene: Scene, snapshots: list[Snapshot]) -> str:
    """The HTML below the scene: a time bar, a legend, and what a run is judged by with its bound.

    That is the slowest carrier's speed with ε, or how near the nearest aircraft is to its stall.
    """
    start = snapshots[0].time
    duration = snapshots[-1].time - start
    times = np.array([snapshot.time - start for snapshot in snapshots])
    bounds = np.array([float(snapshot.speed_bound) for snapshot in snapshots])
    end = np.searchsorted(run.time, snapshots[-1].time, side="right")
    quantities = RunQuantities(run)
    if quantities.has_aircraft:
        bounds = np.ones(len(times))
        state = AircraftState.view(run.signal("aircraft_state")[:end])
        values = stall_shares(quantities.aircraft, state).max(axis=1)
        name, unit, sign = "stall", "", -1
        judged = "black: the aircraft nearest to its stall (dashed), by lift or airspeed"
    else:
        values = carrier_speeds(run.signal("carrier_state")[:end]).min(axis=1)
        name, unit, sign = "ε", " m/s", 1
        judged = "black: speed of the slowest carrier (m/s); dashed: the bound ε"
    shown = extreme_samples(values, MOST_POINTS // 4)
    shown = shown[np.isfinite(values[shown])]
    margins = sign * (values - np.interp(run.time[:end] - start, times, bounds))
    least = int(np.nanargmin(margins))
    judged += f"; least margin {margins[least]:.3g}{unit} at {run.time[least]:.2f} s"
    drawn = np.concatenate([values[shown], bounds])
    ticks, room = np.array([drawn.min(), drawn.max()]), 0.05 * max(np.ptp(drawn), 1e-3)
    bottom, top = ticks[0] - room, ticks[1] + room
    labels = [f'<span class="tick" style="top: {{}}%">{tick:.3g}</span>' for tick in ticks]
    labels += [f'<span class="bound" style="top: {{}}%">{name} {bounds[-1]:.3g}</span>']
    heights = 100 * (top - np.append(ticks, bounds[-1])) / (top - bottom)
    lines = (f'<line stroke="#ddd" x2="{duration:g}" y1="{y:g}" y2="{y:g}"/>' for y in ticks)
    page = resources.files("drake_nonstop.view").joinpath("replay_overlay.html")
    return Template(page.read_text(encoding="utf-8")).substitute(
        title=html.escape(run.scenario.name),
        legend=legend(run.scenario, has_aircraft=quantities.has_aircraft, square=scene.square),
        duration=f"{duration:g}",
        top=f"{top:g}",
        bottom=f"{bottom:g}",
        range=f"{top - bottom:g}",
        labels="".join(map(str.format, labels, map("{:.1f}".format, heights))),
        lines="".join(lines),
        values=_polyline(run.time[shown] - start, values[shown]),
        meaning=judged,
        bound=_polyline(times, bounds),
        aspect=f"{scene.aspect_ratio:.3g}",
        sign=sign,
        unit=unit,
    )


def _polyline(times: NDArray, values: NDArray) -> str:
    """The points of an SVG polyline."""
    return " ".join(f"{time:g},{value:.4g}" for time, value in zip(times, values, strict=True))
