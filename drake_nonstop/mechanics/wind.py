"""The mean wind, by height and time, and coloured noise, such as that of gusts."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.cable import positive_part

LOWEST_HEIGHT = 1.0  # m above the ground, below which the wind is as there


def power_law(height: NDArray, *, reference_height: float, exponent: float) -> NDArray:
    """The wind at a height in m above the ground, over that at the reference height.

    (z/z_r)^α, with z at least `LOWEST_HEIGHT`; α is some 1/7 over open land (IEC 61400-1 takes 0.2
    for its normal wind profile).
    """
    lifted = LOWEST_HEIGHT + positive_part(height - LOWEST_HEIGHT)
    return (lifted / reference_height) ** exponent


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
