"""Which wind, load and speed a formation can take."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.scenario.overrides import as_override, changed
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.design import (
    PEAK,
    DesignedFormation,
    design_task,
    flight_of,
    missed_limits,
    with_load,
)
from drake_nonstop.studies.design_request import DesignRequest

_STRONGEST = 20.0  # m/s, of the winds that are tried
_STEPS = 12  # halvings


@dataclass(frozen=True, kw_only=True, eq=False)
class FeasibleRegion:
    """The largest wind in which a formation flies, over the load's mass.

    Attributes:
        speed: m/s, the largest of the load on its way.
        masses: (k,), kg.
        winds: (k,), m/s; nan where the formation flies in none.
        limits: (k,), the limit that is missed first in more wind.
    """

    speed: float
    masses: NDArray
    winds: NDArray
    limits: tuple[str, ...]


def feasible_region(
    request: DesignRequest, formation: DesignedFormation, masses: Sequence[float], speed: float
) -> FeasibleRegion:
    """The border of what a formation can take: its forces in N, ξ and cables stay as they are.

    Beyond it a limit of the aircraft or of their controllers is missed, at rest or on the way: of
    lift, airspeed, bank, climb or thrust. The wind has the direction of the request's, or of the
    load's way.

    Args:
        request: what the formation was designed for.
        formation: the formation.
        masses: of the load, kg.
        speed: of the load, m/s.
    """
    moved = dataclasses.replace(request, speed=speed)
    task = design_task(moved, formation.carriers)

    def missed(mass: float, wind: float) -> list[str]:
        x = with_load(formation.variables, mass)._replace(wind=wind, speed=speed)
        return [each.name for each in missed_limits(task, flight_of(task, formation.kind, x))]

    winds, limits = [], []
    for mass in masses:
        found = missed(mass, 0.0)
        low, high = 0.0, _STRONGEST
        if found:
            winds.append(np.nan)
            limits.append(found[0])
            continue
        found = missed(mass, high)
        for _ in range(_STEPS):
            middle = (low + high) / 2
            beyond = missed(mass, middle)
            if beyond:
                high, found = middle, beyond
            else:
                low = middle
        winds.append(low)
        limits.append(found[0] if found else "")
    return FeasibleRegion(
        speed=speed, masses=np.array(masses), winds=np.array(winds), limits=tuple(limits)
    )


def region_scenario(
    request: DesignRequest, formation: DesignedFormation, mass: float, wind: float, speed: float
) -> Scenario:
    """The formation's scenario with another load (kg), wind and speed (m/s)."""
    ratio = mass / request.load_mass
    inertia = (ratio * np.array(request.inertia)).tolist()
    velocity = wind * design_task(request, formation.carriers).wind
    changes = [
        as_override("system.load_mass", mass),
        as_override("system.load_inertia", inertia),
        as_override("wind", {"_tag": "!SteadyWind", "velocity": velocity.tolist()}),
        "optimization_layer.speed_bound=0.0",
    ]
    if speed > 0:
        move_time = PEAK * float(np.linalg.norm(request.displacement)) / speed
        changes.append(as_override("load_trajectory.move_time", move_time))
        changes.append(as_override("load_trajectory.displacement", request.displacement))
        changes.append(as_override("simulation_duration", move_time + 15.0))
    else:
        changes.append("load_trajectory.displacement=[0.0, 0.0, 0.0]")
        changes.append("simulation_duration=40.0")
    return changed(formation.scenario, changes)
