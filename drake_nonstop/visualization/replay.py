"""The replay of a run: an animated 3D scene in one HTML file that opens offline."""

import contextlib
import html
import itertools
from importlib import resources
from string import Template

import numpy as np
from pydrake.geometry import MeshcatAnimation

from drake_nonstop.model.system import overridden
from drake_nonstop.scenario.scene_config import SceneConfig
from drake_nonstop.simulation.run import SIGNAL_PERIOD, Run, UnknownSignalError
from drake_nonstop.visualization.canvas import RecordingCanvas
from drake_nonstop.visualization.meshcat_server import start_hidden_meshcat
from drake_nonstop.visualization.scene import Scene
from drake_nonstop.visualization.snapshot import Snapshot


def record_replay(run: Run, *, frame_rate: float = 25.0) -> str:
    """The run as a Meshcat recording (see `Scene`) in an HTML page that loads nothing else.

    The recording ends before the first sample that is not finite.

    Args:
        run: returned by `simulate`, or carried by a RunStopped or RunInterrupted.
        frame_rate: frames per second of simulated time, at most those of the signals; the page
            interpolates between them.

    Raises:
        ScenarioError: a field of the scenario's scene is out of range.
    """
    meshcat, _ = start_hidden_meshcat()
    frame_rate = min(frame_rate, 1 / SIGNAL_PERIOD)
    scene = Scene(overridden(run.scenario.system, run.scenario.simulated), run.scenario.scene)
    snapshots = _snapshots(run, frame_rate)
    if snapshots:
        path = np.array([snapshot.reference_position for snapshot in snapshots])
        scene.set_stage(meshcat, path, np.array([snapshot.carriers for snapshot in snapshots]))
        scene.draw(meshcat)
        animation = MeshcatAnimation(frame_rate)
        canvas = RecordingCanvas(animation)
        for frame, snapshot in enumerate(snapshots):
            canvas.frame = frame
            scene.show(canvas, snapshot)
        canvas.finish()
        meshcat.SetAnimation(animation)
    page = meshcat.StaticHtml()
    if not snapshots:
        return page
    body, end = page.rsplit("</body>", 1)
    overlay = _overlay(run.scenario.name, scene.config, snapshots)
    return f"{body}{overlay}</body>{end}"


def _snapshots(run: Run, frame_rate: float) -> list[Snapshot]:
    """The run at the instants of the frames, up to the first that cannot be shown."""
    speed_bounds = np.full(len(run.time), run.scenario.speed_bound)
    with contextlib.suppress(UnknownSignalError):
        speed_bounds = run.signal("speed_bound")[:, 0]
    frames = np.floor(run.time * frame_rate + 1e-6)
    snapshots = (
        Snapshot.from_signals(
            run.time[k],
            load_state=run.signal("load_state")[k],
            reference=run.signal("reference")[k],
            carrier_state=run.signal("carrier_state")[k],
            tensions=run.signal("tensions")[k],
            speed_bound=speed_bounds[k],
        )
        for k in np.unique(frames, return_index=True)[1]
    )
    return list(itertools.takewhile(lambda snapshot: snapshot.is_finite, snapshots))


def legend(config: SceneConfig) -> str:
    """The legend of the scene's colours in HTML; a sample of a colour has the class `swatch`."""
    colours = (
        (config.mark_colours[::-1], f"carrier's speed, from {config.mark_range:g} ε down to ε"),
        (config.cable_colours, f"tension, up to {config.tension_range:g} shares of the weight"),
        ([config.slack_colour] * 2, "slack cable"),
        ([config.load_colour] * 2, "load"),
        ([config.reference_colour] * 2, "where the load should be"),
    )
    swatch = '<span><span class="swatch" style="background:linear-gradient(to right,{})"></span>{}'
    return "".join(swatch.format(",".join(names), text) + "</span>" for names, text in colours)


def _overlay(title: str, config: SceneConfig, snapshots: list[Snapshot]) -> str:
    """The HTML below the scene: a time bar, a legend, and the slowest carrier's speed and ε."""
    start = snapshots[0].time
    times = [snapshot.time - start for snapshot in snapshots]
    slowest = [float(np.linalg.norm(each.velocities, axis=1).min()) for each in snapshots]
    bounds = [float(snapshot.speed_bound) for snapshot in snapshots]
    page = resources.files("drake_nonstop.visualization").joinpath("replay_overlay.html")
    return Template(page.read_text(encoding="utf-8")).substitute(
        title=html.escape(title),
        legend=legend(config),
        duration=f"{times[-1]:g}",
        top=f"{1.1 * max(*slowest, *bounds, 1e-3):.3g}",
        slowest=_polyline(times, slowest),
        bound=_polyline(times, bounds),
    )


def _polyline(times: list[float], values: list[float]) -> str:
    """The points of an SVG polyline."""
    return " ".join(f"{time:g},{value:.4g}" for time, value in zip(times, values, strict=True))
