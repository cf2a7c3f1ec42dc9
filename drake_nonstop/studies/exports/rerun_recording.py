"""A run for the viewer Rerun: the motion in space, and all signals as plots over time."""

from pathlib import Path
from typing import Any

import numpy as np

from drake_nonstop.mechanics.signals import CarrierStates, LoadState
from drake_nonstop.simulation.run import Run
from drake_nonstop.simulation.run_quantities import attachment_positions
from drake_nonstop.studies.files import replacing_files
from drake_nonstop.validation import require_installed

_TIMELINE = "time"
_DOT, _LINE = 0.02, 0.006  # of the size of the load, the radii of carriers and of cables


def write_rerun(run: Run, path: Path) -> None:
    """Writes a recording, `rerun FILE` shows it.

    Args:
        run: what to write.
        path: of the file, whose name ends in .rrd.

    Raises:
        ScenarioError: the package `rerun-sdk` is not installed, or the file cannot be written.
    """
    require_installed("export", rerun="drake-nonstop[export]")
    import rerun

    # The same run makes the same recording.
    name = f"drake_nonstop {run.scenario.name}"
    recording = rerun.RecordingStream("drake_nonstop", recording_id=name, send_properties=False)
    with replacing_files(path.parent, [path.name]) as new:
        recording.save(str(new / path.name))
        _send_motion(run, recording)
        _send_plots(run, recording)
        recording.flush()
        recording.disconnect()


def _send_motion(run: Run, recording: Any) -> None:
    import rerun

    index = rerun.TimeColumn(_TIMELINE, duration=run.time)
    positions = CarrierStates.view(run.signal("carrier_state")).positions
    ends = attachment_positions(run, run.signal("load_state"))
    count, n = positions.shape[:2]
    size = float(np.max(np.ptp(ends[0], axis=0)))
    recording.log("/", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    load = LoadState.view(run.signal("load_state"))
    attachments = np.asarray(run.scenario.system.attachments, dtype=float)
    half = np.maximum(np.ptp(attachments, axis=0) / 2, 0.02 * size)
    middle = (attachments.max(axis=0) + attachments.min(axis=0)) / 2
    recording.log("load", rerun.Boxes3D(centers=[middle], half_sizes=[half]), static=True)
    turned = rerun.Transform3D.columns(
        translation=load.position, quaternion=np.roll(load.quaternion, -1, axis=1)
    )
    recording.send_columns("load", indexes=[index], columns=turned)
    dots = rerun.Points3D.columns(
        positions=positions.reshape(-1, 3), radii=np.full(count * n, 3 * _DOT * size)
    ).partition(np.full(count, n))
    recording.send_columns("carriers", indexes=[index], columns=dots)
    lines = np.stack([ends, positions], axis=2)
    for k in range(n):
        cable = rerun.LineStrips3D.columns(strips=list(lines[:, k]))
        recording.send_columns(f"cables/{k + 1}", indexes=[index], columns=cable)


def _send_plots(run: Run, recording: Any) -> None:
    import rerun

    index = rerun.TimeColumn(_TIMELINE, duration=run.time)
    for signal, entries in run.entries.items():
        values = run.signals[signal]
        parts: dict[str, list[int]] = {}
        for column, entry in enumerate(entries):  # one plot for a vector
            parts.setdefault(entry.name.rpartition(".")[0] or entry.name, []).append(column)
        for part, columns in parts.items():
            place = f"plots/{part.replace('.', '/')}"
            names = [entries[column].label for column in columns]
            recording.log(place, rerun.SeriesLines(names=names), static=True)
            scalars = rerun.Scalars.columns(scalars=values[:, columns])
            recording.send_columns(place, indexes=[index], columns=scalars)
