"""Fly a task on which looking one sample ahead misses the bound, and a horizon keeps it."""

from pathlib import Path

import numpy as np

from drake_nonstop import compute_metrics, load_scenario, simulate
from drake_nonstop.simulation.run_quantities import RunQuantities
from drake_nonstop.studies.ablation import read_grid
from drake_nonstop.studies.figures import make_overlay_figure

# A drawn task: what it changes of the scenario "quintic". `tests/drawn_tasks.py` draws others.
TASK = [
    "system.attachments=[[0.4921, -0.0966, 0.0], [0.182, 0.452, 0.0], [-0.5042, -0.0464, 0.0], [0.1307, -0.3868, 0.0]]",  # noqa: E501
    "system.load_mass=2.5225",
    "system.cable_length=2.7495",
    "simulation_duration=16.47",
    "pattern=!HamiltonianCycle {}",
    "load_trajectory=!RestToRest {displacement: [-2.301, -4.582, 0.5562], roll_pitch_yaw: [-0.1933, -0.0051, -0.0315], start_time: 1.0, move_time: 12.4697}",  # noqa: E501
    "optimization_layer=!RecedingHorizonOptimizer {speed_bound: 0.7812, frequency: 1.4863, amplitude: 3.496}",  # noqa: E501
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
    times = curves["horizon"][0]
    figure = make_overlay_figure(
        "A drawn task of four carriers",
        "speed of the slowest carrier, of the bound",
        curves,
        framed=set(curves),
        bound=(times, np.ones(len(times))),
    )
    _enlarge_the_slowest(figure, curves)
    Path(folder).mkdir(parents=True, exist_ok=True)
    figure.savefig(Path(folder) / "foresight.png", dpi=150)
    print(f"results: {Path(folder) / 'foresight.png'}")


def _enlarge_the_slowest(figure, curves) -> None:
    """Adds what is about the slowest instant of one sample, enlarged."""
    times, speeds = curves["one sample"]
    (axes,) = figure.axes
    axes.lines[0].set_linewidth(1.5)
    at = times[np.argmin(speeds)]
    inset = axes.inset_axes((0.42, 0.06, 0.3, 0.22), xlim=(at - 0.4, at + 0.4), ylim=(0.97, 1.1))
    for line in axes.lines:
        style = {"color": line.get_color(), "linestyle": line.get_linestyle()}
        inset.plot(line.get_xdata(), line.get_ydata(), linewidth=1.2, **style)
    inset.tick_params(labelsize="x-small")
    axes.indicate_inset_zoom(inset)


if __name__ == "__main__":
    main()
