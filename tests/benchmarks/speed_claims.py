"""Numbers of speed that the README prints: measured by the benchmarks, and compared loosely.

They are rows like other claims, whose arguments begin with `bench`. Machines differ, and so a
time, a share or a factor holds where it is within a factor of 2 of what is printed; errors and
other figures that do not depend on the machine hold to their printed digits.
"""

import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.accuracy import OVERRIDES, benchmark_accuracy
from benchmarks.scaling import benchmark_scale
from benchmarks.viewer import benchmark_viewer
from drake_nonstop.benchmarks.comparing import Source
from drake_nonstop.benchmarks.running import benchmark_run
from drake_nonstop.scenario.loading import load_scenario

Results = dict[str, Any]
Progress = Callable[[str, float], None]

BENCH = "bench"  # the first argument of such a claim
FACTOR = 2.0  # between machines


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """A subcommand of `bench`: how it measures a scenario, and what can be claimed of it."""

    measure: Callable[[str, Sequence[str], Progress], Results]
    quantities: dict[str, Callable[[Results], float | None]]


def measure_benchmark(arguments: str, progress: Progress) -> Results:
    """What a benchmark found, whose arguments begin with `bench`.

    Raises:
        ScenarioError: the scenario cannot be run.
    """
    _, name, scenario, *overrides = shlex.split(arguments)
    return BENCHMARKS[name].measure(scenario, overrides, progress)


def quantities_of(arguments: str) -> dict[str, Callable[[Results], float | None]]:
    """What can be claimed of a benchmark with these arguments."""
    words = shlex.split(arguments)
    known = len(words) > 2 and words[1] in BENCHMARKS
    return BENCHMARKS[words[1]].quantities if known else {}


def is_exact(quantity: str) -> bool:
    """Whether a quantity of a benchmark is the same on all machines."""
    return quantity.startswith("error of")


def _of_scenario(
    benchmark: Callable[..., Results], **options: Any
) -> Callable[[str, Sequence[str], Progress], Results]:
    def measure(name: str, overrides: Sequence[str], progress: Progress) -> Results:
        return benchmark(load_scenario(name, overrides), progress=progress, **options)

    return measure


def _run(name: str, overrides: Sequence[str], progress: Progress) -> Results:
    return benchmark_run(Source(name, tuple(overrides)), progress=progress)


def _carriers(n: int) -> Callable[[Results], float]:
    return lambda results: next(row for row in results["runs"] if row["n"] == n)["real_time_factor"]


def _of_run(
    overrides: Sequence[str], key: str, scale: float = 1.0
) -> Callable[[Results], float | None]:
    """What the accuracy benchmark found with the overrides; None for a run that stopped."""

    def value(results: Results) -> float | None:
        run = next(run for run in results["runs"] if run["overrides"] == list(overrides))
        return scale * run[key] if key in run else None

    return value


def _accuracies() -> Iterator[tuple[str, Callable[[Results], float | None]]]:
    for overrides in ((), *OVERRIDES):
        ending = f", {' '.join(overrides)}" if overrides else ""
        yield f"times real time{ending}", _of_run(overrides, "real_time_factor")
        yield f"error of the load (mm){ending}", _of_run(overrides, "load_error_m", 1e3)
        yield f"error of the speeds (%){ending}", _of_run(overrides, "speed_error", 100)


BENCHMARKS = {
    "viewer": Benchmark(
        measure=_of_scenario(benchmark_viewer),
        quantities={"share of real time (%)": lambda results: 100 * results["cost_of_real_time"]},
    ),
    "run": Benchmark(
        measure=_run,
        quantities={
            "optimization layer's share of the time (%)": lambda results: (
                100 * results["optimization_layer_share"]
            ),
        },
    ),
    "scale": Benchmark(
        measure=_of_scenario(benchmark_scale),
        quantities={
            "times real time with 16 carriers": _carriers(16),
            "times real time with 64 carriers": _carriers(64),
            "exponent of the cost of a step": lambda results: results["exponent"],
        },
    ),
    "accuracy": Benchmark(measure=_of_scenario(benchmark_accuracy), quantities=dict(_accuracies())),
}
