"""A global search for ξ and A that keep every carrier at or above the speed bound."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_COARSE, _FINE = 40, 16  # amplitudes looked at in a wide and in a narrow interval
_ZOOMS = 3
_SAME = 1e-9  # relative, what counts as the end of a forbidden interval


@dataclass(frozen=True)
class Quadratics:
    """‖v‖² = c + 2 b s + a s² over s = A ξ, for k amplitudes and p constraints, (k, p) each."""

    c: NDArray
    b: NDArray
    a: NDArray

    def at(self, s: NDArray) -> NDArray:
        """The squared speeds (k, q, p) at s (k, q)."""
        s = s[:, :, None]
        return self.c[:, None] + s * (2 * self.b[:, None] + s * self.a[:, None])


@dataclass(frozen=True)
class SearchProblem:
    """The problem of one update with the phase at each instant held fixed.

    `quadratics` gives the speeds of amplitudes (k,); `angles` are θ + φ_k (m,); `previous`
    is [ξ⁻, A⁻] (2,), `lower` and `upper` bound [ξ, A] (2,), and `bound` is ε.
    """

    quadratics: Callable[[NDArray], Quadratics]
    angles: NDArray
    previous: NDArray
    lower: NDArray
    upper: NDArray
    bound: float
    internal_force_weight: float
    internal_force_rate_weight: float


def nearest_feasible(problem: SearchProblem, cheaper_than: float = np.inf) -> tuple[NDArray, float]:
    """The feasible [ξ, A] of the least cost (eq. 26), and that cost; inf if there is none.

    Points that cost more than `cheaper_than` may be left out.

    With A fixed, each constraint forbids one interval of s = A ξ, and the cost is a
    quadratic in s: the best s is the quadratic's minimum or the end of an interval. Only A
    has to be searched: over its whole range, then over the part that can still be cheaper
    (|A − A⁻| ≤ √J), then around the best.
    """
    low, high = problem.lower[1], problem.upper[1]
    best, cost = problem.previous, cheaper_than
    if not np.isfinite(cost):
        best, cost = _best_of(problem, np.geomspace(low, high, _COARSE))
        if not np.isfinite(cost):
            return best, cost
    reach = np.sqrt(cost)
    amplitudes = np.linspace(
        max(low, problem.previous[1] - reach), min(high, problem.previous[1] + reach), _COARSE
    )
    for _ in range(_ZOOMS):
        candidate, candidate_cost = _best_of(problem, amplitudes)
        if candidate_cost >= cost:
            break
        best, cost = candidate, candidate_cost
        step = amplitudes[1] - amplitudes[0]
        amplitudes = np.linspace(max(low, best[1] - step), min(high, best[1] + step), _FINE)
    return best, cost


def fastest(problem: SearchProblem) -> NDArray:
    """The [ξ, A] within the bounds at which the slowest carrier is fastest, on a grid."""
    amplitudes = np.geomspace(problem.lower[1], problem.upper[1], _COARSE)
    frequencies = np.geomspace(problem.lower[0], problem.upper[0], _COARSE)
    s = amplitudes[:, None] * frequencies
    slowest = problem.quadratics(amplitudes).at(s).min(axis=2)
    i, j = np.unravel_index(np.argmax(slowest), slowest.shape)
    return np.array([frequencies[j], amplitudes[i]])


def _best_of(problem: SearchProblem, amplitudes: NDArray) -> tuple[NDArray, float]:
    """The best feasible [ξ, A] with one of the amplitudes (k,), and its cost."""
    q = problem.quadratics(amplitudes)
    discriminant = q.b * q.b - q.a * (q.c - problem.bound**2)
    root = np.sqrt(np.maximum(discriminant, 0))
    start, end = (-q.b - root) / q.a, (-q.b + root) / q.a  # empty where nothing is forbidden

    A = amplitudes[:, None]
    frequency, amplitude = problem.previous
    lowest, highest = A * problem.lower[0], A * problem.upper[0]
    velocity_weight = problem.internal_force_rate_weight * (np.sin(problem.angles) ** 2).sum()
    force_weight = problem.internal_force_weight * (np.cos(problem.angles) ** 2).sum()
    unconstrained = (frequency / A + velocity_weight * frequency * amplitude) / (
        1 / A**2 + velocity_weight
    )
    unconstrained = np.clip(unconstrained, lowest, highest)
    # The cost grows away from `unconstrained` on either side: the next allowed s is the best.
    below = -_next_allowed(-unconstrained, -end, -start)
    above = _next_allowed(unconstrained, start, end)
    s = np.concatenate([below, above], axis=1)
    cost = (
        (s / A - frequency) ** 2
        + (1 + force_weight) * (A - amplitude) ** 2
        + velocity_weight * (s - frequency * amplitude) ** 2
    )
    cost = np.where((s >= lowest) & (s <= highest), cost, np.inf)
    i, j = np.unravel_index(np.argmin(cost), cost.shape)
    return np.array([s[i, j] / amplitudes[i], amplitudes[i]]), float(cost[i, j])


def _next_allowed(s: NDArray, start: NDArray, end: NDArray) -> NDArray:
    """The least values (k, 1) from s (k, 1) on that lie inside none of p intervals (k, p)."""
    for _ in range(start.shape[1]):
        inside = (start < s - _SAME * np.abs(s)) & (s + _SAME * np.abs(s) < end)
        if not inside.any():
            break
        s = np.where(inside, end, s).max(axis=1, keepdims=True)
    return s
