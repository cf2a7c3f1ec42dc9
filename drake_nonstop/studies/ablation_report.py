"""The rows of a comparison, its tables, and its page with plots and all replays side by side."""

import csv
import html
import io
import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any
from urllib.parse import quote

import numpy as np

from drake_nonstop.run.metrics import METRICS, Metric, flattened, metric_at, value_at
from drake_nonstop.run.run import Run
from drake_nonstop.run.run_quantities import RunQuantities
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.figures import make_overlay_figure
from drake_nonstop.studies.run_all import COMPLETED
from drake_nonstop.view.figure_style import extreme_samples
from drake_nonstop.view.replay import legend

BASE = "as it is"  # the name of the scenario without any change

OUTCOME = metric_at("outcome")
POSITION_ERROR = metric_at("load.position_error_mean_m")
TIME_BELOW_BOUND = metric_at("carriers.time_below_bound_s")
SLOWEST_SPEED = metric_at("carriers.speed_min_m_s")
_NAME_WIDTH = 26  # characters, of a variant in the terminal
_NO_VALUE = "–"  # in place of what was not measured
_SMALLEST_CHANGE = 0.0005  # as shown; a smaller one is shown as ≈ 0
_BAR = r"\|"  # in a cell of Markdown
PAGE = "index.html"
PLOTS = ("position_error.png", "slowest_speed.png", "tension_min.png")
_MOST_POINTS = 4000  # of a curve: those of all runs are in memory at once
Curves = Mapping[str, Sequence[float]]  # by the names that `curves_of` has


@dataclass(kw_only=True)
class Row:
    """The result of a variant.

    `metrics` are those of `folder`/metrics.json, up to where the run ended; None where there
    was no run. `message` says why a variant that is not "completed" is "diverged", "failed"
    (a block raised an error, or the process died) or "unbuildable".
    """

    variant: str
    folder: str  # of its results, in the folder of all
    overrides: list[str]  # "path=value"
    ending: str = COMPLETED
    message: str = ""
    metrics: dict[str, Any] | None = None


def ordered(rows: Sequence[Row], metric: Metric = POSITION_ERROR) -> list[Row]:
    """The first row, and the others by the size of their change of a metric, largest first.

    A run that did not complete has no such change: it comes before those that have one, and a
    variant without any run comes last.
    """
    base, *others = rows

    def rank(row: Row) -> tuple[int, float]:
        if row.metrics is None:
            return 2, 0.0
        change = change_of(row, base, metric)
        return (0, 0.0) if change is None else (1, -abs(change))

    return [base, *sorted(others, key=rank)]


def change_of(row: Row, base: Row, metric: Metric) -> float | None:
    """A metric's difference from the first row's; None unless both runs completed."""
    values = [metric.value(r.metrics) for r in (row, base)]
    if not all(r.ending == COMPLETED for r in (row, base)) or None in values:
        return None
    return values[0] - values[1]


@dataclass(frozen=True, kw_only=True)
class Column:
    """A metric, or its change against the first row."""

    metric: Metric
    upper: str  # the heading in a terminal, in two lines; columns may share the upper one
    lower: str
    is_change: bool = False

    @property
    def heading(self) -> str:
        """The heading in one line, with the unit."""
        return f"change ({self.metric.quantity.unit})" if self.is_change else self.metric.heading

    def cell(self, row: Row, base: Row) -> str:
        """The value of a row, in a few digits."""
        if not self.is_change:
            return shown(self.metric, row)
        return _NO_VALUE if row is base else _shown_change(self.metric, row, base)

    def is_better(self, row: Row, base: Row) -> bool | None:
        """Whether the change of a row is one for the better; None: neither, or no change."""
        change = change_of(row, base, self.metric) if self.is_change else None
        if change is None or abs(self.metric.shown(change)) < _SMALLEST_CHANGE:
            return None
        direction = change * self.metric.quantity.better
        return None if direction == 0 else direction > 0


def _columns() -> tuple[Column, ...]:
    """The columns of the metrics that have one; those that share a heading stand together."""
    columns = []
    for metric in METRICS:
        if metric.column is None:
            continue
        upper, lower, has_change = metric.column
        columns.append(Column(metric=metric, upper=upper, lower=lower))
        if has_change:
            columns.append(Column(metric=metric, upper=upper, lower="change", is_change=True))
    headings = [column.upper for column in columns]
    return tuple(sorted(columns, key=lambda column: headings.index(column.upper)))


COLUMNS = _columns()


def as_csv(rows: Sequence[Row]) -> str:
    """Every metric that is one value, a row per variant; columns are named by metrics' paths."""
    flat = [flattened(row.metrics or {}) for row in rows]
    paths = list(dict.fromkeys(itertools.chain.from_iterable(flat)))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["variant", "folder", "overrides", "ending", "message", *paths])
    for row, metrics in zip(rows, flat, strict=True):
        about = row.variant, row.folder, "; ".join(row.overrides), row.ending, row.message
        writer.writerow([*about, *(_csv_cell(metrics.get(path)) for path in paths)])
    return text.getvalue()


def _csv_cell(value: Any) -> str:
    """A value as in JSON, but for texts and what was not measured."""
    return "" if value is None else value if isinstance(value, str) else json.dumps(value)


def as_markdown(rows: Sequence[Row]) -> str:
    """The table, the order by the time below the bound, and problems."""
    table = [
        ["variant", *(column.heading for column in COLUMNS)],
        ["---"] + ["---:"] * len(COLUMNS),
    ]
    table += [[labelled(row), *_cells(row, rows[0])] for row in rows]
    lines = [f"| {' | '.join(cell.replace('|', _BAR) for cell in cells)} |" for cells in table]
    effects, unaffected = effects_on_bound(rows)
    if effects:
        lines += ["", "By their effect on the time below the bound:", ""]
        lines += [f"{k}. {row.variant}: {text}" for k, (row, text) in enumerate(effects, 1)]
    if unaffected:
        lines += ["", f"No effect on the time below the bound: {', '.join(unaffected)}."]
    problems = problems_of(rows)
    if problems:
        lines += ["", *(f"- {problem}" for problem in problems)]
    return "\n".join(lines) + "\n"


def as_text(rows: Sequence[Row]) -> str:
    """The same in aligned columns for a terminal."""
    table = [["variant", *(column.lower for column in COLUMNS)]]
    table += [[_shortened(row), *_cells(row, rows[0])] for row in rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    upper = _upper_headings(widths)  # which may widen them
    lines = [upper]
    for name, *cells in table:
        aligned = (f"{cell:>{width}}" for cell, width in zip(cells, widths[1:], strict=True))
        lines.append(" ".join([f"{name:{widths[0]}}", *aligned]).rstrip())
    effects, unaffected = effects_on_bound(rows)
    if effects:
        longest = max(len(_shortened(row)) for row, _ in effects)
        lines += ["", "by their effect on the time below the bound"]
        lines += [f"  {_shortened(row):{longest}}  {text}" for row, text in effects]
    if unaffected:
        lines += ["", f"no effect on the time below the bound: {len(unaffected)} of the variants"]
    problems = problems_of(rows)
    return "\n".join([*lines, *([""] if problems else []), *problems])


def _upper_headings(widths: list[int]) -> str:
    """The upper line of the headings; widens columns in place where one does not fit in."""
    line = " " * widths[0]
    end = 0
    for upper, columns in itertools.groupby(COLUMNS, key=lambda column: column.upper):
        start, end = end, end + len(list(columns))
        width = sum(widths[start + 1 : end + 1]) + end - start - 1
        widths[end] += max(0, len(upper) - width)
        line += f" {upper:>{max(width, len(upper))}}"
    return line


def _shortened(row: Row) -> str:
    label = labelled(row).removeprefix(row.variant)
    room = _NAME_WIDTH - len(label)
    name = row.variant if len(row.variant) <= room else f"{row.variant[: room - 1]}…"
    return f"{name}{label}"


def _cells(row: Row, base: Row) -> list[str]:
    return [column.cell(row, base) for column in COLUMNS]


def effects_on_bound(rows: Sequence[Row]) -> tuple[list[tuple[Row, str]], list[str]]:
    """The variants that change the time below the bound, with figures; the others' names.

    There are no others where no time is below the bound in the first row.
    """
    effects, unaffected = [], []
    for row in ordered(rows, TIME_BELOW_BOUND)[1:]:
        change = change_of(row, rows[0], TIME_BELOW_BOUND)
        if change:
            by = _shown_change(TIME_BELOW_BOUND, row, rows[0])
            effects.append((row, f"{by} s (slowest carrier {shown(SLOWEST_SPEED, row)} m/s)"))
        elif change is not None and TIME_BELOW_BOUND.value(rows[0].metrics) > 0:
            unaffected.append(row.variant)
    return effects, unaffected


def problems_of(rows: Sequence[Row]) -> list[str]:
    """A line for each variant that did not complete, and for each warning about a run."""
    problems = [f"{labelled(row)}: {row.message}" for row in rows if row.ending != COMPLETED]
    for row in rows:
        warnings = (row.metrics or {}).get("warnings", ())
        problems += [f"{labelled(row)}: warning: {warning}" for warning in warnings]
    return problems


def labelled(row: Row) -> str:
    """The variant's name, with the ending where it did not complete."""
    return row.variant if row.ending == COMPLETED else f"{row.variant} ({row.ending})"


def shown(metric: Metric, row: Row) -> str:
    """A row's metric: a text, or a number in three digits, or less where it is small."""
    value = metric.shown(metric.value(row.metrics))
    if value is None:
        return _NO_VALUE
    if isinstance(value, str):
        return value
    if isinstance(value, int) or value == 0:
        return f"{value:.0f}"
    if abs(value) < 1e-4:
        return "≈ 0"
    if abs(value) < 0.1:
        return f"{value:.4f}" if abs(value) < 0.01 else f"{value:.3f}"
    return _three_digits(value)


def _shown_change(metric: Metric, row: Row, base: Row) -> str:
    """A change with its sign, in three digits and no more than three decimals."""
    value = metric.shown(change_of(row, base, metric))
    if value is None:
        return _NO_VALUE
    if abs(value) < _SMALLEST_CHANGE:
        return "≈ 0" if value else "0"
    return f"{'+' if value > 0 else ''}{f'{value:.3f}' if abs(value) < 1 else _three_digits(value)}"


def _three_digits(value: float) -> str:
    return f"{value:.0f}" if 1000 <= abs(value) < 1e6 else f"{value:#.3g}".rstrip(".")


def curves_of(run: Run) -> dict[str, list[float]]:
    """The curves of a run in the plots; of a long run its extreme values only."""
    quantities = RunQuantities(run)
    errors, speeds = quantities.position_error, quantities.speeds.min(axis=1)
    tensions = quantities.tensions.min(axis=1)
    sampled = extreme_samples(errors, _MOST_POINTS)
    stepped = extreme_samples(
        np.column_stack([speeds, quantities.speed_bounds, tensions]), _MOST_POINTS
    )
    return {
        "sample_times": run.time[sampled].tolist(),  # s, at 100 Hz
        "position_error": POSITION_ERROR.shown(errors[sampled]).tolist(),
        "step_times": quantities.time[stepped].tolist(),  # s, of the integrator
        "slowest_speed": speeds[stepped].tolist(),  # m/s
        "speed_bound": quantities.speed_bounds[stepped].tolist(),  # m/s
        "least_tension": tensions[stepped].tolist(),  # N
    }


def write_page(
    folder: Path,
    title: str,
    scenario: Scenario,
    rows: Sequence[Row],
    curves: Mapping[str, Curves],
    *,
    has_replays: bool,
) -> None:
    """Writes the plots and the page to the folder; `curves` are by the rows' folders."""
    _draw(folder, rows, curves)
    page = _page(title, scenario, rows, has_replays=has_replays)
    (folder / PAGE).write_text(page, encoding="utf-8")


def _draw(folder: Path, rows: Sequence[Row], curves: Mapping[str, Curves]) -> None:
    """Writes the plots, whose axes are scaled to the completed runs."""
    drawn = {row.variant: curves[row.folder] for row in rows if row.folder in curves}
    whole = {row.variant for row in rows if row.ending == COMPLETED} or set(drawn)
    longest = max(drawn.values(), key=lambda c: c["step_times"][-1])
    errors, speeds, tensions = (
        {name: (np.array(c[times]), np.array(c[curve])) for name, c in drawn.items()}
        for times, curve in (
            ("sample_times", "position_error"),
            ("step_times", "slowest_speed"),
            ("step_times", "least_tension"),
        )
    )
    label = f"position error ({POSITION_ERROR.quantity.unit})"
    bound = np.array(longest["step_times"]), np.array(longest["speed_bound"])
    title = "Speed of the slowest carrier"
    for name, figure in zip(
        PLOTS,
        (
            make_overlay_figure(
                "Load position error", label, errors, framed=whole, is_logarithmic=True
            ),
            make_overlay_figure(title, "speed (m/s)", speeds, framed=whole, bound=bound),
            make_overlay_figure(
                "Least tension of the cables", "tension (N)", tensions, framed=whole
            ),
        ),
        strict=True,
    ):
        figure.savefig(folder / name, dpi=150)


def _page(title: str, scenario: Scenario, rows: Sequence[Row], *, has_replays: bool) -> str:
    """The table, the plots and the replays as HTML that refers to files of its folder only."""
    base = rows[0]
    headings = "".join(f"<th>{html.escape(column.heading)}</th>" for column in COLUMNS)
    body = "".join(_table_row(row, base) for row in rows)
    effects, unaffected = effects_on_bound(rows)
    effect = "".join(
        f"<li><b>{html.escape(row.variant)}</b> {html.escape(text)}</li>" for row, text in effects
    )
    replayed = [row for row in rows if row.metrics is not None] if has_replays else []
    template = resources.files("drake_nonstop.studies").joinpath("ablation_report.html")
    return Template(template.read_text(encoding="utf-8")).substitute(
        title=html.escape(title),
        description=html.escape(scenario.description),
        headings=headings,
        body=body,
        effects=f"<ol>{effect}</ol>" if effects else "",
        unaffected=html.escape(", ".join(unaffected) or "none"),
        problems="".join(f"<p class=problem>{html.escape(text)}</p>" for text in problems_of(rows)),
        plots="".join(f'<a href="{name}"><img src="{name}" alt="{name}"></a>' for name in PLOTS),
        hidden="" if replayed else "hidden",
        legend=legend(scenario, has_aircraft=scenario.system.aircraft is not None),
        duration=max([value_at(row.metrics, "simulated_s") for row in replayed], default=0.0),
        cards="".join(_card(row) for row in replayed),
    )


def _table_row(row: Row, base: Row) -> str:
    """A row of the page's table, with changes for the worse and for the better marked."""
    cells = ""
    for column in COLUMNS:
        is_better = column.is_better(row, base)
        kind = "" if is_better is None else f" class={'better' if is_better else 'worse'}"
        cells += f"<td{kind}>{column.cell(row, base)}</td>"
    overrides = "<br>".join(html.escape(override) for override in row.overrides)
    name = html.escape(labelled(row))
    if row.metrics is not None:
        name = f'<a href="{quote(row.folder)}/">{name}</a>'
    details = f"<details><summary>{name}</summary><code>{overrides}</code></details>"
    return f"<tr><th>{details if row.overrides else name}</th>{cells}</tr>"


def _card(row: Row) -> str:
    """The place of a replay, with some metrics."""
    figures = (
        f"{shown(OUTCOME, row)} · error {shown(POSITION_ERROR, row)} mm · "
        f"slowest {shown(SLOWEST_SPEED, row)} m/s · below ε for {shown(TIME_BELOW_BOUND, row)} s"
    )
    page = f"{quote(row.folder)}/replay.html"
    return (
        f'<figure data-page="{page}"><div class="screen"></div><figcaption>'
        f'<a href="{page}">{html.escape(labelled(row))}</a> {figures}</figcaption></figure>'
    )
