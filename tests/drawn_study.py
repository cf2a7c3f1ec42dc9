"""Flies drawn tasks with variants of the loop, and compares what they keep.

`python tests/drawn_study.py --count 500` flies those of the published figures, in a process per
core.
"""

import argparse
import multiprocessing
import sys
import warnings
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from drawn_tasks import aircraft_task, carriers_task

from drake_nonstop import (
    Run,
    RunOutcome,
    RunStopped,
    Scenario,
    ScenarioError,
    ScenarioWarning,
    read_grid,
    simulate,
)
from drake_nonstop.mechanics.signals import SIGNAL_PERIOD, Parameters, PlannedParameters
from drake_nonstop.run.outcome import LIMITS
from drake_nonstop.run.run_quantities import RunQuantities
from drake_nonstop.scenario.overrides import changed

TASKS: dict[str, Callable[[int], Scenario]] = {
    "carriers": carriers_task,
    "aircraft": aircraft_task,
}

GRID = read_grid("foresight").variants
# What each changes of a task, the one first that the others are compared with.
VARIANTS: dict[str, list[str]] = {"one sample": GRID["one sample"], "horizon": [], **GRID}


def _noise(scenario: Scenario) -> str:
    period = scenario.control_period or SIGNAL_PERIOD
    sizes = "position_noise: 0.01, orientation_noise: 0.02"
    return f"load_feedback=!FilteredFeedback {{{sizes}, period: {period}}}"


def _delay(scenario: Scenario) -> str:
    period = scenario.control_period or SIGNAL_PERIOD
    return f"load_feedback=!NoisyFeedback {{delay: {period}, period: {period}}}"


def _mass(scenario: Scenario) -> str:
    return f"simulated.load_mass={1.02 * scenario.system.load_mass}"


def _wind(scenario: Scenario) -> str:
    return "wind=!GustyWind {velocity: [1.0, 0.5, 0.0], gust: 0.0, load_gust: 0.3}"


# What the simulated plant differs in from what the controllers believe.
CONDITIONS: dict[str, Sequence[Callable[[Scenario], str]]] = {
    "none": (),
    "mass": (_mass,),
    "noise": (_noise,),
    "delay": (_delay,),
    "wind": (_wind,),
}

_KEPT = (RunOutcome.LOAD_LOST, RunOutcome.CABLES_SLACK, RunOutcome.BOUND_MISSED)
# What flights are judged by. In the paper's pattern, that of the carriers' tasks, cables cross.
_JUDGED_BY = {"carriers": _KEPT, "aircraft": (*_KEPT, RunOutcome.COLLISION)}

Figures = dict[str, Any]  # of a flight


def scenario_of(tasks: str, seed: int, condition: str, overrides: Sequence[str]) -> Scenario:
    """The scenario of a flight."""
    task = TASKS[tasks](seed)
    others = [make(task) for make in CONDITIONS[condition]]
    given = [*overrides]
    if tasks == "aircraft":  # which have controllers of their own, and their sampling period
        given = [o for o in given if not o.startswith(("carrier_controller", "wrench_controller"))]
        if "optimization_layer=NlpLayer" in given:
            given.append(f"optimization_layer.period={task.control_period}")
    return changed(task, [*given, *others])


def fly(tasks: str, seed: int, condition: str, overrides: Sequence[str]) -> dict[str, Any]:
    """How a flight ended, and its figures; never an error of the run."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)
        scenario = scenario_of(tasks, seed, condition, overrides)
        try:
            run = simulate(scenario)
        except ScenarioError as error:
            return {"ending": "refused", "outcome": "", "message": str(error)}
        except RunStopped as stopped:
            run = stopped.run
    wrong = _wrong(RunQuantities(run), _JUDGED_BY[tasks])
    return {
        "ending": "stopped" if run.stopped else "completed",
        "outcome": next((outcome.value for outcome in RunOutcome if outcome in wrong), "ok"),
        "message": "; ".join(wrong.values()),
        **figures_of(run),
    }


def _wrong(run: RunQuantities, outcomes: Collection[RunOutcome]) -> dict[RunOutcome, str]:
    """What is wrong with a run, of these outcomes, with the reason."""
    found = {
        limit.outcome: sentence
        for limit in LIMITS
        if limit.outcome in outcomes and (sentence := limit.complaint(run)) is not None
    }
    if run.run.stopped:
        found[RunOutcome.STOPPED] = run.run.stopped
    if run.first_stall is not None:
        found[RunOutcome.STALLED] = f"a carrier stalled at t = {run.first_stall.time:.3f} s"
    return found


def figures_of(run: Run) -> Figures:
    """The figures of a run by their names; all but wall times repeat to the bit.

    `least` is the least speed of a carrier in units of the bound, also between the integrator's
    steps, `below` (s) how long any was below it, `peak` (m/s) the largest speed, `speed_squared`
    (m²/s) the sum of the ∫v² of all, `position_error` (mm) the mean distance of the load from its
    reference, `amplitude_step` (N) and `frequency_step` (rad/s) the largest changes of A and ξ in
    a sample of the controllers, `least_tension` in N.
    """
    quantities = RunQuantities(run)
    scenario = run.scenario
    squares = (quantities.speeds**2).sum(axis=1)
    parameters = np.hstack(
        PlannedParameters.view(run.signal("planned"))[1:3]
        if any(name.endswith(".planned") for name in run.signals)
        else Parameters.view(run.signal("parameters"))
    )
    samples = max(1, round((scenario.control_period or SIGNAL_PERIOD) / SIGNAL_PERIOD))
    steps = np.abs(parameters[samples:] - parameters[:-samples]).max(axis=0, initial=0.0)
    counts = quantities.update_counts
    figures = {
        "n": quantities.speeds.shape[1],
        "least": quantities.slowest_speed / scenario.speed_bound,
        "below": quantities.time_below_bound,
        "peak": float(quantities.speeds.max()),
        "speed_squared": float(np.diff(quantities.time) @ (squares[1:] + squares[:-1]) / 2),
        "position_error": 1e3 * float(np.mean(quantities.position_error)),
        "frequency_step": float(steps[0]),
        "amplitude_step": float(steps[1]),
        "least_tension": float(quantities.tensions.min()),
        "relaxed": counts["relaxed"],
        "held": counts["held"],
        "flown_s": float(quantities.time[-1]),
        "wall_s": run.wall_time,
    }
    return {name: None if value != value else value for name, value in figures.items()}


def flown(
    function: Callable[..., dict[str, Any]],
    calls: Mapping[Hashable, tuple[Any, ...]],
    *,
    is_serial: bool = False,
) -> dict[Any, dict[str, Any]]:
    """The results of a function by the keys of its calls, in a process per core."""
    if is_serial:
        return {key: function(*arguments) for key, arguments in calls.items()}
    # A process flies a few: diagrams of Python's systems stay in its memory.
    with multiprocessing.get_context("forkserver").Pool(maxtasksperchild=10) as pool:
        return dict(zip(calls, pool.starmap(function, calls.values(), chunksize=1), strict=True))


def study(
    tasks: str,
    seeds: Sequence[int],
    variants: Mapping[str, Sequence[str]],
    *,
    condition: str = "none",
    is_serial: bool = False,
) -> pd.DataFrame:
    """A row for each variant and seed: how the flight ended, and its figures."""
    calls = {
        (name, seed): (tasks, seed, condition, overrides)
        for seed in seeds
        for name, overrides in variants.items()
    }
    found = flown(fly, calls, is_serial=is_serial)
    index = pd.MultiIndex.from_tuples([*calls], names=["variant", "seed"])
    return pd.DataFrame([found[key] for key in calls], index=index)


def table(rows: pd.DataFrame) -> str:
    """A line per variant in Markdown, compared with the first on the tasks that both completed."""
    lines = [
        "| variant | below ε | stopped | otherwise not ok | least v/ε | peak, median (max) | Σ∫v² "
        "| mean ‖e_p‖, median (max), mm | largest ΔA, N | Δξ, rad/s | least tension, N |",
        "| --- " * 11 + "|",
    ]
    names = [*dict.fromkeys(rows.index.get_level_values("variant"))]
    base = rows.loc[names[0]]
    for name in names:
        own = rows.loc[name]
        whole = own.ending == "completed"
        both = whole & (base.ending == "completed")
        peaks = own.peak[both] / base.peak[both]
        squares = own.speed_squared[both].sum() / base.speed_squared[both].sum()
        errors = own.position_error[whole]
        cells = (
            f"{name}",
            f"{((own.below > 0) & whole).sum()} of {len(own)}",
            f"{(~whole).sum()}",
            f"{(~own.outcome.isin(['ok', 'bound_missed']) & whole).sum()}",
            f"{own.least.min():.3f}",
            f"{peaks.median():.3f} ({peaks.max():.2f})",
            f"{squares:.3f}",
            f"{errors.median():.3g} ({own.position_error.max():.3g})",
            f"{own.amplitude_step.max():.3g}",
            f"{own.frequency_step.max():.3g}",
            f"{own.least_tension.min():.3g}",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Parses, flies and prints."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--tasks", choices=TASKS, default="carriers", help="(carriers)")
    parser.add_argument("--first", type=int, default=5000, metavar="SEED", help="(5000)")
    parser.add_argument("--count", type=int, default=20, metavar="N", help="tasks (20)")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=[*VARIANTS][:2])
    parser.add_argument("--condition", choices=CONDITIONS, default="none", help="(none)")
    parser.add_argument("--set", nargs="+", default=[], metavar="PATH=VALUE", help="for all")
    parser.add_argument("--serial", action="store_true", help="in this process")
    options = parser.parse_args(arguments)
    rows = study(
        options.tasks,
        range(options.first, options.first + options.count),
        {name: [*VARIANTS.get(name, []), *options.set] for name in options.variants},
        condition=options.condition,
        is_serial=options.serial,
    )
    print(table(rows))
    for (name, seed), row in rows[rows.outcome != "ok"].iterrows():
        print(f"{name}, seed {seed}: {row.outcome or row.ending}: {row.message}")


if __name__ == "__main__":
    sys.exit(main())
