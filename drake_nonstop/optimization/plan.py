"""Plans of ξ and A over time: uniform splines of fourth degree, and the phase that they make."""

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.math import BsplineBasis
from pydrake.trajectories import BsplineTrajectory

from drake_nonstop.systems.block import number
from drake_nonstop.systems.tracing import where

DEGREE = 4  # of ξ and A, whose third rates are continuous


class PlanValues(NamedTuple):
    """A plan at a time; `np.array` of it is the vector (8,) of the signal `planned`."""

    angle: float  # θ, rad
    frequency: float  # ξ, rad/s
    amplitude: float  # A, N
    frequency_rate: float  # rad/s²
    amplitude_rate: float  # N/s
    frequency_second_rate: float  # rad/s³
    amplitude_second_rate: float  # N/s²
    amplitude_third_rate: float  # N/s³


class SplineRows(NamedTuple):
    """Matrices (k, N) that make values at k times of the N coefficients of a spline."""

    integral: NDArray  # from the start, s
    value: NDArray
    rate: NDArray  # 1/s
    second_rate: NDArray  # 1/s²
    third_rate: NDArray  # 1/s³


def spline_rows(times: NDArray, intervals: int, spacing: float) -> SplineRows:
    """The matrices of a spline with knots at 0, spacing, … intervals · spacing, at times (k,).

    The integral is a spline of one degree more, whose coefficients are the sums of the others
    times the spacing.
    """
    count = intervals + DEGREE
    order = DEGREE + 2  # of the integral
    knots = spacing * np.arange(1 - order, intervals + order)
    points = spacing * np.tri(count + 1, count, -1)
    integral = BsplineTrajectory(
        BsplineBasis(order, knots.tolist()), [row[:, None] for row in points]
    )
    start = integral.value(0.0).ravel()
    rates = [integral.MakeDerivative(i) if i else integral for i in range(5)]
    rows = [rate.vector_values(times).T for rate in rates]
    return SplineRows(rows[0] - start, *rows[1:])


def _powers(x: float) -> NDArray:
    """The powers (4, 5) of x from 0 on, and three derivatives."""
    return np.array(
        [
            [1.0, x, x**2, x**3, x**4],
            [0.0, 1.0, 2 * x, 3 * x**2, 4 * x**3],
            [0.0, 0.0, 2.0, 6 * x, 12 * x**2],
            [0.0, 0.0, 0.0, 6.0, 24 * x],
        ]
    )


def _piece() -> NDArray:
    """The polynomials (5, 5) of x in [0, 1] by which five coefficients make a value."""
    rows = spline_rows(np.linspace(0, 1, DEGREE + 1), 1, 1.0).value
    return np.linalg.solve(np.vander(np.linspace(0, 1, DEGREE + 1), increasing=True), rows)


_PIECE = _piece()
_TURN = _PIECE.T @ (1 / np.arange(1, DEGREE + 2))  # of a piece, by its coefficients


def _values_in_piece(
    plan: "Plan", turned: Any, polynomials: NDArray, place: tuple[Any, Any], is_moving: Any
) -> list[Any]:
    """The entries of `PlanValues`, of numbers or symbols.

    Args:
        plan: whose spacing, nominal ξ and A, and phase at the start count.
        turned: by how much θ has turned at the beginning of the piece, over ξ₀ times the spacing.
        polynomials: (2, 5), of ξ/ξ₀ and A/A₀ over the piece.
        place: in the piece, 0 to 1, and how far behind the plan's end; in intervals.
        is_moving: 0 after the end of the plan, else 1.
    """
    x, late = place
    frequency, amplitude = polynomials
    rows = _powers(x) / plan.spacing ** np.arange(4)[:, None]
    integrals = np.array([x * power for power in rows[0]]) / np.arange(1, DEGREE + 2)
    turns = frequency @ integrals + late * (frequency @ rows[0])
    xi, *xi_rates = [plan.nominal[0] * value for value in rows @ frequency]
    A, *A_rates = [plan.nominal[1] * value for value in rows @ amplitude]
    first, second, _ = [rate * is_moving for rate in xi_rates]
    A_first, A_second, A_third = [rate * is_moving for rate in A_rates]
    theta = plan.start_angle + plan.nominal[0] * plan.spacing * (turned + turns)
    return [theta, xi, A, first, A_first, second, A_second, A_third]


def traced_plan_values(plan: "Plan", time: Any) -> NDArray:
    """`Plan.values` as the vector (8,), at a time in s, by one formula for all pieces.

    Plan and time are numbers of any scalar type, or symbols.
    """
    intervals, coefficients = plan.intervals, plan.coefficients
    place = (time - plan.start_time) / plan.spacing
    turns = [coefficients[0, k : k + DEGREE + 1] @ _TURN for k in range(intervals)]
    before = list(itertools.accumulate(turns, initial=0.0))
    # Of the piece: its number, by how much θ has turned before it, and its coefficients.
    chosen = np.zeros(0)
    for k in range(intervals):
        piece = np.array([float(k), before[k], *coefficients[:, k : k + DEGREE + 1].ravel()])
        chosen = where(place >= k, piece, chosen) if k else piece
    polynomials = chosen[2:].reshape(2, -1) @ _PIECE.T
    late = place - intervals
    behind = np.array([1.0, late, 0.0])
    x, late, is_moving = where(late > 0, behind, np.array([place - chosen[0], 0.0, 1.0]))
    return np.array(_values_in_piece(plan, chosen[1], polynomials, (x, late), is_moving))


@dataclass(frozen=True, eq=False)
class Plan:
    """ξ and A from `start_time` on: N = intervals + 4 coefficients each, relative to the nominal.

    After its end a plan goes on with the last ξ and A that it has, for the convenience of callers
    that are late; the rates are zero there.
    """

    start_time: float  # s
    start_angle: float  # θ, rad
    spacing: float  # s, of the knots
    nominal: NDArray  # (2,), [ξ₀, A₀], rad/s and N
    coefficients: NDArray  # (2, N), of ξ/ξ₀ and A/A₀

    @property
    def intervals(self) -> int:
        """The number of intervals between knots."""
        return self.coefficients.shape[1] - DEGREE

    @property
    def end_time(self) -> float:
        """The end in s."""
        return self.start_time + self.intervals * self.spacing

    def values(self, time: float) -> PlanValues:
        """The plan at a time in s, not before its start, in any scalar type."""
        x = (time - self.start_time) / self.spacing
        place = number(x)
        piece = min(max(int(place), 0), self.intervals - 1)
        late = x - self.intervals if place > self.intervals else 0.0
        x = x - piece if place - piece < 1 else 1.0
        is_moving = float(place <= self.intervals)
        polynomials = self.coefficients[:, piece : piece + DEGREE + 1] @ _PIECE.T
        return PlanValues(
            *_values_in_piece(self, self._turned[piece], polynomials, (x, late), is_moving)
        )

    @cached_property
    def _turned(self) -> NDArray:
        """By how much θ has turned at the knots, over ξ₀ times the spacing."""
        turns = np.convolve(self.coefficients[0], _TURN[::-1], "valid")
        return np.concatenate([[0.0], np.cumsum(turns)])

    def shifted(self, count: int = 1) -> "Plan":
        """The plan from a later knot on, as long, which goes on with its last coefficients."""
        last = np.repeat(self.coefficients[:, -1:], count, axis=1)
        within = min(count, self.intervals)
        late = (count - within) * float(self.coefficients[0, -DEGREE - 1 :] @ _PIECE.sum(axis=0))
        return Plan(
            self.start_time + count * self.spacing,
            self.start_angle + self.nominal[0] * self.spacing * (self._turned[within] + late),
            self.spacing,
            self.nominal,
            np.hstack([self.coefficients[:, count:], last]),
        )
