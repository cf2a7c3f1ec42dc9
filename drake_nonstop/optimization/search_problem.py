"""The nonstop problem of one update, its phases given, and global searches of ξ and A.

One is over A alone, exact in ξ, the other by grids that zoom in.
"""

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
from drake_nonstop.optimization.constraints import FEASIBILITY_TOLERANCE

# Points a side of a grid, and how often one is laid, each within the one before.
FEW, MANY = (9, 6), (40, 5)

# Counts of amplitudes at which the cost is evaluated.
_AMPLITUDES_OVER_BOUNDS = 32
_MIN_AMPLITUDES = 9  # in an interval
_MORE_AMPLITUDES = 24  # in an interval over all of the bounds, in proportion in a shorter one
_AMPLITUDES_ABOUT_MINIMUM = 5  # one that is unclear

_MAX_RATIO = 4  # of the ends of an interval in which amplitudes are evenly spaced
_GOLDEN_RATIO = (math.sqrt(5) - 1) / 2
_GOLDEN_STEPS = 18  # each shortens the interval by that ratio
_PREDICTION_TOLERANCE = 3e-5  # relative, between the cost that is found and the predicted one
_END_TOLERANCE = 1e-9  # relative, what counts as the end of a forbidden interval


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


def nearest_feasible(problem: SearchProblem, start: float | None = None) -> tuple[NDArray, float]:
    """The feasible [ξ, A] (2,) of the least cost, and that cost; inf if none is found.

    An active-set search over the constraints on the p speeds. It begins with the one that
    is violated most at [ξ⁻, A⁻]. The optimum under the active constraints is the optimum if it
    fulfils all of them; else the constraint that it violates most becomes active, too.
    `start` is an amplitude (N) to evaluate besides A⁻ at first.
    """
    allowed, margins = problem.allowed_intervals(), problem.speed_margins(problem.previous)
    active: list[int] = []
    while True:
        worst = int(margins.argmin())
        if worst in active:
            return problem.previous, math.inf
        active.append(worst)
        search = _ActiveSetSearch(problem, active)
        is_enough = search.scan(allowed, start)
        x, cost = search.best
        if not math.isfinite(cost):
            return x, cost
        margins = problem.speed_margins(x)
        if margins.min() < -FEASIBILITY_TOLERANCE:
            continue  # an inexact optimum is enough to find a constraint that is missing
        if not is_enough:
            search.refine(allowed)
            x, cost = search.best
            margins = problem.speed_margins(x)
        if margins.min() >= -FEASIBILITY_TOLERANCE:
            return x, cost


class _ActiveSetSearch:
    """The problem under the constraints on the active speeds only, in plain numbers.

    With A fixed, each speed forbids one interval of s = A ξ, and the cost is a quadratic in
    s: the best s is the quadratic's minimum or the end of an interval. Only A has to be
    searched. For a handful of speeds plain numbers are several times faster than arrays.
    """

    def __init__(self, problem: SearchProblem, active: list[int]):
        self._polynomials = [problem.polynomials[:, :, i].tolist() for i in active]
        self._cables = {"rest_length": problem.rest_length, "compliance": problem.compliance}
        self._previous_amplitude = float(problem.previous[1])
        self._lower, self._upper = problem.lower.tolist(), problem.upper.tolist()
        self._change_cost = problem.change_cost()
        self._bound_squared = float(problem.speed_bound**2)
        self._max_squared = float(problem.max_speed**2)
        self._best = (math.inf, 0.0, self._previous_amplitude)  # cost, s, A
        self._unclear: list[tuple[float, float, float]] = []  # cost, and A on either side
        self._is_wide = False

    @property
    def best(self) -> tuple[NDArray, float]:
        """The cheapest [ξ, A] that was evaluated, and its cost, inf if none was feasible."""
        cost, s, A = self._best
        frequency = min(max(s / A, self._lower[0]), self._upper[0])
        return np.array([frequency, A]), cost

    def scan(self, allowed: list[tuple[float, float]], start: float | None) -> bool:
        """Evaluates amplitudes all over the `allowed` intervals; returns whether that is enough.

        First A⁻ (where nothing is feasible there, the whole range), then what can still be
        cheaper, |A − A⁻| ≤ √J. It is enough where that is narrow and smooth.
        """
        for low, high in allowed:
            for A in (self._previous_amplitude, start):
                if A is not None:
                    self._evaluate(min(max(A, low), high))
        if self._best[0] == math.inf:
            for low, high in allowed:
                ratio = (high / low) ** (1 / (_AMPLITUDES_OVER_BOUNDS - 1))
                for i in range(_AMPLITUDES_OVER_BOUNDS):
                    self._evaluate(min(low * ratio**i, high))
        within_reach = self._within_reach(allowed)
        for low, high in within_reach:
            self._evaluate_evenly(low, (high - low) / (_MIN_AMPLITUDES - 1), _MIN_AMPLITUDES)
        self._is_wide = any(
            self._count(*interval) > _MIN_AMPLITUDES + 1 for interval in within_reach
        )
        return not (self._is_wide or self._unclear)

    def _within_reach(self, allowed: list[tuple[float, float]]) -> list[tuple[float, float]]:
        """The parts of the intervals that can hold something cheaper than the best so far."""
        if self._best[0] == math.inf:
            return []
        reach = math.sqrt(self._best[0] / self._change_cost.amplitude_weight)
        parts = [
            (
                max(low, self._previous_amplitude - reach),
                min(high, self._previous_amplitude + reach),
            )
            for low, high in allowed
        ]
        return [(low, high) for low, high in parts if low < high]

    def _count(self, low: float, high: float) -> int:
        """How many amplitudes to evaluate between two."""
        share = (high - low) / (self._upper[1] - self._lower[1])
        return math.ceil(
            _MIN_AMPLITUDES * max(1.0, math.log(high / low, _MAX_RATIO)) + _MORE_AMPLITUDES * share
        )

    def refine(self, allowed: list[tuple[float, float]]) -> None:
        """Scans wide intervals more closely, and then the surroundings of two unclear minima.

        What is unclear even so is at a kink, where two speeds decide, or at a step, where a way
        past one opens: there, golden section.
        """
        if self._is_wide:
            self._unclear = []
            for low, high in self._within_reach(allowed):
                # The closer together the smaller they are.
                while low < high:
                    end = min(high, _MAX_RATIO * low)
                    count = self._count(low, end)
                    self._evaluate_evenly(low, (end - low) / (count - 1), count)
                    low = end
        for _, low, high in sorted(self._unclear)[:2]:
            self._unclear = []
            step = (high - low) / (_AMPLITUDES_ABOUT_MINIMUM - 1)
            self._evaluate_evenly(low, step, _AMPLITUDES_ABOUT_MINIMUM)
            if self._unclear:
                self._golden_section(*min(self._unclear)[1:])

    def _golden_section(self, low: float, high: float) -> None:
        """Golden section between two amplitudes."""
        left, right = high - _GOLDEN_RATIO * (high - low), low + _GOLDEN_RATIO * (high - low)
        left_cost, right_cost = self._evaluate(left), self._evaluate(right)
        for _ in range(_GOLDEN_STEPS):
            if left_cost < right_cost:
                high, right, right_cost = right, left, left_cost
                left = high - _GOLDEN_RATIO * (high - low)
                left_cost = self._evaluate(left)
            else:
                low, left, left_cost = left, right, right_cost
                right = low + _GOLDEN_RATIO * (high - low)
                right_cost = self._evaluate(right)

    def _evaluate_evenly(self, low: float, step: float, count: int) -> None:
        """Evaluates evenly spaced amplitudes, and the minima between them.

        A smooth minimum is where the parabola through the costs about it has its vertex,
        and costs what the parabola predicts; others are noted as unclear.
        """
        costs = [self._evaluate(low + i * step) for i in range(count)]
        padded = [math.inf, *costs, math.inf]
        for i, cost in enumerate(costs):
            before, after = padded[i], padded[i + 2]
            if cost == math.inf or cost > min(before, after):
                continue
            curvature = before - 2 * cost + after
            if 0 < curvature < math.inf:
                shift = (before - after) / (2 * curvature)
                vertex = cost - curvature * shift**2 / 2
                aside = shift + math.copysign(0.5, -shift)
                predicted = (shift, vertex), (aside, vertex + curvature / 8)
                if all(
                    abs(self._evaluate(low + (i + position) * step) - predicted_cost)
                    <= _PREDICTION_TOLERANCE * cost
                    for position, predicted_cost in predicted
                ):
                    continue
            left, right = low + max(i - 1, 0) * step, low + min(i + 1, count - 1) * step
            self._unclear.append((cost, left, right))

    def _evaluate(self, A: float) -> float:
        """The cost of the best s at an amplitude, inf if there is none; keeps the best."""
        lowest, highest = A * self._lower[0], A * self._upper[0]
        forbidden = []
        for polynomials in self._polynomials:
            values = [p0 + A * (p1 + A * p2) for p0, p1, p2 in polynomials]
            c, b, a, _ = speed_squares(values, **self._cables)
            square = b * b - a * (c - self._bound_squared)
            if square > 0:
                root = math.sqrt(square)
                forbidden.append(((-b - root) / a, (root - b) / a))
            if self._max_squared < math.inf:
                square = b * b - a * (c - self._max_squared)
                if square < 0:
                    return math.inf  # too fast at any s
                root = math.sqrt(square)
                lowest, highest = max(lowest, (-b - root) / a), min(highest, (root - b) / a)
        wanted = min(max(self._change_cost.cheapest_s(A), lowest), highest)
        # The cost grows away from `wanted` on either side: the next allowed s is the best.
        above = _next_allowed(wanted, forbidden)
        below = above
        if above != wanted:
            below = -_next_allowed(-wanted, [(-end, -start) for start, end in forbidden])
        best = math.inf
        for s in (above, below):
            if lowest <= s <= highest:
                cost = self._change_cost.value(s / A, A, s)
                if cost < best:
                    best = cost
                    if cost < self._best[0]:
                        self._best = cost, s, A
        return best


def _next_allowed(s: float, forbidden: list[tuple[float, float]]) -> float:
    """The least value from s on that lies inside none of the intervals."""
    moved = True
    while moved:
        moved = False
        for start, end in forbidden:
            if start < s and s + _END_TOLERANCE * abs(s) < end:
                s, moved = end, True
    return s
