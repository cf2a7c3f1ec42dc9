"""Flies drawn tasks with variants of the loop, and compares what they keep.

`python tests/drawn_study.py --count 500` flies those of the published figures, in a process per
core; Ctrl-C stops it, and the same command goes on from there. Flights of other code, tasks or
variants are not mixed with those that a folder has: give another one, or --restart. More variants
may be added at any time.
"""

import argparse
import contextlib
import gc
import hashlib
import math
import sys
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from drawn_tasks import aircraft_task, carriers_task
from numpy.typing import NDArray

import drake_nonstop
from drake_nonstop.mechanics.signals import SIGNAL_PERIOD, Parameters, PlannedParameters
from drake_nonstop.run.outcome import LIMITS, RunOutcome
from drake_nonstop.run.run import Run
from drake_nonstop.run.run_quantities import RunQuantities
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.attempts import COMPLETED, FAILED, attempts
from drake_nonstop.studies.journal import Journal, StudyInterrupted, open_journal, settings_of
from drake_nonstop.studies.presets import read_grid
from drake_nonstop.studies.workers import SerialExecutor, run_all
from drake_nonstop.systems.block import release
from drake_nonstop.validation import ScenarioError, ScenarioWarning
from drake_nonstop.view.progress import TaskProgress

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
_NO_MARGIN = "needs faster orbits"  # of a warning that no margin suffices


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
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", ScenarioWarning)
        make = partial(scenario_of, tasks, seed, condition, overrides)
        _, tried = next(attempts([(make, {})]))
    if tried.run is None:
        return _without_run(tried.ending, tried.message)
    wrong = _wrong(RunQuantities(tried.run), _JUDGED_BY[tasks])
    result = {
        "ending": tried.ending,
        "outcome": next((outcome.value for outcome in RunOutcome if outcome in wrong), "ok"),
        "message": "; ".join(wrong.values()),
        "figures": figures_of(tried.run),
    }
    margin = [str(warning.message) for warning in told if _NO_MARGIN in str(warning.message)]
    result["figures"]["margin_left_out"] = next(iter(margin), "")
    release(tried.run.diagram)
    del tried
    gc.collect()
    return result


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


def _without_run(ending: str, message: str) -> dict[str, Any]:
    return {"ending": ending, "outcome": "", "message": message, "figures": {}}


def study(
    tasks: str,
    seeds: Sequence[int],
    variants: Mapping[str, Sequence[str]],
    folder: Path,
    *,
    condition: str = "none",
    restart: bool = False,
    is_serial: bool = False,
) -> dict[str, list[dict[str, Any]]]:
    """The results of each variant, a list in the order of the seeds.

    The folder gets a folder per variant, with what is done of it.

    Raises:
        ScenarioError: the folder has flights of other code, tasks or variants.
        StudyInterrupted: Ctrl-C; what is done stays.
    """
    code = _code()
    with contextlib.ExitStack() as stack:
        journals: dict[str, Journal] = {}
        for name, overrides in variants.items():
            journals[name] = stack.enter_context(
                open_journal(
                    folder / name.replace(" ", "_"),
                    settings_of("drawn tasks", code, tasks, condition, str(seeds), *overrides),
                    restart=restart,
                    what="tasks",
                )
            )
        keys = [(seed, name) for seed in seeds for name in variants]
        with TaskProgress() as progress:
            run_all(
                fly,
                keys,
                lambda key: (tasks, key[0], condition, variants[key[1]]),
                lambda key, result: journals[key[1]].record(str(key[0]), result),
                lambda key, error: _without_run(FAILED, error),
                done={key for key in keys if str(key[0]) in journals[key[1]].rows},
                executor=SerialExecutor() if is_serial else None,
                what="flying",
                progress=progress,
            )
        return {name: [journals[name].rows[str(k)] for k in seeds] for name in variants}


def _code() -> str:
    """A name of the sources that results depend on."""
    here, package = Path(__file__), Path(drake_nonstop.__file__).parent
    files = [*package.rglob("*.py"), *(package / "diagrams").rglob("*.py")]
    own = [here, here.with_name("drawn_tasks.py")]
    return hashlib.sha256(
        b"".join(file.read_bytes() for file in [*sorted(files), *own])
    ).hexdigest()


class Comparison(NamedTuple):
    """What a variant did on all tasks; ratios are to the first variant, where both completed.

    `stopped` counts flights without an end, `below` those with a carrier below the bound.
    """

    flown: int
    stopped: int
    below: int
    other_outcomes: int  # neither ok nor below the bound alone
    least: float  # of the bound
    peak_median: float
    peak_max: float
    speed_squared: float  # ratio of the sums over all tasks
    position_error_median: float  # mm
    position_error_max: float  # mm
    amplitude_step: float  # N, the largest
    frequency_step: float  # rad/s, the largest
    least_tension: float  # N


def compared(results: Sequence[dict[str, Any]], base: Sequence[dict[str, Any]]) -> Comparison:
    """A variant's results and those of the variant that it is compared with."""

    def values(name: str, of: Sequence[dict[str, Any]] = results) -> NDArray:
        return np.array([result["figures"].get(name, math.nan) for result in of], dtype=float)

    whole = np.array([result["ending"] == COMPLETED for result in results])
    both = whole & [result["ending"] == COMPLETED for result in base]
    is_below = values("below") > 0
    wrong = [result["outcome"] not in ("ok", "bound_missed") for result in results]
    peaks = values("peak")[both] / values("peak", base)[both]
    squares = values("speed_squared")[both].sum() / values("speed_squared", base)[both].sum()
    return Comparison(
        flown=len(results),
        stopped=int(np.sum(~whole)),
        below=int(np.sum(is_below & whole)),
        other_outcomes=int(np.sum(wrong & whole)),
        least=_least(values("least")),
        peak_median=float(np.median(peaks)) if len(peaks) else math.nan,
        peak_max=-_least(-peaks),
        speed_squared=float(squares),
        position_error_median=float(np.median(values("position_error")[whole]))
        if any(whole)
        else math.nan,
        position_error_max=-_least(-values("position_error")),
        amplitude_step=-_least(-values("amplitude_step")),
        frequency_step=-_least(-values("frequency_step")),
        least_tension=_least(values("least_tension")),
    )


def _least(values: NDArray) -> float:
    """The least number; NaN where there is none."""
    return float(np.nanmin(values)) if np.any(np.isfinite(values)) else math.nan


def table(results: Mapping[str, Sequence[dict[str, Any]]]) -> str:
    """A row per variant in Markdown, compared with the first."""
    base = next(iter(results.values()))
    lines = [
        "| variant | below ε | stopped | otherwise not ok | least v/ε | peak, median (max) | Σ∫v² "
        "| mean ‖e_p‖, median (max), mm | largest ΔA, N | Δξ, rad/s | least tension, N |",
        "| --- " * 11 + "|",
    ]
    for name, of_variant in results.items():
        row = compared(of_variant, base)
        errors = f"{row.position_error_median:.3g} ({row.position_error_max:.3g})"
        cells = (
            f"{name}",
            f"{row.below} of {row.flown}",
            f"{row.stopped}",
            f"{row.other_outcomes}",
            f"{row.least:.3f}",
            f"{row.peak_median:.3f} ({row.peak_max:.2f})",
            f"{row.speed_squared:.3f}",
            errors,
            f"{row.amplitude_step:.3g}",
            f"{row.frequency_step:.3g}",
            f"{row.least_tension:.3g}",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def failures(results: Mapping[str, Sequence[dict[str, Any]]], seeds: Sequence[int]) -> list[str]:
    """A line for each result whose outcome is not ok."""
    return [
        f"{name}, seed {seed}: {result['outcome'] or result['ending']}: {result['message']}"
        for name, of_variant in results.items()
        for seed, result in zip(seeds, of_variant, strict=True)
        if result["outcome"] != "ok"
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Parses, flies and prints; 130 where it was interrupted."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--tasks", choices=TASKS, default="carriers", help="(carriers)")
    parser.add_argument("--first", type=int, default=5000, metavar="SEED", help="(5000)")
    parser.add_argument("--count", type=int, default=20, metavar="N", help="tasks (20)")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=[*VARIANTS][:2])
    parser.add_argument("--condition", choices=CONDITIONS, default="none", help="(none)")
    parser.add_argument("--set", nargs="+", default=[], metavar="PATH=VALUE", help="for all")
    parser.add_argument("--out", type=Path, metavar="DIR", help="(out/drawn/TASKS_CONDITION)")
    parser.add_argument("--restart", action="store_true", help="drop what DIR has")
    parser.add_argument("--serial", action="store_true", help="in this process")
    options = parser.parse_args(arguments)
    seeds = range(options.first, options.first + options.count)
    folder = options.out or Path(f"out/drawn/{options.tasks}_{options.condition}")
    try:
        results = study(
            options.tasks,
            seeds,
            {name: [*VARIANTS.get(name, []), *options.set] for name in options.variants},
            folder,
            condition=options.condition,
            restart=options.restart,
            is_serial=options.serial,
        )
    except StudyInterrupted as interrupt:
        print(interrupt, file=sys.stderr)
        return 130
    except ScenarioError as error:
        print(error, file=sys.stderr)
        return 2
    shown = table(results)
    for name, found in results.items():
        told = [result for result in found if result["figures"].get("margin_left_out")]
        if told:
            wrong = sum(result["outcome"] != "ok" for result in told)
            shown += f"\n\n{name}: {len(told)} told that no margin suffices, {wrong} of them not ok"
    lines = failures(results, seeds)
    print(shown)
    (folder / "table.md").write_text(f"{shown}\n", encoding="utf-8")
    (folder / "failures.txt").write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    print("\n".join(lines[:20] + ([f"and {len(lines) - 20} more"] if len(lines) > 20 else [])))
    print(f"results: {folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
