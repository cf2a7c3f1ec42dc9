"""The folder with the results of one run."""

import contextlib
import itertools
import json
import os
import signal
import sys
import threading
import zipfile
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, BinaryIO

from drake_nonstop.run.metrics import compute_metrics, value_at
from drake_nonstop.run.outcome import RunOutcome
from drake_nonstop.run.run import Run
from drake_nonstop.run.stored_run import (
    SCENARIO,
    SIGNALS,
    VARYING,
    write_signals,
)
from drake_nonstop.scenario.loading import dump_scenario
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.files import (
    as_path,
    open_regular,
    read_regular,
    remove_unfinished,
    replacing_files,
    require_writable,
    write_json,
)
from drake_nonstop.studies.journal import is_written, journalled_settings, own_code_of
from drake_nonstop.studies.workers import Progress, end_with_parent, no_progress
from drake_nonstop.validation import require, require_flags
from drake_nonstop.view.drawing import draw_diagram
from drake_nonstop.view.figure_style import FORMATS
from drake_nonstop.view.replay import record_replay
from drake_nonstop.view.run_figures import FIGURES, figure_names, make_figure

_METRICS = "metrics.json"
_DATA = (SCENARIO, _METRICS, SIGNALS)
_OWN_CODE = "own_code"  # in metrics.json, beside the versions of packages

_DIAGRAM, _REPLAY = "diagram.svg", "replay.html"
_FIGURES = [f"figures/{name}.{kind}" for kind in FORMATS for name in FIGURES]
_PICTURES = (_DIAGRAM, _REPLAY, *_FIGURES)

# All files that may be written; those that a run does not write are removed.
RUN_FILES = (*_DATA, *_PICTURES)


def default_folder(folder: Path, settings: str | Scenario) -> Path:
    """Where results go unless the user names a folder: not over those of other settings.

    It is the folder itself, or the first of FOLDER_2, FOLDER_3, ... that has no results yet, or
    those of the same settings. Those of a study are by `settings_of`; those of a run are its
    scenario and the user's own modules that it names, and of one that was steered never the same.
    """

    def is_free(place: Path) -> bool:
        journalled = journalled_settings(place)
        if journalled is not None:
            return journalled == settings
        names = [name for name in (SCENARIO, _METRICS) if os.path.lexists(place / name)]
        return not names or (isinstance(settings, Scenario) and _is_of(place, names, settings))

    return first_free(folder, is_free)


def stopped_folder(folder: Path) -> Path:
    """Where the results of a run go that ended before its time: not over those of a whole one.

    It is the folder itself, or the first of FOLDER_stopped, FOLDER_stopped_2, ... that has no
    results yet, or those of another run that was stopped.
    """

    def is_free(place: Path) -> bool:
        has_results = any(os.path.lexists(place / item) for item in RUN_FILES)
        return not has_results or _metrics_in(place).get("outcome") == RunOutcome.STOPPED.value

    named = folder if folder.name not in ("", "..") else Path(os.path.abspath(folder))
    return first_free(folder, is_free, Path(f"{named}_stopped"))


def first_free(folder: Path, is_free: Callable[[Path], bool], other: Path | None = None) -> Path:
    """The folder where it is free or none is there, or else the first of OTHER, OTHER_2, ...

    The other one is FOLDER_2 unless it is given.
    """
    base = other or folder
    numbered = (base.with_name(f"{base.name}_{k}") for k in itertools.count(2))
    return next(
        place
        for place in itertools.chain([folder, base], numbered)
        if not os.path.lexists(place) or (place.is_dir() and is_free(place))
    )


def require_no_other_run(folder: Path, scenario: Scenario) -> None:
    """Raises ScenarioError where the results of a run of another scenario are in the folder."""
    is_same = is_written(folder, SCENARIO, dump_scenario(scenario))
    is_other = os.path.lexists(folder / _METRICS) and not is_same
    remedy = f"a run of other settings has its {SCENARIO} there; give another folder"
    require(not is_other, "--out", folder, remedy)


def _is_of(folder: Path, names: Sequence[str], scenario: Scenario) -> bool:
    """Whether the files of these names in a folder are those of such a run, which repeats them."""
    text, metrics = dump_scenario(scenario), _metrics_in(folder)
    own_code = value_at(metrics, f"versions.{_OWN_CODE}")
    is_same = metrics.get("is_steered") is False and own_code == own_code_of(text)
    return is_written(folder, SCENARIO, text) and (is_same or _METRICS not in names)


def _metrics_in(folder: Path) -> dict[str, Any]:
    """The metrics in a folder; empty where there are none that can be read."""
    try:
        metrics = json.loads(read_regular(folder / _METRICS))
    except (OSError, ValueError, RecursionError):
        return {}
    return metrics if isinstance(metrics, dict) else {}


def write_results(
    run: Run,
    folder: Path | str,
    *,
    figures: bool | str = True,
    replay: bool = True,
) -> dict[str, Any]:
    """Writes a run's results to the folder and returns its metrics.

    scenario.yaml (resolved), metrics.json and signals.npz replace all of the earlier
    results once they are written; diagram.svg, replay.html and figures/ follow, one by one.
    Earlier ones that show the same flight stay until then. `Run.load` reads the run back.

    `figures` may also be their format: "png", "pdf" or "svg".

    Raises:
        ScenarioError: the folder cannot be written, or one of the others is no such value; then
            all but the pictures is written.
    """
    metrics = write_data(run, folder)
    require_flags(replay=replay)  # only now: the flight is written
    is_known = isinstance(figures, bool) or (isinstance(figures, str) and figures in FORMATS)
    require(is_known, "figures", figures, f"give true or false, or {' or '.join(FORMATS)}")
    write_pictures(run, folder, figures=figures, replay=replay)
    return metrics


def write_data(run: Run, folder: Path | str, own_code: str | None = None) -> dict[str, Any]:
    """Writes all but the pictures, removes the earlier results, and returns the metrics.

    Pictures of an equal flight, with the same scenario and signals to the bit, are not removed.

    `own_code` is what `own_code_of` said of the scenario as it was loaded; None: as it is now.
    """
    require(isinstance(run, Run), "run", type(run).__name__, "give a Run, which simulate returns")
    folder = as_path(folder)
    require_writable(folder, RUN_FILES)
    metrics = compute_metrics(run)
    scenario = dump_scenario(run.scenario)
    own_code = own_code or own_code_of(scenario)
    if own_code is not None:
        metrics["versions"][_OWN_CODE] = own_code
    with replacing_files(folder, _DATA) as new:
        (new / SCENARIO).write_text(scenario, encoding="utf-8")
        write_json(new / _METRICS, metrics)
        write_signals(new / SIGNALS, run)
        is_other = _flight_in(folder) != _flight_in(new)
    if is_other:
        _remove(folder, _PICTURES)
    return metrics


def _remove(folder: Path, items: Sequence[str]) -> None:
    with replacing_files(folder, items):
        pass


def _flight_in(folder: Path) -> object:
    """Key of the data in a folder that pictures show: equal for equal flights only."""
    try:
        with open_regular(folder / SIGNALS) as file, zipfile.ZipFile(file) as archive:
            items = [item for item in archive.infolist() if item.filename not in VARYING]
            signals = [(item.filename, item.file_size, item.CRC) for item in items]
        return read_regular(folder / SCENARIO), signals
    except (OSError, ValueError, zipfile.BadZipFile):
        return None


def write_pictures(
    run: Run,
    folder: Path | str,
    *,
    figures: bool | str = True,
    replay: bool = True,
    progress: Progress = no_progress,
    may_fork: bool = False,
) -> None:
    """Writes diagram.svg, replay.html and figures/, each of which appears once it is complete.

    `figures` is as of `write_results`. Earlier pictures that are not asked for
    are removed at the end. With `may_fork`, for a process without threads that may hold a lock, a
    fork draws most of the figures meanwhile.
    """
    folder = as_path(folder)
    todo = [_DIAGRAM, _REPLAY] if replay else [_DIAGRAM]
    kind = figures if isinstance(figures, str) else FORMATS[0]
    drawn = [f"figures/{name}.{kind}" for name in figure_names(run)] if figures else []
    write = partial(_write_each, run, folder)
    if drawn and may_fork and sys.platform == "linux" and len(os.sched_getaffinity(0)) > 1:
        import matplotlib.figure  # noqa: F401 - once, for both processes

        most = drawn[len(drawn) // 4 :]
        fork = get_context("fork").Process(target=_draw, args=(write, most), daemon=True)
        fork.start()
        try:
            write([*todo, *drawn[: len(drawn) // 4]], progress)
            fork.join()
        finally:
            fork.kill()
            fork.join()
            remove_unfinished(folder)
        left = most if fork.exitcode else []  # this process tells why
    else:
        left = [*todo, *drawn]
    write(left, progress)
    _remove(folder, [item for item in _PICTURES if item not in (*todo, *drawn)])


def _draw(write: Callable[[Sequence[str]], None], items: Sequence[str]) -> None:
    """Writes pictures in a fork, which Ctrl-C does not reach and which ends with its parent."""
    signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
    threading.Thread(target=end_with_parent, daemon=True).start()
    with contextlib.suppress(BaseException):
        write(items)
        os._exit(0)
    os._exit(1)


def _write_each(
    run: Run, folder: Path, items: Sequence[str], progress: Progress = no_progress
) -> None:
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
        file.write(record_replay(run).encode())
    else:
        name, _, kind = Path(item).name.partition(".")
        make_figure(run, name).savefig(file, format=kind)
