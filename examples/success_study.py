"""How likely a run's outcome is ok: the load heavier or lighter than believed, in gusts."""

import dataclasses
from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow.parquet as parquet

from drake_nonstop import load_scenario, read_sweep, sweep
from drake_nonstop.studies.figures import make_success_figure

SPEC = Path(__file__).with_suffix(".yaml")
MASS, GUST, BOUND = (
    "simulated.load_mass",
    "load_disturbance.gust_force",
    "optimization_layer.speed_bound",
)


def main(
    duration: float = 15.0, runs: int = 1000, folder: str | Path = "out/success_study"
) -> None:
    """Runs the quintic task many times, in one process per core, and plots the successes.

    The runs that the folder has are not run again.
    """
    scenario = load_scenario("quintic", [f"simulation_duration={duration}"])
    spec = dataclasses.replace(read_sweep(SPEC), runs=runs)
    done = sweep(
        scenario,
        spec,
        folder,
        progress=lambda what, share: print(f"\r{what}: {share:.0%}", end="", flush=True),
    )
    print()
    table = {
        name: np.array(values)
        for name, values in parquet.read_table(done.table).to_pydict().items()
    }
    succeeded = table["outcome"] == "ok"  # no carrier below its bound, and nothing else wrong
    for bound in np.unique(table[BOUND]):
        chosen = table[BOUND] == bound
        share, deviation = _probability(succeeded[chosen])
        print(
            f"bound {bound:.2f} m/s   outcome ok in {share:.1%} ± {deviation:.1%} "
            f"of {chosen.sum()} runs"
        )
    for outcome, count in Counter(table["outcome"].tolist()).items():
        print(f"{count:5} {outcome}")
    ended = table["outcome"] != "stopped"
    errors = 1e3 * table["load.position_error_mean_m"][ended].astype(float)
    print(f"mean load error   {np.nanmedian(errors):.1f} mm, at most {np.nanmax(errors):.1f} mm")
    figure = make_success_figure(
        "Outcome of the quintic task: ok",
        succeeded,
        across=("gusts (N, standard deviation)", table[GUST]),
        up=("load's mass, 1 is believed (kg)", table[MASS]),
        panels=("bound (m/s)", table[BOUND]),
    )
    figure.savefig(Path(folder) / "success.png", dpi=150)
    print(f"results: {done.table}, success.png beside it")


def _probability(succeeded: np.ndarray) -> tuple[float, float]:
    """The share of the runs that succeeded, and its standard error by Agresti and Coull's rule."""
    count = len(succeeded) + 4
    share = (succeeded.sum() + 2) / count
    return succeeded.mean(), np.sqrt(share * (1 - share) / count)


if __name__ == "__main__":
    main()
