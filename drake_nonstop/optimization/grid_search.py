"""Searches over ξ and A by grids that zoom in on their best point."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.optimization.search_problem import SearchProblem, least_infeasible

# Points a side of a grid, and how often one is laid, each within the one before.
_INFEASIBLE_POINTS, _INFEASIBLE_GRIDS = 9, 6
_CHEAPEST_POINTS, _CHEAPEST_GRIDS = 40, 5


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
