"""The results of a comparison: a row per variant, and its differences from the first row."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from drake_nonstop.simulation.metrics import Metric, metric_at
from drake_nonstop.studies.run_all import COMPLETED

BASE = "as it is"  # the name of the scenario without any change

OUTCOME = metric_at("outcome")
POSITION_ERROR = metric_at("load.position_error_mean_m")
TIME_BELOW_BOUND = metric_at("carriers.time_below_bound_s")
SLOWEST_SPEED = metric_at("carriers.speed_min_m_s")


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
