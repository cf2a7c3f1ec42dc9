"""What measures the claims of the pages: runs, linearized loops, and the speed of both engines."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from registries import METRICS
from whole_task_plans import cost_beside_the_best

from drake_nonstop import (
    Run,
    Scenario,
    StepAction,
    changed,
    compute_metrics,
    linearize,
    show_in,
    simulate,
    start_meshcat,
)
from drake_nonstop.mechanics.signals import LoadReference
from drake_nonstop.run.run_quantities import RunQuantities

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


@dataclass(frozen=True)
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
    quantities, bound = RunQuantities(found[0]), found[1]["carriers"]["speed_bound_m_s"]
    time, speeds = quantities.time, quantities.speeds
    slowest = speeds.min(axis=1) if carrier is None else speeds[:, carrier]
    near = (slowest <= 1.03 * bound) & (time >= 1)
    return time[near][0] if near.any() else None


def _slowest_while_moving(found: tuple[Run, Metrics]) -> float:
    quantities = RunQuantities(found[0])
    return quantities.speeds[(quantities.time > 7) & (quantities.time < 23)].min()


def _error_at_rest(found: tuple[Run, Metrics]) -> float:
    """The mean error of the load's position in mm while the reference rests."""
    run = found[0]
    rests = np.linalg.norm(LoadReference.view(run.signal("reference")).velocity, axis=1) == 0
    return 1e3 * np.mean(RunQuantities(run).position_error[rests])


def _accuracy(scenario: Scenario) -> tuple[Run, Run]:
    """A run, and the same with steps of 0.5 ms."""
    return simulate(scenario), simulate(changed(scenario, _TRUTH))


def _load_error(runs: tuple[Run, Run]) -> float:
    """The largest distance of the load's positions, mm."""
    positions = [run.signal("load_state")[:, 4:7] for run in runs]
    return 1e3 * np.linalg.norm(positions[0] - positions[1], axis=1).max()


def _speed_error(runs: tuple[Run, Run]) -> float:
    """The largest relative difference of a carrier's speeds, %."""
    velocities = [np.split(run.signal("carrier_state"), 2, axis=1)[1] for run in runs]
    speeds = [np.linalg.norm(v.reshape(len(v), -1, 3), axis=2) for v in velocities]
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


# Every metric by its heading, and figures that are no metrics.
_OF_A_RUN: dict[str, Callable[[Found], float | None]] = {
    metric.heading: lambda found, metric=metric: metric.shown(metric.value(found[1]))
    for metric in METRICS
}
_OF_A_RUN |= {
    "slowest while moving (m/s)": _slowest_while_moving,
    "slowest final speed (m/s)": lambda found: min(found[1]["carriers"]["speed_final_m_s"]),
    "fastest final speed (m/s)": lambda found: max(found[1]["carriers"]["speed_final_m_s"]),
    "first within 3 % of the bound (s)": _first_near_the_bound,
    "mean position error at rest (mm)": _error_at_rest,
}
for _k in range(4):
    _name = f"carrier {_k + 1} first within 3 % of the bound (s)"
    _OF_A_RUN[_name] = partial(_first_near_the_bound, carrier=_k)

MEASURES = {
    RUN: Measure(_run, _OF_A_RUN),
    "stability": Measure(
        linearize,
        {
            "stable (1: yes)": lambda loop: loop.is_stable,
            "growth rate (1/s)": lambda loop: loop.rate,
            "growth in a turn": lambda loop: loop.largest,
        },
    ),
    "accuracy": Measure(
        _accuracy, {"error of the load (mm)": _load_error, "error of the speeds (%)": _speed_error}
    ),
    "engines": Measure(
        _engines, {"times the diagram": lambda s: s["diagram"] / s["compiled"]}, is_alone=True
    ),
    "viewer": Measure(
        _viewer, {"share of real time (%)": lambda share: 100 * share}, is_alone=True
    ),
    "plans": Measure(
        cost_beside_the_best, {"cost above the best plan (%)": lambda ratio: 100 * (ratio - 1)}
    ),
}
OF_SPEED = ("times the diagram", "share of real time (%)")  # they depend on the machine
