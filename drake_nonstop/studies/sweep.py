"""Many runs of one scenario, a row each in one table."""

import contextlib
import fcntl
import gc
import hashlib
import json
import os
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from drake_nonstop.scenario.loading import (
    Scenario,
    changed,
    dump_plain,
    dump_scenario,
    parse_scenario,
)
from drake_nonstop.simulation.metrics import compute_metrics, flattened, is_wall_time
from drake_nonstop.studies.outcomes import FAILED, attempt
from drake_nonstop.studies.results_folder import replacing_file, require_writable
from drake_nonstop.studies.sweep_spec import SweepSpec, dump_spec
from drake_nonstop.studies.workers import worker_processes
from drake_nonstop.systems.block import release
from drake_nonstop.validation import ScenarioError, one_line, require

TABLE = "runs.parquet"
WALL_TIMES = "wall_times.parquet"
JOURNAL = "journal.jsonl"

_MOST_PENDING = 200  # runs, that an executor has at a time
_TRIED = 20  # runs, of which one has to be a scenario before any is simulated
_JSON_SEPARATORS = (",", ":")

Result = dict[str, Any]  # of a run: its outcome, error, metrics and wall times, as in the journal


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """A sweep that is done: its table, and how many of its runs came to each outcome."""

    table: Path
    outcomes: dict[str, int]


class SweepInterrupted(KeyboardInterrupt):
    """A sweep was interrupted from the keyboard; the message tells how far it came."""


def sweep(
    scenario: Scenario,
    spec: SweepSpec,
    folder: str | Path,
    *,
    executor: Executor | None = None,
    restart: bool = False,
    trust: bool = False,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Sweep:
    """Simulates all runs of a sweep and writes a table with a row for each.

    The folder gets runs.parquet: per run its number, the seed of its draws, the values that were
    swept, the outcome ("completed", "diverged", "failed" where a block raised an error, or
    "unbuildable"), the error, and every metric that is one value, by its path in metrics.json.
    The rows stand in the order of the runs, and are the same, to the bit, however they were
    computed; what is measured with a clock is therefore in wall_times.parquet.

    Each run that ends is noted in journal.jsonl at once. A sweep that was interrupted goes on
    from there when it is called again with the same scenario, spec and folder.

    Args:
        scenario: what the runs change.
        spec: what to run.
        folder: for the results, made where there is none.
        executor: any of concurrent.futures' kind, whose workers can import this package, and the
            blocks of the user's own; it is not shut down. A process per core where there is none.
        restart: whether to begin anew, and to drop what the folder has of a sweep.
        trust: whether the spec may name blocks of the user's own, which runs their code.
        progress: called with what is done and the share that is.

    Raises:
        ScenarioError: the spec does not fit the scenario, the folder cannot be written, or has
            another sweep, or pyarrow is not installed.
        SweepInterrupted: Ctrl-C; the runs that ended are kept.
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
                progress(f"simulating {total} runs", len(results) / total)

            def submit(to: Executor, number: int) -> Future:
                return to.submit(_simulated, text, spec.run(number).settings, trust)

            try:
                _run_all(spec, results, executor, submit, record)
            except KeyboardInterrupt:
                raise SweepInterrupted(
                    f"{len(results)} of {total} runs are in {folder}; the same call goes on from "
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
    """Raises the first run's ScenarioError where none of some runs all over has a scenario."""
    first_error = None
    step = max(1, len(spec) // _TRIED)
    for number in range(0, len(spec), step):
        try:
            changed(scenario, spec.run(number).settings, trust=trust)
        except ScenarioError as error:
            first_error = first_error or error
        else:
            return
    assert first_error is not None
    raise first_error


def _identity(text: str, spec: SweepSpec) -> str:
    """What tells sweeps apart that differ in any result."""
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
        whole = content[: content.rfind(b"\n") + 1]  # without a line that an end cut short
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
            "(restart=True) to begin anew"
        ) from None
    require(
        found == identity,
        "--out",
        folder,
        "it has the runs of another scenario or spec; give another folder, or --restart "
        "(restart=True) to drop them",
    )
    return results


def _run_all(
    spec: SweepSpec,
    results: dict[int, Result],
    executor: Executor | None,
    submit: Callable[[Executor, int], Future],
    record: Callable[[int, Result], None],
) -> None:
    """Records the results of all runs that have none yet.

    Where a worker process of ours dies, those runs that it may have been at are tried again one
    by one, in a process of their own: the one that ends it has failed.
    """
    if executor is not None:
        _run_in(executor, _missing(spec, results), submit, record)
        return
    while missing := _missing(spec, results):
        try:
            with worker_processes() as processes:
                _run_in(processes, missing, submit, record)
        except BrokenProcessPool:
            # Each worker has one, and one more is on its way to them.
            for number in _missing(spec, results)[: (os.cpu_count() or 1) + 1]:
                with worker_processes(1) as process:
                    try:
                        result = _result(submit(process, number))
                    except BrokenProcessPool:
                        result = _failed("its process died, by a crash or for want of memory")
                record(number, result)


def _missing(spec: SweepSpec, results: dict[int, Result]) -> list[int]:
    return [number for number in range(len(spec)) if number not in results]


def _run_in(
    executor: Executor,
    numbers: Sequence[int],
    submit: Callable[[Executor, int], Future],
    record: Callable[[int, Result], None],
) -> None:
    """Records each run's result as it comes."""
    waiting = deque(numbers)
    pending: dict[Future, int] = {}
    try:
        while waiting or pending:
            while waiting and len(pending) < _MOST_PENDING:
                future = submit(executor, waiting[0])
                pending[future] = waiting.popleft()
                if future.done():
                    break  # to be recorded before the next, which may be run in submitting it
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                result = _result(future)
                record(pending.pop(future), result)
    finally:
        for future in pending:
            future.cancel()


def _result(future: Future) -> Result:
    """The result of a run, which has failed where its worker raised anything.

    Raises:
        BrokenProcessPool: a worker process died.
        KeyboardInterrupt: the run was interrupted.
    """
    try:
        result = future.result()
    except BrokenProcessPool:
        raise
    except Exception as error:
        return _failed(one_line(error))
    if result is None:
        raise KeyboardInterrupt
    return result


def _failed(error: str) -> Result:
    return {"outcome": FAILED, "error": error, "metrics": {}, "wall_times": {}}


def _simulated(text: str, settings: Sequence[str], trust: bool) -> Result | None:
    """The result of a run; None: it was interrupted."""

    def scenario() -> Scenario:
        # A copy of a scenario that was trusted when it was loaded.
        return changed(parse_scenario(text, trust=True), settings, trust=trust)

    tried = attempt(scenario)
    if tried is None:
        return None
    metrics = {} if tried.run is None else flattened(compute_metrics(tried.run))
    result = {
        "outcome": tried.outcome,
        "error": tried.message,
        "metrics": {path: value for path, value in metrics.items() if not is_wall_time(path)},
        "wall_times": {path: value for path, value in metrics.items() if is_wall_time(path)},
    }
    # The systems of a run refer to each other, and few Python objects hold much of C++'s memory:
    # the collector would come to them too late.
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
