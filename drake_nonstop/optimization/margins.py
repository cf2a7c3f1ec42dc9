"""The constraints on speeds and tensions, as margins.

A margin is negative where its constraint is not fulfilled: ‖v_i‖²/ε² − 1 of a speed, and likewise
of the other constraints, each with its tightened limit.
"""

import math

from numpy.typing import NDArray

from drake_nonstop.optimization.diagnostics import BOUND
from drake_nonstop.optimization.limits import Of, asked
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
        rows = [(limit, limit.tightened(config, tightening)) for limit, _ in asked(config)]
        self._speeds, self._tensions, self._separations = (
            [row for row in rows if row[0].of is of] for of in (Of.SPEED, Of.TENSION, Of.SEPARATION)
        )
        self.max_speed = min((value for _, value in self._speeds), default=math.inf)
        self.min_separation = max((value for _, value in self._separations), default=0.0)
        self.speed_count = speed_count

    @property
    def limit_tensions(self) -> bool:
        """Whether tensions have a limit."""
        return bool(self._tensions)

    @property
    def speed_factors(self) -> list[float]:
        """The slopes of the margins of speeds by their squares, for each limit but the bound."""
        return [limit.slope_of_squares(value) for limit, value in self._speeds]

    @property
    def tension_factors(self) -> list[float]:
        """The slopes of the margins of tensions by their squares, for each limit of theirs."""
        return [limit.slope_of_squares(value) for limit, value in self._tensions]

    @property
    def kinds(self) -> list[str]:
        """The names of the limits of `of_speeds`, the bound first, then of `of_tensions`."""
        return [BOUND, *(limit.name for limit, _ in self._speeds + self._tensions)]

    @property
    def separation_kinds(self) -> list[str]:
        """The names of the limits of separations."""
        return [limit.name for limit, _ in self._separations]

    @property
    def limit_high_speeds(self) -> bool:
        """Whether speeds have a limit besides the bound."""
        return bool(self._speeds)

    def of_speeds(
        self, squares: NDArray, speed_bound: NDArray | float, speed_unit: NDArray | float
    ) -> list[NDArray]:
        """The margins (k, p) of squared speeds (k, p), for each enabled limit of theirs."""
        margins = [(squares - speed_bound * speed_bound) / (speed_unit * speed_unit)]
        return margins + [row.margin_of_squares(squares, value) for row, value in self._speeds]

    def of_tensions(self, tension_squares: NDArray) -> list[NDArray]:
        """The margins (k, p) of squared tensions (k, p), for each limit of theirs."""
        return [row.margin_of_squares(tension_squares, value) for row, value in self._tensions]

    def worse_of_each_speed(self, margins: NDArray) -> NDArray:
        """The worse margin (speed_count,) of each speed, which may have limits on either side."""
        count = self.speed_count
        limits = 1 + len(self._speeds)
        return margins[: limits * count].reshape(limits, count).min(axis=0)

    def infeasibility_order(self, margins: NDArray) -> tuple[float, float]:
        """What is larger for the better one of two infeasible points, see `least_infeasible`."""
        speeds = float(margins[: self.speed_count].min())
        return min(speeds, 0.0), float(margins.min())
