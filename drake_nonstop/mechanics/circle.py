"""Motion on a circle."""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rotation import components


def circular_motion(angle: NDArray, radius: float) -> NDArray:
    """A point on a circle about the origin of a plane, and four derivatives, (5, 2) in m, s.

    `angle` (5,) is θ, from the first axis towards the second, with its four derivatives in
    rad, s. With e = (cos θ, sin θ) and n = (−sin θ, cos θ), so that ė = θ̇ n and ṅ = −θ̇ e,

        p = r e,   ṗ = r θ̇ n,   p̈ = r (θ̈ n − θ̇² e),   p⃛ = r ((θ⃛ − θ̇³) n − 3 θ̇ θ̈ e),
        p⁗ = r ((θ⁗ − 6 θ̇² θ̈) n − (4 θ̇ θ⃛ + 3 θ̈² − θ̇⁴) e).
    """
    theta, rate, acceleration, jerk, snap = components(angle)
    outward = np.concatenate([np.cos(theta), np.sin(theta)])
    onward = np.concatenate([-np.sin(theta), np.cos(theta)])
    square = rate * rate
    return radius * np.stack(
        [
            outward,
            rate * onward,
            acceleration * onward - rate * rate * outward,
            (jerk - rate * rate * rate) * onward - 3 * rate * acceleration * outward,
            (snap - 6 * square * acceleration) * onward
            - (4 * rate * jerk + 3 * acceleration * acceleration - square * square) * outward,
        ]
    )
