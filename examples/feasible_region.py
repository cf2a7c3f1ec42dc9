"""Which wind, load and speed four aircraft can take, beside flights on both sides of the border.

For each load, speed and kind of orbit a formation is designed for the most wind. The border is
where a limit of the aircraft or of their controllers is reached, by the exact inverse of their
dynamics. Flights within it have to keep the limits; beyond it the formations that miss them by the
least are flown. The picture goes to feasible_region.png. It takes ten minutes on two cores.
"""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from drake_nonstop import compute_metrics, simulate
from drake_nonstop.run.run import RunStopped
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.design_figures import (
    AT_LIMITS,
    KEPT,
    LOST,
    RegionFlight,
    make_region_figure,
)
from drake_nonstop.studies.design_request import read_request
from drake_nonstop.studies.designed_formation import DesignedFormation
from drake_nonstop.studies.formation_search import (
    design_one,
    redesigned_region,
    redesigned_scenario,
)

REQUEST = [
    *("carriers=[4]", "cable_length=[200, 200]"),
    *("wind=[1, 0, 0]", "displacement=[-50, 0, 0]"),  # the load flies against the wind
]
KINDS = {"leaning": "Orbits that lean", "co_rotating": "Level circles, the load turns with them"}
SPEEDS = (0.0, 1.5, 3.0)  # m/s, of the load
MASSES = [2.0, 4.0, 7.0, 10.0, 15.0, 20.0]  # kg
FLOWN = (4.0, 10.0, 20.0)  # kg
LARGEST_ERROR = 1.0  # m, of a load that is not lost
FACTORS = (0.9, 1.15)  # of the border's wind, at which it is flown


def fly(scenario: Scenario) -> tuple[str, str]:
    """How a flight went, and a line about it."""
    try:
        metrics = compute_metrics(simulate(scenario))
    except RunStopped as stopped:
        return LOST, f"load error unknown: {stopped}"
    flight, load = metrics["aircraft"], metrics["load"]
    if load["position_error_max_m"] is None or flight["saturated_share"] is None:
        return LOST, f"{metrics['outcome']:9} load error unknown: lost at once"
    error = load["position_error_max_m"]
    saturated = flight["saturated_share"]
    is_lost = metrics["outcome"] != "ok" or error > LARGEST_ERROR
    outcome = LOST if is_lost else KEPT if saturated < 0.01 else AT_LIMITS
    return outcome, (
        f"{metrics['outcome']:9} load error max {error:.3f} m, C_L {flight['lift_share_max']:.2f} "
        f"of C_Lmax, saturated {saturated:.1%}"
    )


def main(duration: float | None = None, processes: int = 2) -> None:
    """Flies at each speed; with a duration (s) one of the flights, that long."""
    request = read_request(None, REQUEST)
    kinds, speeds, masses, flown = list(KINDS), SPEEDS, MASSES, FLOWN
    if duration is not None:
        kinds, speeds, masses, flown = ["co_rotating"], (0.0,), [10.0], (10.0,)
    panels, planned, scenarios = {}, [], []
    for kind in kinds:
        found = design_one(request, request.carriers[0], kind)
        formation = next(item for item in found if isinstance(item, DesignedFormation))
        regions = [redesigned_region(request, formation, masses, speed) for speed in speeds]
        panels[KINDS[kind]] = regions
        for k, region in enumerate(regions):
            for mass in flown:
                x = region.formations[masses.index(mass)]
                for factor in FACTORS if x is not None else ():
                    wind = factor * x.wind
                    planned.append((KINDS[kind], k, mass, wind))
                    scenarios.append(redesigned_scenario(request, formation, x, wind))
    if duration is not None:
        del planned[1:], scenarios[1:]
        scenarios[0].simulation_duration = duration
    flights = []
    with ProcessPoolExecutor(processes, get_context("fork")) as pool:
        for about, (outcome, line) in zip(planned, pool.map(fly, scenarios), strict=True):
            panel, k, mass, wind = about
            about_it = f"{panel}, {speeds[k]:.1f} m/s, {mass:4.1f} kg, wind {wind:.2f} m/s"
            print(f"{about_it}: {line}", flush=True)
            flights.append(RegionFlight(*about, outcome))
    figure = make_region_figure(panels, flights)
    figure.savefig("feasible_region.png", dpi=300)


if __name__ == "__main__":
    main()
