"""The limits that a config asks for, tightened, as margins of what they limit.

A margin is negative where its constraint is not fulfilled: ‖v_i‖²/ε² − 1 of a speed, and likewise
of the other constraints.
"""

import copy
import math
from collections.abc import Iterable
from typing import Any

from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import Aircraft, FlightNeeds
from drake_nonstop.planning.limits import Of, asked
from drake_nonstop.planning.problem_config import limit_tightening

FEASIBILITY_TOLERANCE = 1e-6  # on a margin


class Constraints:
    """The rows of the table of limits that a config asks for, with their tightened values.

    Attributes:
        min_separation: m, 0 without such a limit.
    """

    def __init__(self, config: Any):
        tightening = limit_tightening(config)
        self._rows = {
            of: [(limit, limit.tightened(config, tightening)) for limit, _ in asked(config, of)]
            for of in Of
        }
        separations = self._rows[Of.SEPARATION]
        self.min_separation = max((value for _, value in separations), default=0.0)

    @property
    def max_speed(self) -> Any:
        """The largest speed in m/s, inf without such a limit."""
        return min((value for _, value in self._rows[Of.SPEED]), default=math.inf)

    @property
    def values(self) -> list[Any]:
        """The tightened values of all rows."""
        return [value for rows in self._rows.values() for _, value in rows]

    def with_values(self, values: Iterable[Any]) -> "Constraints":
        """The same limits of other `values`, numbers or symbols."""
        found, left = copy.copy(self), iter(values)
        found._rows = {
            of: [(limit, next(left)) for limit, _ in rows] for of, rows in self._rows.items()
        }
        return found

    def names(self, *kinds: Of) -> list[str]:
        """The name of the row that each margin of these kinds belongs to, in their order."""
        rows = [limit for of in kinds for limit, _ in self._rows[of]]
        return [limit.name for limit in rows for _ in range(limit.margin_count)]

    def of_squares(self, of: Of, squares: Any) -> list[Any]:
        """The margins of squared speeds, tensions or distances, for each limit of theirs."""
        return [limit.margin_of_squares(squares, value) for limit, value in self._rows[of]]

    def of_speeds(self, squares: Any, speed_bound: Any, speed_unit: Any) -> list[Any]:
        """The margins of squared speeds, for the bound and then for each limit of theirs."""
        margin = (squares - speed_bound * speed_bound) / (speed_unit * speed_unit)
        return [margin, *self.of_squares(Of.SPEED, squares)]

    def of_flight(self, aircraft: Aircraft, needs: FlightNeeds) -> list[NDArray]:
        """The margins (...,) of what aircraft need (...,), for each limit of theirs."""
        rows = self._rows[Of.FLIGHT]
        return [m for limit, value in rows for m in limit.margins(aircraft, needs, value)]
