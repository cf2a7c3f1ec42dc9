"""The folder with the results of one run."""

import contextlib
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np

from drake_nonstop.scenario.loading import dump_scenario
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.simulation.metrics import compute_metrics
from drake_nonstop.simulation.run import Run
from drake_nonstop.studies.files import replacing_files, require_writable
from drake_nonstop.studies.journal import journalled_settings
from drake_nonstop.visualization.drawing import draw_diagram
from drake_nonstop.visualization.replay import record_replay
from drake_nonstop.visualization.run_figures import FIGURE_NAMES, make_figures

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
    run: Run, folder: Path, *, figures: bool = True, replay: bool = True
) -> dict[str, Any]:
    """Writes a run's results to the folder and returns its metrics.

    scenario.yaml (resolved), metrics.json, signals.npz, diagram.svg, replay.html and figures/
    replace the earlier ones once all of them are written.

    Args:
        run: what to write.
        folder: for the results, made where there is none.
        figures: whether to write figures.
        replay: whether to write the replay.

    Raises:
        ScenarioError: the folder cannot be written.
    """
    require_writable(folder)
    metrics = compute_metrics(run)
    with replacing_files(folder, RUN_FILES) as new:
        (new / _SCENARIO).write_text(dump_scenario(run.scenario), encoding="utf-8")
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
