"""Coloured noise as a function of the time alone, which repeats to the bit at any steps.

White noise through a first-order filter of time constant τ has the spectrum σ² 2τ/(1 + (ωτ)²)/2π
over ω and the correlation σ² exp(−|t|/τ). A sum of waves of random frequencies and phases has both:
one wave from each of `count` bands of equal power, up to a highest ωτ, which leaves out a share of
2/(π ωτ) of the power (M. Shinozuka and G. Deodatis, Simulation of stochastic processes by spectral
representation, Applied Mechanics Reviews 44, 1991).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Waves(NamedTuple):
    """Of some independent noises."""

    frequencies: NDArray  # (noises, count), rad/s
    phases: NDArray  # (noises, count), rad


def random_waves(
    random: np.random.Generator, noises: int, correlation_time: float, *, count: int, highest: float
) -> Waves:
    """The waves of that many noises of a correlation time τ in s, up to the `highest` ωτ."""
    # Bands of equal power: each wave has the same amplitude.
    shares = (np.arange(count) + random.uniform(size=(noises, count))) / count
    frequencies = np.tan(shares * np.arctan(highest)) / correlation_time
    return Waves(frequencies, random.uniform(0, 2 * np.pi, (noises, count)))


def wave_frequencies(correlation_time: float, *, count: int, highest: float) -> NDArray:
    """The middles (count,) of the bands of `random_waves`, rad/s."""
    shares = (np.arange(count) + 0.5) / count
    return np.tan(shares * np.arctan(highest)) / correlation_time


def coloured_noise(time: Any, waves: Waves, deviation: float | NDArray) -> NDArray:
    """The noises (noises,) at a time in s, of any scalar type, with these standard deviations.

    At times (k, 1, 1) they are (k, noises).
    """
    sines = np.sin(waves.frequencies * time + waves.phases)
    return deviation * np.sqrt(2 / sines.shape[-1]) * sines.sum(axis=-1)
