"""The folder of results that a run leaves."""

import contextlib
import json
import os
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from drake_nonstop.scenario.loading import dump_scenario
from drake_nonstop.simulation.metrics import compute_metrics
from drake_nonstop.simulation.simulate import Run
from drake_nonstop.validation import ScenarioError
from drake_nonstop.visualization.drawing import draw_diagram
from drake_nonstop.visualization.replay import record_replay
from drake_nonstop.visualization.run_figures import FIGURE_NAMES, make_figures

_FIGURES = "figures"

# All that a run may leave; what this run does not write is not left over from another.
RUN_FILES = (
    "scenario.yaml",
    "metrics.json",
    "signals.npz",
    "diagram.svg",
    "replay.html",
    *(f"{_FIGURES}/{name}.png" for name in FIGURE_NAMES),
)


def require_writable(folder: Path) -> None:
    """Makes the folder, and raises ScenarioError where results cannot be written to it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ScenarioError(
            f"--out = {folder}: give a folder that can be written ({error.strerror})"
        ) from None


@contextlib.contextmanager
def replacing_file(path: Path) -> Iterator[BinaryIO]:
    """A file to write that takes the place of `path` once all is in it, or else is gone."""
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=path.suffix, delete=False) as file:
        try:
            yield file  # type: ignore[misc]
        except BaseException:
            os.unlink(file.name)
            raise
    os.chmod(file.name, 0o644)
    os.replace(file.name, path)


def write_json(path: Path, data: Any) -> None:
    """Writes the data to a file that is never half-written."""
    with replacing_file(path) as file:
        file.write((json.dumps(data, indent=2) + "\n").encode())


def write_results(
    run: Run, folder: Path, *, figures: bool = True, replay: bool = True
) -> dict[str, Any]:
    """Writes a run's results to the folder and returns its metrics.

    All is written to a folder beside the old results first, and moved over them at the
    end, so that no file is ever half-written.

    Raises:
        ScenarioError: the folder cannot be written.
    """
    require_writable(folder)
    metrics = compute_metrics(run)
    with replacing_files(folder, RUN_FILES) as new:
        (new / "scenario.yaml").write_text(dump_scenario(run.scenario), encoding="utf-8")
        text = json.dumps(metrics, indent=2, allow_nan=False)
        (new / "metrics.json").write_text(text + "\n", encoding="utf-8")
        np.savez_compressed(new / "signals.npz", **{"time": run.time, **run.signals})  # type: ignore[arg-type]
        (new / "diagram.svg").write_text(draw_diagram(run.diagram), encoding="utf-8")
        if replay:
            (new / "replay.html").write_text(record_replay(run), encoding="utf-8")
        if figures:
            (new / _FIGURES).mkdir()
            for name, figure in make_figures(run).items():
                figure.savefig(new / _FIGURES / f"{name}.png", dpi=150)
    return metrics


@contextlib.contextmanager
def replacing_files(folder: Path, contents: Iterable[str]) -> Iterator[Path]:
    """A new folder to write files to that take the place of those in `folder` at the end.

    `contents` are the paths, relative to it, of all that may be there: where there is no new
    file of that path, the old one is removed.

    Raises:
        ScenarioError: the folder cannot be written.
    """
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=".new-") as name:
            new = Path(name)
            yield new
            for item in contents:
                if (new / item).exists():
                    (folder / item).parent.mkdir(parents=True, exist_ok=True)
                    os.replace(new / item, folder / item)
                else:
                    (folder / item).unlink(missing_ok=True)
            with contextlib.suppress(OSError):  # where something of the user's is left in it
                (folder / _FIGURES).rmdir()
    except OSError as error:
        raise ScenarioError(
            f"--out = {folder}: give a folder with room to write to ({error.strerror})"
        ) from None
