"""The nonstop problem of one update as the searches take it: its phases given, in arrays."""

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
