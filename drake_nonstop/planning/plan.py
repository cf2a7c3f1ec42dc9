"""Plans of ξ and A over time: uniform splines of fourth degree, and the phase that they make."""

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.math import BsplineBasis
from pydrake.trajectories import BsplineTrajectory

from drake_nonstop.systems.tracing import where

DEGREE = 4  # of ξ and A, whose third rates are continuous


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


def _powers(x: Any) -> NDArray:
    """The powers (4, 5) of x from 0 on, and three derivatives."""
    zero = 0 * x
    rows = [[zero + 1, x, x**2, x**3, x**4]]
    for _ in range(3):
        rows.append([zero, *(k * rows[-1][k - 1] for k in range(1, DEGREE + 1))])
    return np.array(rows)


def _piece() -> NDArray:
    """The polynomials (5, 5) of x in [0, 1] by which five coefficients make a value."""
    rows = spline_rows(np.linspace(0, 1, DEGREE + 1), 1, 1.0).value
    return np.linalg.solve(np.vander(np.linspace(0, 1, DEGREE + 1), increasing=True), rows)


_PIECE = _piece()
_TURN = _PIECE.T @ (1 / np.arange(1, DEGREE + 2))  # of a piece, by its coefficients


@dataclass(frozen=True, eq=False)
class Plan:
    """ξ and A from `start_time` on: N = intervals + 4 coefficients each, relative to the nominal.

    After its end a plan goes on with the last ξ and A that it has, for the convenience of callers
    that are late; the rates are zero there. All are numbers of any scalar type, or symbols.
    """

    start_time: Any  # s
    start_angle: Any  # θ, rad
    spacing: float  # s, of the knots
    nominal: NDArray  # (2,), [ξ₀, A₀], rad/s and N
    coefficients: NDArray  # (2, N), of ξ/ξ₀ and A/A₀

    @property
    def intervals(self) -> int:
        """The number of intervals between knots."""
        return self.coefficients.shape[1] - DEGREE

    @property
    def end_time(self) -> Any:
        """The end in s."""
        return self.start_time + self.intervals * self.spacing

    def planned(self, time: Any) -> NDArray:
        """θ, ξ, A and their rates (8,), as of the signal `planned`, at a time in s.

        It is not before the start; one formula holds for all pieces.
        """
        place = (time - self.start_time) / self.spacing
        turned = self._turned
        # Of the piece: its number, by how much θ has turned before it, and its coefficients.
        chosen = np.zeros(0)
        for k in range(self.intervals):
            own = self.coefficients[:, k : k + DEGREE + 1].ravel()
            piece = np.array([float(k), turned[k], *own])
            chosen = where(place >= k, piece, chosen) if k else piece
        late = place - self.intervals
        behind = np.array([1.0, late, 0.0])
        x, late, is_moving = where(late > 0, behind, np.array([place - chosen[0], 0.0, 1.0]))
        frequency, amplitude = chosen[2:].reshape(2, -1) @ _PIECE.T
        rows = _powers(x) / self.spacing ** np.arange(4)[:, None]
        integrals = np.array([x * power for power in rows[0]]) / np.arange(1, DEGREE + 2)
        turns = chosen[1] + frequency @ integrals + late * (frequency @ rows[0])
        xi, *xi_rates = [self.nominal[0] * value for value in rows @ frequency]
        A, *A_rates = [self.nominal[1] * value for value in rows @ amplitude]
        first, second, _ = [rate * is_moving for rate in xi_rates]
        A_first, A_second, A_third = [rate * is_moving for rate in A_rates]
        theta = self.start_angle + self.nominal[0] * self.spacing * turns
        return np.array([theta, xi, A, first, A_first, second, A_second, A_third])

    @cached_property
    def _turned(self) -> list[Any]:
        """By how much θ has turned at the knots, over ξ₀ times the spacing."""
        turns = [self.coefficients[0, k : k + DEGREE + 1] @ _TURN for k in range(self.intervals)]
        return [*itertools.accumulate(turns, initial=0.0)]

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
