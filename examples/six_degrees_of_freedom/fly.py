"""The shipped flights of aircraft as point masses and with six degrees of freedom, side by side.

Each flight has a line per plant: what the aircraft need, as the mean over the last turn, and the
load's error, as the mean after the first turn. `pip install jsbsim`; see `jsbsim_carriers.py`.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jsbsim_carriers import JsbsimCarriers

from drake_nonstop import Run, load_scenario, simulate
from drake_nonstop.mechanics.aircraft import drawn_power
from drake_nonstop.mechanics.signals import AircraftState
from drake_nonstop.model.system import aircraft_in
from drake_nonstop.run.run_quantities import load_errors

# Still air; the way of the third is 50 m long.
FLIGHTS = {
    "rest": ("aircraft_rest", ["simulation_duration=120"]),
    "co-rotating": (
        "aircraft_co_rotating",
        ["simulation_duration=120", "wind.velocity=[0, 0, 0]"],
    ),
    "50 m": (
        "aircraft_transfer",
        [
            *("load_trajectory.displacement=[50, 0, 0]", "load_trajectory.move_time=40"),
            "simulation_duration=55",
        ],
    ),
}
PLANTS = {"point masses": {}, "JSBSim": {"carrier_dynamics": JsbsimCarriers}}


class Flown(NamedTuple):
    """Means of a flight."""

    lift: float  # C_L
    bank: float  # rad
    thrust: float  # N
    power: float  # W, that an aircraft draws
    error: float  # m, of the load's position
    largest_error: float  # m


def measured(run: Run) -> Flown:
    """What a flight needed over its last turn, and the error of its load after the first one."""
    frequency = run.signal("parameters")[-1, 0]
    turn = min(2 * np.pi / frequency, run.time[-1] / 2)
    last = run.time > run.time[-1] - turn
    state = AircraftState.view(run.signal("aircraft_state")[last])
    power = drawn_power(aircraft_in(run.scenario.system), state.thrust, state.airspeed)
    errors = np.linalg.norm(load_errors(run)[0], axis=1)[run.time > turn]
    needs = (state.lift, np.abs(state.bank), state.thrust, power)
    return Flown(*(float(np.mean(need)) for need in needs), errors.mean(), errors.max())


def flights(duration: float | None = None) -> Iterator[tuple[str, str, Flown]]:
    """Each flight with each plant; with a duration, that many s of it."""
    for name, (scenario, changes) in FLIGHTS.items():
        shorter = [] if duration is None else [f"simulation_duration={duration}"]
        for plant, blocks in PLANTS.items():
            run = simulate(load_scenario(scenario, [*changes, *shorter]), **blocks)
            yield name, plant, measured(run)


def main(duration: float | None = None) -> None:
    """Flies all of them: five minutes, most of it with JSBSim."""
    columns = f"{'C_L':>6} {'bank':>7} {'thrust':>7} {'drawn':>7}   load error"
    print(f"{'flight':12} {'plant':18} {columns}")
    for name, plant, flown in flights(duration):
        print(
            f"{name:12} {plant:18} {flown.lift:6.3f} {np.degrees(flown.bank):5.1f} ° "
            f"{flown.thrust:5.2f} N {flown.power:5.0f} W   mean {1e3 * flown.error:.1f} mm, "
            f"largest {1e3 * flown.largest_error:.0f} mm",
            flush=True,
        )


if __name__ == "__main__":
    main()
