"""A motion along its path in a time of its own: the chain rule."""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.signals import LoadReference


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
