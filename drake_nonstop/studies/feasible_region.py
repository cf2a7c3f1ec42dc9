"""Which wind, load and speed formations can take that are designed again for each."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.optimization.formation_program import FormationVariables
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.studies.design_request import DesignRequest
from drake_nonstop.studies.designed_formation import DesignedFormation, formation_scenario
from drake_nonstop.studies.formation_flight import flight_of
from drake_nonstop.studies.formation_search import FormationSearch, variables_of

_STRONGEST = 20.0  # m/s, of the winds that are tried
_TOLERANCE = 0.05  # of the reserve, at a border
_MASS, _WIND, _RESERVE = map(FormationVariables._fields.index, ("mass", "wind", "reserve"))


@dataclass(frozen=True, kw_only=True, eq=False)
class FeasibleRegion:
    """The largest wind in which formations fly, over the load's mass.

    Attributes:
        speed: m/s, the largest of the load on its way.
        masses: (k,), kg.
        winds: (k,), m/s; nan where none was found.
        limits: (k,), the limit that is missed first in more wind.
        formations: (k,) that fly in these winds; None where none was found.
    """

    speed: float
    masses: NDArray
    winds: NDArray
    limits: tuple[str, ...]
    formations: tuple[FormationVariables | None, ...]


class _Redesign:
    """Formations like a given one for other loads and winds, at a speed."""

    def __init__(self, request: DesignRequest, formation: DesignedFormation, speed: float):
        moved = dataclasses.replace(request, speed=speed)
        shape = formation.carriers, formation.kind, formation.phase_turns
        self.search = FormationSearch(moved, *shape)
        self.program = self.search.program()

    def solved(self, start: NDArray, aim: int, **bounds: tuple[float, float]) -> NDArray:
        """The formation of the largest variable of a number, for the load of the start."""
        lower, upper = self.search.lower.copy(), self.search.upper.copy()
        lower[_MASS] = upper[_MASS] = start[_MASS]
        for name, (least, most) in bounds.items():
            index = FormationVariables._fields.index(name)
            lower[index], upper[index] = least, most
        values = self.program.solve(start, lower, upper, -np.eye(len(start))[aim])
        return self.search.with_true_reserve(self.program, values)

    def in_wind(self, start: NDArray, wind: float) -> NDArray:
        """The formation of the largest reserve in a wind."""
        return self.solved(start, _RESERVE, wind=(wind, wind))

    def in_most_wind(self, start: NDArray) -> NDArray | None:
        """The formation that keeps its limits in the most wind."""
        for share in (1.0, 0.7, 0.3, 0.0):
            found = start if share == 1 else self.in_wind(start, share * start[_WIND])
            least = 0.0
            for _ in range(3):  # between the instants of the program the reserve is less
                found = self.solved(found, _WIND, wind=(0.0, _STRONGEST), reserve=(least, least))
                if abs(found[_RESERVE]) < _TOLERANCE:
                    return found
                least -= found[_RESERVE]
        return None


def redesigned_region(
    request: DesignRequest, formation: DesignedFormation, masses: Sequence[float], speed: float
) -> FeasibleRegion:
    """The border of what aircraft can take in a formation that is designed for each load and wind.

    The forces, ξ and, in the request's range, the cables are those that keep the limits in the most
    wind, at rest and on the way; found from mass to mass, from that of the request on. Beyond the
    border a limit of the aircraft or of their controllers is missed: of lift, airspeed, bank, climb
    or thrust. The wind has the direction of the request's, or is against the load's way.

    Args:
        request: what the formation was designed for, whose kind, n and κ they have.
        formation: found for it.
        masses: of the load, kg, in rising order.
        speed: of the load, m/s.
    """
    redesign = _Redesign(request, formation, speed)
    found: dict[float, FormationVariables] = {}
    heavier = [mass for mass in masses if mass >= request.load_mass]
    lighter = [mass for mass in reversed(masses) if mass < request.load_mass]
    for one_way in (heavier, lighter):
        start = formation.variables
        for mass in one_way:
            values = redesign.in_most_wind(np.array(start._replace(mass=mass, speed=speed)))
            if values is not None:
                found[mass] = start = variables_of(values)
    rows = [found.get(mass) for mass in masses]
    return FeasibleRegion(
        speed=speed,
        masses=np.array(masses),
        winds=np.array([np.nan if x is None else x.wind for x in rows]),
        limits=tuple("" if x is None else redesign.program.closest_row(np.array(x)) for x in rows),
        formations=tuple(rows),
    )


def redesigned_scenario(
    request: DesignRequest, formation: DesignedFormation, beside: FormationVariables, wind: float
) -> Scenario:
    """The scenario of the formation that keeps the most margin in a wind, m/s.

    The load and its speed are those of `beside`, such as a formation of a `FeasibleRegion`.
    """
    redesign = _Redesign(request, formation, beside.speed)
    x = variables_of(redesign.in_wind(np.array(beside), wind))
    asked = dataclasses.replace(
        request,
        load_mass=x.mass,
        speed=x.speed,
        wind=(wind * redesign.search.task.wind).tolist(),
    )
    flight = flight_of(redesign.search.way, formation.kind, x)
    shape = formation.kind, formation.carriers, formation.phase_turns
    scenario = formation_scenario(asked, *shape, x, flight)
    scenario.carrier_controller = formation.scenario.carrier_controller
    # Beyond the border the least airspeed is no news.
    scenario.optimization_layer.speed_bound = 0.0
    return scenario
