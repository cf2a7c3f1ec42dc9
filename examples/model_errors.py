"""What the shipped flights keep where the model is wrong: without errors, and with light and rough.

A row per flight and set of errors, of 20 seeds: the mean of the load's error with its 95 %
interval, the largest error, tilt and yaw after the first 10 s (all of a flight of less than 20 s),
the longest time below the bound, and how many flights ended otherwise than `ok`. The sets are
those of `errors` of a scenario. All of them take an hour or two on two cores;
`python examples/model_errors.py quintic` flies one.
"""

import math
import sys
from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student

from drake_nonstop import Run, RunStopped, compute_metrics, load_scenario, simulate_many
from drake_nonstop.run.run_quantities import RunQuantities

FLIGHTS = {
    "quintic": [],
    "line": [],
    "three_carriers": [],
    "aircraft_rest_cables": ["cables.nodes=24"],
    "aircraft_transfer_cables": ["cables.nodes=24"],
    "aircraft_rest_cables_gusty": ["cables.nodes=24"],
    "aircraft_transfer_cables_gusty": ["cables.nodes=24"],
}
SETS = ("none", "light", "rough")
FIRST = 10.0  # s


def row(name: str, errors: str, runs: Sequence[Run | BaseException]) -> str:
    """A line of the table."""
    ended = [run.run if isinstance(run, RunStopped) else run for run in runs]
    flown = [run for run in ended if isinstance(run, Run)]
    outcomes = Counter(
        compute_metrics(run)["outcome"] if isinstance(run, Run) else "no start" for run in ended
    )
    others = ", ".join(f"{count} {name}" for name, count in outcomes.items() if name != "ok")
    means, largest, tilts, yaws, below = [], [], [], [], []
    for run in flown:
        quantities = RunQuantities(run)
        late = run.time >= (FIRST if run.time[-1] >= 2 * FIRST else 0.0)
        means.append(1e3 * np.mean(quantities.position_error[late]))
        largest.append(1e3 * np.max(quantities.position_error[late]))
        tilts.append(math.degrees(np.max(quantities.tilt_error[late])))
        yaws.append(math.degrees(np.max(quantities.yaw_error[late])))
        below.append(quantities.time_below_bound)
    if not flown:
        return f"| `{name}` | {errors} | | | | | | {others} |"
    interval = 0.0
    if len(means) > 1:
        interval = student.ppf(0.975, len(means) - 1) * np.std(means, ddof=1) / len(means) ** 0.5
    cells = [
        f"{np.mean(means):.2g} ± {interval:.2g}",
        *(f"{np.max(values):.2g}" for values in (largest, tilts, yaws, below)),
    ]
    return f"| `{name}` | {errors} | {' | '.join(cells)} | {others or 'none'} |"


def main(names: Sequence[str] = (), duration: float | None = None, runs: int = 20) -> None:
    """Flies all, or those that are named, and prints the table; duration (s): None, as stated."""
    columns = ("scenario", "errors", "load error, mean (mm)", "largest (mm)", "tilt (°)", "yaw (°)")
    columns += ("below ε (s)", "not ok")
    print(f"| {' | '.join(columns)} |\n|{' --- |' * len(columns)}")
    for name in names or FLIGHTS:
        for errors in SETS:
            own = [*FLIGHTS.get(name, []), f"errors={errors}"]
            own += [] if duration is None else [f"simulation_duration={duration}"]
            seeds = range(runs if errors != "none" else 1)
            scenarios = [load_scenario(name, [*own, f"random_seed={seed}"]) for seed in seeds]
            print(row(name, errors, simulate_many(scenarios)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
