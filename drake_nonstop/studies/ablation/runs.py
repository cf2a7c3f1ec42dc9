"""The runs of a comparison: a scenario and its variants, in a process per core."""

import contextlib
import itertools
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from drake_nonstop.scenario.loading import dump_scenario, parse_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.ablation.page import PAGE, PLOTS, Curves, write_page
from drake_nonstop.studies.ablation.rows import BASE, Row, ordered
from drake_nonstop.studies.ablation.tables import as_csv, as_markdown
from drake_nonstop.studies.files import replacing_files, require_writable
from drake_nonstop.studies.results_folder import RUN_FILES, write_results
from drake_nonstop.studies.run_all import (
    FAILED,
    UNBUILDABLE,
    Progress,
    attempt,
    no_progress,
    run_all,
)
from drake_nonstop.validation import ScenarioError

_FILES = ("table.md", "table.csv", PAGE, *PLOTS)


def ablate(
    scenario: Scenario,
    variants: Mapping[str, Sequence[str]] | Iterable[tuple[str, Sequence[str]]],
    folder: str | Path,
    *,
    title: str = "",
    replay: bool = True,
    trust: bool = False,
    progress: Progress = no_progress,
) -> list[Row]:
    """Runs a scenario and each of its variants, in a process per core, and compares them.

    The folder gets table.md, table.csv (every metric), plots, and index.html with all replays
    side by side; the results of each variant are in a folder of their own in it. They replace
    earlier ones once all runs are done; folders of other variants of earlier calls stay. A
    variant that cannot be built, or whose run does not complete, has a row with the reason.

    Args:
        scenario: what the variants change, and the first row.
        variants: overrides "path=value" by the variant's name; equal names get numbers.
        folder: for the results, made where there is none.
        title: of the page.
        replay: whether to write replays.
        trust: whether the variants may import the user's own blocks, which runs their code.
        progress: called with a description and the share that is done.

    Returns:
        The row of the unchanged scenario, and then the variants by their effect on the load's
        mean position error, the largest first; runs that did not complete come before these,
        variants without any run last.

    Raises:
        ScenarioError: the scenario itself cannot be built or run, the overrides of no variant
            can be used, or the folder cannot be written.
    """
    folder = Path(folder)
    pairs = variants.items() if isinstance(variants, Mapping) else variants
    rows = _named([(BASE, ()), *pairs])
    texts, first_error = {}, None
    for k, row in enumerate(rows):
        try:
            texts[k] = dump_scenario(changed(scenario, row.overrides, trust=trust))
        except ScenarioError as error:
            first_error = first_error or error
            row.outcome, row.message = UNBUILDABLE, str(error)
    if first_error is not None and len(texts) <= 1:
        raise first_error
    is_new = not folder.exists()
    require_writable(folder)
    try:
        return _ablate(scenario, rows, texts, folder, title, replay, progress)
    except BaseException:
        if is_new:
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise


def _ablate(
    scenario: Scenario,
    rows: list[Row],
    texts: dict[int, str],
    folder: Path,
    title: str,
    replay: bool,
    progress: Progress,
) -> list[Row]:
    """Runs the rows that have a scenario, of these texts, and writes all results; see `ablate`."""
    curves: dict[str, Curves] = {}
    contents = [f"{row.folder}/{item}" for row in rows for item in RUN_FILES] + [*_FILES]
    with replacing_files(folder, contents) as new:

        def record(key: int, result: _Result) -> None:
            row = rows[key]
            row.outcome, row.message = result.outcome, result.message
            if key == 0 and result.curves is None:
                raise ScenarioError(row.message)
            if result.curves is not None:
                curves[row.folder] = result.curves
                text = (new / row.folder / "metrics.json").read_text(encoding="utf-8")
                row.metrics = json.loads(text)

        run_all(
            _run,
            list(texts),
            lambda key: (texts[key], new / rows[key].folder, replay),
            record,
            lambda key, error: _Result(outcome=FAILED, message=error),
            progress=progress,
        )
        rows = ordered(rows)
        (new / "table.csv").write_text(as_csv(rows), encoding="utf-8", newline="")
        (new / "table.md").write_text(as_markdown(rows), encoding="utf-8")
        write_page(new, title or scenario.name, scenario, rows, curves, has_replays=replay)
    return rows


@dataclass(kw_only=True)
class _Result:
    """How the run of a variant ended, and its curves where there are any samples."""

    outcome: str
    message: str = ""
    curves: Curves | None = None


def _run(text: str, folder: Path, replay: bool) -> _Result:
    """Runs a variant and writes its results."""
    # A copy of a scenario that was trusted when it was loaded.
    tried = attempt(lambda: parse_scenario(text, trust=True))
    result = _Result(outcome=tried.outcome, message=tried.message)
    if tried.run is not None:
        write_results(tried.run, folder, figures=False, replay=replay)
        result.curves = Curves.of(tried.run)
    return result


def _named(variants: Iterable[tuple[str, Sequence[str]]]) -> list[Row]:
    """A row for each variant, with names and folders made unique by numbers."""
    names: set[str] = set()
    folders = {name.lower() for name in _FILES}
    rows = []
    for given, overrides in variants:
        name = next(name for name in _numbered(given, " ({})") if name not in names)
        slug = re.sub(r"[^A-Za-z0-9.+-]+", "_", name)[:60].strip("_.") or "variant"
        place = next(place for place in _numbered(slug, "_{}") if place.lower() not in folders)
        names.add(name)
        folders.add(place.lower())
        rows.append(Row(variant=name, folder=place, overrides=list(overrides)))
    return rows


def _numbered(name: str, ending: str) -> Iterable[str]:
    """The name, and the name with 2, 3, … at its end."""
    return itertools.chain([name], (name + ending.format(k) for k in itertools.count(2)))
