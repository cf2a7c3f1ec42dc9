"""How close layers come to the best ξ and A for a whole task, which an offline optimization finds.

Each layer flies the task; the offline optimum is a plan that knows all of the motion, the best of
those from several starts, see `whole_task_plans`.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from whole_task_plans import plan_task

from drake_nonstop.analysis.task import Task, task_of
from drake_nonstop.blocks.phase import ShapedPhaseConfig
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.signals import SIGNAL_PERIOD, PlannedParameters
from drake_nonstop.planning.horizon_config import HorizonConfig, timed
from drake_nonstop.planning.horizon_problem import AMPLITUDE_WEIGHT, HorizonProblem
from drake_nonstop.run.run import Run
from drake_nonstop.run.run_quantities import RunQuantities
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import Scenario

TASKS = ("line", "quintic", "three_carriers", "real_scale_spread")
OFFLINE = "offline optimum"
_MARGIN = "optimization_layer.tightening=0.02"  # of all, since costs depend on it
ONE_SAMPLE = ["optimization_layer=NlpLayer", "phase=AccumulatedPhase"]
LAYERS: dict[str, list[str]] = {
    "one sample": [*ONE_SAMPLE, _MARGIN],
    "horizon": ["optimization_layer=RecedingHorizonOptimizer", "phase=ShapedPhase", _MARGIN],
}

Row = dict[str, Any]


def benchmark_tasks(
    names: Sequence[str] = TASKS,
    overrides: Sequence[str] = (),
    progress: Callable[[str, float], None] | None = None,
) -> dict[str, dict[str, Row]]:
    """A row for each layer and for the offline optimum, by the scenario's name.

    A row has `deviation` and `cost`, of which the first is the cost's part without the rates of ξ
    and A, and the only one that is finite where they move in steps; `least_of_bound`, `peak_m_s`
    and `speed_squared_m2_s`, of the carriers' speeds; and the wall time of an update (`plan_ms`),
    `period_s` between two, `total_s` of all, and the `real_time_factor` of the flight.

    Args:
        names: of the scenarios.
        overrides: for all of them.
        progress: called with a description and the share of it that is done.

    Raises:
        ScenarioError: a scenario cannot be built, or its motion is not known beforehand.
        RunStopped: a flight ended before its time.
    """
    results: dict[str, dict[str, Row]] = {}
    for k, name in enumerate(names):
        scenario = load_scenario(name, overrides)
        flown = {layer: changed(scenario, changes) for layer, changes in LAYERS.items()}
        task = task_of(flown["horizon"])
        config = timed(task.horizon, task.limits.frequency, task.model.control_period)
        rows = {layer: _flown(variant, config) for layer, variant in flown.items()}
        rows[OFFLINE] = _offline(task, config)
        results[name] = rows
        if progress is not None:
            progress("whole tasks", (k + 1) / len(names))
    return results


def tasks_table(results: dict[str, dict[str, Row]]) -> str:
    """The results as text, a line per task and layer."""
    names = ("deviation", "cost", "v/ε", "peak m/s", "Σ∫v² m²/s", "p50 / max ms", "of period")
    lines = [" " * 36 + "".join(f"{name:>14}" for name in names)]
    for task, rows in results.items():
        for layer, row in rows.items():
            cells = [
                f"{row['deviation']:.4g}",
                "-" if row["cost"] is None else f"{row['cost']:.4g}",
                f"{row['least_of_bound']:.3f}",
                f"{row['peak_m_s']:.3f}",
                f"{row['speed_squared_m2_s']:.4g}",
            ]
            if row["period_s"] is None:
                cells += [f"{row['total_s']:.1f} s", "-"]
            else:
                median, largest = row["plan_ms"].values()
                cells += [f"{median:.3g} / {largest:.3g}", f"{largest / row['period_s'] / 1e3:.0%}"]
            lines.append(f"{task:19}{layer:17}" + "".join(f"{cell:>14}" for cell in cells))
    explained = "cost: deviation from the nominal ξ and A, and that of their second and third rates"
    return "\n".join([*lines, "", f"{explained}; of period: the longest update"])


def _flown(scenario: Scenario, config: HorizonConfig) -> Row:
    """The row of a layer that flies."""
    run = simulate(scenario)
    quantities = RunQuantities(run)
    layer = scenario.optimization_layer
    planned = _planned(run)
    parameters = planned[:, 1:3] if planned is not None else run.signal("parameters")
    nominal = np.array([layer.frequency, layer.amplitude])
    times = 1e3 * run.solve_times
    return {
        **_costs(parameters / nominal, planned, nominal, config),
        **_speeds(quantities.speeds, quantities.time, scenario.speed_bound),
        "least_of_bound": quantities.slowest_speed / scenario.speed_bound,
        "plan_ms": {"p50": float(np.median(times)), "max": float(np.max(times))},
        "period_s": getattr(layer, "period", config.knot_spacing),
        "total_s": float(np.sum(run.solve_times)),
        "real_time_factor": quantities.time[-1] / run.wall_time,
    }


def _planned(run: Run) -> NDArray | None:
    """ξ, A and their rates (samples, 8), where ξ and A are smooth."""
    is_smooth = isinstance(run.scenario.phase, ShapedPhaseConfig)
    return run.signal("planned") if is_smooth else None


def _offline(task: Task, config: HorizonConfig) -> Row:
    """The row of the best plan of a whole task."""
    start = time.perf_counter()
    best, *_ = plan_task(
        task.model,
        task.limits,
        task.reference,
        task.duration,
        config=config,
    )
    total = time.perf_counter() - start
    times = np.arange(0.0, task.duration, SIGNAL_PERIOD)
    planned = np.array([best.plan.planned(instant) for instant in times])
    problem = HorizonProblem(task.model, task.limits, config)
    squares = [
        problem.squared_speeds(values[:, None], task.reference(instant), STILL_AIR)[:, 0]
        for values, instant in zip(planned, times, strict=True)
    ]
    speeds = np.sqrt(squares)
    bound = task.limits.speed_bound
    return {
        **_costs(planned[:, 1:3] / task.nominal, planned, task.nominal, config),
        **_speeds(speeds, times, bound),
        "least_of_bound": float(speeds.min()) / bound,
        "plan_ms": None,
        "period_s": None,
        "total_s": total,
        "real_time_factor": None,
        "slack": best.slack,
    }


def _speeds(speeds: NDArray, times: NDArray, bound: float) -> Row:
    squares = (speeds**2).sum(axis=1)
    return {
        "peak_m_s": float(speeds.max()),
        "speed_squared_m2_s": float(np.diff(times) @ (squares[1:] + squares[:-1]) / 2),
    }


def _costs(
    relative: NDArray, planned: NDArray | None, nominal: NDArray, config: HorizonConfig
) -> Row:
    """The cost of ξ/ξ₀ and A/A₀ (k, 2) at samples, as in `planning.horizon_problem`."""
    weights = np.array([1.0, AMPLITUDE_WEIGHT])
    deviation = SIGNAL_PERIOD * float(np.sum((relative - 1) ** 2 @ weights))
    if planned is None:
        return {"deviation": deviation, "cost": None}
    view = PlannedParameters.view(planned)
    third = np.gradient(view.frequency_second_rate[:, 0], SIGNAL_PERIOD)[:, None]
    tau = config.smoothing * config.knot_spacing
    second = np.hstack([view.frequency_second_rate, view.amplitude_second_rate])
    thirds = np.hstack([third, view.amplitude_third_rate])
    rates = tau**4 * (second / nominal) ** 2 + tau**6 * (thirds / nominal) ** 2
    return {"deviation": deviation, "cost": deviation + SIGNAL_PERIOD * float(np.sum(rates))}
