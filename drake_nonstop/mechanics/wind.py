"""The mean wind: how it grows with the height, and how it rises with the time."""

from typing import Any

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
