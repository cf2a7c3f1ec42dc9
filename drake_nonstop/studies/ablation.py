"""Variants of a scenario, compared: a table, plots, and all replays on one page."""

import contextlib
import csv
import html
import io
import itertools
import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.scenario.loading import Scenario, changed, dump_scenario, parse_scenario
from drake_nonstop.scenario.overrides import (
    as_setting,
    combinations,
    read_mapping,
    require_choices,
    require_setting,
)
from drake_nonstop.simulation.metrics import carrier_speeds, flattened, load_errors, speed_bounds
from drake_nonstop.studies.figures import make_overlay_figure
from drake_nonstop.studies.outcomes import COMPLETED, UNBUILDABLE, attempt
from drake_nonstop.studies.results_folder import (
    RUN_FILES,
    replacing_files,
    require_writable,
    write_results,
)
from drake_nonstop.studies.workers import worker_processes
from drake_nonstop.validation import ScenarioError, require
from drake_nonstop.visualization.replay import legend

GRIDS = Path(__file__).parents[1] / "diagrams" / "grids"
BASE = "as it is"  # the name of the scenario without any change

_ERROR = "load.position_error_mean_m"
_BELOW = "carriers.time_below_bound_s"
_PLOTS = ("position_error.png", "slowest_speed.png", "tension_min.png")
_FILES = ("table.md", "table.csv", "index.html", *_PLOTS)
_LONGEST_NAME = 30  # characters, of a variant in the terminal
_NOTHING = "–"  # in the place of what was not measured


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Variants by their names, each a list of settings "path=value"."""

    name: str
    description: str
    variants: dict[str, list[str]]


@dataclass(kw_only=True)
class Row:
    """What a variant came to.

    `metrics` are those of `folder`/metrics.json, up to where the run ended; None where there
    was no run. `message` tells why a variant that is not "completed" is "diverged", "failed"
    (a block raised an error) or "unbuildable".
    """

    variant: str
    folder: str  # of its results, in the folder of all
    settings: list[str]
    outcome: str = COMPLETED
    message: str = ""
    metrics: dict[str, Any] | None = None


@dataclass(kw_only=True)
class _Curves:
    """What is drawn of a run: its samples at 100 Hz, and the steps of the integrator."""

    sample_times: NDArray  # (samples,), s
    position_error: NDArray  # (samples,), m
    step_times: NDArray  # (steps,), s
    slowest_speed: NDArray  # (steps,), m/s
    speed_bound: NDArray  # (steps,), m/s
    least_tension: NDArray  # (steps,), N


@dataclass(frozen=True, kw_only=True)
class _Column:
    """A figure of the table, or its change against the first row."""

    heading: str
    short: tuple[str, str]  # the heading in two lines
    path: str  # of the metric
    scale: float = 1.0
    is_change: bool = False

    def cell(self, row: Row, base: Row) -> str:
        value = metric(row, self.path)
        if not self.is_change:
            return _shown(value, self.scale)
        return _NOTHING if row is base else _shown_change(_change(row, base, self.path), self.scale)


_COLUMNS = (
    _Column(
        heading="position error, mean (mm)", short=("error (mm)", "mean"), path=_ERROR, scale=1e3
    ),
    _Column(heading="change (mm)", short=("", "change"), path=_ERROR, scale=1e3, is_change=True),
    _Column(heading="max (mm)", short=("", "max"), path="load.position_error_max_m", scale=1e3),
    _Column(
        heading="orientation error, mean (mrad)",
        short=("tilt", "mrad"),
        path="load.orientation_error_mean_rad",
        scale=1e3,
    ),
    _Column(heading="slowest speed (m/s)", short=("slow-", "est"), path="carriers.speed_min_m_s"),
    _Column(heading="time below the bound (s)", short=("below (s)", "time"), path=_BELOW),
    _Column(heading="change (s)", short=("", "change"), path=_BELOW, is_change=True),
    _Column(heading="least tension (N)", short=("least", "N"), path="cables.tension_min_N"),
    _Column(heading="slack (s)", short=("slack", "s"), path="cables.slack_time_s"),
    _Column(
        heading="closest carriers (m)",
        short=("apart (m)", "carr."),
        path="carriers.separation_min_m",
    ),
    _Column(heading="closest cables (m)", short=("", "cables"), path="cables.separation_min_m"),
    _Column(heading="updates relaxed", short=("re-", "laxed"), path="optimizer.relaxed"),
    _Column(heading="solve, p99 (ms)", short=("p99", "ms"), path="optimizer.solve_time_ms.p99"),
)


def grid_names() -> list[str]:
    """The names of the grids that come with the package, sorted."""
    return sorted(path.stem for path in GRIDS.glob("*.yaml"))


def read_grid(name_or_file: str | Path) -> Grid:
    """The grid of that name, or the one in a YAML file.

    A file has a `description`, if any, and either `variants`, a mapping from a variant's name
    to a list of settings "path=value", or `grid`, a mapping from a path to a list of values:
    then every combination of values is a variant, named by them.

    Raises:
        ScenarioError: there is no such grid or file, or its content cannot be used.
    """
    path = Path(name_or_file)
    if path.suffix not in (".yaml", ".yml"):
        names = grid_names()
        require(
            str(name_or_file) in names,
            "--grid",
            name_or_file,
            f"give a .yaml file or one of {', '.join(names)}",
        )
        path = GRIDS / f"{name_or_file}.yaml"
    known = ("description", "variants", "grid")
    remedy = "give variants or grid, and a description if you like"
    content, source = read_mapping(path, "--grid", known, remedy), path.name
    given = [key for key in known[1:] if key in content]
    require(len(given) == 1, source, " and ".join(given) or "neither", "give variants or grid")
    entries = content[given[0]]
    require(
        isinstance(entries, dict) and entries and "_tag" not in entries,
        f"{source}.{given[0]}",
        entries,
        "give a mapping from the variants' names to lists of settings path=value"
        if given[0] == "variants"
        else "give a mapping from paths to lists of values",
    )
    if given[0] == "variants":
        variants = _listed(entries, f"{source}.variants")
    else:
        variants = _combined(entries, f"{source}.grid")
    return Grid(name=path.stem, description=content.get("description", ""), variants=variants)


def _listed(entries: Mapping[str, Any], source: str) -> dict[str, list[str]]:
    """The variants as a file lists them."""
    for name, settings in entries.items():
        require(name.strip(), source, "a variant without a name", "name it")
        where = f"{source}.{name}"
        require(
            isinstance(settings, list) and settings, where, settings, "give a list of path=value"
        )
        for setting in settings:
            require_setting(setting, where)
    return {" ".join(name.split()): settings for name, settings in entries.items()}


def _combined(entries: Mapping[str, Any], source: str) -> dict[str, list[str]]:
    """Every combination of the values."""
    for path, values in entries.items():
        require_choices(values, f"{source}.{path}")
    variants = ([as_setting(*item) for item in c.items()] for c in combinations(entries))
    return {name_settings(settings): settings for settings in variants}


def name_settings(settings: Sequence[str]) -> str:
    """A variant's name: its blocks, and its other values with their fields."""
    paths = [setting.partition("=")[0] for setting in settings]
    last = Counter(path.split(".")[-1] for path in paths)
    labels = []
    for path, setting in zip(paths, settings, strict=True):
        value = " ".join(setting.partition("=")[2].split())
        block = value.removeprefix("!").removesuffix("{}").strip()
        if "." not in path and re.match(r"[A-Za-z_]", block):
            labels.append(block)
        else:
            name = path.split(".")[-1]
            labels.append(f"{name if last[name] == 1 else path}={value}")
    return ", ".join(labels)


def ablate(
    scenario: Scenario,
    variants: Mapping[str, Sequence[str]] | Iterable[tuple[str, Sequence[str]]],
    folder: str | Path,
    *,
    title: str = "",
    replay: bool = True,
    trust: bool = False,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> list[Row]:
    """Runs a scenario as it is and each of its variants, in a process per core, and compares.

    The folder gets table.md, table.csv (every metric), plots, and index.html with all replays
    side by side; the results of each variant stand in a folder of their own in it. All of it
    takes the place of what was there once all is done; variants of earlier calls keep their
    folders. A variant that cannot be built, or
    whose run ends before its time, is a row like the others, and says why.

    Args:
        scenario: what the variants change, and the first row.
        variants: settings "path=value" by the variant's name; equal names are told apart.
        folder: for the results, made where there is none.
        title: of the page.
        replay: whether to write replays.
        trust: whether the variants may import blocks of the user's own, which runs their code.
        progress: called with what is done and the share that is.

    Returns:
        The scenario as it is, and then the variants by their effect on the load's mean position
        error, the largest first; those that ended before their time come before these, and
        those without any run last.

    Raises:
        ScenarioError: the scenario as it is cannot be built or run, none of the variants'
            settings can be used, or the folder cannot be written.
    """
    folder = Path(folder)
    pairs = variants.items() if isinstance(variants, Mapping) else variants
    rows = _named([(BASE, ()), *pairs])
    texts, first_error = {}, None
    for k, row in enumerate(rows):
        try:
            texts[k] = dump_scenario(changed(scenario, row.settings, trust=trust))
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
    progress: Callable[[str, float], None],
) -> list[Row]:
    """Runs the rows that have a scenario's text, and writes all; see `ablate`."""
    curves = {}
    contents = [f"{row.folder}/{item}" for row in rows for item in RUN_FILES] + [*_FILES]
    with replacing_files(folder, contents) as new:
        with worker_processes() as executor:
            futures = {
                executor.submit(_run, text, new / rows[k].folder, replay): k
                for k, text in texts.items()
            }
            for done, future in enumerate(as_completed(futures)):
                result, row = future.result(), rows[futures[future]]
                if result is None:
                    raise KeyboardInterrupt
                row.outcome, row.message, drawn = result
                if row is rows[0] and drawn is None:
                    raise ScenarioError(row.message)
                if drawn is not None:
                    curves[row.folder] = drawn
                    text = (new / row.folder / "metrics.json").read_text(encoding="utf-8")
                    row.metrics = json.loads(text)
                progress("simulating", (done + 1) / len(futures))
        rows = ordered(rows)
        (new / "table.csv").write_text(as_csv(rows), encoding="utf-8", newline="")
        (new / "table.md").write_text(as_markdown(rows), encoding="utf-8")
        _draw(new, rows, curves)
        page = _page(title or scenario.name, scenario, rows, has_replays=replay)
        (new / "index.html").write_text(page, encoding="utf-8")
    return rows


def _named(variants: Iterable[tuple[str, Sequence[str]]]) -> list[Row]:
    """A row for each, with names and folders that are told apart."""
    names: set[str] = set()
    folders = {name.lower() for name in _FILES}
    rows = []
    for given, settings in variants:
        name = next(name for name in _numbered(given, " ({})") if name not in names)
        slug = re.sub(r"[^A-Za-z0-9.+-]+", "_", name)[:60].strip("_.") or "variant"
        place = next(place for place in _numbered(slug, "_{}") if place.lower() not in folders)
        names.add(name)
        folders.add(place.lower())
        rows.append(Row(variant=name, folder=place, settings=list(settings)))
    return rows


def _numbered(name: str, ending: str) -> Iterable[str]:
    """The name, and the name with 2, 3, … at its end."""
    return itertools.chain([name], (name + ending.format(k) for k in itertools.count(2)))


def _run(text: str, folder: Path, replay: bool) -> tuple[str, str, _Curves | None] | None:
    """Outcome, message and curves of a variant, whose results it writes; None: interrupted."""
    # A copy of a scenario that was trusted when it was loaded.
    tried = attempt(lambda: parse_scenario(text, trust=True))
    if tried is None:
        return None
    run = tried.run
    if run is None:
        return tried.outcome, tried.message, None
    write_results(run, folder, figures=False, replay=replay)
    return (
        tried.outcome,
        tried.message,
        _Curves(
            sample_times=run.time,
            position_error=np.linalg.norm(load_errors(run)[0], axis=1),
            step_times=run.steps["time"],
            slowest_speed=carrier_speeds(run.steps["carrier_state"]).min(axis=1),
            speed_bound=speed_bounds(run),
            least_tension=run.steps["tensions"].min(axis=1),
        ),
    )


def metric(row: Row, path: str) -> Any:
    """A metric by its path in metrics.json, such as "load.position_error_mean_m", or None."""
    value: Any = row.metrics
    for key in path.split("."):
        value = value.get(key) if isinstance(value, dict) else None
    return value


def ordered(rows: Sequence[Row], path: str = _ERROR) -> list[Row]:
    """The first row, and the others by the size of their change of a metric, largest first.

    Runs that ended before their time have no such change: they come first of the others, and
    what has no run at all last.
    """
    base, *others = rows

    def rank(row: Row) -> tuple[int, float]:
        if row.metrics is None:
            return 2, 0.0
        change = _change(row, base, path)
        return (0, 0.0) if change is None else (1, -abs(change))

    return [base, *sorted(others, key=rank)]


def _change(row: Row, base: Row, path: str) -> float | None:
    """By how much a metric differs from the first row's; None unless both runs completed."""
    values = [metric(r, path) for r in (row, base)]
    if not all(r.outcome == COMPLETED for r in (row, base)) or None in values:
        return None
    return values[0] - values[1]


def as_csv(rows: Sequence[Row]) -> str:
    """Every metric that is one value, a row per variant; columns are named by metrics' paths."""
    flat = [dict(_flattened(row.metrics or {})) for row in rows]
    paths = list(dict.fromkeys(itertools.chain.from_iterable(flat)))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["variant", "folder", "settings", "outcome", "message", *paths])
    for row, metrics in zip(rows, flat, strict=True):
        about = row.variant, row.folder, "; ".join(row.settings), row.outcome, row.message
        writer.writerow([*about, *(metrics.get(path, "") for path in paths)])
    return text.getvalue()


def _flattened(metrics: Mapping[str, Any]) -> Iterable[tuple[str, str]]:
    """Paths and values, written as in JSON but for texts and what was not measured."""
    for path, value in flattened(metrics).items():
        text = value if isinstance(value, str) else json.dumps(value)
        yield path, "" if value is None else text


def as_markdown(rows: Sequence[Row]) -> str:
    """The table, the order by the time below the bound, and why variants did not complete."""
    headings = ["variant", *(column.heading for column in _COLUMNS)]
    lines = [_markdown_line(headings), _markdown_line(["---"] + ["---:"] * len(_COLUMNS))]
    lines += [_markdown_line([_labelled(row), *_cells(row, rows[0])]) for row in rows]
    effects, unaffected = _effects_on_bound(rows)
    if effects:
        lines += ["", "By their effect on the time below the bound:", ""]
        lines += [f"{k}. {row.variant}: {text}" for k, (row, text) in enumerate(effects, 1)]
    if unaffected:
        lines += ["", f"No effect on it: {', '.join(unaffected)}."]
    problems = _problems(rows)
    if problems:
        lines += ["", *(f"- {problem}" for problem in problems)]
    return "\n".join(lines) + "\n"


def _markdown_line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def as_text(rows: Sequence[Row]) -> str:
    """The same in aligned columns for a terminal."""
    table = [["variant", *(column.short[1] for column in _COLUMNS)]]
    table += [[_shortened(row), *_cells(row, rows[0])] for row in rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    upper = _upper_headings(widths)  # which may widen them
    shown = [upper]
    for name, *cells in table:
        aligned = (f"{cell:>{width}}" for cell, width in zip(cells, widths[1:], strict=True))
        shown.append(" ".join([f"{name:{widths[0]}}", *aligned]).rstrip())
    effects, unaffected = _effects_on_bound(rows)
    if effects:
        longest = max(len(_shortened(row)) for row, _ in effects)
        shown += ["", "by their effect on the time below the bound"]
        shown += [f"  {_shortened(row):{longest}}  {text}" for row, text in effects]
    if unaffected:
        shown += ["", f"no effect on the time below the bound: {len(unaffected)} of the variants"]
    problems = _problems(rows)
    return "\n".join([*shown, *([""] if problems else []), *problems])


def _upper_headings(widths: list[int]) -> str:
    """The upper line of the headings; widens columns in place where one does not fit in.

    A column without an upper heading shares that of the column before it.
    """
    line = " " * widths[0]
    k = 0
    while k < len(_COLUMNS):
        end = k + 1
        while end < len(_COLUMNS) and not _COLUMNS[end].short[0]:
            end += 1
        heading = _COLUMNS[k].short[0]
        width = sum(widths[k + 1 : end + 1]) + end - k - 1
        widths[end] += max(0, len(heading) - width)
        line += f" {heading:>{max(width, len(heading))}}"
        k = end
    return line


def _shortened(row: Row) -> str:
    ending = _labelled(row).removeprefix(row.variant)
    room = _LONGEST_NAME - len(ending)
    name = row.variant if len(row.variant) <= room else f"{row.variant[: room - 1]}…"
    return f"{name}{ending}"


def _labelled(row: Row) -> str:
    return row.variant if row.outcome == COMPLETED else f"{row.variant} ({row.outcome})"


def _cells(row: Row, base: Row) -> list[str]:
    return [column.cell(row, base) for column in _COLUMNS]


def _effects_on_bound(rows: Sequence[Row]) -> tuple[list[tuple[Row, str]], list[str]]:
    """The variants that change the time below the bound, with figures; the others' names."""
    effects, unaffected = [], []
    for row in ordered(rows, _BELOW)[1:]:
        change = _change(row, rows[0], _BELOW)
        if change:
            slowest = _shown(metric(row, "carriers.speed_min_m_s"))
            effects.append((row, f"{_shown_change(change)} s (slowest carrier {slowest} m/s)"))
        elif change is not None:
            unaffected.append(row.variant)
    return effects, unaffected


def _problems(rows: Sequence[Row]) -> list[str]:
    return [f"{_labelled(row)}: {row.message}" for row in rows if row.outcome != COMPLETED]


def _shown(value: Any, scale: float = 1.0) -> str:
    """A figure in three digits, or less where it is small."""
    if value is None:
        return _NOTHING
    if isinstance(value, int) or value == 0:
        return f"{value:.0f}"
    value *= scale
    if abs(value) < 1e-4:
        return "≈ 0"
    if abs(value) < 0.1:
        return f"{value:.4f}" if abs(value) < 0.01 else f"{value:.3f}"
    return _three_digits(value)


def _shown_change(value: float | None, scale: float = 1.0) -> str:
    """A change with its sign, in three digits and no more than three decimals."""
    if value is None:
        return _NOTHING
    value *= scale
    if abs(value) < 0.0005:
        return "≈ 0" if value else "0"
    return f"{'+' if value > 0 else ''}{f'{value:.3f}' if abs(value) < 1 else _three_digits(value)}"


def _three_digits(value: float) -> str:
    return f"{value:.0f}" if 1000 <= abs(value) < 1e6 else f"{value:#.3g}".rstrip(".")


def _draw(folder: Path, rows: Sequence[Row], curves: Mapping[str, _Curves]) -> None:
    """Draws the plots; a run that ended before its time does not stretch their axes."""
    drawn = {row.variant: curves[row.folder] for row in rows if row.folder in curves}
    whole = {row.variant for row in rows if row.outcome == COMPLETED} or set(drawn)
    longest = max(drawn.values(), key=lambda c: c.step_times[-1])
    figures = (
        make_overlay_figure(
            "Load position error",
            "position error (mm)",
            {name: (c.sample_times, 1e3 * c.position_error) for name, c in drawn.items()},
            framed=whole,
            is_logarithmic=True,
        ),
        make_overlay_figure(
            "Speed of the slowest carrier",
            "speed (m/s)",
            {name: (c.step_times, c.slowest_speed) for name, c in drawn.items()},
            framed=whole,
            bound=(longest.step_times, longest.speed_bound),
        ),
        make_overlay_figure(
            "Least tension of the cables",
            "tension (N)",
            {name: (c.step_times, c.least_tension) for name, c in drawn.items()},
            framed=whole,
        ),
    )
    for name, figure in zip(_PLOTS, figures, strict=True):
        figure.savefig(folder / name, dpi=150)


def _page(title: str, scenario: Scenario, rows: Sequence[Row], *, has_replays: bool) -> str:
    """The table, the plots and the replays, in HTML that refers to files beside it only."""
    base = rows[0]
    headings = "".join(f"<th>{html.escape(column.heading)}</th>" for column in _COLUMNS)
    body = "".join(_table_row(row, base) for row in rows)
    effects, unaffected = _effects_on_bound(rows)
    effect = "".join(
        f"<li><b>{html.escape(row.variant)}</b> {html.escape(text)}</li>" for row, text in effects
    )
    shown = [row for row in rows if row.metrics is not None] if has_replays else []
    template = resources.files("drake_nonstop.studies").joinpath("ablation.html")
    return Template(template.read_text(encoding="utf-8")).substitute(
        title=html.escape(title),
        description=html.escape(scenario.description),
        headings=headings,
        body=body,
        effects=f"<ol>{effect}</ol>" if effects else "",
        unaffected=html.escape(", ".join(unaffected) or "none"),
        problems="".join(f"<p class=problem>{html.escape(text)}</p>" for text in _problems(rows)),
        plots="".join(f'<a href="{name}"><img src="{name}" alt="{name}"></a>' for name in _PLOTS),
        hidden="" if shown else "hidden",
        legend=legend(scenario.scene),
        duration=max([metric(row, "simulated_s") for row in shown], default=0.0),
        cards="".join(_card(row) for row in shown),
    )


def _table_row(row: Row, base: Row) -> str:
    """A row of the page's table; a change for the worse is marked, and one for the better."""
    cells = ""
    for column in _COLUMNS:
        kind = ""
        change = _change(row, base, column.path) if column.is_change else None
        if change is not None and abs(change * column.scale) >= 0.0005:
            kind = " class=worse" if change > 0 else " class=better"
        cells += f"<td{kind}>{column.cell(row, base)}</td>"
    settings = "<br>".join(html.escape(setting) for setting in row.settings)
    name = html.escape(_labelled(row))
    if row.metrics is not None:
        name = f'<a href="{quote(row.folder)}/">{name}</a>'
    details = f"<details><summary>{name}</summary><code>{settings}</code></details>"
    return f"<tr><th>{details if row.settings else name}</th>{cells}</tr>"


def _card(row: Row) -> str:
    """The place of a replay, with what it comes to."""
    figures = (
        f"error {_shown(metric(row, _ERROR), 1e3)} mm · slowest "
        f"{_shown(metric(row, 'carriers.speed_min_m_s'))} m/s · below ε for "
        f"{_shown(metric(row, _BELOW))} s"
    )
    page = f"{quote(row.folder)}/replay.html"
    return (
        f'<figure data-page="{page}"><div class="screen"></div><figcaption>'
        f'<a href="{page}">{html.escape(_labelled(row))}</a> {figures}</figcaption></figure>'
    )
