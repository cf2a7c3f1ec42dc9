"""What the shipped flights of fixed-wing aircraft keep: wind, gusts, errors of the model.

One line per flight; of the gusty ones a line per seed. All of them, 20 seeds at 100 and at 25 Hz,
take half an hour on two cores.
"""

import math
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from drake_nonstop import compute_metrics, load_scenario, simulate

WIND = "wind.velocity=[{}, 0, 0]"
ERRORS = [  # of the simulated aircraft: lift -10, mass +5, drag +30, thrust -20 %
    "simulated.aircraft.lift_gain=0.9",
    "simulated.aircraft.mass=6.3",
    "simulated.aircraft.zero_lift_drag=0.0351",
    "simulated.aircraft.induced_drag=0.0715",
    "simulated.aircraft.thrust_gain=0.8",
]
FLIGHTS = {
    "at rest": ("aircraft_rest", []),
    "transfer": ("aircraft_transfer", []),
    "at rest, wind of 2 m/s": ("aircraft_rest", ["wind=SteadyWind", WIND.format(2)]),
    "at rest, 2 m/s, errors": ("aircraft_rest", ["wind=SteadyWind", WIND.format(2), *ERRORS]),
    "co-rotating, 5 m/s": ("aircraft_co_rotating", []),
    "co-rotating, 3 m/s, errors": ("aircraft_co_rotating", [WIND.format(3), *ERRORS]),
    "three aircraft": ("aircraft_three", []),
    "six aircraft": ("aircraft_six", []),
    "small aircraft": ("aircraft_small", []),
}
GUSTY = {
    "transfer, gusts": "aircraft_transfer_gusty",
    "co-rotating, gusts": "aircraft_co_rotating_gusty",
}


def flights(runs: int) -> Iterator[tuple[str, str, list[str]]]:
    """Their names, scenarios and changes, with this number of seeds."""
    for period in (0.04, 0.01):
        rate = f"control_period={period}"
        for name, (scenario, changes) in FLIGHTS.items():
            yield f"{1 / period:3.0f} Hz {name}", scenario, [rate, *changes]
        for seed in range(runs):
            for name, scenario in GUSTY.items():
                yield f"{1 / period:3.0f} Hz {name} {seed}", scenario, [rate, f"wind.seed={seed}"]


def fly(name: str, scenario_name: str, changes: list[str]) -> str:
    """Flies one, and returns its line."""
    metrics = compute_metrics(simulate(load_scenario(scenario_name, changes)))
    load, flight = metrics["load"], metrics["aircraft"]
    return (
        f"{name:34} {metrics['outcome']:7} load error mean {load['position_error_mean_m']:.4f} "
        f"max {load['position_error_max_m']:.4f} m, "
        f"C_L {flight['lift_share_max']:.2f} of C_Lmax, "
        f"V {flight['airspeed_over_stall_min']:.2f} V_s, "
        f"bank {math.degrees(flight['bank_max_rad']):.0f} deg, "
        f"T {flight['thrust_min_N']:.1f} to {flight['thrust_max_N']:.1f} N, "
        f"{metrics['carriers']['separation_min_m']:.1f} m apart, "
        f"tension from {metrics['cables']['tension_min_N']:.1f} N, "
        f"saturated {flight['saturated_share']:.1%}"
    )


def main(duration: float | None = None, runs: int = 20) -> None:
    """Flies all with this number of seeds; with a duration (s) only the first, and that long."""
    planned = list(flights(runs))
    if duration is not None:
        planned = [
            (name, scenario, [*changes, f"simulation_duration={duration}"])
            for name, scenario, changes in planned[:1]
        ]
    with ProcessPoolExecutor(2, get_context("fork")) as pool:
        for line in pool.map(fly, *zip(*planned, strict=True)):
            print(line, flush=True)


if __name__ == "__main__":
    main()
