"""A wind that rises, its gusts, and coloured noise, such as that of a force."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.cable import positive_part

FOOT = 0.3048  # m
GUST_STEP = 0.01  # s, between the samples of gusts


def risen_share(time: Any, *, start: float, rise_time: float) -> Any:
    """Share of a value that grows linearly from 0 at `start` to 1 a rise time (s) later."""
    since = (time - start) / rise_time
    return positive_part(since) - positive_part(since - 1.0)


class Waves(NamedTuple):
    """Some independent noises of variance 1, as sums of waves."""

    frequencies: NDArray  # (noises, count), rad/s
    phases: NDArray  # (noises, count), rad

    def at(self, times: NDArray, order: int = 0) -> NDArray:
        """The noises (k, noises) at times (k,) in s, or of order 1 their rates, 1/s."""
        angles = self.frequencies * times[:, None, None] + self.phases
        waves = np.sin(angles) if order == 0 else self.frequencies * np.cos(angles)
        noises: NDArray = np.sqrt(2 / waves.shape[-1]) * waves.sum(axis=-1)
        return noises


def random_waves(
    random: np.random.Generator, noises: int, correlation_time: float, *, count: int, highest: float
) -> Waves:
    """The waves of that many noises of a correlation time τ in s, up to the `highest` ωτ.

    White noise through a first-order filter of time constant τ has the spectrum
    σ² 2τ/(1 + (ωτ)²)/2π over ω and the correlation σ² exp(−|t|/τ). A sum of waves of
    random frequencies and phases has both: one wave from each of `count` bands of equal power, up
    to a highest ωτ, which leaves out a share of 2/(π ωτ) of the power (M. Shinozuka and G.
    Deodatis, Simulation of stochastic processes by spectral representation, Applied Mechanics
    Reviews 44, 1991). It is a function of the time alone, which repeats to the bit at any steps.
    """
    # Bands of equal power: each wave has the same amplitude.
    shares = (np.arange(count) + random.uniform(size=(noises, count))) / count
    frequencies = np.tan(shares * np.arctan(highest)) / correlation_time
    return Waves(frequencies, random.uniform(0, 2 * np.pi, (noises, count)))


def turbulence_at(altitude: float) -> tuple[NDArray, float]:
    """Dryden's scale lengths (3,), m, and σ_u/σ_w, at 3 to 305 m above the ground.

    L_u = L_v = h/(0.177 + 0.000823 h)^1.2 and L_w = h, and σ_u = σ_v = σ_w/(0.177 + 0.000823 h)^0.4
    with σ_w = 0.1 W_20, of the wind 20 ft above the ground, with h in ft (MIL-F-8785C, 3.7.3;
    MIL-HDBK-1797, where the spectra of v and w are written with half of the lengths).
    """
    share = 0.177 + 0.000823 * altitude / FOOT
    return altitude * np.array([share**-1.2, share**-1.2, 1.0]), share**-0.4


def gust_samples(seeds: Sequence[Sequence[int]], times: NDArray, count: int) -> NDArray:
    """Dryden's gusts [u, v, w] (count, seeds, 3), of variance 1, each `GUST_STEP`.

    White noise n of density 1 through the filters

        u = √(2τ)/(1 + τs) n,    v, w = √τ (1 + √3 τs)/(1 + τs)² n,    τ = L/V,

    whose spectra are the standard's, from their stationary state on. The samples are exact: they
    have the filters' own covariances at any lag. The first ones are the same to the bit whatever
    the count, and each seed's whatever the others.

    Args:
        seeds: of `numpy.random.default_rng`.
        times: τ (3,), s.
        count: of samples.
    """
    # z_1 = √τ/(1 + τs) n and z_2 = z_1/(1 + τs): their covariance P, and that of a step's noise.
    x = GUST_STEP / times
    decay = np.exp(-x)
    first = np.sqrt((1 - decay**2) / 2)
    mixed = (1 - decay**2 * (1 + 2 * x)) / 4 / first
    second = np.sqrt(positive_part((1 - decay**2 * (1 + 2 * x + 2 * x**2)) / 4 - mixed**2))
    draws = [np.random.default_rng(seed).standard_normal((count, 2, 3)) for seed in seeds]
    n_1, n_2 = np.moveaxis(np.array(draws), (0, 2), (2, 0))  # (count, seeds, 3) each
    z_1, z_2 = first * n_1, mixed * n_1 + second * n_2
    z_1[0], z_2[0] = n_1[0] / np.sqrt(2), (n_1[0] + n_2[0]) / np.sqrt(8)
    z_1 = _summed(z_1, decay)
    z_2[1:] += decay * x * z_1[:-1]
    root = np.sqrt(3)
    own, lagged = np.array([np.sqrt(2), root, root]), np.array([0, 1 - root, 1 - root])
    return own * z_1 + lagged * _summed(z_2, decay)


def _summed(inputs: NDArray, decay: NDArray) -> NDArray:
    """z_k = decay z_(k−1) + input_k of inputs (k, ..., 3), by sums of 2, 4, 8, ... of them."""
    sums, lag = inputs.copy(), 1
    while lag < len(sums):
        sums[lag:] += decay**lag * sums[:-lag]
        lag *= 2
    return sums
