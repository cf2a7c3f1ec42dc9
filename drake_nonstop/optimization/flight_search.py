"""A search for ξ and A within the limits of aircraft, by exact gradients.

What aircraft need is no polynomial in ξ, so that no interval of it is known to be forbidden. The
search follows the gradients: successive projections onto the linearized margins, from the last ξ
and A on. Where these do not end at a feasible point it begins anew at the best point of a grid
over the bounds.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.nonstop import QuadraticChangeCost
from drake_nonstop.optimization.constraints import FEASIBILITY_TOLERANCE
from drake_nonstop.optimization.search_problem import best_on_grid
from drake_nonstop.optimization.update_problem import UpdateProblem

_MOST_STEPS, _FEW_STEPS = 12, 3
_MOST_REFUSALS = 2  # of steps from a point that is not feasible
_FIRST_RADIUS = 0.2  # relative to ξ and A, of the first step
_SHORTEST = 1e-5  # relative, a step that ends the search
_GRID = (12, 1)  # points a side, grids
_FAR = 0.1  # relative, a step of which something closer may lie elsewhere
_HALVINGS = 6  # of the range of what linearized margins may lack
_MOST_EXCHANGES = 60
_ROUNDING = 1e-12
_SPEED_WEIGHT = 10.0  # of what a margin of the speed bound lacks, beside the others


def nearest_within_limits(problem: UpdateProblem) -> tuple[NDArray, float]:
    """The [ξ, A] (2,) of the least cost that keeps all margins, and its cost.

    Where none is found the least infeasible one that was met, and inf.
    """
    previous = problem.previous
    found = _descend(problem, previous)
    lower, upper = problem.known_bounds
    size = np.max(np.abs(found.x / previous - 1))
    if _are_narrow(lower, upper) or (found.is_feasible and size < _FAR):
        return found.x, problem.cost(found.x) if found.is_feasible else math.inf
    best, _ = best_on_grid(
        problem.margins_on_grid, lower, upper, _GRID, cost=problem.cost, previous=previous
    )
    other = _descend(problem, best)
    points = sorted((found, other), key=lambda point: _order(problem, point))
    return points[-1].x, problem.cost(points[-1].x) if points[-1].is_feasible else math.inf


def _are_narrow(lower: NDArray, upper: NDArray) -> bool:
    """Whether the bounds are so close to each other that a grid finds nothing else."""
    return bool(np.all(upper < (1 + _FAR) * lower))


class _Point(NamedTuple):
    x: NDArray  # (2,)
    margins: NDArray
    weights: NDArray  # (r,), of what the margins lack

    @property
    def violation(self) -> float:
        return max(0.0, -float((self.margins * self.weights).min()))

    @property
    def is_feasible(self) -> bool:
        return bool(self.margins.min() >= -FEASIBILITY_TOLERANCE)


def _order(problem: UpdateProblem, point: _Point) -> tuple[float, ...]:
    """Score of a point, larger for the better one of two."""
    if point.is_feasible:
        return 1.0, -problem.cost(point.x)
    return 0.0, *problem.infeasibility_order(point.margins)


def _at(problem: UpdateProblem, x: NDArray) -> _Point:
    margins = problem.margins_but_separation(x)
    weights = np.ones(len(margins))
    weights[: problem.speed_count] = _SPEED_WEIGHT
    return _Point(x, margins, weights)


def _descend(problem: UpdateProblem, start: NDArray) -> _Point:
    """The last point of the steps from `start` on."""
    lower, upper = problem.known_bounds
    cost = problem.search_problem.change_cost()
    point, radius = _at(problem, np.clip(start, lower, upper)), _FIRST_RADIUS
    refusals, jacobian = 0, None
    # Within bounds this narrow the margins are as good as linear.
    for _ in range(_FEW_STEPS if _are_narrow(lower, upper) else _MOST_STEPS):
        reach = radius * point.x
        low, high = np.maximum(lower, point.x - reach), np.minimum(upper, point.x + reach)
        if jacobian is None:
            _, jacobian = problem.margins_and_jacobian(point.x)
        target = _step(cost, point, jacobian, low, high)
        length = np.max(np.abs(target - point.x) / point.x)
        if length <= _SHORTEST:
            break
        new = _at(problem, target)
        if new.violation <= max(FEASIBILITY_TOLERANCE, 0.9 * point.violation):
            was_short = length <= _SHORTEST**0.5 and new.is_feasible
            point, jacobian, radius = new, None, min(2 * radius, 1.0)
            if was_short:
                break  # what is left is of the second order in it
        else:
            radius, refusals = 0.3 * min(radius, length), refusals + 1
            if refusals >= _MOST_REFUSALS and not point.is_feasible:
                break
    return point


def _step(
    cost: QuadraticChangeCost, point: _Point, jacobian: NDArray, low: NDArray, high: NDArray
) -> NDArray:
    """The cheapest [ξ, A] (2,) within bounds that the linearized margins allow.

    Where there is none, one that lacks the least.
    """
    hessian, gradient = _quadratic(cost, point.x)
    root = np.linalg.cholesky(hessian)
    best = -np.linalg.solve(root.T, np.linalg.solve(root, gradient))
    shift = point.x
    rows = np.vstack([jacobian, np.eye(2), -np.eye(2)])
    offsets = np.concatenate([-point.margins, low - shift, shift - high])
    weights = np.concatenate([1 / point.weights, np.zeros(4)])  # bounds have no slack
    # In coordinates of which the cost is the squared distance, z = Rᵀ δ.
    normals = np.linalg.solve(root, rows.T).T
    sizes = np.linalg.norm(normals, axis=1) + _ROUNDING
    normals, offsets, weights = normals / sizes[:, None], offsets / sizes, weights / sizes
    goal = root.T @ best

    found = nearest_in_polygon(goal, normals, offsets)
    if found is None:
        least, most = 0.0, point.violation + _ROUNDING
        found = nearest_in_polygon(goal, normals, offsets - most * weights)
        for _ in range(_HALVINGS):
            middle = (least + most) / 2
            other = nearest_in_polygon(goal, normals, offsets - middle * weights)
            if other is None:
                least = middle
            else:
                most, found = middle, other
    if found is None:
        return point.x
    return np.clip(shift + np.linalg.solve(root.T, found), low, high)


def _quadratic(cost: QuadraticChangeCost, x: NDArray) -> tuple[NDArray, NDArray]:
    """The Hessian and the gradient at x of the cost with s = A ξ linearized."""
    frequency, amplitude = x
    by_s = np.array([amplitude, frequency])
    hessian = np.diag([1 + cost.anchor_weight, cost.amplitude_weight + cost.anchor_weight])
    hessian = hessian + cost.rate_weight * np.outer(by_s, by_s)
    before = np.array([cost.frequency, cost.amplitude])
    nominal = np.array([cost.nominal_frequency, cost.nominal_amplitude])
    gradient = np.array([1.0, cost.amplitude_weight]) * (x - before)
    gradient = gradient + cost.anchor_weight * (x - nominal)
    change = frequency * amplitude - cost.frequency * cost.amplitude
    return hessian, gradient + cost.rate_weight * change * by_s


def nearest_in_polygon(point: NDArray, normals: NDArray, offsets: NDArray) -> NDArray | None:
    """The point (2,) of {z: N z ≥ c} that is closest to another one; None: there is none.

    By exchanges of at most two active constraints: what is violated most becomes active, so that
    the distance grows with each. The rows of N (r, 2) have the norm 1.
    """
    active: list[int] = []
    z = point
    for _ in range(_MOST_EXCHANGES):
        slack = normals @ z - offsets
        worst = int(slack.argmin())
        if slack[worst] >= -_ROUNDING * (1 + abs(offsets[worst])):
            return z
        if worst in active:
            return z  # by rounding
        closest, best = math.inf, None
        for others in ([], *([i] for i in active)):
            chosen = [worst, *others]
            candidate = _on_lines(point, normals[chosen], offsets[chosen])
            if candidate is None:
                continue
            trial = [*active, worst]
            least = (normals[trial] @ candidate - offsets[trial]).min()
            distance = float(((candidate - point) ** 2).sum())
            if least >= -1e-9 * (1 + math.sqrt(distance)) and distance < closest:
                closest, best = distance, (candidate, chosen)
        if best is None:
            return None
        z, active = best
    return None


def _on_lines(point: NDArray, normals: NDArray, offsets: NDArray) -> NDArray | None:
    """The closest point of one line, or where two meet; None: they are parallel."""
    if len(normals) == 1:
        return point + (offsets[0] - normals[0] @ point) * normals[0]
    (a, b), (c, d) = normals.tolist()
    determinant = a * d - b * c
    if abs(determinant) < _ROUNDING:
        return None
    p, q = offsets.tolist()
    return np.array([d * p - b * q, a * q - c * p]) / determinant
