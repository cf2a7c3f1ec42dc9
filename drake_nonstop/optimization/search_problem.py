"""The nonstop problem of one update, its phases given, and searches by grids that zoom in."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

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
_INFEASIBLE_POINTS, _INFEASIBLE_GRIDS = 9, 6
_CHEAPEST_POINTS, _CHEAPEST_GRIDS = 40, 5


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

    def margins(self, amplitudes: NDArray, frequencies: NDArray) -> tuple[NDArray, NDArray]:
        """The margins of the p speeds (k, q, p), and the worst of all other constraints (k, q).

        At amplitudes (k,) and frequencies (q,); the latter is inf where there are none.
        """
        values = polynomial_values(self.polynomials[:, :, None, None], amplitudes[:, None, None])
        c, b, a, _ = speed_squares(values, rest_length=self.rest_length, compliance=self.compliance)
        s = (amplitudes[:, None] * frequencies)[:, :, None]
        squares = c + s * (2 * b + s * a)
        others = np.full(squares.shape[:2], np.inf)
        if math.isfinite(self.max_speed):
            others = 1 - squares.max(axis=2) / self.max_speed**2
        if self.amplitude_margins is not None:
            others = np.minimum(others, self.amplitude_margins(amplitudes)[:, None])
        return (squares - self.speed_bound**2) / self.speed_unit**2, others


def least_infeasible(speeds: NDArray, others: NDArray) -> int:
    """The flat index of the point to take where none is feasible, of worst margins in any shape.

    The one of the largest worst margin of the `speeds`; where some fulfil them all, that of
    the largest worst margin of the `others` among these.
    """
    is_fast = speeds >= 0
    if is_fast.any():
        return int(np.argmax(np.where(is_fast, others, -np.inf)))
    return int(np.argmax(speeds))


def least_infeasible_on_grid(problem: SearchProblem) -> NDArray:
    """The [ξ, A] (2,) within the bounds that is `least_infeasible`.

    Speeds that are the slowest nowhere on the first grid are left out of the others.
    """
    lower, upper = np.log(problem.lower), np.log(problem.upper)
    low, high = lower, upper
    best = problem.previous
    for grid in range(_INFEASIBLE_GRIDS):
        frequencies, amplitudes = np.exp(np.linspace(low, high, _INFEASIBLE_POINTS)).T
        margins, others = problem.margins(amplitudes, frequencies)
        i, j = np.unravel_index(least_infeasible(margins.min(axis=2), others), others.shape)
        best = np.array([frequencies[j], amplitudes[i]])
        step = (high - low) / (_INFEASIBLE_POINTS - 1)
        low = np.maximum(np.log(best) - step, lower)
        high = np.minimum(np.log(best) + step, upper)
        if grid == 0 and not math.isfinite(problem.max_speed):
            slowest = np.unique(margins.argmin(axis=2))
            problem = replace(problem, polynomials=problem.polynomials[:, :, slowest])
    return np.clip(best, problem.lower, problem.upper)


def cheapest_on_grid(
    problem_at: Callable[[float], SearchProblem],
    start: float,
    cost: Callable[[NDArray], float],
) -> tuple[NDArray, float]:
    """The cheapest feasible [ξ, A] (2,) of a grid, and its cost.

    The grid is laid over the bounds, then over what can still be cheaper, then it zooms in.
    Where none of its points is feasible the `least_infeasible` one is sought, and the cost is
    inf. Phases may depend on ξ: `problem_at` gives the problem of each frequency, `start` is one.
    """
    problem = problem_at(start)
    lower, upper, previous = problem.lower, problem.upper, problem.previous
    axes = np.geomspace(lower, upper, _CHEAPEST_POINTS).T
    best, best_cost = previous, math.inf
    for grid in range(_CHEAPEST_GRIDS):
        frequencies, amplitudes = axes.clip(lower[:, None], upper[:, None])
        rows = [problem_at(f).margins(amplitudes, np.array([f])) for f in frequencies]
        speeds = np.array([margins.min(axis=2)[:, 0] for margins, _ in rows])
        others = np.array([worst[:, 0] for _, worst in rows])
        feasible = np.argwhere((speeds >= 0) & (others >= 0))
        for i, j in feasible:
            x = np.array([frequencies[i], amplitudes[j]])
            x_cost = cost(x)
            if x_cost < best_cost:
                best, best_cost = x, x_cost
        if best_cost == math.inf:
            i, j = np.unravel_index(least_infeasible(speeds, others), speeds.shape)
            best = np.array([frequencies[i], amplitudes[j]])
        if grid == 0 and best_cost < math.inf:
            # The change of ξ and of A costs at least its square.
            around, size = previous, np.full(2, math.sqrt(best_cost))
        else:
            around, size = best, np.max(np.diff(axes), axis=1)
        axes = np.linspace(around - size, around + size, _CHEAPEST_POINTS).T
    return best, best_cost
