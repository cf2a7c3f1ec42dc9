"""The mean wind: how it grows with the height, and how it rises with the time."""

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
    """What share has risen of what grows linearly from 0 at `start` to 1 a rise time (s) later."""
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
