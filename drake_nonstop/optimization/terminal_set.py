"""The set in which a plan ends: within the limits at all phases of the orbit."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.nonstop import (
    polynomial_values,
    speed_polynomials,
    speed_squares,
)
from drake_nonstop.mechanics.planned_orbit import OrbitTerms, orbit_directions


class TerminalSet(NamedTuple):
    """Limits at k instants on s = A ξ and on A, over a table of A, for constant ξ and A.

    Below `least_products` a carrier is too slow at some phase, above `most_products`, inf where
    there is no limit, too fast. `amplitude_margins`, inf likewise, are the worst of what does not
    depend on ξ.
    """

    amplitudes: NDArray  # (a,), N, evenly spaced
    least_products: NDArray  # (k, a), N/s
    most_products: NDArray  # (k, a), N/s
    amplitude_margins: NDArray  # (k, a)

    def at(self, amplitudes: NDArray) -> tuple[NDArray, NDArray]:
        """The three limits (3, k) at A (k,), one per instant, and their slopes by A.

        They are linear between the entries of the table.
        """
        low, step = self.amplitudes[0], self.amplitudes[1] - self.amplitudes[0]
        place = np.clip((amplitudes - low) / step, 0, len(self.amplitudes) - 1.000001)
        left = place.astype(int)
        rows = np.arange(len(amplitudes))
        tables = np.stack(self[1:])
        start, end = tables[:, rows, left], tables[:, rows, left + 1]
        with np.errstate(invalid="ignore"):  # inf − inf, of a limit that there is not
            return start + (place - left) * (end - start), (end - start) / step

    def continued(self, later: "TerminalSet", count: int) -> "TerminalSet":
        """The limits from the instant of number `count` on, and after them later ones."""
        known = [table[count:] for table in self[1:]]
        return TerminalSet(
            self.amplitudes,
            *(np.concatenate(tables) for tables in zip(known, later[1:], strict=True)),
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
    polynomials = orbit_polynomials(terms, axes, phase_count)
    values = polynomial_values(polynomials[..., None], amplitudes)
    c, b, a, tension_squares = speed_squares(values, rest_length=rest_length, compliance=compliance)

    def upper_roots(speed: NDArray | float) -> tuple[NDArray, NDArray]:
        square = b * b - a * (c - speed**2)
        return square, (np.sqrt(np.maximum(square, 0)) - b) / a

    square, roots = upper_roots(speed_bound)
    least = np.maximum(np.where(square > 0, roots, 0.0).max(axis=(0, 2)), 0.0)
    most = np.full(least.shape, np.inf)
    if np.isfinite(max_speed):
        most = upper_roots(max_speed)[1].min(axis=(0, 2))
    return least, most, tension_squares.min(axis=(0, 2)), tension_squares.max(axis=(0, 2))
