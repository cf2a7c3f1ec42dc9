"""A global search for ξ and A that keep every carrier at or above the speed bound."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.nonstop import polynomial_values, speed_squares

FEASIBILITY_TOLERANCE = 1e-6  # on a margin, such as speed²/ε² − 1
_WIDE = 32  # amplitudes looked at where the whole range is
_FEW, _MORE = 9, 24  # within reach: at least, and as many more as it is of the whole range
_WIDEST = 4  # the ratio of the ends of what is looked at evenly
_GOLDEN = (math.sqrt(5) - 1) / 2
_CLOSER = 5  # amplitudes looked at about a minimum that is unclear
_GOLDEN_STEPS = 18  # each shortens what is looked at by that factor
_PREDICTION_TOLERANCE = 3e-5  # relative, between the cost that is found and the one foretold
_SAME = 1e-9  # relative, what counts as the end of a forbidden interval
_GRID, _GRID_ZOOMS = 9, 6  # points a side of the grid on which the fastest is sought
_DENSE, _DENSE_ZOOMS = 40, 5  # likewise, of the grid on which both ξ and A are sought


@dataclass(frozen=True)
class SearchProblem:
    """The problem of one update, its phases given.

    `polynomials` (10, 3, p) make the squared speeds, see `mechanics.nonstop.speed_squares`;
    `amplitude_margins` gives the worst margin (k,) of amplitudes (k,) in the constraints
    that do not depend on ξ, None where there are none. `angles` are θ + φ_k (m,); `previous`
    is [ξ⁻, A⁻] and `nominal` what `anchor_weight` pulls [ξ, A] to; `lower` and `upper` bound
    [ξ, A]; speeds have to stay within `speed_bound` and `max_speed`, and `speed_unit` scales
    the margins of the former.
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
    """The number of the point to take where none is feasible, of worst margins in any shape.

    The one of the largest worst margin of the `speeds`; where some fulfil them all, that of
    the largest worst margin of the `others` among these.
    """
    is_fast = speeds >= 0
    if is_fast.any():
        return int(np.argmax(np.where(is_fast, others, -np.inf)))
    return int(np.argmax(speeds))


def nearest_feasible(
    problem: SearchProblem,
    margins: NDArray,
    margins_at: Callable[[NDArray], NDArray],
    start: float | None = None,
) -> tuple[NDArray, float]:
    """The feasible [ξ, A] of the least cost, and that cost; inf if none is found.

    `margins_at` gives the margins of the p speeds at any [ξ, A], `margins` are those at
    [ξ⁻, A⁻]. The search begins with the constraint on a single speed. What is the best for
    some and feasible for all is the best for all; else the one that is violated most joins
    them. `start` is an amplitude that is worth a look.
    """
    allowed = _allowed_amplitudes(problem)
    speeds: list[int] = []
    while True:
        worst = int(margins.argmin())
        if worst in speeds:
            return problem.previous, math.inf
        speeds.append(worst)
        few = _ActiveSetSearch(problem, speeds)
        is_enough = few.scan(allowed, start)
        x, cost = few.best
        if not math.isfinite(cost):
            return x, cost
        margins = margins_at(x)
        if margins.min() < -FEASIBILITY_TOLERANCE:
            continue  # the optimum of too few speeds need not be exact to tell what is missing
        if not is_enough:
            few.refine(allowed)
            x, cost = few.best
            margins = margins_at(x)
        if margins.min() >= -FEASIBILITY_TOLERANCE:
            return x, cost


class _ActiveSetSearch:
    """The problem with the constraints on a few of the speeds only, in plain numbers.

    With A fixed, each speed forbids one interval of s = A ξ, and the cost is a quadratic in
    s: the best s is the quadratic's minimum or the end of an interval. Only A has to be
    searched. For a handful of speeds plain numbers are several times faster than arrays.
    """

    def __init__(self, problem: SearchProblem, speeds: list[int]):
        self._polynomials = [problem.polynomials[:, :, i].tolist() for i in speeds]
        self._cables = {"rest_length": problem.rest_length, "compliance": problem.compliance}
        self._frequency, self._amplitude = problem.previous.tolist()
        self._nominal = problem.nominal.tolist()
        self._lower, self._upper = problem.lower.tolist(), problem.upper.tolist()
        cosines, sines = np.cos(problem.angles), np.sin(problem.angles)
        # What (A − A⁻)² and (s − s⁻)² cost, see `mechanics.nonstop.change_cost`.
        self._amplitude_weight = 1 + problem.internal_force_weight * float(cosines @ cosines)
        self._rate_weight = problem.internal_force_rate_weight * float(sines @ sines)
        self._anchor_weight = problem.anchor_weight
        self._bound_squared = float(problem.speed_bound**2)
        self._max_squared = float(problem.max_speed**2)
        self._best = (math.inf, 0.0, self._amplitude)  # cost, s, A
        self._unclear: list[tuple[float, float, float]] = []  # cost, and A on either side
        self._is_wide = False

    @property
    def best(self) -> tuple[NDArray, float]:
        """The cheapest [ξ, A] that was looked at, and its cost, inf if none was feasible."""
        cost, s, A = self._best
        frequency = min(max(s / A, self._lower[0]), self._upper[0])
        return np.array([frequency, A]), cost

    def scan(self, allowed: list[tuple[float, float]], start: float | None) -> bool:
        """Looks all over the amplitudes in the `allowed` intervals; whether that was enough.

        First at A⁻ (where nothing is feasible there, at the whole range), then at what can
        still be cheaper, |A − A⁻| ≤ √J. It is enough where that is little and smooth.
        """
        for low, high in allowed:
            for A in (self._amplitude, start):
                if A is not None:
                    self._look(min(max(A, low), high))
        if self._best[0] == math.inf:
            for low, high in allowed:
                ratio = (high / low) ** (1 / (_WIDE - 1))
                for i in range(_WIDE):
                    self._look(min(low * ratio**i, high))
        within_reach = self._within_reach(allowed)
        for low, high in within_reach:
            self._look_along(low, (high - low) / (_FEW - 1), _FEW)
        self._is_wide = any(self._count(*interval) > _FEW + 1 for interval in within_reach)
        return not (self._is_wide or self._unclear)

    def _within_reach(self, allowed: list[tuple[float, float]]) -> list[tuple[float, float]]:
        """The parts of the intervals that can hold something cheaper than the best so far."""
        if self._best[0] == math.inf:
            return []
        reach = math.sqrt(self._best[0] / self._amplitude_weight)
        parts = [
            (max(low, self._amplitude - reach), min(high, self._amplitude + reach))
            for low, high in allowed
        ]
        return [(low, high) for low, high in parts if low < high]

    def _count(self, low: float, high: float) -> int:
        """How many amplitudes to look at between two."""
        share = (high - low) / (self._upper[1] - self._lower[1])
        return math.ceil(_FEW * max(1.0, math.log(high / low, _WIDEST)) + _MORE * share)

    def refine(self, allowed: list[tuple[float, float]]) -> None:
        """Scans more closely what is wide, and then about two minima that are unclear.

        What is unclear even so is at a kink, where two speeds decide, or at a step, where a way
        past one opens: there, golden section.
        """
        if self._is_wide:
            self._unclear = []
            for low, high in self._within_reach(allowed):
                # The closer together the smaller they are.
                while low < high:
                    end = min(high, _WIDEST * low)
                    count = self._count(low, end)
                    self._look_along(low, (end - low) / (count - 1), count)
                    low = end
        for _, low, high in sorted(self._unclear)[:2]:
            self._unclear = []
            self._look_along(low, (high - low) / (_CLOSER - 1), _CLOSER)
            if self._unclear:
                self._shrink(*min(self._unclear)[1:])

    def _shrink(self, low: float, high: float) -> None:
        """Golden section between two amplitudes."""
        left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        left_cost, right_cost = self._look(left), self._look(right)
        for _ in range(_GOLDEN_STEPS):
            if left_cost < right_cost:
                high, right, right_cost = right, left, left_cost
                left = high - _GOLDEN * (high - low)
                left_cost = self._look(left)
            else:
                low, left, left_cost = left, right, right_cost
                right = low + _GOLDEN * (high - low)
                right_cost = self._look(right)

    def _look_along(self, low: float, step: float, count: int) -> None:
        """Looks at evenly spaced amplitudes, and at the minima between them.

        A smooth minimum is where the parabola through the costs about it has its vertex,
        and costs what that foretells; others are noted as unclear.
        """
        costs = [self._look(low + i * step) for i in range(count)]
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
                foretold = (shift, vertex), (aside, vertex + curvature / 8)
                if all(
                    abs(self._look(low + (i + position) * step) - cost_there)
                    <= _PREDICTION_TOLERANCE * cost
                    for position, cost_there in foretold
                ):
                    continue
            left, right = low + max(i - 1, 0) * step, low + min(i + 1, count - 1) * step
            self._unclear.append((cost, left, right))

    def _look(self, A: float) -> float:
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
        weight = self._anchor_weight
        s_before = self._frequency * self._amplitude
        wanted = (
            (self._frequency + weight * self._nominal[0]) / A + self._rate_weight * s_before
        ) / ((1 + weight) / (A * A) + self._rate_weight)
        wanted = min(max(wanted, lowest), highest)
        # The cost grows away from `wanted` on either side: the next allowed s is the best.
        above = _next_allowed(wanted, forbidden)
        below = above
        if above != wanted:
            below = -_next_allowed(-wanted, [(-end, -start) for start, end in forbidden])
        best = math.inf
        for s in (above, below):
            if lowest <= s <= highest:
                frequency = s / A
                cost = (
                    (frequency - self._frequency) ** 2
                    + self._amplitude_weight * (A - self._amplitude) ** 2
                    + self._rate_weight * (s - s_before) ** 2
                )
                if weight > 0:
                    away = (frequency - self._nominal[0]) ** 2 + (A - self._nominal[1]) ** 2
                    cost += weight * away
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
            if start < s and s + _SAME * abs(s) < end:
                s, moved = end, True
    return s


def _allowed_amplitudes(problem: SearchProblem) -> list[tuple[float, float]]:
    """The intervals of A that the constraints that do not depend on ξ allow."""
    low, high = float(problem.lower[1]), float(problem.upper[1])
    if problem.amplitude_margins is None:
        return [(low, high)]
    amplitudes = np.geomspace(low, high, _WIDE).clip(low, high)
    amplitudes = np.sort(np.append(amplitudes, problem.previous[1]))
    is_allowed = problem.amplitude_margins(amplitudes) >= 0
    # Bisects every change between allowed and not, all at once.
    i = np.flatnonzero(is_allowed[1:] != is_allowed[:-1])
    inside = np.where(is_allowed[i], amplitudes[i], amplitudes[i + 1])
    outside = np.where(is_allowed[i], amplitudes[i + 1], amplitudes[i])
    for _ in range(30 if len(i) > 0 else 0):
        middle = (inside + outside) / 2
        middle_is_allowed = problem.amplitude_margins(middle) >= 0
        inside = np.where(middle_is_allowed, middle, inside)
        outside = np.where(middle_is_allowed, outside, middle)
    ends = inside.tolist()
    if is_allowed[0]:
        ends.insert(0, low)
    if is_allowed[-1]:
        ends.append(high)
    return list(zip(ends[::2], ends[1::2], strict=True))


def fastest(problem: SearchProblem) -> NDArray:
    """The [ξ, A] within the bounds that is `least_infeasible`, by a grid that zooms in.

    Speeds that are the slowest nowhere on the first grid are left out of the others.
    """
    lower, upper = np.log(problem.lower), np.log(problem.upper)
    low, high = lower, upper
    best = problem.previous
    for zoom in range(_GRID_ZOOMS):
        frequencies, amplitudes = np.exp(np.linspace(low, high, _GRID)).T
        margins, others = problem.margins(amplitudes, frequencies)
        i, j = np.unravel_index(least_infeasible(margins.min(axis=2), others), others.shape)
        best = np.array([frequencies[j], amplitudes[i]])
        step = (high - low) / (_GRID - 1)
        low = np.maximum(np.log(best) - step, lower)
        high = np.minimum(np.log(best) + step, upper)
        if zoom == 0 and not math.isfinite(problem.max_speed):
            slowest = np.unique(margins.argmin(axis=2))
            problem = replace(problem, polynomials=problem.polynomials[:, :, slowest])
    return np.clip(best, problem.lower, problem.upper)


def on_grid(
    problem_at: Callable[[float], SearchProblem],
    start: float,
    cost: Callable[[NDArray], float],
) -> tuple[NDArray, float]:
    """The cheapest feasible [ξ, A] of a grid, and its cost.

    The grid is laid over the bounds, then over what can still be cheaper, then it zooms in.
    Where none of its points is feasible the one that is `least_infeasible` is sought, and the cost
    is inf. The phases follow ξ: `problem_at` gives the problem of each frequency, such as
    `start`.
    """
    problem = problem_at(start)
    lower, upper, previous = problem.lower, problem.upper, problem.previous
    axes = np.geomspace(lower, upper, _DENSE).T
    best, best_cost = previous, math.inf
    for zoom in range(_DENSE_ZOOMS):
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
        if zoom == 0 and best_cost < math.inf:
            # The change of ξ and of A costs at least its square.
            around, size = previous, np.full(2, math.sqrt(best_cost))
        else:
            around, size = best, np.max(np.diff(axes), axis=1)
        axes = np.linspace(around - size, around + size, _DENSE).T
    return best, best_cost
