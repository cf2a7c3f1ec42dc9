"""What the runs of a study have in common: statistics over seeds, and tables of them."""

from __future__ import annotations

import html
import math
import textwrap
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.run.metrics import Metric
from drake_nonstop.studies.attempts import COMPLETED

if TYPE_CHECKING:
    from pandas import DataFrame, Series

NO_VALUE = "–"  # in place of what was not measured
_HEADING = 12  # characters, of a line of a column's heading in a terminal
_MOST_PROBLEMS = 12
_LEAST = 5e-4  # as shown; what is smaller is shown as ≈ 0
_ABOUT = ("run", "seed", "ending", "message", "outcome", "reasons", "warnings")
_LATEX = str.maketrans({c: f"\\{c}" for c in "&%$#_{}"} | {"²": "$^2$", "ε": "$\\epsilon$"})
_LATEX |= str.maketrans({"–": "--", "±": "$\\pm$", "≈": "$\\approx$", "−": "$-$"})


def interval(values: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Mean, standard deviation and half of the 95 % interval of rows (k, m), without NaN."""
    from scipy.special import stdtrit  # here: commands that compare nothing need none of it

    count = np.sum(~np.isnan(values), axis=1)
    mean = np.nansum(values, axis=1) / np.where(count > 0, count, math.nan)
    squares = np.nansum((values - mean[:, None]) ** 2, axis=1)
    deviation = np.sqrt(squares / np.where(count > 1, count - 1, math.nan))
    half = stdtrit(np.maximum(count - 1, 1), 0.975) * deviation / np.sqrt(np.maximum(count, 1))
    return mean, deviation, half


def name_of(factors: Mapping[str, Any]) -> str:
    """Levels of factors in a line: names alone, numbers with the last part of their factor."""
    return ", ".join(
        level if isinstance(level, str) else f"{name.rpartition('.')[2]}={level}"
        for name, level in factors.items()
        if level != ""
    )


class Summary:
    """The runs of a study by their settings, each with the same number of seeds in the table."""

    def __init__(self, table: DataFrame, settings: Sequence[Any]):
        self.table = table
        self.settings = settings
        self.seeds = len(table) // len(settings)
        self.factors = [*dict.fromkeys(name for each in settings for name in each.factors)]

    def values(self, path: str) -> NDArray:
        """A metric (settings, seeds); NaN where it was not measured or a run did not complete."""
        from pandas import to_numeric

        if path not in self.table:
            return np.full((len(self.settings), self.seeds), math.nan)
        column = to_numeric(self.table[path], errors="coerce")
        column = column.where(self.table["ending"] == COMPLETED)
        return column.to_numpy(dtype=float).reshape(-1, self.seeds)

    def frame(self) -> DataFrame:
        """The statistics of every metric that is a number; see `Study.summary`."""
        from pandas import DataFrame
        from pandas.api.types import is_bool_dtype, is_numeric_dtype

        known = {*_ABOUT, *self.factors}
        columns: dict[Any, Any] = {
            (name, ""): [setting.factors.get(name) for setting in self.settings]
            for name in self.factors
        }
        completed = self.table["ending"] == COMPLETED
        columns["completed", ""] = completed.to_numpy().reshape(-1, self.seeds).sum(axis=1)
        if "outcome" in self.table:
            is_ok = (self.table["outcome"] == "ok").to_numpy().reshape(-1, self.seeds)
            columns["ok", ""] = is_ok.sum(axis=1)
        for path in self.table:
            column = self.table[path]
            if path in known or is_bool_dtype(column) or not is_numeric_dtype(column):
                continue
            values = self.values(path)
            mean, deviation, half = interval(values)
            change, _, change_half = interval(values - values[:1])
            columns |= {
                (path, "mean"): mean,
                (path, "std"): deviation,
                (path, "low"): mean - half,
                (path, "high"): mean + half,
                (path, "change"): change,
                (path, "change low"): change - change_half,
                (path, "change high"): change + change_half,
            }
        frame = DataFrame(columns)
        if not self.factors:
            return frame
        return frame.set_index([(name, "") for name in self.factors]).rename_axis(self.factors)

    def outcome(self, k: int) -> str:
        """The outcomes of a setting's runs, or how they ended; with numbers where they differ."""
        rows = self.table.iloc[k * self.seeds : (k + 1) * self.seeds]
        named = Counter(map(_outcome, (row for _, row in rows.iterrows())))
        if len(named) == 1:
            return next(iter(named))
        return ", ".join(f"{count} {name}" for name, count in named.most_common())

    def columns(self, metrics: Sequence[Metric]) -> list[tuple[str, list[str], list[bool | None]]]:
        """Headings, a cell for each setting, and whether it is a change for the better.

        The factors come first; metrics with changes have a column more.
        """
        found: list[tuple[str, list[str], list[bool | None]]] = []
        nothing: list[bool | None] = [None] * len(self.settings)
        for name in self.factors:
            cells = [_level(setting.factors.get(name, "")) for setting in self.settings]
            last = name.rpartition(".")[2]
            is_one = sum(each.endswith(last) for each in self.factors) == 1
            found.append((last if is_one else name, cells, nothing))
        for metric in metrics:
            if metric.path == "outcome":
                found.append(("outcome", [*map(self.outcome, range(len(nothing)))], nothing))
                continue
            values = self.values(metric.path) * metric.quantity.scale
            if not np.isnan(values).all():
                found.append((metric.heading, _cells(values), nothing))
                if metric.column and metric.column.has_change and len(values) > 1:
                    changes = values - values[:1]
                    better = _better(changes, metric.quantity.better)
                    found.append(("change", ["", *_cells(changes, sign="+")[1:]], better))
        return found

    def problems(self) -> list[str]:
        """A line for each reason why runs did not complete, and for each warning."""
        said: dict[str, list[str]] = {}
        for number, (_, row) in enumerate(self.table.iterrows()):
            name = self.settings[number // self.seeds].name
            warnings = row.get("warnings")
            texts = [row["message"]] if row["ending"] != COMPLETED else []
            texts += [f"warning: {warnings}"] if isinstance(warnings, str) and warnings else []
            for text in texts:
                said.setdefault(text, []).append(name)
        lines = []
        for text, names in said.items():
            others = len({*names}) - 1
            where = f"{names[0]}{f' and {others} more' if others else ''}"
            lines.append(f"{where}: {text}")
        rest = len(lines) - _MOST_PROBLEMS
        return lines[:_MOST_PROBLEMS] + ([f"and {rest} more: see the table"] if rest > 0 else [])

    def text(self, metrics: Sequence[Metric]) -> str:
        """The table in aligned columns for a terminal; no name is cut."""
        columns = self.columns(metrics)
        wrapped = [
            textwrap.wrap(heading, _HEADING, break_long_words=False) or [""]
            for heading, *_ in columns
        ]
        height = max(map(len, wrapped))
        lines = [""] * (height + len(self.settings))
        for k, (heading, (_, cells, _)) in enumerate(zip(wrapped, columns, strict=True)):
            every = [""] * (height - len(heading)) + heading + cells
            width = max(map(len, every))
            is_name = k < len(self.factors)
            for i, cell in enumerate(every):
                lines[i] += f"{cell:{'<' if is_name else '>'}{width}}  "
        return "\n".join(line.rstrip() for line in [*lines, *self.problems()])

    def html(self, metrics: Sequence[Metric], name: Callable[[int], str] | None = None) -> str:
        """The table as HTML, with changes marked; `name` is the first cell of a setting."""
        columns = self.columns(metrics)
        head = "".join(f"<th>{html.escape(heading)}</th>" for heading, *_ in columns)
        body = ""
        for k in range(len(self.settings)):
            body += "<tr>"
            for i, (_, cells, better) in enumerate(columns):
                kind = {None: "", True: " class=better", False: " class=worse"}[better[k]]
                cell = name(k) if name and i == 0 else html.escape(cells[k])
                tag = "th" if i < len(self.factors) else "td"
                body += f"<{tag}{kind}>{cell}</{tag}>"
            body += "</tr>"
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"

    def latex(self, metrics: Sequence[Metric]) -> str:
        """The table as LaTeX, for booktabs."""
        columns = self.columns(metrics)
        kinds = "l" * len(self.factors) + "r" * (len(columns) - len(self.factors))
        rows = [[heading for heading, *_ in columns]]
        rows += [[*row] for row in zip(*(cells for _, cells, _ in columns), strict=True)]
        head, *body = [" & ".join(c.translate(_LATEX) for c in row) + r" \\" for row in rows]
        begin, end = rf"\begin{{tabular}}{{{kinds}}}", r"\end{tabular}"
        return "\n".join([begin, r"\toprule", head, r"\midrule", *body, r"\bottomrule", end, ""])


def _outcome(row: Series) -> str:
    outcome = row.get("outcome")
    if row["ending"] == COMPLETED and isinstance(outcome, str):
        return outcome
    return str(row["ending"])


def _level(level: Any) -> str:
    return f"{level:g}" if isinstance(level, float) else str(level)


def _cells(values: NDArray, sign: str = "") -> list[str]:
    """The means of rows, with half of their intervals where there are several values."""
    return [
        number(mean, half, sign)
        for mean, _, half in zip(*(x.tolist() for x in interval(values)), strict=True)
    ]


def number(mean: float, half: float = math.nan, sign: str = "") -> str:
    """A number in three digits, or with its uncertainty, in two digits of that."""
    if math.isnan(mean):
        return NO_VALUE
    half = math.nan if half <= 1e-9 * abs(mean) else half  # of runs without chance
    if 0 < abs(mean) < _LEAST and not half > _LEAST:
        return "≈ 0"
    size = half if half > 0 else abs(mean) / 10
    digits = 1 - math.floor(math.log10(size)) if size > 0 else 0
    digits = min(max(digits, 0), 6)
    if math.isnan(half):
        return f"{mean:{sign if mean else ''}.{digits}f}"
    return f"{mean:{sign}.{digits}f} ± {half:.{digits}f}"


def _better(changes: NDArray, direction: int) -> list[bool | None]:
    """Whether changes are for the better; None where their interval holds zero."""
    mean, _, half = interval(changes)
    half = np.where(np.isnan(half), 0.0, half)
    is_clear = np.abs(mean) > half
    return [
        bool(value * direction > 0) if clear and direction else None
        for value, clear in zip(mean, is_clear, strict=True)
    ]
