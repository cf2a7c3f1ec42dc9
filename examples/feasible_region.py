"""Which wind, load and speed a formation of aircraft can take, beside flights on both sides.

Four aircraft are designed for a load of 10 kg in a wind of 2 m/s. The border is where a limit of
the aircraft or of their controllers is missed, by the exact inverse of their dynamics; flights
within it have to succeed, and flights beyond it need not. The picture goes to feasible_region.png.
All flights take a quarter of an hour on two cores.
"""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

from drake_nonstop import compute_metrics, simulate
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.simulation.run import RunStopped
from drake_nonstop.studies.design import DesignedFormation, design_one
from drake_nonstop.studies.design_figures import make_region_figure
from drake_nonstop.studies.design_request import dump_request, read_request
from drake_nonstop.studies.feasible_region import feasible_region, region_scenario

REQUEST = ["carriers=[4]", "wind=[2, 0, 0]", "cable_length=[150, 200]", "starts=2"]
SPEEDS = (0.0, 1.5, 3.0)  # m/s, of the load
FACTORS = (0.8, 0.95, 1.25)  # of the border's wind, at which it is flown


def fly(scenario: Scenario) -> tuple[bool, str]:
    """Whether a flight keeps its limits, without its aircraft at theirs, and a line about it."""
    try:
        metrics = compute_metrics(simulate(scenario))
    except RunStopped as stopped:
        return False, f"load error unknown: {stopped}"
    flight, error = metrics["aircraft"], metrics["load"]["position_error_max_m"]
    saturated = flight["saturated_share"]
    is_ok = metrics["outcome"] == "ok" and saturated < 0.01
    return is_ok, (
        f"{metrics['outcome']:9} load error max {error:.3f} m, C_L {flight['lift_share_max']:.2f} "
        f"of C_Lmax, saturated {saturated:.1%}"
    )


def main(duration: float | None = None, runs: int = 4) -> None:
    """Flies this number of loads at each speed and wind; with a duration (s) one, that long."""
    request = read_request(None, REQUEST)
    kind = "leaning" if duration is None else "co_rotating"  # which is found sooner
    found = design_one(dump_request(request), request.carriers[0], kind)
    formation = next(item for item in found if isinstance(item, DesignedFormation))
    count, speeds = (15, SPEEDS) if duration is None else (2, SPEEDS[:1])
    masses = np.linspace(5.0, 10.0, count).round(3).tolist()
    regions = [feasible_region(request, formation, masses, speed) for speed in speeds]
    planned = []
    for k, region in enumerate(regions):
        possible = np.flatnonzero(region.winds > 0)
        for index in possible[np.linspace(0, len(possible) - 1, runs).round().astype(int)]:
            for factor in FACTORS:
                planned.append((k, masses[index], float(factor * region.winds[index])))
    if duration is not None:
        planned = planned[:1]
    scenarios = []
    for k, mass, wind in planned:
        scenario = region_scenario(request, formation, mass, wind, SPEEDS[k])
        scenario.simulation_duration = duration or scenario.simulation_duration
        scenarios.append(scenario)
    flown = []
    with ProcessPoolExecutor(2, get_context("fork")) as pool:
        for (k, mass, wind), (is_ok, line) in zip(planned, pool.map(fly, scenarios), strict=True):
            print(f"{SPEEDS[k]:.1f} m/s, {mass:5.2f} kg, wind {wind:.2f} m/s: {line}", flush=True)
            flown.append((k, mass, wind, is_ok))
    n, length = request.carriers[0], formation.variables.cable_length
    title = f"{n} {request.aircraft_name}, {formation.kind}, on cables of {length:.0f} m"
    make_region_figure(title, regions, flown).savefig("feasible_region.png", dpi=300)


if __name__ == "__main__":
    main()
