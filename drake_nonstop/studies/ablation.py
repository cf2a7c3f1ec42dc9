"""A comparison of a scenario with its variants, from grids or given: their runs."""

import itertools
import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drake_nonstop import diagrams
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.run.preparation import LoopMaker
from drake_nonstop.scenario.loading import dump_scenario, parse_scenario
from drake_nonstop.scenario.overrides import (
    as_override,
    combinations,
    read_mapping,
    require_choices,
    require_override,
)
from drake_nonstop.scenario.schema import Scenario, sample
from drake_nonstop.studies.ablation_report import (
    BASE,
    PAGE,
    PLOTS,
    Curves,
    Row,
    as_csv,
    as_markdown,
    curves_of,
    ordered,
    write_page,
)
from drake_nonstop.studies.files import as_path, read_regular, replacing_files, shared
from drake_nonstop.studies.journal import Journal, open_journal, settings_of
from drake_nonstop.studies.processes import keep_what_is_done, require_main
from drake_nonstop.studies.results_folder import RUN_FILES, write_results
from drake_nonstop.studies.run_all import (
    FAILED,
    UNBUILDABLE,
    Progress,
    attempts,
    no_progress,
    run_all,
)
from drake_nonstop.studies.variants import (
    Change,
    checked_changes,
    identity,
    labels,
    require_sendable,
    varied,
)
from drake_nonstop.validation import ScenarioError, listed, message_of, require, require_flags
from drake_nonstop.view.figure_style import require_drawing

Changes = Sequence[Change] | Mapping[str, Any]
Variants = Mapping[str, Changes] | Iterable[tuple[str, Changes]]


GRIDS = diagrams.FOLDER / "grids"
_MAX_VARIANTS = 10_000

_FILES = ("table.md", "table.csv", PAGE, *PLOTS)
_RESULT = {"ending": str, "message": str, "curves": dict}  # no curves: there was no run


def ablate(
    scenario: Scenario,
    variants: Variants,
    folder: str | Path,
    *,
    title: str = "",
    replay: bool = True,
    trust: bool = False,
    restart: bool = False,
    make_loop: LoopMaker = make_nonstop,
    progress: Progress = no_progress,
) -> list[Row]:
    """Runs a scenario and each of its variants, in a process per core, and compares them.

    The folder gets table.md, table.csv (every metric), plots, and index.html with all replays
    side by side. The results of each variant are in a folder of their own in it, from the end of
    its run on; tables, plots and page are written once all runs are done, and replace earlier ones
    only then. Folders of other variants of earlier calls stay. A variant that
    cannot be built, or whose run does not complete, has a row with the reason.

    An interrupted comparison continues from the variants that are done when it is called again
    with the same scenario, variants and folder, unless `restart` drops these; a complete one is run
    again.

    `variants` are by their names: a list of overrides "path=value" and of mappings from boxes to
    configs, classes or functions, as the replacements of `make_nonstop`; or one such mapping. Equal
    names get numbers. Processes have to be able to import what is given, and `make_loop`, which is
    as of `simulate`; `trust` lets variants import the user's own blocks, which runs their code.

    Returns:
        The row of the unchanged scenario, and then the variants by their effect on the load's
        mean position error, the largest first; runs that did not complete come before these,
        variants without any run last.

    Raises:
        ScenarioError: the scenario itself cannot be built or run, the overrides of no variant
            can be used, processes end as they start, or the folder cannot be written, or has
            variants of another, interrupted comparison.
        StudyInterrupted: Ctrl-C; the variants that are done stay.
    """
    folder = as_path(folder)
    require_flags(replay=replay, trust=trust, restart=restart)
    require_main()
    require_drawing()
    pairs: list[tuple[str, list[Change]]] = [(BASE, []), *_checked(variants)]
    require_sendable(make_loop, "make_loop")
    rows = _named(pairs)
    texts, arguments, first_error = {}, {}, None
    for k, (row, (_, changes)) in enumerate(zip(rows, pairs, strict=True)):
        try:
            variant, others = varied(scenario, changes, trust=trust)
            texts[k] = dump_scenario(sample(variant)[0])
            arguments[k] = {"make_loop": make_loop, **others}
        except ScenarioError as error:
            if k == 0:
                raise
            first_error = first_error or error
            row.ending, row.message = UNBUILDABLE, message_of(error)
    if first_error is not None and len(texts) <= 1:
        raise first_error
    curves: dict[str, Curves] = {}

    def add(row: Row, result: dict[str, Any]) -> None:
        row.ending, row.message = result["ending"], result["message"]
        if result["curves"]:
            row.metrics = json.loads(read_regular(folder / row.folder / "metrics.json"))
            curves[row.folder] = result["curves"]

    settings = ablation_settings(scenario, pairs[1:], replay=replay, make_loop=make_loop)
    places = [row.folder for row in rows]
    contents = [*_FILES, *(f"{place}/{item}" for place in places for item in RUN_FILES)]
    journalled = open_journal(
        folder, settings, [*texts], _RESULT, contents=contents, restart=restart, what="variants"
    )
    with journalled as journal, shared(folder / place for place in places):
        done = {k for k in texts if _is_there(folder, rows[k], texts[k], journal, k)}
        for key in done:
            add(rows[key], journal.result(key))

        def record(key: int, result: dict[str, Any]) -> None:
            if key == 0 and not result["curves"]:
                raise ScenarioError(result["message"])
            add(rows[key], result)
            journal.record(key, result)

        run_all(
            _run,
            [*texts],
            lambda key: (texts[key], folder, rows[key], replay, arguments[key]),
            record,
            lambda key, error: {"ending": FAILED, "message": error, "curves": {}},
            done=done,
            progress=progress,
            is_of_many=True,
        )
        rows = ordered(rows)
        without_run = [row.folder for row in rows if row.metrics is None]
        old = [f"{place}/{item}" for place in without_run for item in RUN_FILES]
        with replacing_files(folder, [*_FILES, *old]) as new:
            (new / "table.csv").write_text(as_csv(rows), encoding="utf-8", newline="")
            (new / "table.md").write_text(as_markdown(rows), encoding="utf-8")
            write_page(new, title or scenario.name, scenario, rows, curves, has_replays=replay)
        journal.finish()
    return rows


def ablation_settings(
    scenario: Scenario, variants: Variants, *, replay: bool, make_loop: LoopMaker = make_nonstop
) -> str:
    """A name of all that the results of a comparison depend on; see `settings_of`."""
    given = [f"{name}\n{identity(changes, make_loop)}" for name, changes in _checked(variants)]
    return settings_of("ablation", dump_scenario(scenario), json.dumps(given), str(replay))


def _checked(variants: Variants) -> list[tuple[str, list[Change]]]:
    """The variants as pairs of a name and changes; raises ScenarioError for anything else."""
    remedy = 'give a mapping from names to lists of overrides, {"name": ["path=value"]}'
    pairs: Any = variants.items() if isinstance(variants, Mapping) else variants
    checked = []
    for pair in listed("variants", pairs, remedy):
        is_pair = isinstance(pair, (tuple, list)) and len(pair) == 2
        require(is_pair and isinstance(pair[0], str), "variants", pair, remedy)
        name, changes = pair
        checked.append((name, checked_changes(changes, f"variant {name}")))
    return checked


def _is_there(folder: Path, row: Row, text: str, journal: Journal, key: int) -> bool:
    """Whether a variant has a result, with the files that belong to it."""
    if key not in journal:
        return False
    if not journal.result(key)["curves"]:
        return True
    try:
        json.loads(read_regular(folder / row.folder / "metrics.json"))
        return read_regular(folder / row.folder / "scenario.yaml") == text.encode()
    except (OSError, ValueError):
        return False


def _run(
    calls: Sequence[tuple[str, Path, Row, bool, dict[str, Any]]],
) -> Iterator[tuple[int, dict[str, Any]]]:
    """Runs variants and writes their results; the numbers of the calls as they end."""
    # Copies of scenarios that were trusted when they were loaded.
    runs = [(parse_scenario(text, trust=True), given) for text, *_, given in calls]
    for k, tried in attempts(runs):
        _, folder, row, replay, _ = calls[k]
        curves: Curves = {}
        if tried.run is not None:
            keep_what_is_done()
            curves = curves_of(tried.run)
            write_results(tried.run, folder / row.folder, figures=False, replay=replay)
        yield k, {"ending": tried.ending, "message": tried.message, "curves": curves}


def _named(variants: Iterable[tuple[str, Sequence[Change]]]) -> list[Row]:
    """A row for each variant, with names and folders made unique by numbers."""
    names: set[str] = set()
    folders = {name.lower() for name in _FILES}
    rows = []
    for given, changes in variants:
        name = next(name for name in _numbered(given, " ({})") if name not in names)
        slug = re.sub(r"[^A-Za-z0-9.+-]+", "_", name)[:60].strip("_.") or "variant"
        place = next(place for place in _numbered(slug, "_{}") if place.lower() not in folders)
        names.add(name)
        folders.add(place.lower())
        rows.append(Row(variant=name, folder=place, overrides=labels(changes)))
    return rows


def _numbered(name: str, ending: str) -> Iterable[str]:
    """The name, and the name with 2, 3, … at its end."""
    return itertools.chain([name], (name + ending.format(k) for k in itertools.count(2)))


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Variants by their names, each a list of overrides "path=value"."""

    name: str
    description: str
    variants: dict[str, list[str]]


def grid_names() -> list[str]:
    """The names of the grids that come with the package, sorted."""
    return sorted(path.stem for path in GRIDS.glob("*.yaml"))


def read_grid(name_or_file: str | Path) -> Grid:
    """The grid of that name, or the one in a YAML file.

    A file may have a `description`, and has either `variants`, a mapping from a variant's name
    to a list of overrides "path=value", or `grid`, a mapping from a path to a list of values:
    then every combination of values is a variant, named by them.

    Raises:
        ScenarioError: there is no such grid or file, or its content cannot be used.
    """
    is_path = isinstance(name_or_file, (str, Path))
    require(is_path, "--grid", name_or_file, "give a grid's name, or a .yaml file")
    path = Path(name_or_file)
    if path.suffix not in (".yaml", ".yml"):
        remedy = f"give a .yaml file or one of {', '.join(grid_names())}"
        require(str(name_or_file) in grid_names(), "--grid", name_or_file, remedy)
        path = GRIDS / f"{name_or_file}.yaml"
    known = ("description", "variants", "grid")
    remedy = "give variants or grid, and a description if needed"
    content, source = read_mapping(path, "--grid", known, remedy), path.name
    given = [key for key in known[1:] if key in content]
    require(len(given) == 1, source, " and ".join(given) or "neither", "give variants or grid")
    (key,) = given
    entries, where = content[key], f"{source}.{key}"
    read, remedy = {
        "variants": (_listed, "the variants' names to lists of path=value"),
        "grid": (_combined, "paths to lists of values"),
    }[key]
    is_mapping = isinstance(entries, dict) and entries and "_tag" not in entries
    require(is_mapping, where, entries, f"give a mapping from {remedy}")
    variants = read(entries, where)
    return Grid(name=path.stem, description=content.get("description", ""), variants=variants)


def _listed(entries: Mapping[str, Any], source: str) -> dict[str, list[str]]:
    for name, overrides in entries.items():
        require(name.strip(), source, "a variant without a name", "name it")
        where = f"{source}.{name}"
        require(
            isinstance(overrides, list) and overrides, where, overrides, "give a list of path=value"
        )
        for override in overrides:
            require_override(override, where)
    return {" ".join(name.split()): overrides for name, overrides in entries.items()}


def _combined(entries: Mapping[str, Any], source: str) -> dict[str, list[str]]:
    """A variant for every combination of the values, named by them."""
    for path, values in entries.items():
        require_choices(values, f"{source}.{path}")
    count = math.prod(map(len, entries.values()))
    require(count <= _MAX_VARIANTS, source, f"{count} variants", f"give at most {_MAX_VARIANTS}")
    variants = ([as_override(*item) for item in c.items()] for c in combinations(entries))
    return {name_overrides(overrides): overrides for overrides in variants}


def name_overrides(overrides: Sequence[str]) -> str:
    """A variant's name: its blocks, and its other values with their fields."""
    paths = [override.partition("=")[0] for override in overrides]
    last = Counter(path.split(".")[-1] for path in paths)
    labels = []
    for path, override in zip(paths, overrides, strict=True):
        value = " ".join(override.partition("=")[2].split())
        block = value.removeprefix("!").removesuffix("{}").strip()
        if "." not in path and re.match(r"[A-Za-z_]", block):
            labels.append(block)
        else:
            name = path.split(".")[-1]
            labels.append(f"{name if last[name] == 1 else path}={value}")
    return ", ".join(labels)
