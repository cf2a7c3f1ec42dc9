"""What measures the claims of the pages: runs, linearized loops, and the speed of both engines."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from whole_task_plans import plan_task, receding_coefficients

from drake_nonstop.analysis.stability import linearize
from drake_nonstop.analysis.task import task_of
from drake_nonstop.mechanics.signals import LoadReference, LoadState
from drake_nonstop.planning.horizon_config import timed
from drake_nonstop.planning.horizon_problem import HorizonProblem
from drake_nonstop.run.metrics import METRICS, compute_metrics
from drake_nonstop.run.run import Run, StepAction
from drake_nonstop.run.run_quantities import carrier_speeds, load_errors
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.view.meshcat_server import start_meshcat
from drake_nonstop.view.nonstop_visualizer import show_in

RUN = ""  # no name in front of the scenario's
_REPEATS = 3  # of what is timed; medians are taken
_TRUTH = [
    "engine=compiled",
    "simulator_config.integration_scheme=runge_kutta3",
    "simulator_config.use_error_control=false",
    "simulator_config.max_step_size=0.0005",
]

Found = Any  # what a measure returns: its quantities are functions of that
Metrics = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Measure:
    """A way to measure a scenario, and the quantities that it finds, by their names in claims.

    One that `is_alone` measures speed, which other processes would lower.
    """

    measure: Callable[[Scenario], Found]
    quantities: dict[str, Callable[[Found], float | None]]
    is_alone: bool = False


def _run(scenario: Scenario) -> tuple[Run, Metrics]:
    run = simulate(scenario)
    return run, compute_metrics(run)


def _first_near_the_bound(found: tuple[Run, Metrics], carrier: int | None = None) -> float | None:
    """When a carrier, or any of all, is first near the bound, after the first second."""
    run, metrics = found
    time, speeds = run.steps["time"], carrier_speeds(run.steps["carrier_state"])
    slowest = speeds.min(axis=1) if carrier is None else speeds[:, carrier]
    near = (slowest <= 1.03 * metrics["carriers"]["speed_bound_m_s"]) & (time >= 1)
    return time[near][0] if near.any() else None


def _slowest_while_moving(found: tuple[Run, Metrics]) -> float:
    steps = found[0].steps
    moving = (steps["time"] > 7) & (steps["time"] < 23)
    return carrier_speeds(steps["carrier_state"])[moving].min()


def _error_at_rest(found: tuple[Run, Metrics]) -> float:
    """The mean error of the load's position in mm while the reference rests."""
    run = found[0]
    rests = np.linalg.norm(LoadReference.view(run.signal("reference")).velocity, axis=1) == 0
    return 1e3 * np.mean(np.linalg.norm(load_errors(run)[0][rests], axis=1))


def _accuracy(scenario: Scenario) -> tuple[Run, Run]:
    """A run, and the same with steps of 0.5 ms."""
    return simulate(scenario), simulate(changed(scenario, _TRUTH))


def _load_error(runs: tuple[Run, Run]) -> float:
    """The largest distance of the load's positions, mm."""
    positions = [LoadState.view(run.signal("load_state")).position for run in runs]
    return 1e3 * np.linalg.norm(positions[0] - positions[1], axis=1).max()


def _speed_error(runs: tuple[Run, Run]) -> float:
    """The largest relative difference of a carrier's speeds, %."""
    speeds = [carrier_speeds(run.signal("carrier_state")) for run in runs]
    return 100 * np.abs(speeds[0] / speeds[1] - 1).max()


def _engines(scenario: Scenario) -> dict[str, float]:
    """The median wall time in s of a run by each engine, which are flown alternately."""
    seconds: dict[str, list[float]] = {"compiled": [], "diagram": []}
    for _ in range(_REPEATS):
        for engine, found in seconds.items():
            found.append(simulate(scenario, engine=engine).wall_time)
    return {engine: statistics.median(found) for engine, found in seconds.items()}


def _viewer(scenario: Scenario) -> float:
    """The processor time that a live view takes, of real time: with it less without, alternately.

    It is that of all threads, with Meshcat's; no browser is connected.
    """

    def in_real_time(simulator: Any, nonstop: Any) -> StepAction:
        simulator.set_target_realtime_rate(1.0)
        return StepAction.CONTINUE

    costs = []
    for _ in range(_REPEATS):
        seconds = []
        for viewers in ([show_in(start_meshcat())], []):
            start = time.process_time()
            simulate(scenario, viewers=viewers, after_step=in_real_time)
            seconds.append(time.process_time() - start)
        costs.append(seconds[0] - seconds[1])
    return statistics.median(costs) / scenario.simulation_duration


def _plans(scenario: Scenario) -> float:
    """The cost of a task's plans over a horizon, of that of the best plan that knows all of it."""
    task = task_of(scenario)
    short = timed(task.horizon, task.limits.frequency, task.model.control_period)
    intervals = round(task.duration / short.knot_spacing)
    bound = task.limits.speed_bound
    problem = HorizonProblem(task.model, task.limits, short)
    flown, _ = receding_coefficients(problem, task.reference, intervals, bound)
    best, *_ = plan_task(task.model, task.limits, task.reference, task.duration, config=short)
    whole = replace(short, horizon=intervals * short.knot_spacing)
    return HorizonProblem(task.model, task.limits, whole).cost(flown) / best.cost


MEASURES = {
    # Every metric by its heading, and figures that are no metrics.
    RUN: Measure(
        measure=_run,
        quantities={
            **{
                metric.heading: lambda found, metric=metric: metric.shown(metric.value(found[1]))
                for metric in METRICS
            },
            "slowest while moving (m/s)": _slowest_while_moving,
            "slowest final speed (m/s)": lambda found: min(found[1]["carriers"]["speed_final_m_s"]),
            "fastest final speed (m/s)": lambda found: max(found[1]["carriers"]["speed_final_m_s"]),
            "first within 3 % of the bound (s)": _first_near_the_bound,
            **{
                f"carrier {k + 1} first within 3 % of the bound (s)": partial(
                    _first_near_the_bound, carrier=k
                )
                for k in range(4)
            },
            "mean position error at rest (mm)": _error_at_rest,
        },
    ),
    "stability": Measure(
        measure=linearize,
        quantities={
            "stable (1: yes)": lambda loop: loop.is_stable,
            "growth rate (1/s)": lambda loop: loop.rate,
            "growth in a turn": lambda loop: loop.largest,
        },
    ),
    "accuracy": Measure(
        measure=_accuracy,
        quantities={"error of the load (mm)": _load_error, "error of the speeds (%)": _speed_error},
    ),
    "engines": Measure(
        measure=_engines,
        quantities={"times the diagram": lambda s: s["diagram"] / s["compiled"]},
        is_alone=True,
    ),
    "viewer": Measure(
        measure=_viewer,
        quantities={"share of real time (%)": lambda share: 100 * share},
        is_alone=True,
    ),
    "plans": Measure(
        measure=_plans,
        quantities={"cost above the best plan (%)": lambda ratio: 100 * (ratio - 1)},
    ),
}
OF_SPEED = ("times the diagram", "share of real time (%)")  # they depend on the machine
