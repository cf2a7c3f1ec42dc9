"""Which metrics of a run move with the integrator's step."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from drake_nonstop.run.metrics import METRICS, Metric

SHARE = 0.02  # of a value; what a metric may move by
SPEED_GRAIN, TENSION_GRAIN = 2e-3, 1e-2  # m/s, N; see _GRAINS
_LENGTH = 1e-3  # m; what a length may move by, whatever its value

# What the other metrics have to move by besides, in the unit that ends their path: less is the
# grain that they are measured with (a time is counted in steps, an update is one), or does not
# matter for a carrier. Radii of turns are lengths of which a share counts, not a distance; the
# direction of a velocity may move by as much of it as its size.
_GRAINS = {
    "turn_radius_min_m": 1e-3,
    "climb_angle_max_rad": 0.02,
    "rad": 1e-3,
    "m_s": SPEED_GRAIN,
    "m_s2": 1e-2,
    "rad_s": 2e-3,
    "N": TENSION_GRAIN,
    "W": 1.0,
    "Wh_per_kg_km": 0.1,
    "share": 0.005,
    "share_max": 0.005,
    "over_stall_min": 0.005,
    "s": 0.02 + 1e-9,  # a step of 10 ms at either end
}
_COUNT = 2  # updates
TOLERANCES = f"lengths by {1e3 * _LENGTH:g} mm, others by {SHARE:.0%}"
_STEP = "simulator.step_s"  # what differs between the two


@dataclass(frozen=True, kw_only=True)
class Move:
    """A metric that differs between a run and the same with shorter steps."""

    metric: Metric
    value: float | None  # of the run
    finer: float | None  # of that with shorter steps

    def __str__(self) -> str:
        """Such as "least tension: 0.262 N, 0.696 N"."""
        values = [self.metric.shown(value) for value in (self.value, self.finer)]
        unit = self.metric.quantity.unit
        shown = ("none" if v is None else f"{v:.4g} {unit}".rstrip() for v in values)
        return f"{self.metric.quantity.label}: {', '.join(shown)}"


def moved_metrics(
    metrics: Mapping[str, Any], finer: Mapping[str, Any], *, share: float = 1.0
) -> list[Move]:
    """The metrics that differ between a run's and those of the same with shorter steps.

    A length moves by more than 1 mm; anything else by more than 2 % of its value and more than
    its grain; where only a part of the error shows, by more than that `share` of these. Wall
    times, texts and lists are left out.
    """
    moves = []
    for metric in METRICS:
        if metric.is_wall_time or metric.is_list or metric.path == _STEP:
            continue
        values = metric.value(metrics), metric.value(finer)
        if values[0] == values[1] or any(isinstance(value, str) for value in values):
            continue
        if None in values or abs(values[0] - values[1]) > share * _tolerance(metric.path, *values):
            moves.append(Move(metric=metric, value=values[0], finer=values[1]))
    return moves


def _tolerance(path: str, value: float, finer: float) -> float:
    name = path.split(".")[-1]
    for ending, grain in _GRAINS.items():
        if name == ending or name.endswith(f"_{ending}"):
            return max(grain, SHARE * max(abs(value), abs(finer)))
    if name.endswith("_m"):
        return _LENGTH
    return max(_COUNT, SHARE * max(abs(value), abs(finer)))
