"""Many runs of one scenario, a row each in one table."""

import contextlib
import functools
import html
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.run.metrics import METRICS, compute_metrics, flattened
from drake_nonstop.run.preparation import LoopMaker
from drake_nonstop.scenario.loading import dump_scenario, parse_scenario
from drake_nonstop.scenario.schema import Scenario, has_distributions, sample
from drake_nonstop.scenario.yaml_text import dump_plain
from drake_nonstop.studies.files import as_path, replacing_file, replacing_files
from drake_nonstop.studies.journal import Journal, StudyInterrupted, open_journal, settings_of
from drake_nonstop.studies.processes import require_main
from drake_nonstop.studies.run_all import (
    COMPLETED,
    FAILED,
    UNBUILDABLE,
    Progress,
    attempts,
    no_progress,
    run_all,
)
from drake_nonstop.studies.sweep_spec import PlannedRun, SweepSpec, dump_spec
from drake_nonstop.studies.variants import Change, identity, labels, require_sendable, varied
from drake_nonstop.validation import ScenarioError, require, require_flags, require_installed

TABLE = "runs.parquet"
WALL_TIMES = "wall_times.parquet"
_SPEC, _SCENARIO = "spec.yaml", "scenario.yaml"

_CHECKED_RUNS = 20  # one of them has to make a scenario before any run is simulated
_ROW_GROUP = 10_000  # rows of a table that are held in memory at a time
_MOST_SHOWN = 5  # messages in a summary
_MAX_MESSAGES = 1000  # that are counted
_WALL_TIME_PATHS = {metric.path for metric in METRICS if metric.is_wall_time}
_RESULT = {"drawn": dict, "ending": str, "error": str, "metrics": dict, "wall_times": dict}

Result = dict[str, Any]  # of a run, with the fields of _RESULT
Row = dict[str, Any]  # values by their columns

SweepInterrupted = StudyInterrupted  # what `sweep` raises


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """A completed sweep: its table, and how many runs had each ending and outcome.

    `errors` counts the runs that did not complete by their endings and messages; there are no
    more than 1000 of them.
    """

    table: Path
    endings: dict[str, int]
    errors: dict[tuple[str, str], int] = field(default_factory=dict)
    outcomes: dict[str, int] = field(default_factory=dict)  # of those that have metrics

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(self.summary())}\ntable: {html.escape(str(self.table))}</pre>"

    def summary(self) -> str:
        """Why runs did not complete, and how many had each ending and outcome, in lines."""
        errors = [*self.errors.items()][:_MOST_SHOWN]
        lines = [f"{count} {ending}: {message}" for (ending, message), count in errors]
        failed = sum(count for ending, count in self.endings.items() if ending != COMPLETED)
        rest = failed - sum(count for _, count in errors)
        more = [f"{rest} more for other reasons: column `error` of the table"] if rest else []
        endings = ", ".join(f"{count} {ending}" for ending, count in sorted(self.endings.items()))
        outcomes = ", ".join(f"{count} {outcome}" for outcome, count in self.outcomes.items())
        return "\n".join([*lines, *more, endings, f"outcomes: {outcomes or 'none'}"])


def sweep(
    scenario: Scenario,
    spec: SweepSpec,
    folder: str | Path,
    *,
    executor: Executor | None = None,
    restart: bool = False,
    trust: bool = False,
    make_loop: LoopMaker = make_nonstop,
    progress: Progress = no_progress,
) -> Sweep:
    """Simulates all runs of a sweep and writes a table with a row for each.

    The folder gets runs.parquet: per run its number, the seed of its draws, the values that were
    swept, those drawn for the scenario's distributions and their `random_seed`, its ending
    ("completed", "diverged", "failed" where a block raised an error or the process died, or
    "unbuildable"), the error, and every metric that is one value, by its path in metrics.json.
    Rows are in the order of the runs and, to the bit, the same with any executor; metrics
    measured with a clock are therefore in wall_times.parquet.

    The result of each run is appended to journal.jsonl as it comes. An interrupted sweep
    continues from there when it is called again with the same scenario, spec and folder, unless it
    is to `restart`.

    Runs are in a process per core, or in an executor of concurrent.futures' kind, which is not shut
    down and whose workers can import this package and the user's own blocks; `trust` lets the spec
    name such blocks, which runs their code. `make_loop` is as of `simulate`, and one that processes
    can import.

    Raises:
        ScenarioError: the spec does not fit the scenario, the folder cannot be written, or has
            another sweep, processes end as they start, or pyarrow is not installed.
        SweepInterrupted: Ctrl-C; the results that there are stay in the journal.
    """
    require(isinstance(spec, SweepSpec), "spec", spec, "give a SweepSpec, such as of read_sweep")
    folder = as_path(folder)
    require_flags(restart=restart, trust=trust)
    _pyarrow()
    if executor is None:
        require_main()
    require_sendable(make_loop, "make_loop")
    settings = sweep_settings(scenario, spec, make_loop)
    _require_runnable(scenario, spec, trust)
    text = dump_scenario(scenario)  # which can be sent to a process
    total = len(spec)
    with open_journal(folder, settings, range(total), _RESULT, restart=restart) as journal:

        def record(number: int, result: tuple[bool, Result]) -> None:
            has_scenario, fields = result
            if not has_scenario:
                _require_unusable(scenario, spec.run(number), trust, fields["error"])
            if len(journal) == 0:
                files = (_SPEC, _SCENARIO, TABLE, WALL_TIMES)
                with replacing_files(folder, files) as new:  # which leaves no earlier tables
                    (new / _SPEC).write_text(f"{dump_spec(spec)}\n", encoding="utf-8")
                    (new / _SCENARIO).write_text(text, encoding="utf-8")
            journal.record(number, fields)

        run_all(
            _simulated,
            range(total),
            lambda number: (text, spec.run(number).overrides, trust, make_loop),
            record,
            lambda number, error: (True, _without_run(FAILED, error)),
            executor=executor,
            what=f"simulating {total} runs",
            done=journal,
            progress=progress,
            is_of_many=True,
        )
        return _write_tables(folder, spec, journal)


def sweep_settings(scenario: Scenario, spec: SweepSpec, make_loop: LoopMaker = make_nonstop) -> str:
    """A name of all that the results of a sweep depend on; see `settings_of`."""
    own = identity(spec.blocks, make_loop)
    return settings_of("sweep", dump_scenario(scenario), dump_spec(spec), own)


def _require_runnable(scenario: Scenario, spec: SweepSpec, trust: bool) -> None:
    """Raises the first ScenarioError where none of some runs, evenly chosen, has a scenario."""
    first_error = None
    step = max(1, len(spec) // _CHECKED_RUNS)
    for number in range(0, len(spec), step):
        try:
            made, _ = varied(scenario, spec.run(number).overrides, trust=trust)
        except ScenarioError as error:
            first_error = first_error or error
        else:
            remedy = (
                "all runs of a combination would be the same; leave it out, give draws, or give a "
                "field of the scenario a distribution, such as !Uniform {min: 0.8, max: 1.2}"
            )
            is_random = spec.draws or spec.runs is None or has_distributions(made)
            require(is_random, f"{spec.source}.runs", spec.runs, remedy)
            return
    assert first_error is not None
    raise first_error


def _require_unusable(scenario: Scenario, planned: PlannedRun, trust: bool, error: str) -> None:
    """Raises ScenarioError where the scenario of a run cannot be made in other processes only."""
    try:
        varied(scenario, planned.overrides, trust=trust)
    except ScenarioError:
        return
    raise ScenarioError(
        f"run {planned.number} = {', '.join(labels(planned.overrides))}: processes cannot make its "
        f"scenario, which this one can ({error}); put its modules where they find them, such "
        "as the current folder or PYTHONPATH"
    )


def _without_run(ending: str, error: str) -> Result:
    return {"drawn": {}, "ending": ending, "error": error, "metrics": {}, "wall_times": {}}


@functools.lru_cache(maxsize=1)
def _base(text: str) -> Scenario:
    """The scenario that the runs of a sweep change: one that was trusted when it was loaded."""
    return parse_scenario(text, trust=True)


def _simulated(
    calls: Sequence[tuple[str, Sequence[Change], bool, LoopMaker]],
) -> Iterator[tuple[int, tuple[bool, Result]]]:
    """The numbers of runs, whether each has a scenario, and its result."""
    runs: list[tuple[Scenario, dict[str, Any]]] = []
    about: list[tuple[int, dict[str, Any]]] = []
    for number, (text, changes, trust, make_loop) in enumerate(calls):
        try:
            scenario, others = varied(_base(text), changes, trust=trust)
        except ScenarioError as error:
            yield number, (False, _without_run(UNBUILDABLE, str(error)))
            continue
        drawn: dict[str, Any] = {}
        with contextlib.suppress(ScenarioError):  # which the run ends with
            if values := sample(scenario)[1]:
                drawn = {"random_seed": scenario.random_seed} | values
        runs.append((scenario, {"make_loop": make_loop} | others))
        about.append((number, drawn))
    for k, tried in attempts(runs):
        number, drawn = about[k]
        result = _without_run(tried.ending, tried.message) | {"drawn": drawn}
        if tried.run is not None:
            for path, value in flattened(compute_metrics(tried.run)).items():
                result["wall_times" if path in _WALL_TIME_PATHS else "metrics"][path] = value
        yield number, (True, result)


def _write_tables(folder: Path, spec: SweepSpec, journal: Journal) -> Sweep:
    """Writes both tables, with a row per result."""

    def row(number: int) -> Row:
        planned, result = spec.run(number), journal.result(number)
        drawn = {
            f"{path} (drawn)" if path in planned.values else path: value
            for path, value in result["drawn"].items()
        }
        about = {"run": number, "seed": planned.seed, **planned.values, **drawn}
        return {**about, "ending": result["ending"], "error": result["error"], **result["metrics"]}

    def wall_times(number: int) -> Row:
        return {"run": number, **journal.result(number)["wall_times"]}

    _write_table(folder / WALL_TIMES, len(spec), wall_times)
    _write_table(folder / TABLE, len(spec), row)
    endings: Counter[str] = Counter()
    errors: Counter[tuple[str, str]] = Counter()
    outcomes: Counter[str] = Counter()
    for result in map(journal.result, range(len(spec))):
        ending = result["ending"]
        error = ending, result["error"]
        endings[ending] += 1
        if "outcome" in result["metrics"]:
            outcomes[result["metrics"]["outcome"]] += 1
        if ending != COMPLETED and (error in errors or len(errors) < _MAX_MESSAGES):
            errors[error] += 1
    return Sweep(
        table=folder / TABLE,
        endings=dict(endings),
        errors=dict(errors.most_common()),
        outcomes=dict(outcomes.most_common()),
    )


def _types(rows: Iterable[Row]) -> dict[str, type]:
    """The columns in the order in which they appear, and their types: str for texts and YAML."""
    found: dict[str, set[type]] = {}
    for row in rows:
        for name, value in row.items():
            found.setdefault(name, set())
            if value is not None:
                found[name].add(_type_of(value))
    return {name: _common(types) for name, types in found.items()}


def _type_of(value: Any) -> type:
    kind = type(value.item() if isinstance(value, np.generic) else value)
    return object if kind is int and not -(2**63) <= value < 2**63 else kind


def _common(types: set[type]) -> type:
    """The type of a column that has values of these types; object for YAML texts of them."""
    if len(types) == 1 and types <= {bool, int, str}:
        return next(iter(types))
    return float if types <= {int, float} else object


def _write_table(path: Path, total: int, row: Callable[[int], Row]) -> None:
    """Writes a table of a number of rows, some of which are held in memory at a time."""
    arrow, parquet = _pyarrow()
    types = _types(map(row, range(total)))
    kinds = {bool: arrow.bool_(), int: arrow.int64(), float: arrow.float64()}
    schema = arrow.schema((name, kinds.get(kind, arrow.string())) for name, kind in types.items())
    make: dict[type, Callable[[Any], Any]] = {float: float, object: dump_plain}
    with replacing_file(path) as file, parquet.ParquetWriter(file, schema) as writer:
        for start in range(0, total, _ROW_GROUP):
            rows = [
                {
                    name: make.get(types[name], types[name])(value)
                    for name, value in row(number).items()
                    if value is not None
                }
                for number in range(start, min(start + _ROW_GROUP, total))
            ]
            writer.write_table(arrow.Table.from_pylist(rows, schema=schema))


def _pyarrow() -> tuple[Any, Any]:
    """The modules pyarrow and pyarrow.parquet."""
    require_installed("sweep", pyarrow="pyarrow")
    import pyarrow
    import pyarrow.parquet

    return pyarrow, pyarrow.parquet
