"""The folder with the results of one run."""

import json
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from drake_nonstop.scenario.loading import dump_scenario
from drake_nonstop.simulation.metrics import compute_metrics
from drake_nonstop.simulation.run import Run
from drake_nonstop.studies.files import as_path, replacing_files, require_writable
from drake_nonstop.validation import require
from drake_nonstop.visualization.drawing import draw_diagram
from drake_nonstop.visualization.replay import record_replay
from drake_nonstop.visualization.run_figures import FIGURE_NAMES, make_figure

_FIGURES = "figures"

# All files that may be written; those that a run does not write are removed.
RUN_FILES = (
    "scenario.yaml",
    "metrics.json",
    "signals.npz",
    "diagram.svg",
    "replay.html",
    *(f"{_FIGURES}/{name}.png" for name in FIGURE_NAMES),
)


def write_results(
    run: Run, folder: Path | str, *, figures: bool = True, replay: bool = True
) -> dict[str, Any]:
    """Writes a run's results to the folder and returns its metrics.

    scenario.yaml (resolved), metrics.json and signals.npz replace all of the earlier results once
    they are written; diagram.svg, replay.html and figures/ follow, one by one.

    Args:
        run: what to write.
        folder: for the results, made where there is none.
        figures: whether to write figures.
        replay: whether to write the replay.

    Raises:
        ScenarioError: the folder cannot be written.
    """
    metrics = write_data(run, folder)
    write_pictures(run, folder, figures=figures, replay=replay)
    return metrics


def write_data(run: Run, folder: Path | str) -> dict[str, Any]:
    """Writes all but the pictures, removes the earlier results, and returns the metrics."""
    require(isinstance(run, Run), "run", type(run).__name__, "give a Run, which simulate returns")
    folder = as_path(folder)
    require_writable(folder, RUN_FILES)
    metrics = compute_metrics(run)
    with replacing_files(folder, RUN_FILES) as new:
        (new / "scenario.yaml").write_text(dump_scenario(run.scenario), encoding="utf-8")
        text = json.dumps(metrics, indent=2, allow_nan=False)
        (new / "metrics.json").write_text(text + "\n", encoding="utf-8")
        _write_signals(new / "signals.npz", run)
    return metrics


def write_pictures(
    run: Run,
    folder: Path | str,
    *,
    figures: bool = True,
    replay: bool = True,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> None:
    """Writes diagram.svg, replay.html and figures/, each of which appears once it is complete.

    Args:
        run: what to show.
        folder: as for `write_results`.
        figures: whether to write figures.
        replay: whether to write the replay.
        progress: called with a description and the share that is written.
    """
    folder = as_path(folder)
    todo: list[tuple[str, Callable[[BinaryIO], Any]]] = [
        ("diagram.svg", lambda file: file.write(draw_diagram(run.diagram).encode()))
    ]
    if replay:
        todo.append(("replay.html", lambda file: file.write(record_replay(run).encode())))
    if figures:
        todo += [
            (f"{_FIGURES}/{name}.png", partial(_write_figure, run, name)) for name in FIGURE_NAMES
        ]
    for k, (item, write) in enumerate(todo):
        progress("writing", k / len(todo))
        with replacing_files(folder, [item]) as new:
            (new / item).parent.mkdir(exist_ok=True)
            with (new / item).open("wb") as file:
                write(file)


def _write_figure(run: Run, name: str, file: BinaryIO) -> None:
    make_figure(run, name).savefig(file, format="png", dpi=150)


def _write_signals(path: Path, run: Run) -> None:
    """Writes what `np.savez_compressed` would, a signal at a time: not all are in memory."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("time", *run.signals):
            values = run.time if name == "time" else run.signals[name]
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, values, allow_pickle=False)
