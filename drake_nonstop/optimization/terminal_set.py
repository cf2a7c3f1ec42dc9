"""The set in which a plan ends: within the limits at all phases of the orbit."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.cable import positive_part
from drake_nonstop.mechanics.nonstop import (
    polynomial_values,
    speed_polynomials,
    speed_squares,
)
from drake_nonstop.mechanics.planned_orbit import OrbitTerms, orbit_directions, term_columns
from drake_nonstop.optimization.elementwise import ElementwiseFunction
from drake_nonstop.systems.tracing import where


class TerminalSet(NamedTuple):
    """Limits at k instants on s = A ξ and on A, at some A, for constant ξ and A.

    Below `least_products` a carrier is too slow at some phase, above `most_products`, inf where
    there is no limit, too fast. `amplitude_margins`, inf likewise, are the worst of what does not
    depend on ξ.
    """

    amplitudes: NDArray  # (a,), N
    least_products: NDArray  # (k, a), N/s
    most_products: NDArray  # (k, a), N/s
    amplitude_margins: NDArray  # (k, a)


class TerminalTables(NamedTuple):
    """The limits of a `TerminalSet` over a table of A, whose entries are found when they count."""

    amplitudes: NDArray  # (a,), N, evenly spaced
    limits: NDArray  # (3, k, a), those of a `TerminalSet`; NaN: an entry is not found yet
    apart: NDArray  # (k, a), margins of the carriers' distances, inf where none are limited
    flat_terms: NDArray  # (k, 9n + 3), the `OrbitTerms`
    bounds: NDArray  # (k, n), m/s
    function: ElementwiseFunction  # of carriers at phases, see `limits_of_carrier`
    directions: NDArray  # (6, phases, n), u and u′
    numbers: NDArray  # as of `OrbitConstraints`

    @property
    def spacing(self) -> float:
        """That of the amplitudes, N."""
        return float(self.amplitudes[1] - self.amplitudes[0])

    def at(self, amplitudes: NDArray) -> tuple[NDArray, NDArray]:
        """The three limits (3, k) at A (k,), one per instant, and their slopes by A.

        They are linear between the entries of the table.
        """
        place = (amplitudes - self.amplitudes[0]) / self.spacing
        place = np.nan_to_num(np.clip(place, 0, len(self.amplitudes) - 1.000001))
        left = place.astype(int)
        for k, first in enumerate(left.tolist()):
            for entry in (first, first + 1):
                if np.isnan(self.limits[0, k, entry]):
                    self.limits[:, k, entry] = self._found(k, entry)
        rows = np.arange(len(amplitudes))
        start, end = self.limits[:, rows, left], self.limits[:, rows, left + 1]
        with np.errstate(invalid="ignore"):  # inf − inf, of a limit that there is not
            return start + (place - left) * (end - start), (end - start) / self.spacing

    def _found(self, k: int, entry: int) -> tuple[float, float, float]:
        """The limits at an instant, at an amplitude of the table."""
        n = self.bounds.shape[1]
        terms = self.flat_terms[k, term_columns(n)][:, None]
        amplitude = np.full((1, *self.directions.shape[1:]), self.amplitudes[entry])
        bound = self.bounds[k, None, None]
        numbers = self.numbers[:, None, None]
        given = terms, self.directions, amplitude, bound, numbers
        (least, most, *margins), _ = self.function(*given)
        worst = np.min(margins, initial=self.apart[k, entry])
        return max(least.max(), 0.0), most.min(), worst

    def part(self, first: int, count: int) -> "TerminalTables":
        """The tables of so many instants, whose entries are found for both."""
        of = slice(first, first + count)
        return self._replace(
            limits=self.limits[:, of],
            apart=self.apart[of],
            flat_terms=self.flat_terms[of],
            bounds=self.bounds[of],
        )


def orbit_polynomials(
    terms: OrbitTerms, axes: tuple[NDArray, NDArray], phase_count: int
) -> NDArray:
    """`speed_polynomials` (10, 3, h, k, n) of k instants at h phases of a turn."""
    angles = 2 * np.pi * np.arange(phase_count) / phase_count
    u, along, _ = orbit_directions(axes, angles)
    return speed_polynomials(terms, u[:, None], along[:, None])


def product_limits(
    terms: OrbitTerms,
    axes: tuple[NDArray, NDArray],
    amplitudes: NDArray,
    speed_bound: NDArray | float,
    max_speed: float,
    *,
    phase_count: int,
    rest_length: float,
    compliance: float,
) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """The limits on s = A ξ, and the range of the squared tensions, over all phases.

    At amplitudes (a,) in N and k instants, for constant ξ and A, and a bound in m/s of all carriers
    or bounds (k, n, 1). By the upper roots of c + 2 b s + a s² = ε² or v_max², see `speed_squares`.
    Where there are none s is not limited from below; from above it is by what makes the carrier
    slowest.

    Returns:
        The least and the most s (k, a) in N/s, inf without a limit; the least and the largest
        squared tension (k, a) in N².
    """
    polynomials = orbit_polynomials(terms, axes, phase_count)[..., None]
    cables = {"rest_length": rest_length, "compliance": compliance}
    least, most, tension_squares = _limits(
        polynomials,
        amplitudes,
        speed_bound,
        max_speed,
        lambda square, root: np.where(square > 0, root, 0.0),
        **cables,
    )
    return (
        np.maximum(least.max(axis=(0, 2)), 0.0),
        most.min(axis=(0, 2)),
        tension_squares.min(axis=(0, 2)),
        tension_squares.max(axis=(0, 2)),
    )


def limits_of_carrier(
    terms: NDArray,
    directions: NDArray,
    amplitude: NDArray,
    speed_bound: NDArray,
    *,
    max_speed: Any,
    margins_of_tension: Callable[[Any], list[Any]],
    **cables: Any,
) -> list[NDArray]:
    """The least and the most s, and the margins of the tension, of symbols.

    Args:
        terms: (12,), the `OrbitTerms` of a carrier.
        directions: (6,), u and u′ of a phase.
        amplitude: (1,), A, N.
        speed_bound: (1,), m/s.
        max_speed: m/s, inf where there is no limit.
        margins_of_tension: of its square.
        **cables: their `rest_length` in m and `compliance` in m/N.
    """
    own = OrbitTerms.view(terms[None])
    polynomials = speed_polynomials(own, directions[None, None, :3], directions[None, None, 3:])
    least, most, square = _limits(
        polynomials[:, :, 0, :], amplitude, speed_bound, max_speed, _where_positive, **cables
    )
    return [least, most, *margins_of_tension(square)]


def _where_positive(square: NDArray, root: NDArray) -> NDArray:
    return where(square[0] > 0, root, np.zeros(1))


def _limits(
    polynomials: NDArray,
    amplitudes: NDArray,
    speed_bound: Any,
    max_speed: Any,
    where_positive: Callable[[NDArray, NDArray], NDArray],
    **cables: Any,
) -> tuple[NDArray, NDArray, NDArray]:
    """The limits on s of `product_limits`, of each speed alone, and the squared tension.

    `where_positive` gives the second array where the first is positive, and else zeros.
    """
    values = polynomial_values(polynomials, amplitudes)
    c, b, a, tension_squares = speed_squares(values, **cables)

    def upper_root(speed: Any) -> tuple[NDArray, NDArray]:
        square = b * b - a * (c - speed * speed)
        return square, (np.sqrt(positive_part(square)) - b) / a

    square, root = upper_root(speed_bound)
    least = where_positive(square, root)
    is_limited = not isinstance(max_speed, float) or np.isfinite(max_speed)
    most = upper_root(max_speed)[1] if is_limited else least + np.inf
    return least, most, tension_squares
