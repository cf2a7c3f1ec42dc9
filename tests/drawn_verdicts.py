"""What `check` says of drawn tasks beside what becomes of their flights.

`python tests/drawn_verdicts.py --count 300` prints the table of verdict against outcome and lists
the contradictions; Ctrl-C stops it, and the same command goes on from there.
"""

import argparse
import sys
import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from drawn_study import _code
from drawn_tasks import GRAVITY, aircraft_task, attachments_of, loaded

from drake_nonstop.analysis.limit import RunOutcome
from drake_nonstop.analysis.task_check import check_task
from drake_nonstop.run.outcome import Judgement, judge
from drake_nonstop.run.run_quantities import RunQuantities
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.journal import StudyInterrupted, open_journal, settings_of
from drake_nonstop.studies.run_all import FAILED, SerialExecutor, attempts, run_all
from drake_nonstop.systems.block import release
from drake_nonstop.validation import ScenarioError, ScenarioWarning
from drake_nonstop.view.progress import TaskProgress

SOUND, CANNOT, UNKNOWN = "sound", "cannot", "unknown"
_AIRCRAFT = 5  # one task in so many is flown by aircraft
# `check` judges all but these.
_NOT_JUDGED = (RunOutcome.OK, RunOutcome.UNCONVERGED)
_RESULT = {"verdict": str, "said": list, "outcome": str, "reasons": list}


def task_of_seed(seed: int) -> Scenario:
    """The task of a seed: one in five is one of aircraft, the others are of the kind of `draw`."""
    if seed % _AIRCRAFT == 0:
        return _aircraft_task(seed)
    return changed(loaded("quintic"), draw(seed))


def draw(seed: int) -> list[str]:
    """The overrides that make the scenario "quintic" the task of a seed.

    3 to 8 cables of 0.6 to 3 m hold a load of 0.5 to 3 kg, on a cycle, a carousel, or one that is
    spread, at attachments about a circle. The load moves by up to two cable lengths along each axis
    and turns by up to 0.25 rad. Half of the bounds are 40 to 160 % of the nominal speed at rest,
    the others 40 to 80 %; half of the layers have a limit of speed, tension or separation, too, and
    half of the tasks none of distances.
    """
    rng = np.random.default_rng([34, seed])

    def uniform(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 4)

    n = int(rng.integers(3, 9))
    attachments = attachments_of(n, rng)
    mass, length = uniform(0.5, 3.0), uniform(0.6, 3.0)
    share = mass * GRAVITY / n
    amplitude = round(share * uniform(0.3, 0.8), 4)
    frequency = uniform(1.2, 2.5)
    radius = float(np.linalg.norm(attachments[:, :2], axis=1).mean())
    inertia = round(mass * radius**2 / 4, 4) * np.diag([1.0, 1.0, 2.0])
    speed = frequency * length * amplitude / np.hypot(amplitude, share)
    pattern = ("HamiltonianCycle {}", "Carousel {}", None)[int(rng.integers(3))]
    if pattern is None:
        pattern = f"SpreadCarousel {{spread: {round(amplitude * uniform(1.1, 2.0), 4)}}}"
    move_time = uniform(8.0, 14.0)
    turn = rng.normal(size=3)
    turn *= uniform(0.0, 0.25) / np.linalg.norm(turn)
    bounds = (0.4, 1.6) if rng.random() < 0.5 else (0.4, 0.8)
    layer: dict[str, Any] = {
        "speed_bound": round(float(speed) * uniform(*bounds), 4),
        "frequency": frequency,
        "amplitude": amplitude,
    }
    if rng.random() < 0.5:
        name, value = (
            ("max_speed", float(speed) * uniform(1.3, 3.0)),
            ("max_tension", share * uniform(1.2, 3.0)),
            ("min_separation", radius * uniform(0.2, 1.0)),
        )[int(rng.integers(3))]
        layer[name] = round(value, 4)
    trajectory = {
        "displacement": np.round(rng.uniform(-2.0, 2.0, 3) * length, 4).tolist(),
        "roll_pitch_yaw": np.round(turn, 4).tolist(),
        "start_time": 1.0,
        "move_time": move_time,
    }
    settings = {
        "system.attachments": attachments.tolist(),
        "system.load_mass": mass,
        "system.load_inertia": inertia.tolist(),
        "system.cable_length": length,
        "simulation_duration": round(3.0 + move_time, 2),
        "pattern": f"!{pattern}",
        "load_trajectory": _tagged("RestToRest", trajectory),
        "optimization_layer": _tagged("RecedingHorizonOptimizer", layer),
    }
    if rng.random() < 0.5:  # so that what collides hides nothing else
        settings |= dict.fromkeys(("limits.carrier_distance", "limits.cable_distance"), 0.0)
    return [f"{path}={value}" for path, value in settings.items()]


def _aircraft_task(seed: int) -> Scenario:
    """A drawn transfer of aircraft; half of them with bounds of up to 1.6 of their first ones."""
    rng = np.random.default_rng([35, seed])
    task = aircraft_task(seed)
    factor = float(rng.uniform(0.6, 1.6)) if rng.random() < 0.5 else 1.0
    bound = round(factor * task.speed_bound, 4)
    return changed(task, [f"optimization_layer.speed_bound={bound}"])


def _tagged(name: str, values: dict[str, Any]) -> str:
    return f"!{name} {{{', '.join(f'{key}: {value}' for key, value in values.items())}}}"


def verdict_of(scenario: Scenario) -> tuple[str, list[str]]:
    """What is said of a task beforehand, and the sentences; a refusal is "cannot".

    Nothing is tried that may help. "Unknown" is what `check` says a flight alone tells, and what it
    says of loops that it does not know.
    """
    try:
        found = check_task(scenario, tries_remedies=False)
    except ScenarioError as error:
        return CANNOT, [f"refused: {error}"]
    said = [*found.verdicts]
    if found.is_in_doubt:
        return UNKNOWN, said
    if not found.is_sound:
        return CANNOT, said
    is_known = found.flight is not None or np.isfinite(found.formation.sampled.growth)
    return SOUND if is_known else UNKNOWN, said


def outcome_of(scenario: Scenario) -> Judgement:
    """What becomes of the flight; one that could not be built has stopped."""
    _, tried = next(attempts([(scenario, {})]))
    if tried.run is None:
        return Judgement(outcome=RunOutcome.STOPPED, reasons=(tried.message,))
    judged = judge(RunQuantities(tried.run))
    release(tried.run.diagram)
    return judged


def looked_at(seed: int) -> dict[str, Any]:
    """The verdict on a task and the outcome of its flight, of the fields of `_RESULT`."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)
        scenario = task_of_seed(seed)
        verdict, said = verdict_of(scenario)
        judged = outcome_of(scenario)
    return {
        "verdict": verdict,
        "said": said,
        "outcome": judged.outcome.value,
        "reasons": [*judged.reasons],
    }


def contradicts(result: dict[str, Any]) -> bool:
    """Whether a verdict and an outcome cannot both be true."""
    if result["verdict"] == CANNOT:
        return result["outcome"] == RunOutcome.OK.value
    return result["verdict"] == SOUND and result["outcome"] not in _NOT_JUDGED


def table(results: Sequence[dict[str, Any]]) -> str:
    """Verdicts against outcomes in Markdown."""
    counts = Counter((result["verdict"], result["outcome"]) for result in results)
    outcomes = sorted({outcome for _, outcome in counts})
    lines = [f"| verdict | {' | '.join(outcomes)} |", f"| --- {'| --- ' * len(outcomes)}|"]
    for verdict in (SOUND, CANNOT, UNKNOWN):
        cells = [str(counts[verdict, outcome]) for outcome in outcomes]
        lines.append(f"| {verdict} | {' | '.join(cells)} |")
    return "\n".join(lines)


def study(
    seeds: Sequence[int], folder: Path, *, restart: bool = False, is_serial: bool = False
) -> list[dict[str, Any]]:
    """The results in the order of the seeds; the folder has what is done.

    Raises:
        StudyInterrupted: Ctrl-C; what is done stays.
    """
    settings = settings_of("drawn verdicts", _code(), Path(__file__).read_text(), str(seeds))
    with (
        open_journal(folder, settings, seeds, _RESULT, restart=restart, what="tasks") as journal,
        TaskProgress() as progress,
    ):
        run_all(
            looked_at,
            seeds,
            lambda seed: (seed,),
            journal.record,
            lambda seed, error: {"verdict": "", "said": [], "outcome": FAILED, "reasons": [error]},
            done=journal,
            executor=SerialExecutor() if is_serial else None,
            what="checking and flying",
            progress=progress,
        )
        return [journal.result(seed) for seed in seeds]


def main(arguments: Sequence[str] | None = None) -> int:
    """Checks, flies and prints; 1 where a verdict is contradicted, 130 where it was interrupted."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="(0)")
    parser.add_argument("--count", type=int, default=20, metavar="N", help="tasks (20)")
    parser.add_argument("--out", type=Path, default=Path("out/drawn/verdicts"), metavar="DIR")
    parser.add_argument("--restart", action="store_true", help="drop what DIR has")
    parser.add_argument("--serial", action="store_true", help="in this process")
    options = parser.parse_args(arguments)
    seeds = range(options.first, options.first + options.count)
    try:
        results = study(seeds, options.out, restart=options.restart, is_serial=options.serial)
    except StudyInterrupted as interrupt:
        print(interrupt, file=sys.stderr)
        return 130
    print(table(results))
    wrong = [(k, r) for k, r in zip(seeds, results, strict=True) if contradicts(r)]
    for seed, result in wrong:
        print(f"seed {seed}: {result['verdict']}, but {result['outcome']}")
        print("".join(f"    {text}\n" for text in (*result["said"], *result["reasons"])), end="")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
