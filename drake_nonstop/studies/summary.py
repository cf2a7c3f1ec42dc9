"""What the runs of a study have in common: statistics over seeds, and tables of them."""

from __future__ import annotations

import html
import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from drake_nonstop.run.metrics import Metric
from drake_nonstop.studies.attempts import COMPLETED

if TYPE_CHECKING:
    from pandas import DataFrame

NO_VALUE = "–"  # in place of what was not measured
_HEADING = 12  # characters, of a line of a column's heading in a terminal
_MOST_PROBLEMS = 12
_LEAST = 5e-4  # as shown; what is smaller is shown as ≈ 0
_LATEX = str.maketrans({c: f"\\{c}" for c in "&%$#_{}"} | {"²": "$^2$", "ε": "$\\epsilon$"})
_LATEX |= str.maketrans({"–": "--", "±": "$\\pm$", "≈": "$\\approx$", "−": "$-$"})


def name_of(factors: Mapping[str, Any]) -> str:
    """Levels of factors in a line: names alone, numbers with the last part of their factor."""
    return ", ".join(
        level if isinstance(level, str) else f"{name.rpartition('.')[2]}={level}"
        for name, level in factors.items()
    )


class Summary:
    """The runs of a study by their settings, each with the same number of seeds in the table.

    Attributes:
        statistics: of each metric, by "mean", "std", the "half" of the 95 % interval by Student's
            t, and the same of its "change" from the first setting over the same seeds: "change"
            and "change half". A row for each setting; of runs that completed.
    """

    def __init__(self, table: DataFrame, settings: Sequence[Any]):
        self.table, self.settings = table, settings
        self.seeds = len(table) // len(settings)
        self.factors = [*settings[0].factors]
        self._number = np.repeat(np.arange(len(settings)), self.seeds)
        numbers = table.select_dtypes("number").drop(
            columns=[*self.factors, "seed"], errors="ignore"
        )
        self.values = numbers.where(table["ending"] == COMPLETED).astype(float)
        first = np.tile(self.values[: self.seeds], (len(settings), 1))
        self.statistics = self._over_seeds(self.values)
        changes = self._over_seeds(self.values - first)
        self.statistics |= {"change": changes["mean"], "change half": changes["half"]}

    def _over_seeds(self, values: DataFrame) -> dict[str, DataFrame]:
        from scipy.special import stdtrit  # here: commands that compare nothing need none of it

        groups = values.groupby(self._number)
        count, std = groups.count(), groups.std()
        half = stdtrit(np.maximum(count - 1, 1), 0.975) * std / np.sqrt(count)
        return {"mean": groups.mean(), "std": std, "half": half}

    def frame(self) -> DataFrame:
        """The statistics of every metric that is a number; see `Study.summary`."""
        from pandas import DataFrame

        columns: dict[Any, Any] = {
            (name, ""): [setting.factors[name] for setting in self.settings]
            for name in self.factors
        }
        told = {"completed": self.table["ending"] == COMPLETED}
        if "outcome" in self.table:
            told["ok"] = self.table["outcome"] == "ok"
        columns |= {(name, ""): is_so.groupby(self._number).sum() for name, is_so in told.items()}
        for path in self.values:
            mean, std, half, change, change_half = (each[path] for each in self.statistics.values())
            columns |= {(path, "mean"): mean, (path, "std"): std}
            columns |= {(path, "low"): mean - half, (path, "high"): mean + half}
            columns[path, "change"] = change
            columns[path, "change low"] = change - change_half
            columns[path, "change high"] = change + change_half
        frame = DataFrame(columns)
        if not self.factors:
            return frame
        return frame.set_index([(name, "") for name in self.factors]).rename_axis(self.factors)

    def outcomes(self) -> list[str]:
        """The outcomes of each setting's runs, or endings; with numbers where they differ."""
        completed = self.table["ending"] == COMPLETED
        outcome = self.table.get("outcome", self.table["ending"]).where(completed)
        named = outcome.fillna(self.table["ending"]).groupby(self._number)
        return [
            ", ".join(f"{n} {name}" for name, n in counts.items())
            if len(counts) > 1
            else str(counts.index[0])
            for counts in (group.value_counts() for _, group in named)
        ]

    def columns(
        self, metrics: Sequence[Metric], mark: Callable[[str, bool], str] = lambda cell, _: cell
    ) -> dict[tuple[int, str], list[str]]:
        """A cell for each setting by the column's number and heading, the factors' first.

        Metrics with changes have a column more, in which those that are for the better, or the
        worse, beyond their interval are marked by a function of the cell and of that.
        """
        found: list[tuple[str, list[str]]] = []
        for name in self.factors:
            last = name.rpartition(".")[2]
            is_one = sum(each.endswith(last) for each in self.factors) == 1
            cells = [setting.factors[name] for setting in self.settings]
            cells = [f"{cell:g}" if isinstance(cell, float) else str(cell) for cell in cells]
            found.append((last if is_one else name, cells))
        for metric in metrics:
            if metric.path == "outcome":
                found.append(("outcome", self.outcomes()))
            if metric.path not in self.values or self.values[metric.path].isna().all():
                continue
            mean, _, half, change, change_half = (
                each[metric.path] * metric.scale for each in self.statistics.values()
            )
            found.append((metric.heading, [*map(number, mean, half)]))
            if metric.has_change and len(self.settings) > 1:
                cells = [number(*each, "+") for each in zip(change, change_half, strict=True)]
                better = change * metric.better
                is_clear = (change.abs() > change_half.fillna(0.0)) & (better != 0)
                for k in np.flatnonzero(is_clear & (change.abs() > _LEAST)):
                    cells[k] = mark(cells[k], bool(better[k] > 0))
                found.append(("change", ["", *cells[1:]]))
        return {(k, heading): cells for k, (heading, cells) in enumerate(found)}

    def problems(self) -> list[str]:
        """A line for each reason why runs did not complete, and for each warning."""
        names: dict[str, dict[str, None]] = {}
        for k, (_, row) in zip(self._number.tolist(), self.table.iterrows(), strict=True):
            warnings = row.get("warnings")
            texts = [row["message"]] if row["ending"] != COMPLETED else []
            texts += [f"warning: {warnings}"] if isinstance(warnings, str) and warnings else []
            for text in texts:
                names.setdefault(text, {})[self.settings[k].name] = None
        lines = [
            f"{next(iter(of))}{f' and {len(of) - 1} more' if len(of) > 1 else ''}: {text}"
            for text, of in names.items()
        ]
        rest = len(lines) - _MOST_PROBLEMS
        return lines[:_MOST_PROBLEMS] + ([f"and {rest} more: see the table"] if rest > 0 else [])

    def text(self, metrics: Sequence[Metric]) -> str:
        """The table in aligned columns for a terminal; no name is cut."""
        columns = [
            (k, textwrap.wrap(heading, _HEADING, break_long_words=False) or [""], cells)
            for (k, heading), cells in self.columns(metrics).items()
        ]
        height = max(len(head) for _, head, _ in columns)
        padded = []
        for k, head, cells in columns:
            every = [""] * (height - len(head)) + head + cells
            justify = str.ljust if k < len(self.factors) else str.rjust
            padded.append([justify(cell, max(map(len, every))) for cell in every])
        lines = ["  ".join(row).rstrip() for row in zip(*padded, strict=True)]
        return "\n".join([*lines, *self.problems()])

    def html(self, metrics: Sequence[Metric], name: Callable[[int], str] | None = None) -> str:
        """The table as HTML, with changes marked; `name` is the first cell of a setting."""
        from pandas import DataFrame, option_context

        def mark(cell: str, is_better: bool) -> str:
            return f"<span class={'better' if is_better else 'worse'}>{cell}</span>"

        columns = self.columns(metrics, mark)
        cells = {
            key: [html.escape(cell) for cell in column] if key[0] < len(self.factors) else column
            for key, column in columns.items()
        }
        if name and self.factors:
            cells[next(iter(cells))] = [name(k) for k in range(len(self.settings))]
        frame = DataFrame(cells)
        frame.columns = [html.escape(heading) for _, heading in cells]
        with option_context("display.max_colwidth", None):
            return frame.to_html(index=False, escape=False, border=0)

    def latex(self, metrics: Sequence[Metric]) -> str:
        """The table as LaTeX, for booktabs."""
        columns = self.columns(metrics)
        kinds = "l" * len(self.factors) + "r" * (len(columns) - len(self.factors))
        rows = [[heading for _, heading in columns], *zip(*columns.values(), strict=True)]
        head, *body = [" & ".join(c.translate(_LATEX) for c in row) + r" \\" for row in rows]
        begin, end = rf"\begin{{tabular}}{{{kinds}}}", r"\end{tabular}"
        return "\n".join([begin, r"\toprule", head, r"\midrule", *body, r"\bottomrule", end, ""])


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
