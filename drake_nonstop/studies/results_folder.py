"""The folder with the results of one run."""

import json
from pathlib import Path
from typing import Any, BinaryIO

from drake_nonstop.run.metrics import compute_metrics
from drake_nonstop.run.outcome import RunOutcome
from drake_nonstop.run.run import Run
from drake_nonstop.run.stored_run import SCENARIO, SIGNALS, write_signals
from drake_nonstop.scenario.loading import dump_scenario
from drake_nonstop.studies.files import as_path, replacing_files, require_writable, write_json
from drake_nonstop.studies.workers import Progress, no_progress
from drake_nonstop.validation import require, require_flags
from drake_nonstop.view.drawing import draw_diagram
from drake_nonstop.view.figure_style import FORMATS
from drake_nonstop.view.run_figures import FIGURES, figure_names, make_figure

METRICS = "metrics.json"
_DIAGRAM, _REPLAY = "diagram.svg", "replay.html"
_FIGURES = [f"figures/{name}.{kind}" for kind in FORMATS for name in FIGURES]

# All files that may be written; those that a run does not write are removed.
RUN_FILES = (SCENARIO, METRICS, SIGNALS, _DIAGRAM, _REPLAY, *_FIGURES)


def stopped_folder(folder: Path) -> Path:
    """Where the results of a run go that ended before its time: not over those of a whole one.

    It is the folder itself, or FOLDER_stopped where the folder has those of a whole run.
    """
    try:
        outcome = json.loads((folder / METRICS).read_bytes())["outcome"]
    except (OSError, ValueError, KeyError, TypeError):
        return folder
    named = folder if folder.name not in ("", "..") else folder.resolve()
    is_stopped = outcome == RunOutcome.STOPPED.value
    return folder if is_stopped else named.with_name(f"{named.name}_stopped")


def write_results(
    run: Run, folder: Path | str, *, figures: bool | str = True, replay: bool = True
) -> dict[str, Any]:
    """Writes a run's results to the folder and returns its metrics.

    scenario.yaml (resolved), metrics.json and signals.npz replace all earlier results at once;
    diagram.svg, replay.html and figures/ follow, one by one. `Run.load` reads the run back.

    `figures` may also be their format: "png", "pdf" or "svg".

    Raises:
        ScenarioError: the folder cannot be written, or another argument is wrong; then all but the
            pictures is written.
    """
    metrics = write_data(run, folder)
    require_flags(replay=replay)  # only now: the flight is written
    is_known = isinstance(figures, bool) or (isinstance(figures, str) and figures in FORMATS)
    require(is_known, "figures", figures, f"give true or false, or {' or '.join(FORMATS)}")
    write_pictures(run, folder, figures=figures, replay=replay)
    return metrics


def write_data(run: Run, folder: Path | str) -> dict[str, Any]:
    """Writes all but the pictures in place of all earlier results, and returns the metrics."""
    require(isinstance(run, Run), "run", type(run).__name__, "give a Run, which simulate returns")
    folder = as_path(folder)
    require_writable(folder, RUN_FILES)
    metrics = compute_metrics(run)
    with replacing_files(folder, RUN_FILES) as new:
        (new / SCENARIO).write_text(dump_scenario(run.scenario), encoding="utf-8")
        write_json(new / METRICS, metrics)
        write_signals(new / SIGNALS, run)
    return metrics


def write_pictures(
    run: Run,
    folder: Path | str,
    *,
    figures: bool | str = True,
    replay: bool = True,
    progress: Progress = no_progress,
) -> None:
    """Writes diagram.svg, replay.html and figures/, each of which appears once it is complete.

    `figures` is as of `write_results`.
    """
    folder = as_path(folder)
    kind = figures if isinstance(figures, str) else FORMATS[0]
    items = [_DIAGRAM, _REPLAY] if replay else [_DIAGRAM]
    items += [f"figures/{name}.{kind}" for name in figure_names(run)] if figures else []
    for k, item in enumerate(items):
        progress("writing", k / len(items))
        with replacing_files(folder, [item]) as new:
            (new / item).parent.mkdir(exist_ok=True)
            with (new / item).open("wb") as file:
                _write_picture(run, item, file)


def _write_picture(run: Run, item: str, file: BinaryIO) -> None:
    if item == _DIAGRAM:
        file.write(draw_diagram(run.diagram).encode())
    elif item == _REPLAY:
        from drake_nonstop.view.replay import record_replay

        file.write(record_replay(run).encode())
    else:
        name, _, kind = Path(item).name.partition(".")
        make_figure(run, name).write(file, kind)
