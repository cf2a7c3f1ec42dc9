"""A run to watch again: an animated 3D scene in one HTML file that opens offline."""

import contextlib
import html
import itertools
from importlib import resources
from string import Template

import numpy as np
from pydrake.geometry import MeshcatAnimation

from drake_nonstop.model.system import overridden
from drake_nonstop.simulation.simulate import SIGNAL_PERIOD, Run
from drake_nonstop.visualization.scene import (
    FilmCanvas,
    Scene,
    SceneConfig,
    Snapshot,
    start_meshcat,
)


def record_replay(run: Run, *, frame_rate: float = 25.0) -> str:
    """The run as a Meshcat recording (see `Scene`), an HTML page without links to the outside.

    Samples from the first that is not finite are left out.

    Args:
        run: what `simulate` returned, or what a RunStopped or RunInterrupted carries.
        frame_rate: frames per second of simulated time; between them the viewer
            interpolates.
    """
    meshcat = start_meshcat(port=0)
    frame_rate = min(frame_rate, 1 / SIGNAL_PERIOD)
    scene = Scene(overridden(run.scenario.system, run.scenario.simulated), run.scenario.scene)
    snapshots = _snapshots(run, frame_rate)
    if snapshots:
        path = np.array([snapshot.reference[4:] for snapshot in snapshots])
        scene.set_stage(meshcat, path, np.array([snapshot.carriers for snapshot in snapshots]))
        scene.draw(meshcat)
        animation = MeshcatAnimation(frame_rate)
        canvas = FilmCanvas(animation)
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
    states = run.signal("carrier_state").reshape(len(run.time), 2, -1, 3)
    speed_bounds = np.full(len(run.time), run.scenario.speed_bound)
    with contextlib.suppress(KeyError):
        speed_bounds = run.signal("speed_bound")[:, 0]
    frames = np.floor(run.time * frame_rate + 1e-6)
    snapshots = (
        Snapshot(
            time=run.time[k],
            load=run.signal("load_state")[k, :7],
            reference=run.signal("reference")[k, :7],
            carriers=states[k, 0],
            velocities=states[k, 1],
            tensions=run.signal("tensions")[k],
            speed_bound=speed_bounds[k],
        )
        for k in np.unique(frames, return_index=True)[1]
    )
    return list(itertools.takewhile(lambda snapshot: snapshot.is_finite, snapshots))


def legend(config: SceneConfig) -> str:
    """What the scene's colours mean, in HTML whose swatches have a class of that name."""
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
    """A play bar, what the colours mean, and the slowest carrier's speed beside ε."""
    start = snapshots[0].time
    times = [shot.time - start for shot in snapshots]
    slowest = [float(np.linalg.norm(shot.velocities, axis=1).min()) for shot in snapshots]
    bounds = [float(shot.speed_bound) for shot in snapshots]
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
    return " ".join(f"{time:g},{value:.4g}" for time, value in zip(times, values, strict=True))
