"""The constraints on speeds and tensions, as margins.

A margin is negative where its constraint is not fulfilled: ‖v_i‖²/ε² − 1 of a speed, and likewise
of the other constraints, each with its tightened limit.
"""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.optimization.problem_config import LimitsConfig, limit_tightening

FEASIBILITY_TOLERANCE = 1e-6  # on a margin


class ConstraintMargins:
    """The enabled constraints of the nonstop problem, and the places of their margins.

    The margins of a point are one vector: those of the `speed_count` speeds above the speed
    bound come first, then, where `max_speed` is given, those of the same speeds below it, then
    those of the tensions; the worst one of the distances between carriers, see `Separation`, is
    the last.

    Args:
        config: its limits are tightened.
        speed_count: of the speeds, at all instants and phases.
    """

    def __init__(self, config: LimitsConfig, speed_count: int):
        tightening = limit_tightening(config)
        larger, smaller = 1 + tightening, 1 - tightening
        self.max_speed = smaller * config.max_speed
        self._min_tension = larger * config.min_tension
        self._max_tension = smaller * config.max_tension
        self.min_separation = larger * config.min_separation
        self.speed_count = speed_count

    @property
    def limit_tensions(self) -> bool:
        """Whether tensions have a limit."""
        return self._min_tension > 0 or bool(np.isfinite(self._max_tension))

    @property
    def tension_factors(self) -> list[float]:
        """The slopes of the margins of tensions by their squares, for each limit of theirs."""
        factors = []
        if self._min_tension > 0:
            factors.append(1 / self._min_tension**2)
        if np.isfinite(self._max_tension):
            factors.append(-1 / self._max_tension**2)
        return factors

    @property
    def limit_high_speeds(self) -> bool:
        """Whether speeds have to stay below `max_speed`, too."""
        return bool(np.isfinite(self.max_speed))

    def of_speeds(
        self, squares: NDArray, speed_bound: NDArray | float, speed_unit: NDArray | float
    ) -> list[NDArray]:
        """The margins (k, p) of squared speeds (k, p), for each enabled limit of theirs."""
        margins = [(squares - speed_bound * speed_bound) / (speed_unit * speed_unit)]
        if self.limit_high_speeds:
            margins.append(1 - squares / self.max_speed**2)
        return margins

    def of_tensions(self, tension_squares: NDArray) -> list[NDArray]:
        """The margins (k, p) of squared tensions (k, p), for each limit of theirs."""
        margins = []
        if self._min_tension > 0:
            margins.append(tension_squares / self._min_tension**2 - 1)
        if np.isfinite(self._max_tension):
            margins.append(1 - tension_squares / self._max_tension**2)
        return margins

    def worse_of_each_speed(self, margins: NDArray) -> NDArray:
        """The worse margin (speed_count,) of each speed, which may have limits on either side."""
        count = self.speed_count
        if not self.limit_high_speeds:
            return margins[:count]
        return np.minimum(margins[:count], margins[count : 2 * count])

    def infeasibility_order(self, margins: NDArray) -> tuple[float, float]:
        """What is larger for the better one of two infeasible points, see `least_infeasible`."""
        speeds = float(margins[: self.speed_count].min())
        return min(speeds, 0.0), float(margins.min())
