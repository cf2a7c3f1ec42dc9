"""The set in which a plan ends: speeds above the bound at all phases of the orbit."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.nonstop import (
    polynomial_values,
    speed_polynomials,
    speed_products,
    speed_squares,
)
from drake_nonstop.mechanics.planned_orbit import OrbitTerms


class LeastProducts(NamedTuple):
    """The least s = A ξ with speeds above the bound at all phases, over a table of A."""

    amplitudes: NDArray  # (a,), N, evenly spaced
    products: NDArray  # (k, a), N/s, at k instants; beyond the largest, no s is too slow

    def at(self, amplitudes: NDArray) -> tuple[NDArray, NDArray]:
        """The products at A (k,), one per instant, and their slopes: linear between entries."""
        low, step = self.amplitudes[0], self.amplitudes[1] - self.amplitudes[0]
        place = np.clip((amplitudes - low) / step, 0, len(self.amplitudes) - 1.000001)
        left = place.astype(int)
        rows = np.arange(len(amplitudes))
        start, end = self.products[rows, left], self.products[rows, left + 1]
        return start + (place - left) * (end - start), (end - start) / step


def orbit_polynomials(terms: OrbitTerms, axes: tuple[NDArray, NDArray], angles: NDArray) -> NDArray:
    """`speed_polynomials` (10, 3, h, n) of one instant at phases (h,), in rad."""
    products = speed_products(
        terms.forces, terms.rates, terms.velocities, terms.angular_velocity, *axes
    )
    return speed_polynomials(np.cos(angles)[:, None], np.sin(angles)[:, None], products[:, None])


def least_products(
    terms: OrbitTerms,
    axes: tuple[NDArray, NDArray],
    amplitudes: NDArray,
    speed_bound: float,
    *,
    phase_count: int,
    rest_length: float,
    compliance: float,
) -> NDArray:
    """The least s (a,) above which every carrier is faster than the bound, at all phases.

    At amplitudes (a,) in N and one instant, for constant ξ and A: the largest upper root of
    c + 2 b s + a s² = ε², see `speed_squares`; 0 where there is none.
    """
    angles = 2 * np.pi * np.arange(phase_count) / phase_count
    polynomials = orbit_polynomials(terms, axes, angles)
    values = polynomial_values(polynomials[..., None], amplitudes)
    c, b, a, _ = speed_squares(values, rest_length=rest_length, compliance=compliance)
    square = b * b - a * (c - speed_bound**2)
    roots = np.where(square > 0, (np.sqrt(np.maximum(square, 0)) - b) / a, 0.0)
    return np.maximum(roots.max(axis=(0, 1)), 0.0)
