"""The folder with the results of one run."""

import contextlib
import itertools
import json
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from drake_nonstop.scenario.loading import dump_scenario
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.simulation.metrics import compute_metrics
from drake_nonstop.simulation.run import Run
from drake_nonstop.studies.files import as_path, replacing_files, require_writable
from drake_nonstop.studies.journal import journalled_settings
from drake_nonstop.validation import require
from drake_nonstop.visualization.drawing import draw_diagram
from drake_nonstop.visualization.replay import record_replay
from drake_nonstop.visualization.run_figures import FIGURE_NAMES, make_figure

_FIGURES = "figures"
_SCENARIO = "scenario.yaml"

# All files that may be written; those that a run does not write are removed.
RUN_FILES = (
    _SCENARIO,
    "metrics.json",
    "signals.npz",
    "diagram.svg",
    "replay.html",
    *(f"{_FIGURES}/{name}.png" for name in FIGURE_NAMES),
)


def default_folder(folder: Path, settings: str | Scenario) -> Path:
    """Where results go unless the user names a folder: not over those of other settings.

    It is the folder itself, or the first of FOLDER_2, FOLDER_3, ... that has no results yet, or
    those of the same settings.

    Args:
        folder: the first to be tried.
        settings: of a study, by `settings_of`; of a run, its scenario.
    """

    def is_free(place: Path) -> bool:
        found: str | bytes | None = journalled_settings(place)
        if found is None:
            with contextlib.suppress(OSError):  # one that cannot be read cannot be written either
                found = (place / _SCENARIO).read_bytes()
        return found in (None, wanted)

    wanted = settings if isinstance(settings, str) else dump_scenario(settings).encode()
    numbered = (folder.with_name(f"{folder.name}_{k}") for k in itertools.count(2))
    return next(place for place in itertools.chain([folder], numbered) if is_free(place))


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
        (new / _SCENARIO).write_text(dump_scenario(run.scenario), encoding="utf-8")
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
