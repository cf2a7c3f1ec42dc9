"""What `check` says of drawn tasks beside what becomes of their flights in other seeds.

`python tests/drawn_verdicts.py --count 300` prints the table of verdict against outcome and lists
the contradictions. With `--kind errors` each task states `errors`.
"""

import argparse
import sys
import warnings
from typing import Any

import numpy as np
import pandas as pd
from drawn_study import in_processes
from drawn_tasks import GRAVITY, Draw, aircraft_task, carriers_task

from drake_nonstop import (
    Scenario,
    ScenarioError,
    ScenarioWarning,
    SerialExecutor,
    changed,
    check_scenario,
    study,
)

OK, CANNOT, MIXED, REFUSED = "ok", "cannot", "mixed", "refused"
AIRCRAFT = 5  # one task in so many is flown by aircraft
OTHER_SEEDS = [100, 101, 102]


def task_of_seed(seed: int) -> Scenario:
    """A drawn task with other bounds: one in five is one of aircraft.

    Half of the bounds are 0.6 to 2 times those of the drawn ones. Of carriers half of the layers
    have a limit of speed, tension or separation, too, half of the tasks none of distances, and a
    third each flies on a cycle, a carousel, or one that is spread.
    """
    uniform, is_of_aircraft = Draw(34, seed), seed % AIRCRAFT == 0
    task = aircraft_task(seed) if is_of_aircraft else carriers_task(seed)
    factor = uniform(0.6, 1.6 if is_of_aircraft else 2.0)
    changes = [f"optimization_layer.speed_bound={factor * task.speed_bound}"] * uniform.is_so()
    if not is_of_aircraft:
        system, layer = task.system, task.optimization_layer
        share = system.load_mass * GRAVITY / len(system.attachments)
        steepness = layer.amplitude / np.hypot(layer.amplitude, share)
        speed = layer.frequency * system.cable_length * steepness
        radius = np.linalg.norm(np.array(system.attachments)[:, :2], axis=1).mean()
        limits = (
            f"max_speed={speed * uniform(1.3, 3.0)}",
            f"max_tension={share * uniform(1.2, 3.0)}",
            f"min_separation={radius * uniform(0.2, 1.0)}",
        )
        spread = f"!SpreadCarousel {{spread: {layer.amplitude * uniform(1.1, 2.0)}}}"
        pattern = ("!HamiltonianCycle {}", "!Carousel {}", spread)[uniform.rng.integers(3)]
        changes.append(f"pattern={pattern}")
        changes += [f"optimization_layer.{uniform.rng.choice(limits)}"] * uniform.is_so()
        free = ["limits.carrier_distance=0", "limits.cable_distance=0"]
        changes += free * uniform.is_so()  # so that what collides hides nothing else
    return changed(task, changes)


def with_errors(seed: int) -> Scenario:
    """The task of a seed with errors that its controllers do not know of, light or rough ones."""
    size = ("light", "rough")[Draw(36, seed).rng.integers(2)]
    return changed(task_of_seed(seed), [f"errors={size}", f"random_seed={seed}"])


TASKS = {"exact": task_of_seed, "errors": with_errors}


def looked_at(kind: str, seed: int) -> dict[str, Any]:
    """The verdict on a task, what is said of it, and the outcomes of its flights in other seeds.

    It is contradicted where one of these ends well although no flight of the check does, or ill
    although all do. Flights of which some end well and some do not promise neither.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)
        scenario = TASKS[kind](seed)
        try:
            found = check_scenario(scenario, tries_remedies=False)
        except ScenarioError as error:
            return judged(REFUSED, [str(error)], [])
        seeds = OTHER_SEEDS if len(found.flights) > 1 else [0]
        others = study(scenario, {}, seeds, executor=SerialExecutor()).table.outcome
    outcomes = [flight.outcome.value for flight in found.flights]
    verdict = CANNOT if OK not in outcomes else OK if set(outcomes) == {OK} else MIXED
    if verdict != MIXED and found.narrow:
        verdict = f"{verdict}, narrow"
    return judged(verdict, [*found.verdicts], [*others])


def judged(verdict: str, said: list[str], outcomes: list[str]) -> dict[str, Any]:
    """A row of the table."""
    are_ok = [outcome == OK for outcome in outcomes]
    kind = verdict.partition(",")[0]
    is_wrong = any(are_ok) if kind == CANNOT else kind == OK and not all(are_ok)
    others = {"others": len(outcomes), "of them ok": sum(are_ok), "contradicted": is_wrong}
    return {"verdict": verdict, "said": said, "outcomes": outcomes, **others}


def main() -> int:
    """Checks, flies and prints; 1 where a verdict is contradicted."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--kind", choices=TASKS, default="exact", help="(exact)")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="(0)")
    parser.add_argument("--count", type=int, default=20, metavar="N", help="tasks (20)")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.count)
    results = in_processes(looked_at, [(options.kind, seed) for seed in seeds])
    rows = pd.DataFrame(results, index=pd.Index(seeds, name="seed"))
    columns = ["others", "of them ok", "contradicted"]
    print(rows.assign(tasks=1).groupby("verdict")[["tasks", *columns]].sum().to_string())
    for row in rows[rows.contradicted].itertuples():
        print(f"seed {row.Index}: {row.verdict}, but {', '.join(row.outcomes)}", *row.said)
    return 1 if rows.contradicted.any() else 0


if __name__ == "__main__":
    sys.exit(main())
