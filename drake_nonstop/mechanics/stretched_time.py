"""A motion along its path in a time of its own: the chain rule."""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.signals import LoadReference, ReferenceHigherRates


def stretched_reference(reference: NDArray, rates: NDArray) -> NDArray:
    """The reference (..., 22) of a motion whose own time s passes at another rate.

    With p(s(t)) and R(s(t)), and derivatives by s on the right,

        v = v ṡ,   a = a ṡ² + v s̈,   j = j ṡ³ + 3 a ṡ s̈ + v s⃛,   ω = ω ṡ,   ω̇ = ω̇ ṡ² + ω s̈.

    Args:
        reference: (..., 22), at s.
        rates: ṡ, s̈ (1/s), s⃛ (1/s²), (..., 3).
    """
    # Pose, twist and its rate, each angular part beside the linear one, and the jerk.
    pose, twist, twist_rate, jerk = np.split(reference, [7, 13, 19], axis=-1)
    at = LoadReference.view(reference)
    rate, second, third = rates[..., :1], rates[..., 1:2], rates[..., 2:]
    square = rate * rate
    return np.concatenate(
        [
            pose,
            twist * rate,
            twist_rate * square + twist * second,
            jerk * (square * rate) + at.acceleration * (3 * rate * second) + at.velocity * third,
        ],
        axis=-1,
    )


def stretched_higher_rates(reference: NDArray, higher_rates: NDArray, rates: NDArray) -> NDArray:
    """The higher rates (..., 6) of the same motion.

    The snap is n,

        n = n ṡ⁴ + 6 j ṡ² s̈ + a (3 s̈² + 4 ṡ s⃛) + v s⁗,   ω̈ = ω̈ ṡ³ + 3 ω̇ ṡ s̈ + ω s⃛.

    Args:
        reference: (..., 22), at s.
        higher_rates: (..., 6), a `ReferenceHigherRates` at s.
        rates: ṡ, s̈ (1/s), s⃛ (1/s²), s⁗ (1/s³), (..., 4).
    """
    at, higher = LoadReference.view(reference), ReferenceHigherRates.view(higher_rates)
    rate, second, third, fourth = (rates[..., i : i + 1] for i in range(4))
    square = rate * rate
    parts = ReferenceHigherRates(
        angular_jerk=(
            higher.angular_jerk * (square * rate)
            + at.angular_acceleration * (3 * rate * second)
            + at.angular_velocity * third
        ),
        snap=(
            higher.snap * (square * square)
            + at.jerk * (6 * square * second)
            + at.acceleration * (3 * second * second + 4 * rate * third)
            + at.velocity * fourth
        ),
    )
    return np.concatenate(parts, axis=-1)
