"""The folder with the results of one run."""

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from drake_nonstop.scenario.loading import dump_scenario
from drake_nonstop.simulation.metrics import compute_metrics
from drake_nonstop.simulation.run import Run
from drake_nonstop.studies.files import replacing_files, require_writable
from drake_nonstop.visualization.drawing import draw_diagram
from drake_nonstop.visualization.replay import record_replay
from drake_nonstop.visualization.run_figures import FIGURE_NAMES, make_figures

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
        (new / "scenario.yaml").write_text(dump_scenario(run.scenario), encoding="utf-8")
        text = json.dumps(metrics, indent=2, allow_nan=False)
        (new / "metrics.json").write_text(text + "\n", encoding="utf-8")
        _write_signals(new / "signals.npz", run)
        (new / "diagram.svg").write_text(draw_diagram(run.diagram), encoding="utf-8")
        if replay:
            (new / "replay.html").write_text(record_replay(run), encoding="utf-8")
        if figures:
            (new / _FIGURES).mkdir()
            for name, figure in make_figures(run).items():
                figure.savefig(new / _FIGURES / f"{name}.png", dpi=150)
    return metrics


def _write_signals(path: Path, run: Run) -> None:
    """Writes what `np.savez_compressed` would, a signal at a time: not all are in memory."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("time", *run.signals):
            values = run.time if name == "time" else run.signals[name]
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, values, allow_pickle=False)
