"""Many runs of one scenario, a row each in one table."""

import contextlib
import fcntl
import gc
import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from drake_nonstop.scenario.loading import dump_scenario, parse_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.scenario.yaml_text import dump_plain
from drake_nonstop.simulation.metrics import METRICS, compute_metrics, flattened
from drake_nonstop.studies.files import replacing_file, require_writable
from drake_nonstop.studies.run_all import FAILED, Progress, attempt, no_progress, run_all
from drake_nonstop.studies.sweep_spec import SweepSpec, dump_spec
from drake_nonstop.systems.block import release
from drake_nonstop.validation import ScenarioError, require

TABLE = "runs.parquet"
WALL_TIMES = "wall_times.parquet"
JOURNAL = "journal.jsonl"

_CHECKED_RUNS = 20  # one of them has to make a scenario before any run is simulated
_JSON_SEPARATORS = (",", ":")
_WALL_TIME_PATHS = {metric.path for metric in METRICS if metric.is_wall_time}

Result = dict[str, Any]  # of a run, as in the journal: outcome, error, metrics, wall_times


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """A completed sweep: its table, and how many runs had each outcome."""

    table: Path
    outcomes: dict[str, int]


class SweepInterrupted(KeyboardInterrupt):
    """A sweep was interrupted from the keyboard; the message says how many runs are done."""


def sweep(
    scenario: Scenario,
    spec: SweepSpec,
    folder: str | Path,
    *,
    executor: Executor | None = None,
    restart: bool = False,
    trust: bool = False,
    progress: Progress = no_progress,
) -> Sweep:
    """Simulates all runs of a sweep and writes a table with a row for each.

    The folder gets runs.parquet: per run its number, the seed of its draws, the values that were
    swept, the outcome ("completed", "diverged", "failed" where a block raised an error or the
    process died, or "unbuildable"), the error, and every metric that is one value, by its path
    in metrics.json. Rows are in the order of the runs and, to the bit, the same with any
    executor; metrics measured with a clock are therefore in wall_times.parquet.

    The result of each run is appended to journal.jsonl as it comes. An interrupted sweep
    continues from there when it is called again with the same scenario, spec and folder.

    Args:
        scenario: what the runs change.
        spec: what to run.
        folder: for the results, made where there is none.
        executor: any of concurrent.futures' kind, whose workers can import this package and the
            user's own blocks; it is not shut down. None: a process per core.
        restart: whether to remove the folder's earlier sweep and start again.
        trust: whether the spec may name the user's own blocks, which runs their code.
        progress: called with a description and the share that is done.

    Returns:
        The path of the table and the number of runs with each outcome.

    Raises:
        ScenarioError: the spec does not fit the scenario, the folder cannot be written, or has
            another sweep, or pyarrow is not installed.
        SweepInterrupted: Ctrl-C; the results that there are stay in the journal.
    """
    folder = Path(folder)
    _pyarrow()
    _require_runnable(scenario, spec, trust)
    text = dump_scenario(scenario)  # which can be sent to a process
    is_new = not folder.exists()
    require_writable(folder)
    total = len(spec)
    results: dict[int, Result] = {}
    try:
        with _journal(folder, _identity(text, spec), results, restart=restart) as file:
            (folder / "scenario.yaml").write_text(text, encoding="utf-8")
            (folder / "spec.yaml").write_text(f"{dump_spec(spec)}\n", encoding="utf-8")

            def record(number: int, result: Result) -> None:
                results[number] = result
                line = json.dumps({"run": number, **result}, separators=_JSON_SEPARATORS)
                file.write(f"{line}\n".encode())
                file.flush()

            missing = [number for number in range(total) if number not in results]
            try:
                run_all(
                    _simulated,
                    missing,
                    lambda number: (text, spec.run(number).overrides, trust),
                    record,
                    lambda number, error: _failed(error),
                    executor=executor,
                    what=f"simulating {total} runs",
                    progress=progress,
                    already_done=total - len(missing),
                )
            except KeyboardInterrupt:
                raise SweepInterrupted(
                    f"{len(results)} of {total} runs are in {folder}; the same call continues from "
                    "there"
                ) from None
            ordered = {number: results[number] for number in range(total)}
            _write_tables(folder, spec, ordered)
    except ScenarioError:
        if is_new:
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise
    outcomes = Counter(result["outcome"] for result in ordered.values())
    return Sweep(table=folder / TABLE, outcomes=dict(outcomes))


def _require_runnable(scenario: Scenario, spec: SweepSpec, trust: bool) -> None:
    """Raises the first ScenarioError where none of some runs, evenly chosen, has a scenario."""
    first_error = None
    step = max(1, len(spec) // _CHECKED_RUNS)
    for number in range(0, len(spec), step):
        try:
            changed(scenario, spec.run(number).overrides, trust=trust)
        except ScenarioError as error:
            first_error = first_error or error
        else:
            return
    assert first_error is not None
    raise first_error


def _identity(text: str, spec: SweepSpec) -> str:
    """A hash that differs between sweeps whose results may differ."""
    return hashlib.sha256(f"{text}\n{dump_spec(spec)}".encode()).hexdigest()


@contextlib.contextmanager
def _journal(
    folder: Path, identity: str, results: dict[int, Result], *, restart: bool
) -> Iterator[BinaryIO]:
    """The journal to append to, whose results are put into `results`.

    Its first line is the sweep's identity, and each other one a run's number and result.
    """
    path = folder / JOURNAL
    with path.open("a+b") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise ScenarioError(
                f"--out = {folder}: another sweep is running in it; wait for it or give another "
                "folder"
            ) from None
        if restart:
            file.truncate(0)
            for name in (TABLE, WALL_TIMES):
                (folder / name).unlink(missing_ok=True)
        file.seek(0)
        content = file.read()
        whole = content[: content.rfind(b"\n") + 1]  # without an incomplete last line
        if whole:
            results |= _read_journal(whole, identity, folder)
            file.truncate(len(whole))
        else:
            file.truncate(0)
            file.write(f"{json.dumps({'sweep': identity})}\n".encode())
            file.flush()
        yield file


def _read_journal(content: bytes, identity: str, folder: Path) -> dict[int, Result]:
    """The results in a journal by the runs' numbers."""
    try:
        first, *lines = map(json.loads, content.splitlines())
        found = first["sweep"]
        results = {line.pop("run"): line for line in lines}
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ScenarioError(
            f"--out = {folder}: its {JOURNAL} cannot be read; give another folder, or --restart "
            "(restart=True) to start again"
        ) from None
    require(
        found == identity,
        "--out",
        folder,
        "it has the runs of another scenario or spec; give another folder, or --restart "
        "(restart=True) to drop them",
    )
    return results


def _failed(error: str) -> Result:
    return {"outcome": FAILED, "error": error, "metrics": {}, "wall_times": {}}


def _simulated(text: str, overrides: Sequence[str], trust: bool) -> Result:
    """The result of a run."""

    def scenario() -> Scenario:
        # A copy of a scenario that was trusted when it was loaded.
        return changed(parse_scenario(text, trust=True), overrides, trust=trust)

    tried = attempt(scenario)
    metrics = {} if tried.run is None else flattened(compute_metrics(tried.run))
    result = {
        "outcome": tried.outcome,
        "error": tried.message,
        "metrics": {path: value for path, value in metrics.items() if path not in _WALL_TIME_PATHS},
        "wall_times": {path: value for path, value in metrics.items() if path in _WALL_TIME_PATHS},
    }
    # The systems of a run refer to each other, and their memory is mostly C++'s: Python's
    # collector would run too late.
    if tried.run is not None:
        release(tried.run.diagram)
    del tried
    gc.collect()
    return result


def _write_tables(folder: Path, spec: SweepSpec, results: dict[int, Result]) -> None:
    """Writes both tables, with a row per result."""
    rows, wall_times = [], []
    for number, result in results.items():
        planned = spec.run(number)
        about = {"run": number, "seed": planned.seed}
        ending = {"outcome": result["outcome"], "error": result["error"]}
        rows.append({**about, **planned.values, **ending, **result["metrics"]})
        wall_times.append({"run": number, **result["wall_times"]})
    _write_table(folder / WALL_TIMES, wall_times)
    _write_table(folder / TABLE, rows)


def _write_table(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    arrow, parquet = _pyarrow()
    names = dict.fromkeys(name for row in rows for name in row)
    columns = {name: _column(arrow, [row.get(name) for row in rows]) for name in names}
    with replacing_file(path) as file:
        parquet.write_table(arrow.table(columns), file)


def _column(arrow: Any, values: list[Any]) -> Any:
    """The values as an array of one type: as YAML texts where they have none in common."""
    given = [value for value in values if value is not None]
    for kinds, kind in ((bool, arrow.bool_()), (int, arrow.int64()), (str, arrow.string())):
        if given and all(type(value) is kinds for value in given):
            return arrow.array(values, kind)
    if all(type(value) in (int, float) for value in given):
        numbers = [value if value is None else float(value) for value in values]
        return arrow.array(numbers, arrow.float64())
    texts = [value if value is None else dump_plain(value) for value in values]
    return arrow.array(texts, arrow.string())


def _pyarrow() -> tuple[Any, Any]:
    """The modules pyarrow and pyarrow.parquet."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ScenarioError(
            "sweep = pyarrow is not installed: install the extra, drake-nonstop[sweep]"
        ) from None
    return pyarrow, pyarrow.parquet
