"""The nonstop problem of one update, its phases given, and searches by grids that zoom in."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.nonstop import (
    QuadraticChangeCost,
    polynomial_values,
    quadratic_change_cost,
    speed_squares,
)
from drake_nonstop.optimization.amplitude_intervals import allowed_intervals

# Points a side of a grid, and how often one is laid, each within the one before.
FEW, MANY = (9, 6), (40, 5)


@dataclass(frozen=True)
class SearchProblem:
    """The problem of one update, its phases given.

    `polynomials` (10, 3, p) make the squared speeds, see `mechanics.nonstop.speed_squares`;
    `amplitude_margins` gives the worst margin (k,) of amplitudes (k,) in the constraints
    that do not depend on ξ, None where there are none. `angles` (m,) are θ + φ_k, in rad;
    `previous` is [ξ⁻, A⁻] and `nominal` what `anchor_weight` pulls [ξ, A] to; `lower` and
    `upper` bound [ξ, A]; speeds have to stay within `speed_bound` and `max_speed`, in m/s, and
    `speed_unit` scales the margins of the former.
    """

    polynomials: NDArray
    rest_length: float
    compliance: float
    amplitude_margins: Callable[[NDArray], NDArray] | None
    angles: NDArray
    previous: NDArray
    nominal: NDArray
    lower: NDArray
    upper: NDArray
    speed_bound: float
    speed_unit: float
    max_speed: float
    internal_force_weight: float
    internal_force_rate_weight: float
    anchor_weight: float

    def change_cost(self) -> QuadraticChangeCost:
        """The cost of the step from `previous`, by ξ, A and s = A ξ."""
        return quadratic_change_cost(
            self.previous,
            self.angles,
            internal_force_weight=self.internal_force_weight,
            internal_force_rate_weight=self.internal_force_rate_weight,
            anchor_weight=self.anchor_weight,
            nominal=self.nominal,
        )

    def allowed_intervals(self) -> list[tuple[float, float]]:
        """The intervals of A (N) that the constraints that do not depend on ξ allow."""
        low, high = float(self.lower[1]), float(self.upper[1])
        if self.amplitude_margins is None:
            return [(low, high)]
        return allowed_intervals(self.amplitude_margins, low, high, float(self.previous[1]))

    def squares(self, amplitudes: NDArray, frequencies: NDArray) -> NDArray:
        """The p squared speeds (k, q, p), m²/s², at amplitudes (k,) and frequencies (q,)."""
        values = polynomial_values(self.polynomials[:, :, None, None], amplitudes[:, None, None])
        c, b, a, _ = speed_squares(values, rest_length=self.rest_length, compliance=self.compliance)
        s = (amplitudes[:, None] * frequencies)[:, :, None]
        return c + s * (2 * b + s * a)

    def speed_margins(self, x: NDArray) -> NDArray:
        """The worse margin (p,) of each speed at [ξ, A] (2,): it may have limits on either side."""
        squares = self.squares(x[1:], x[:1])[0, 0]
        margins = (squares - self.speed_bound**2) / self.speed_unit**2
        if math.isfinite(self.max_speed):
            margins = np.minimum(margins, 1 - squares / self.max_speed**2)
        return margins

    def margins(self, amplitudes: NDArray, frequencies: NDArray) -> tuple[NDArray, NDArray]:
        """The worst margin of the speeds (k, q), and that of all other constraints (k, q).

        At amplitudes (k,) and frequencies (q,); the latter is inf where there are none.
        """
        squares = self.squares(amplitudes, frequencies)
        others = np.full(squares.shape[:2], np.inf)
        if math.isfinite(self.max_speed):
            others = 1 - squares.max(axis=2) / self.max_speed**2
        if self.amplitude_margins is not None:
            others = np.minimum(others, self.amplitude_margins(amplitudes)[:, None])
        return (squares.min(axis=2) - self.speed_bound**2) / self.speed_unit**2, others


def least_infeasible(speeds: NDArray, others: NDArray) -> int:
    """The flat index of the point to take where none is feasible, of worst margins in any shape.

    The one of the largest worst margin of the `speeds`; where some fulfil them all, that of
    the largest worst margin of the `others` among these.
    """
    is_fast = speeds >= 0
    if is_fast.any():
        return int(np.argmax(np.where(is_fast, others, -np.inf)))
    return int(np.argmax(speeds))


def best_on_grid(
    margins: Callable[[NDArray, NDArray], tuple[NDArray, NDArray]],
    lower: NDArray,
    upper: NDArray,
    size: tuple[int, int],
    *,
    cost: Callable[[NDArray], float] | None = None,
    previous: NDArray | None = None,
) -> tuple[NDArray, float]:
    """The cheapest feasible [ξ, A] (2,) of grids that zoom in, and its cost.

    Where no point is feasible, or there is no cost, the `least_infeasible` one, and inf. The first
    grid is laid over the bounds, the next one over what can still be cheaper.

    Args:
        margins: as of `SearchProblem.margins`.
        lower: the bounds (2,) of [ξ, A].
        upper: likewise.
        size: points a side of a grid, and how many grids.
        cost: of [ξ, A] (2,), at least the squared change of each from `previous`.
        previous: [ξ⁻, A⁻] (2,).
    """
    points, grids = size
    low, high = np.log([lower, upper])
    best, best_cost = lower, math.inf
    for grid in range(grids):
        axes = np.exp(np.linspace(low, high, points)).clip(lower, upper)
        frequencies, amplitudes = axes.T
        speeds, others = margins(amplitudes, frequencies)
        if cost is not None:
            for i, j in np.argwhere((speeds >= 0) & (others >= 0)):
                x = np.array([frequencies[j], amplitudes[i]])
                x_cost = cost(x)
                if x_cost < best_cost:
                    best, best_cost = x, x_cost
        if best_cost == math.inf:
            i, j = np.unravel_index(least_infeasible(speeds, others), speeds.shape)
            best = np.array([frequencies[j], amplitudes[i]])
        step = (high - low) / (points - 1)
        low, high = np.log(best) - step, np.log(best) + step
        if grid == 0 and best_cost < math.inf:
            assert previous is not None
            reach = math.sqrt(best_cost)
            low = np.log(np.maximum(previous - reach, lower))
            high = np.log(previous + reach)
        low, high = np.maximum(low, np.log(lower)), np.minimum(high, np.log(upper))
    return best, best_cost
