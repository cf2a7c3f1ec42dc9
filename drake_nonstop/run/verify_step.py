"""Whether a run's steps resolve its metrics: the same run with half of them."""

import copy
import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.run.flight import without_warnings
from drake_nonstop.run.metrics import METRICS, Metric, compute_metrics
from drake_nonstop.run.run import Run, RunInterrupted, RunStopped
from drake_nonstop.run.simulate import simulate
from drake_nonstop.validation import ScenarioError, require

SHARE = 0.02  # of a value, by which a metric may move
TOLERANCES = f"lengths by 1 mm, others by {SHARE:.0%}"

# What metrics may move by whatever their values are, as shown, by their units: what a time is
# counted in, and what does not matter for a carrier.
_GRAINS = {
    "s": 0.02 + 1e-9,  # a step of 10 ms at either end
    "mm": 1.0,
    "m": 1e-3,
    "mrad": 1.0,
    "deg": 0.1,
    "": 0.01,
    "%": 0.5,
    "% of the time": 0.5,
    "W": 1.0,
    "Wh/(kg km)": 0.1,
}
_GRAIN = 1e-2  # of others: speeds, forces
_COUNT = 2  # updates
_STEP = "simulator.step_s"


def verify_step(run: Run, *, progress: Callable[[float], None] | None = None) -> Run:
    """Flies a run's scenario again with half the step; the run with the differences.

    `unresolved` has a sentence for each metric that moves: a length by more than 1 mm, others by
    more than 2 % and a small amount of their unit. `half_step` has the shorter step in s and both
    values of each of these metrics by its path.

    Args:
        run: one that nobody steered.
        progress: as of `simulate`.

    Raises:
        ScenarioError: the run is not one of `simulate`.
        RunInterrupted: Ctrl-C; carries the run.
    """
    remedy = "give a run of simulate, which can make the loop again (make_loop=...)"
    require(run.replacements is not None, "run", "from logs", remedy)
    config = copy.deepcopy(run.scenario.simulator_config)
    config.max_step_size = run.step / 2
    config.accuracy /= 8  # of a third-order scheme
    scenario = dataclasses.replace(
        run.scenario, simulator_config=config, simulation_duration=float(run.steps["time"][-1])
    )
    given = {"make_loop": make_nonstop, **(run.replacements or {})}
    try:
        with without_warnings():
            half = simulate(scenario, progress=progress, **given)
    except RunInterrupted:
        raise RunInterrupted(run) from None
    except (RunStopped, ScenarioError) as error:
        said = f"with half of the steps of {1e3 * run.step:.3g} ms {error}"
        return dataclasses.replace(run, unresolved=(said,))
    moves = moved_metrics(compute_metrics(run), compute_metrics(half))
    unresolved = [f"{_told(*move)} with half the step" for move in moves]
    if unresolved:
        used, remedy = (
            f"steps of {1e3 * run.step:.3g} ms",
            f"max_step_size, such as {run.step / 4:.3g}",
        )
        if config.use_error_control:
            used = f"an accuracy of {8 * config.accuracy:g}"
            remedy = f"accuracy, such as {config.accuracy / 8:.2g}"
        unresolved[0] = (
            f"not resolved by {used}: {unresolved[0]}; give a smaller simulator_config.{remedy}"
        )
    moved = {metric.path: [value, finer] for metric, value, finer in moves}
    half_step = {"step_s": half.step, "moved": moved}
    return dataclasses.replace(run, unresolved=tuple(unresolved), half_step=half_step)


def moved_metrics(
    metrics: Mapping[str, Any], finer: Mapping[str, Any]
) -> list[tuple[Metric, Any, Any]]:
    """The metrics that differ between a run's and those of the same with shorter steps.

    With both values. Wall times, texts and lists are left out.
    """
    found = []
    for metric in METRICS:
        value, other = metric.value(metrics), metric.value(finer)
        is_number = not any(isinstance(each, str | list) for each in (value, other))
        if metric.is_wall_time or metric.path == _STEP or not is_number or value == other:
            continue
        if value is None or other is None or abs(value - other) > _tolerance(metric, value):
            found.append((metric, value, other))
    return found


def _tolerance(metric: Metric, value: float) -> float:
    if metric.path.startswith("optimizer.") and not metric.unit:
        return max(_COUNT, SHARE * abs(value))
    grain = _GRAINS.get(metric.unit, _GRAIN) / metric.scale
    is_length = metric.unit in ("m", "mm")
    return grain if is_length else max(grain, SHARE * abs(value))


def _told(metric: Metric, *values: float | None) -> str:
    """Such as "least tension: 0.262 N, 0.696 N"."""
    shown = (
        "none" if v is None else f"{metric.shown(v):.4g} {metric.unit}".rstrip() for v in values
    )
    return f"{metric.label}: {', '.join(shown)}"
