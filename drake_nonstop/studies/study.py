"""One study: a scenario flown with every combination of factors and seeds, as a table of runs."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import itertools
import json
import re
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drake_nonstop.analysis.stated_errors import with_seed
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.run.metrics import METRICS, compute_metrics, flattened
from drake_nonstop.run.preparation import LoopMaker
from drake_nonstop.scenario.loading import dump_scenario, parse_scenario
from drake_nonstop.scenario.overrides import as_override, require_choices
from drake_nonstop.scenario.schema import Scenario, has_distributions, sample
from drake_nonstop.scenario.yaml_text import dump_plain
from drake_nonstop.studies.attempts import FAILED, UNBUILDABLE, attempts
from drake_nonstop.studies.changes import (
    Change,
    checked_changes,
    identity,
    is_block,
    label,
    require_sendable,
    varied,
)
from drake_nonstop.studies.files import as_path, replacing_files
from drake_nonstop.studies.journal import Row, open_journal, settings_of
from drake_nonstop.studies.page import PAGE, make_page
from drake_nonstop.studies.results_folder import METRICS as METRICS_FILE
from drake_nonstop.studies.results_folder import RUN_FILES, write_results
from drake_nonstop.studies.study_figures import make_study_figure
from drake_nonstop.studies.summary import Summary, name_of
from drake_nonstop.studies.workers import (
    Progress,
    in_batches,
    no_progress,
    require_main,
    results_of,
)
from drake_nonstop.validation import (
    ScenarioError,
    require,
    require_flags,
    require_seed,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

SEED = "seed"  # the column of seeds
SCENARIO = "scenario.yaml"
FILES = (SCENARIO, "runs.csv", "summary.csv", "summary.tex", PAGE)
_MOST_RUNS = 100_000
_MOST_TOGETHER = 16  # runs that a process gets at a time
SHOWN = tuple(metric for metric in METRICS if metric.is_brief)
_BRIEF = (
    "outcome",
    "load.position_error_mean_m",
    "carriers.speed_min_m_s",
    "carriers.time_below_bound_s",
)
BRIEF = tuple(metric for metric in SHOWN if metric.path in _BRIEF)


@dataclass(frozen=True, kw_only=True)
class Setting:
    """A combination of the levels of factors, and how it changes the scenario."""

    factors: dict[str, Any]  # the levels, as the table has them
    changes: list[Change] = field(default_factory=list)

    @property
    def name(self) -> str:
        """The levels in a line, see `name_of`."""
        return name_of(self.factors)


@dataclass(frozen=True, kw_only=True)
class Study:
    """The runs of a study.

    Attributes:
        title: of its page and figures.
        table: a row per run: factors, `seed`, the numbers drawn for the scenario's distributions,
            `ending` ("completed", "diverged", "failed" or "unbuildable") with its `message`, and
            every metric by its path in metrics.json.
        settings: combinations of the factors, each with the same number of runs one after the
            other in the table.
        folder: has its files; None: there are none.
    """

    title: str
    table: DataFrame
    settings: Sequence[Setting]
    folder: Path | None = None

    @functools.cached_property
    def _summary(self) -> Summary:
        return Summary(self.table, self.settings)

    def summary(self) -> DataFrame:
        """A row per combination of factors: of each metric the mean, standard deviation, interval.

        Intervals are of 95 %, by Student's t over seeds. The `change` is the mean difference from
        the first combination over the same seeds, with its interval. Runs that did not complete
        are left out.
        """
        return self._summary.frame()

    def figure(self, path: str = "load.position_error_mean_m") -> Figure:
        """Draws a metric over a factor of numbers, with 95 % bands, or in a row per combination.

        Raises:
            ScenarioError: there is no such metric of one number.
        """
        found = [metric for metric in METRICS if metric.path == path]
        remedy = f"give the path of a metric, such as {_BRIEF[-1]}"
        require(found and path in self._summary.values, "path", path, remedy)
        return make_study_figure(self._summary, found[0])

    def __str__(self) -> str:
        return self._summary.text(BRIEF)

    def _repr_html_(self) -> str:
        return self._summary.html(BRIEF)

    def latex(self) -> str:
        """The same table as LaTeX, for booktabs."""
        return self._summary.latex(BRIEF)


def study(
    scenario: Scenario,
    factors: Mapping[str, Any],
    seeds: int | Sequence[int] | None = None,
    folder: str | Path | None = None,
    *,
    title: str = "",
    replay: bool = False,
    executor: Executor | None = None,
    restart: bool = False,
    trust: bool = False,
    make_loop: LoopMaker = make_nonstop,
    progress: Progress = no_progress,
) -> Study:
    """Flies a scenario with every combination of factors, over seeds, in a process per core.

    Args:
        scenario: what is changed.
        factors: by a path of the scenario, such as "wrench_controller.position_gain", a list of
            values; or by any name a mapping from the names of levels to lists of changes: "path=
            value", and mappings from boxes to what makes their blocks, as of `make_nonstop`. A
            box's values may be classes, configs and functions that processes can import.
        seeds: a number of seeds, from 0 on, or a list. Each is added to the scenario's
            `random_seed`, of its distributions, and to the `seed` of its blocks. All combinations
            have the same seeds. None: the scenario's own.
        folder: gets journal.jsonl, a row for each run as it ends; then runs.csv, summary.csv,
            summary.tex, figures as PNG and PDF, and index.html. The same call, or one with other
            factors or seeds, takes the rows that are there. None: nothing is written.
        title: of page and figures.
        replay: whether the first run of each combination leaves all its results in a folder of its
            own, and index.html has the replays side by side.
        executor: an executor as in concurrent.futures, in place of processes; it is not shut down.
        restart: whether to drop the rows that the folder has.
        trust: whether changes may import blocks of the user's own, which runs their code.
        make_loop: as of `simulate`; processes can import it.
        progress: called with a description and the share that is done.

    Raises:
        ScenarioError: no combination can be built, processes end as they start, or the folder
            cannot be written, or has rows of another scenario.
        StudyInterrupted: Ctrl-C; the rows of complete runs stay.
    """
    settings = settings_of_factors(factors)
    folder = None if folder is None else as_path(folder)
    require_flags(restart=restart, trust=trust, replay=replay)
    require(callable(progress), "progress", progress, "give a function, such as a TaskProgress()")
    require_sendable(make_loop, "make_loop")
    if executor is None:
        require_main()
    numbers = listed_seeds(seeds)
    count = len(settings) * len(numbers)
    require(0 < count <= _MOST_RUNS, "study", f"{count} runs", f"give 1 to {_MOST_RUNS}")
    _require_buildable(scenario, settings, trust=trust)
    text = dump_scenario(scenario)
    places = _places(settings) if replay and folder is not None else {}
    calls: dict[str, Call] = {}
    for k, call in enumerate(planned_calls(scenario, settings, numbers, trust, make_loop)):
        setting, number = divmod(k, len(numbers))
        if folder is not None and setting in places and number == 0:
            call = dataclasses.replace(call, place=folder / places[setting])
        key = call.key
        calls[key if key not in calls else f"{key}_{len(calls)}"] = call
    contents = [*FILES, *(f"{place}/{item}" for place in places.values() for item in RUN_FILES)]
    name = settings_of(text, identity([], make_loop))
    with open_journal(folder, name, contents=contents, restart=restart) as journal:
        missing = [key for key, call in calls.items() if not call.is_done(journal.rows.get(key))]
        done = len(calls) - len(missing)
        kept = [key for key in missing if calls[key].place]  # writing takes as long as flying
        others = [key for key in missing if not calls[key].place]
        batches = [*in_batches(kept, 1), *in_batches(others, _MOST_TOGETHER)]
        named = [[(key, calls[key]) for key in batch] for batch in batches]
        for batch, rows in results_of(fly, named, executor):
            if folder is not None and not journal.rows:
                (folder / SCENARIO).write_text(text, encoding="utf-8")
            if isinstance(rows, str):
                rows = [failed_row(FAILED, rows)] * len(batch)
            for (key, _), row in zip(batch, rows, strict=True):
                journal.record(key, row)
            done += len(batch)
            progress(f"{len(calls)} runs", done / len(calls))
        table = _table(settings, numbers, [journal.rows[key] for key in calls])
        title = title or scenario.name
        made = Study(title=title, table=table, settings=settings, folder=folder)
        if folder is not None:
            _write(made, folder, scenario, places)
    return made


def settings_of_factors(factors: Any) -> list[Setting]:
    """Every combination of the levels, the last factor's changing first; raises ScenarioError."""
    remedy = "give a mapping from paths to lists of values"
    require(isinstance(factors, Mapping) and "_tag" not in factors, "factors", factors, remedy)
    levels = []
    for name, values in factors.items():
        require(isinstance(name, str) and name.strip(), "factors", name, "give paths as texts")
        levels.append([*_levels(name, values)])
        require(levels[-1], f"factors.{name}", values, "give one level or more")
    combined = []
    for combination in itertools.product(*levels):
        shown = {name: level for name, (level, _) in zip(factors, combination, strict=True)}
        changes = [change for _, changes in combination for change in changes]
        combined.append(Setting(factors=shown, changes=changes))
    return combined


def _levels(name: str, values: Any) -> list[tuple[Any, list[Change]]]:
    """The levels of a factor, as the table has them, with their changes."""
    if isinstance(values, Mapping):
        return [(str(key), checked_changes(of, f"{name}, {key}")) for key, of in values.items()]
    shown = [label(v) if is_block(name, v) else v for v in values] if _is_list(values) else values
    require_choices(shown, f"factors.{name}")
    levels: list[tuple[Any, list[Change]]] = []
    for value, text in zip(values, shown, strict=True):
        own: Change = {name: value} if is_block(name, value) else as_override(name, value)
        is_scalar = isinstance(text, (str, bool, int, float))
        plain = text if is_scalar else re.sub(r"^!(\w[\w.]*) \{\}$", r"\1", dump_plain(text))
        levels.append((plain, checked_changes([own], f"factors.{name}")))
    return levels


def _is_list(values: Any) -> bool:
    return isinstance(values, (list, tuple))


@dataclass(frozen=True)
class Call:
    """What a process needs for a run; `place` is the folder that gets its results."""

    text: str
    changes: Sequence[Change]
    seed: int | None
    trust: bool = False
    make_loop: LoopMaker = make_nonstop
    place: Path | None = None

    def scenario(self) -> tuple[Scenario, dict[str, Any], dict[str, Any]]:
        """The scenario, replacements that are no configs, and what was drawn."""
        made, others = varied(_base(self.text), self.changes, trust=self.trust)
        made = made if self.seed is None else with_seed(made, self.seed)
        drawn: dict[str, Any] = {}
        if has_distributions(made):
            made, drawn = sample(made)
        return made, {"make_loop": self.make_loop} | others, drawn

    def is_done(self, row: Row | None) -> bool:
        """Whether there is a row, with the files that belong to it."""
        if row is None or not {"ending", "message", "drawn", "metrics"} <= row.keys():
            return False
        return self.place is None or not row["metrics"] or (self.place / METRICS_FILE).exists()

    @property
    def key(self) -> str:
        """A name of what the run depends on besides the scenario."""
        parts = [identity(self.changes, self.make_loop), self.seed, self.place and self.place.name]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:20]


def planned_calls(
    scenario: Scenario,
    settings: Sequence[Setting],
    seeds: Sequence[int | None],
    trust: bool = False,
    make_loop: LoopMaker = make_nonstop,
) -> list[Call]:
    """The runs of a study, of each setting with each seed."""
    text, pairs = dump_scenario(scenario), itertools.product(settings, seeds)
    return [Call(text, setting.changes, seed, trust, make_loop) for setting, seed in pairs]


@functools.lru_cache(maxsize=1)
def _base(text: str) -> Scenario:
    """The scenario that is changed: a copy of one that was trusted when it was loaded."""
    return parse_scenario(text, trust=True)


def failed_row(ending: str, message: str, drawn: Mapping[str, Any] | None = None) -> Row:
    """The row of a run without metrics."""
    return {"ending": ending, "message": message, "drawn": dict(drawn or {}), "metrics": {}}


def fly(calls: list[tuple[str, Call]]) -> list[Row]:
    """The rows of runs, several of which fly side by side; those with a place leave results."""
    rows: dict[int, Row] = {}
    runs, about = [], []
    for k, (_, call) in enumerate(calls):
        _base(call.text)  # what cannot be read here is no fault of a setting
        try:
            scenario, others, drawn = call.scenario()
        except ScenarioError as error:
            rows[k] = failed_row(UNBUILDABLE, str(error))
            continue
        runs.append((scenario, others))
        about.append((k, drawn))
    for number, tried in attempts(runs):
        k, drawn = about[number]
        row = rows[k] = failed_row(tried.ending, tried.message, drawn)
        if tried.run is None:
            continue
        place = calls[k][1].place
        if place is None:
            metrics = compute_metrics(tried.run)
        else:
            metrics = write_results(tried.run, place, figures=False)
        metrics["warnings"] = [*tried.told]
        row["metrics"] = flattened(metrics)
    return [rows[k] for k in range(len(calls))]


def listed_seeds(seeds: Any) -> list[int | None]:
    """The seeds; [None] where each run has the scenario's own."""
    if seeds is None:
        return [None]
    if isinstance(seeds, int) and not isinstance(seeds, bool):
        require(seeds > 0, "seeds", seeds, "give a number of seeds, 1 or more, or a list of them")
        return [*range(seeds)]
    require(_is_list(seeds) and seeds, "seeds", seeds, "give a number of seeds, or a list of them")
    for seed in seeds:
        require_seed("seeds", seed)
    return [*dict.fromkeys(seeds)]


def _require_buildable(scenario: Scenario, settings: Sequence[Setting], *, trust: bool) -> None:
    """Raises the first ScenarioError unless a setting can be made."""
    errors = []
    for setting in settings[:20]:
        try:
            varied(scenario, setting.changes, trust=trust)
            return
        except ScenarioError as error:
            errors.append(error)
    raise errors[0]


def _places(settings: Sequence[Setting]) -> dict[int, str]:
    """The folders of the settings' results, named after them, with numbers where equal."""
    taken = {name.lower() for name in FILES}
    places = {}
    for k, setting in enumerate(settings):
        slug = re.sub(r"[^A-Za-z0-9.+-]+", "_", setting.name)[:60].strip("_.") or "run"
        numbered = itertools.chain([slug], (f"{slug}_{i}" for i in itertools.count(2)))
        places[k] = next(place for place in numbered if place.lower() not in taken)
        taken.add(places[k].lower())
    return places


def _table(
    settings: Sequence[Setting], seeds: Sequence[int | None], rows: Sequence[Row]
) -> DataFrame:
    from pandas import DataFrame

    entries = []
    for (setting, seed), row in zip(itertools.product(settings, seeds), rows, strict=True):
        drawn = {
            f"{path} (drawn)" if path in setting.factors else path: value
            for path, value in row["drawn"].items()
        }
        about = setting.factors | ({} if seed is None else {SEED: seed}) | drawn
        metrics = {k: v for k, v in row["metrics"].items() if k not in about}
        entries.append(about | {"ending": row["ending"], "message": row["message"]} | metrics)
    table = DataFrame(entries)
    table.index.name = "run"
    return table


def _write(made: Study, folder: Path, scenario: Scenario, places: Mapping[int, str]) -> None:
    """Writes all files of a study but its journal, which replace earlier ones together."""
    names = {path: re.sub(r"\W", "_", path) for path in _BRIEF if path in made._summary.values}
    pictures = [f"{name}.{kind}" for name in names.values() for kind in ("png", "pdf")]
    with replacing_files(folder, [*FILES, *pictures]) as new:
        (new / SCENARIO).write_text(dump_scenario(scenario), encoding="utf-8")
        made.table.to_csv(new / "runs.csv")
        made.summary().to_csv(new / "summary.csv")
        (new / "summary.tex").write_text(made.latex(), encoding="utf-8")
        for path, name in names.items():
            figure = made.figure(path)
            for kind in ("png", "pdf"):
                figure.savefig(new / f"{name}.{kind}", dpi=200)
        replays = {k: p for k, p in places.items() if (folder / p / METRICS_FILE).exists()}
        page = make_page(made.title, scenario, made._summary, SHOWN, [*names.values()], replays)
        (new / PAGE).write_text(page, encoding="utf-8")
