"""The cost and the error of a run by integrator and step size, against a converged run."""

import statistics
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from drake_nonstop.mechanics.signals import LoadState
from drake_nonstop.run.run import Run, RunStopped
from drake_nonstop.run.run_quantities import carrier_speeds
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import AUTO, Scenario

_STEP = "simulator_config.max_step_size={}"
_REFERENCE_STEP = 0.0005  # s; a run with half of it shows the error of the reference

# The overrides of each run that is compared, besides the scenario as it is.
OVERRIDES: tuple[tuple[str, ...], ...] = (
    ("engine=compiled",),
    (_STEP.format(0.0025),),
    (_STEP.format(0.001),),
    ("simulator_config.use_error_control=true",),
    ("simulator_config.integration_scheme=bogacki_shampine3",),
    ("simulator_config.integration_scheme=runge_kutta2", _STEP.format(0.001)),
    ("simulator_config.integration_scheme=semi_explicit_euler", _STEP.format(0.001)),
)


def benchmark_accuracy(
    scenario: Scenario,
    *,
    overrides: Sequence[Sequence[str]] = OVERRIDES,
    repeats: int = 3,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> dict[str, Any]:
    """Runs a scenario with several overrides alternately, and compares each with a reference.

    Where neither names an engine the diagram is simulated. The reference is Drake's third-order
    Runge-Kutta with steps of 0.5 ms on separate blocks. Errors are the largest over all samples:
    the distance of the load's positions, and the carriers' speeds, each relative to that in the
    reference.

    Args:
        scenario: what to run.
        overrides: the overrides of each run, as in `load_scenario`; the scenario without any is
            run as well.
        repeats: of each; medians of the times are taken.
        progress: called with what is being done and the share of it that is done.

    Returns:
        What `python -m tests.benchmarks accuracy` writes as JSON. Where a run stops before its end,
        its row has the error's message and no figures.

    Raises:
        ScenarioError: the scenario cannot be built, as it is or with some of the overrides.
        RunStopped: the reference stops before its end.
    """
    fine = [
        "engine=diagram",
        "simulator_config.integration_scheme=runge_kutta3",
        "simulator_config.use_error_control=false",
    ]
    reference, finer = (
        simulate(
            changed(scenario, [*fine, _STEP.format(_REFERENCE_STEP / part)]),
        )
        for part in (1, 2)
    )
    variants = [(), *overrides]
    engine = ["engine=diagram"] if scenario.engine == AUTO else []
    scenarios = [changed(scenario, [*engine, *overrides]) for overrides in variants]
    rows: list[dict[str, Any]] = [
        {"overrides": list(overrides), "wall_s": []} for overrides in variants
    ]
    for turn in range(repeats):
        for i, (row, one) in enumerate(zip(rows, scenarios, strict=True)):
            progress("running", (turn * len(rows) + i) / (repeats * len(rows)))
            if "stopped" in row:
                continue
            try:
                run = simulate(one)
            except RunStopped as stopped:
                row["stopped"] = str(stopped)
                continue
            row["wall_s"].append(run.wall_time)
            row |= _errors(run, reference) | {"steps": len(run.steps["time"]) - 1}
            wall = statistics.median(row["wall_s"])
            row["real_time_factor"] = scenario.simulation_duration / wall
    progress("running", 1.0)
    return {
        "scenario": scenario.name,
        "simulated_s": scenario.simulation_duration,
        "repeats": repeats,
        "reference_step_s": _REFERENCE_STEP,
        "reference": _errors(reference, finer),
        "runs": rows,
    }


def _errors(run: Run, reference: Run) -> dict[str, float]:
    """The largest distance of the loads in m, and of the carriers' relative speeds."""
    positions = [LoadState.view(each.signal("load_state")).position for each in (run, reference)]
    speeds = [carrier_speeds(each.signal("carrier_state")) for each in (run, reference)]
    distances = np.linalg.norm(positions[0] - positions[1], axis=1)
    return {
        "load_error_m": float(np.max(distances)),
        "speed_error": float(np.max(np.abs(speeds[0] / speeds[1] - 1))),
    }


def table(results: dict[str, Any]) -> str:
    """The results as text."""
    lines = [f"{'real-time factor':>16}{'load (mm)':>12}{'speed':>10}{'steps':>8}  overrides"]
    for row in results["runs"]:
        overrides = " ".join(row["overrides"]) or "(as it is)"
        if "stopped" in row:
            lines.append(f"{'-':>16}{'-':>12}{'-':>10}{'-':>8}  {overrides}: {row['stopped']}")
            continue
        lines.append(
            f"{row['real_time_factor']:16.1f}{1e3 * row['load_error_m']:12.5f}"
            f"{row['speed_error']:10.4%}{row['steps']:8}  {overrides}"
        )
    error = results["reference"]
    lines.append(
        f"largest differences from steps of {1e3 * results['reference_step_s']:g} ms, which are "
        f"within {1e3 * error['load_error_m']:.1g} mm and {error['speed_error']:.1g} of steps "
        "half as long"
    )
    return "\n".join(lines)
