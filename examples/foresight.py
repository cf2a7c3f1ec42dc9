"""Fly a task on which looking one sample ahead misses the bound, and a horizon keeps it."""

from pathlib import Path

import matplotlib.style
import numpy as np
from matplotlib.figure import Figure

from drake_nonstop import compute_metrics, load_scenario, simulate
from drake_nonstop.run.run_quantities import RunQuantities
from drake_nonstop.studies.presets import read_grid

# A drawn task: what it changes of the scenario "quintic". `tests/drawn_tasks.py` draws others.
TASK = [
    "system.attachments=[[1.0411, -0.1233, -0.1524], [0.8383, 0.6246, 0.1812], [-0.0082, 1.1194, 0.1372], [-0.9558, 0.3693, -0.0841], [-0.9825, -0.5251, -0.0859], [-0.0845, -0.9009, 0.1508], [0.6536, -0.8428, -0.1826]]",  # noqa: E501
    "system.load_mass=1.2226",
    "system.cable_length=2.8848",
    "simulation_duration=13.35",
    "pattern=!HamiltonianCycle {}",
    "load_trajectory=!RestToRest {displacement: [5.3021, 3.0764, 2.9082], roll_pitch_yaw: [-0.2105, 0.0459, 0.0777], start_time: 1.0, move_time: 9.3513}",  # noqa: E501
    "optimization_layer=!RecedingHorizonOptimizer {speed_bound: 1.0681, frequency: 2.268, amplitude: 0.9545}",  # noqa: E501
]
LAYERS = {"one sample": read_grid("foresight").variants["one sample"], "horizon": []}


def main(duration: float = 20.0, folder: str | Path = "out/foresight") -> None:
    """Flies it with both, and draws the speed of the slowest carrier in units of the bound."""
    curves = {}
    for name, changes in LAYERS.items():
        scenario = load_scenario("quintic", [*TASK, *changes])
        scenario.simulation_duration = min(duration, scenario.simulation_duration)
        run = simulate(scenario)
        quantities = RunQuantities(run)
        curves[name] = quantities.time, quantities.speeds.min(axis=1) / scenario.speed_bound
        metrics = compute_metrics(run)
        print(
            f"{name:11} slowest {quantities.slowest_speed / scenario.speed_bound:.3f} of the bound,"
            f" below it for {metrics['carriers']['time_below_bound_s']:.3f} s,"
            f" load error {1e3 * metrics['load']['position_error_mean_m']:.4f} mm"
        )
    Path(folder).mkdir(parents=True, exist_ok=True)
    with matplotlib.style.context("drake_nonstop.view.paper"):
        make_figure(curves).savefig(Path(folder) / "foresight.png")
    print(f"results: {Path(folder) / 'foresight.png'}")


def make_figure(curves: dict[str, tuple[np.ndarray, np.ndarray]]) -> Figure:
    """The speeds, in units of the bound, over times (s), by the names of the layers."""
    figure = Figure(figsize=(7.16, 2.8))  # of two columns of a paper
    axes = figure.subplots()
    for (name, curve), colour in zip(curves.items(), ("black", "C0"), strict=True):
        axes.plot(*curve, label=name, color=colour)
    axes.axhline(1, color="black", linestyle="--", label="bound ε")
    axes.set(xlabel="time (s)", ylabel="speed of the slowest carrier / ε", ylim=(0, None))
    _enlarge_the_slowest(figure, curves)
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def _enlarge_the_slowest(figure, curves) -> None:
    """Adds what is about the slowest instant of one sample, enlarged."""
    times, speeds = curves["one sample"]
    (axes,) = figure.axes
    at = times[np.argmin(speeds)]
    inset = axes.inset_axes((0.42, 0.12, 0.3, 0.2), xlim=(at - 0.4, at + 0.4), ylim=(0.75, 1.25))
    for line in axes.lines:
        style = {"color": line.get_color(), "linestyle": line.get_linestyle()}
        inset.plot(line.get_xdata(), line.get_ydata(), linewidth=1.2, **style)
    inset.tick_params(labelsize=6)
    axes.indicate_inset_zoom(inset)


if __name__ == "__main__":
    main()
