"""The mean wind, by height and time, its gusts, and coloured noise, such as that of a force."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.cable import positive_part

LOWEST_HEIGHT = 1.0  # m above the ground, below which the wind is as there
FOOT, KNOT = 0.3048, 0.514444  # m, m/s
SEVERITIES = {"light": 15 * KNOT, "moderate": 30 * KNOT, "severe": 45 * KNOT}  # W_20, m/s
GUST_STEP = 0.01  # s, between the samples of gusts


def power_law(height: NDArray, *, reference_height: Any, exponent: Any) -> NDArray:
    """The wind at a height in m above the ground, over that at the reference height.

    (z/z_r)^α, with z at least `LOWEST_HEIGHT`; α is some 1/7 over open land (IEC 61400-1 takes 0.2
    for its normal wind profile).
    """
    lifted = LOWEST_HEIGHT + positive_part(height - LOWEST_HEIGHT)
    power: NDArray = np.exp(exponent * np.log(lifted / reference_height))
    return power


def risen_share(time: Any, *, start: float, rise_time: float) -> Any:
    """Share of a value that grows linearly from 0 at `start` to 1 a rise time (s) later."""
    since = (time - start) / rise_time
    return positive_part(since) - positive_part(since - 1.0)


class MeanWind(NamedTuple):
    """A wind without its gusts, of the fields of the box "wind"."""

    velocity: NDArray  # (3,), m/s, in W, at the reference height
    exponent: float = 0.0  # of the height
    reference_height: float = 10.0  # m, above the ground
    ground_height: float = 0.0  # m, z of the ground in W

    def at(self, positions: NDArray) -> NDArray:
        """(..., 3), m/s, in W, at positions (..., 3), m."""
        if self.exponent == 0:
            return np.broadcast_to(self.velocity, positions.shape)
        height = positions[..., 2:] - self.ground_height
        law = {"reference_height": self.reference_height, "exponent": self.exponent}
        return self.velocity * power_law(height, **law)

    def times(self, share: float) -> "MeanWind":
        """A share of it."""
        return self._replace(velocity=share * self.velocity)

    @classmethod
    def of(cls, config: Any, velocity: Any) -> "MeanWind":
        """That of a block's config, for a velocity (3,) at the reference height, m/s, in W."""
        law = {name: getattr(config, name) for name in cls._fields[1:] if hasattr(config, name)}
        return cls(np.array(velocity, dtype=float), **law)


class Waves(NamedTuple):
    """Of some independent noises."""

    frequencies: NDArray  # (noises, count), rad/s
    phases: NDArray  # (noises, count), rad


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


def wave_frequencies(
    correlation_time: float, *, count: int, highest: float, is_along: bool = True
) -> NDArray:
    """Frequencies (count,), rad/s, in the middles of bands of equal power, up to a highest ωτ.

    The power below x = ωτ is in proportion to arctan x in first-order noise, as that of
    `random_waves` and of gusts along the wind; of other gusts, to 2 arctan x − x/(1 + x²).
    """
    shares = (np.arange(count) + 0.5) / count
    if is_along:
        return np.tan(shares * np.arctan(highest)) / correlation_time
    x = np.geomspace(1e-4, highest, 4000)
    power = 2 * np.arctan(x) - x / (1 + x**2)
    return np.interp(shares * power[-1], power, x) / correlation_time


def coloured_noise(times: NDArray, waves: Waves) -> NDArray:
    """The noises (k, noises), of variance 1, at times (k,) in s."""
    sines = np.sin(waves.frequencies * times[:, None, None] + waves.phases)
    noises: NDArray = np.sqrt(2 / sines.shape[-1]) * sines.sum(axis=-1)
    return noises


def coloured_noise_rate(times: NDArray, waves: Waves) -> NDArray:
    """Their rates (k, noises), 1/s."""
    cosines = np.cos(waves.frequencies * times[:, None, None] + waves.phases)
    rates: NDArray = np.sqrt(2 / cosines.shape[-1]) * (waves.frequencies * cosines).sum(axis=-1)
    return rates


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
