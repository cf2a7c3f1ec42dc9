"""Flies drawn tasks with variants of the loop, and compares what they keep.

`python tests/drawn_study.py --count 500` flies those of the published figures, in a process per
core.
"""

import argparse
import multiprocessing
import warnings
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from drawn_tasks import aircraft_task, carriers_task
from fleet import flown

from drake_nonstop import Scenario, ScenarioWarning, changed, compute_metrics, read_grid
from drake_nonstop.run.run_quantities import RunQuantities

TASKS: dict[str, Callable[[int], Scenario]] = {
    "carriers": carriers_task,
    "aircraft": aircraft_task,
}
GRID = read_grid("foresight").variants
# What each changes of a task, the one first that the others are compared with.
VARIANTS: dict[str, list[str]] = {"one sample": GRID["one sample"], "horizon": [], **GRID}
# What flights are not judged by: in the paper's pattern, that of the carriers, cables cross.
FREE = {
    "carriers": ["limits.carrier_distance=0", "limits.cable_distance=0"],
    "aircraft": ["limits.saturated_share=1"],
}


def scenario_of(tasks: str, seed: int, overrides: Sequence[str]) -> Scenario:
    """The scenario of a flight."""
    task = TASKS[tasks](seed)
    given = [*overrides, *FREE[tasks]]
    if tasks == "aircraft":  # which have controllers of their own, and their sampling period
        given = [o for o in given if not o.startswith(("carrier_controller", "wrench_controller"))]
        if "optimization_layer=NlpLayer" in given:
            given.append(f"optimization_layer.period={task.control_period}")
    return changed(task, given)


def fly(tasks: str, seed: int, overrides: Sequence[str]) -> dict[str, Any]:
    """The outcome of a flight with its reasons, and its figures.

    `least` is the least speed of a carrier in units of the bound, `below` (s) how long any was
    below it, `peak` (m/s) the largest speed, `squares` (m²/s) the sum of the ∫v² of all, `error`
    (mm) the mean distance of the load from its reference, `xi_step` (rad/s) and `A_step` (N) the
    largest changes of ξ and A in a sample of the controllers, `tension` the least one in N.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)
        scenario = scenario_of(tasks, seed, overrides)
        run = flown(scenario)
        metrics = compute_metrics(run)
    quantities = RunQuantities(run)
    squares = (quantities.speeds**2).sum(axis=1)
    is_planned = any(name.endswith(".planned") for name in run.signals)
    parameters = run.signal("planned")[:, 1:3] if is_planned else run.signal("parameters")
    samples = max(1, round(scenario.control_period / (run.time[1] - run.time[0])))
    steps = np.abs(parameters[samples:] - parameters[:-samples]).max(axis=0)
    return {
        "outcome": metrics["outcome"],
        "reasons": "; ".join(metrics["reasons"]),
        "least": quantities.slowest_speed / scenario.speed_bound,
        "below": quantities.time_below_bound,
        "peak": quantities.speeds.max(),
        "squares": np.diff(quantities.time) @ (squares[1:] + squares[:-1]) / 2,
        "error": 1e3 * np.mean(quantities.position_error),
        "A_step": steps[1],
        "xi_step": steps[0],
        "tension": quantities.tensions.min(),
        "is_whole": not run.stopped,
    }


def in_processes(function: Callable[..., Any], calls: Iterable[tuple[Any, ...]]) -> list[Any]:
    """What a function makes of each call, in a process per core."""
    # A process flies a few: diagrams of Python's systems stay in its memory.
    with multiprocessing.get_context("forkserver").Pool(maxtasksperchild=10) as pool:
        return pool.starmap(function, calls, chunksize=1)


def compared(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per variant; peaks and squares beside the first one's, on tasks that both complete."""
    found = {}
    variants = dict(tuple(rows.groupby("variant", sort=False)))
    base = next(iter(variants.values())).set_index("seed")
    for name, own in variants.items():
        own = own.set_index("seed")
        both = own.is_whole & base.is_whole
        peaks = own.peak[both] / base.peak[both]
        found[name] = {
            "below": (own.is_whole & (own.below > 0)).sum(),
            "stopped": (~own.is_whole).sum(),
            "otherwise not ok": (own.is_whole & ~own.outcome.isin(["ok", "bound_missed"])).sum(),
            "least v/ε": own.least.min(),
            "peak": peaks.median(),
            "its largest": peaks.max(),
            "∫v²": own.squares[both].sum() / base.squares[both].sum(),
            "error (mm)": own.error[own.is_whole].median(),
            "the largest": own.error.max(),
            "ΔA (N)": own.A_step.max(),
            "Δξ (rad/s)": own.xi_step.max(),
            "tension (N)": own.tension.min(),
        }
    return pd.DataFrame.from_dict(found, orient="index")


def main() -> None:
    """Parses, flies and prints."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--tasks", choices=TASKS, default="carriers", help="(carriers)")
    parser.add_argument("--first", type=int, default=5000, metavar="SEED", help="(5000)")
    parser.add_argument("--count", type=int, default=20, metavar="N", help="tasks (20)")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=[*VARIANTS][:2])
    parser.add_argument("--set", nargs="+", default=[], metavar="PATH=VALUE", help="for all")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.count)
    keys = [{"variant": name, "seed": seed} for name in options.variants for seed in seeds]
    calls = [(options.tasks, k["seed"], [*VARIANTS[k["variant"]], *options.set]) for k in keys]
    flights = in_processes(fly, calls)
    rows = pd.DataFrame([key | flight for key, flight in zip(keys, flights, strict=True)])
    print(compared(rows).to_string(float_format="{:.4g}".format))
    for row in rows[rows.outcome != "ok"].itertuples():
        print(f"{row.variant}, seed {row.seed}: {row.outcome}: {row.reasons}")


if __name__ == "__main__":
    main()
