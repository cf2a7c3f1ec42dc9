"""How the wall time of a step grows with the number of carriers."""

import dataclasses
import statistics
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray

from drake_nonstop.model.pattern import HamiltonianCycleConfig, LinearPatternConfig
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.validation import require
from drake_nonstop.view.figure_style import new_figure, titled

COUNTS = (3, 4, 6, 8, 12, 16, 24, 32, 48, 64)  # carriers


def scaled(scenario: Scenario, n: int) -> Scenario:
    """The scenario with n carriers, each of which carries the share of the load that it has now.

    The attachments are the corners of a regular polygon with the mean radius of the present
    ones; the load's mass, inertia and drag grow in proportion to n; a Hamiltonian cycle takes
    its default phases.

    Raises:
        ScenarioError: the pattern is a `LinearPattern`, which is defined for one n alone.
    """
    pattern = scenario.pattern
    require(
        not isinstance(pattern, LinearPatternConfig),
        "pattern",
        "LinearPattern",
        "give one that can be made for any number of carriers, such as HamiltonianCycle",
    )
    if isinstance(pattern, HamiltonianCycleConfig):
        pattern = HamiltonianCycleConfig()
    present = np.array(scenario.system.attachments)
    ratio = n / len(present)
    system = dataclasses.replace(
        scenario.system, attachments=_polygon(present, n), **_scaled_load(scenario.system, ratio)
    )
    simulated = dataclasses.replace(
        scenario.simulated, attachments=None, **_scaled_load(scenario.simulated, ratio)
    )
    return dataclasses.replace(scenario, system=system, simulated=simulated, pattern=pattern)


def _scaled_load(system: Any, ratio: float) -> dict[str, Any]:
    """The load's parameters, scaled; in `simulated`, which overrides some, None stays None."""
    names = ("load_mass", "load_inertia", "load_drag", "load_angular_drag")
    values = {name: getattr(system, name) for name in names}
    return {
        name: None if value is None else (ratio * np.array(value)).tolist()
        for name, value in values.items()
    }


def _polygon(attachments: NDArray, n: int) -> list[list[float]]:
    """The corners (n, 3) in m of a regular polygon about the centre of the attachments."""
    centre = attachments.mean(axis=0)
    radius = np.mean(np.linalg.norm((attachments - centre)[:, :2], axis=1))
    angles = 2 * np.pi * np.arange(n) / n
    circle = np.stack([np.cos(angles), np.sin(angles), np.zeros(n)], axis=1)
    return (centre + radius * circle).tolist()


def benchmark_scale(
    scenario: Scenario,
    *,
    max_n: int = COUNTS[-1],
    duration: float = 3.0,
    repeats: int = 3,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> dict[str, Any]:
    """Runs `scaled` scenarios with 3 to `max_n` carriers, alternately.

    Args:
        scenario: what to scale.
        max_n: the largest number of carriers, of those in `COUNTS`.
        duration: of a run, in s.
        repeats: of each; medians are taken.
        progress: called with what is being done and the share of it that is done.

    Returns:
        What `python -m tests.benchmarks scale` writes as JSON. `exponent` is that of the power of n
        that fits the wall time per step best, over all n; `last_exponent` that between the two
        largest n.

    Raises:
        ScenarioError: the scenario cannot be scaled, or run with some n.
    """
    counts = [n for n in COUNTS if n <= max_n]
    require(len(counts) > 1, "--max-n", max_n, f"give at least {COUNTS[1]}")
    scenarios = [
        dataclasses.replace(scaled(scenario, n), simulation_duration=duration) for n in counts
    ]
    walls: list[list[float]] = [[] for _ in counts]
    rows = []
    for turn in range(repeats):
        for i, (n, one) in enumerate(zip(counts, scenarios, strict=True)):
            run = simulate(one)
            walls[i].append(run.wall_time)
            if turn == repeats - 1:
                wall = statistics.median(walls[i])
                steps = len(run.steps["time"]) - 1
                rows.append(
                    {
                        "n": n,
                        "real_time_factor": duration / wall,
                        "wall_per_step_s": wall / steps,
                        "lowest_wall_per_step_s": min(walls[i]) / steps,
                        "highest_wall_per_step_s": max(walls[i]) / steps,
                        "steps": steps,
                        "solving_share": float(run.solve_times.sum()) / run.wall_time,
                    }
                )
            progress(f"{n} carriers", (turn * len(counts) + i + 1) / (repeats * len(counts)))
    costs = np.log([row["wall_per_step_s"] for row in rows])
    logarithms = np.log(counts)
    return {
        "scenario": scenario.name,
        "simulated_s": duration,
        "repeats": repeats,
        "runs": rows,
        "exponent": float(np.polyfit(logarithms, costs, 1)[0]),
        "last_exponent": float(np.diff(costs[-2:])[0] / np.diff(logarithms[-2:])[0]),
    }


def table(results: dict[str, Any]) -> str:
    """The results as text."""
    rows = [f"{'n':>4}{'real-time factor':>20}{'us/step':>12}{'steps':>8}{'solving':>10}"]
    for row in results["runs"]:
        rows.append(
            f"{row['n']:4}{row['real_time_factor']:20.2f}{1e6 * row['wall_per_step_s']:12.0f}"
            f"{row['steps']:8}{row['solving_share']:10.1%}"
        )
    last = [row["n"] for row in results["runs"][-2:]]
    rows.append(
        f"a step's wall time grows as n^{results['exponent']:.2f}, from {last[0]} to {last[1]} "
        f"carriers as n^{results['last_exponent']:.2f}"
    )
    return "\n".join(rows)


def make_scale_figure(results: Mapping[str, Any]) -> Figure:
    """Wall time per step and real-time factor over the number of carriers.

    Args:
        results: returned by `benchmark_scale`.
    """
    runs = results["runs"]
    counts = np.array([run["n"] for run in runs])
    figure = new_figure((9.0, 4.2))
    left, right = figure.subplots(1, 2)
    costs, low, high = (
        np.array([1e6 * run[f"{which}wall_per_step_s"] for run in runs])
        for which in ("", "lowest_", "highest_")
    )
    left.errorbar(counts, costs, [costs - low, high - costs], fmt="o-", capsize=3, label="measured")
    left.plot(counts, costs[0] * counts / counts[0], ":", color="0.5", label="in proportion to n")
    left.set_ylabel("wall time per step (µs)")
    left.legend(fontsize="small")
    right.plot(counts, [run["real_time_factor"] for run in runs], "o-")
    right.axhline(1, color="green", linestyle="--")
    right.set_ylabel("real-time factor")
    for axes in (left, right):
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xticks(counts, [str(n) for n in counts])
        axes.minorticks_off()
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_xlabel("carriers")
    return titled(figure, f"{results['scenario']}, scaled: n^{results['exponent']:.2f}")
