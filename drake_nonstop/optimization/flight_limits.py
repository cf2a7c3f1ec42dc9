"""The limits of aircraft on the orbits that a layer predicts, as margins."""

from typing import Any

from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import Aircraft, FlightNeeds
from drake_nonstop.optimization.limits import Of, asked
from drake_nonstop.optimization.problem_config import limit_tightening


class FlightLimits:
    """The rows of the table of limits that aircraft are asked to keep.

    Args:
        config: with the fields of these rows; its limits are tightened.

    Attributes:
        kinds: the name of the row that each array of margins belongs to, in their order.
    """

    def __init__(self, config: Any):
        tightening = limit_tightening(config)
        self._rows = [
            (limit, limit.tightened(config, tightening)) for limit, _ in asked(config, Of.FLIGHT)
        ]
        self.kinds = [limit.name for limit, _ in self._rows for _ in range(limit.margin_count)]

    def margins(self, aircraft: Aircraft, needs: FlightNeeds) -> list[NDArray]:
        """The margins (...,) of needs (...,), of numbers or symbols, for each of `kinds`."""
        return [m for limit, value in self._rows for m in limit.margins(aircraft, needs, value)]
