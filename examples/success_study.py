"""How likely a run's outcome is ok: the load heavier or lighter than believed, in gusts."""

import dataclasses
from collections import Counter
from pathlib import Path

import matplotlib.style
import numpy as np
from matplotlib.figure import Figure

from drake_nonstop import load_scenario, read_grid, sweep

SPEC = Path(__file__).with_suffix(".yaml")
MASS, GUST, BOUND = (
    "simulated.load_mass",
    "load_disturbance.gust_force",
    "optimization_layer.speed_bound",
)


def main(
    duration: float = 15.0, seeds: int = 250, folder: str | Path = "out/success_study"
) -> None:
    """Runs the quintic task many times, in one process per core, and plots the successes.

    The runs that the folder has are not run again.
    """
    scenario = load_scenario("quintic", [f"simulation_duration={duration}"])
    done = sweep(
        scenario,
        dataclasses.replace(read_grid(SPEC), seeds=seeds),
        folder,
        progress=lambda what, share: print(f"\r{what}: {share:.0%}", end="", flush=True),
    )
    print()
    table = {name: done.table[name].to_numpy() for name in done.table}
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
    with matplotlib.style.context("drake_nonstop.view.paper"):
        make_success_figure(table, succeeded).savefig(Path(folder) / "success.png")
    print(f"results: {folder}")


def make_success_figure(table: dict[str, np.ndarray], succeeded: np.ndarray) -> Figure:
    """The share of runs that succeeded over gusts and masses, a panel for each bound.

    Gusts are standard deviations of the force; the controllers believe in a load of 1 kg.
    """
    bounds, gusts, masses = np.unique(table[BOUND]), table[GUST], table[MASS]
    edges = [np.linspace(values.min(), values.max(), 6) for values in (gusts, masses)]
    figure = Figure(figsize=(7.16, 2.3))  # of two columns of a paper
    all_axes = figure.subplots(1, len(bounds), sharey=True, squeeze=False)[0]
    for axes, bound in zip(all_axes, bounds, strict=True):
        chosen = table[BOUND] == bound
        counts, hits = (
            np.histogram2d(gusts[which], masses[which], bins=edges)[0].T
            for which in (chosen, chosen & succeeded)
        )
        shares = np.ma.masked_array(hits / np.maximum(counts, 1), counts == 0)
        shown = axes.pcolormesh(*edges, shares, cmap="viridis", vmin=0, vmax=1)
        axes.grid(visible=False)
        columns, rows = ((edge[:-1] + edge[1:]) / 2 for edge in edges)
        for i, j in np.argwhere(counts > 0):
            text = f"{shares[i, j]:.0%}\nof {counts[i, j]:.0f}"
            colour = "black" if shares[i, j] > 0.6 else "white"
            style = {"color": colour, "ha": "center", "va": "center", "fontsize": 5}
            axes.text(columns[j], rows[i], text, **style)
        axes.set(xlabel="gusts (N)", title=f"ε = {bound:g} m/s")
    all_axes[0].set_ylabel("mass of the load (kg)")
    figure.colorbar(shown, ax=list(all_axes), label="share of runs that are ok")
    return figure


def _probability(succeeded: np.ndarray) -> tuple[float, float]:
    """The share of the runs that succeeded, and its standard error by Agresti and Coull's rule."""
    count = len(succeeded) + 4
    share = (succeeded.sum() + 2) / count
    return succeeded.mean(), np.sqrt(share * (1 - share) / count)


if __name__ == "__main__":
    main()
