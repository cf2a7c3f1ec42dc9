"""Numbers smoothed by a chain of three equal poles.

With the target u and the poles at −ω,

    ẋ₁ = κ (u − x₁),  ẋ₂ = ω (x₁ − x₂),  ẋ₃ = ω (x₂ − x₃),

κ = ω where time is continuous. At samples a period T apart x₁ moves along a line from one to the
next, with κ = (1 − e^(−ωT))/T: it then has the values of the pole −ω at the samples. x₃, the
smoothed number, is continuous to its second rate. x₂ and x₃ are averages of earlier x₁ with
positive weights: none leaves the range of the targets. Numbers or arrays of any scalar type. Own
derivation.
"""

import math
from typing import Any


class Smoothing:
    """The chain of poles.

    Args:
        bandwidth: ω, rad/s.
        period: T, s, between samples; 0: continuous.
    """

    def __init__(self, *, bandwidth: float, period: float = 0.0):
        self._bandwidth, self._period = bandwidth, period
        turn, self._decay = bandwidth * period, math.exp(-bandwidth * period)
        self._gain = -math.expm1(-turn) / period if period > 0 else bandwidth
        self._turn = turn
        # Of the two transients in the integral of x₃ over a period.
        self._integrals = (
            (1 - self._decay) / bandwidth,
            (1 - self._decay * (1 + turn)) / bandwidth,
        )

    def approach(self, first: Any, target: Any) -> Any:
        """ẋ₁ of x₁ and u, until the next sample."""
        return self._gain * (target - first)

    def stage_rates(self, first: Any, second: Any, third: Any) -> tuple[Any, Any]:
        """ẋ₂ and ẋ₃ of x₁, x₂ and x₃."""
        return self._bandwidth * (first - second), self._bandwidth * (second - third)

    def rates(self, first: Any, second: Any, third: Any, first_rate: Any) -> tuple[Any, Any, Any]:
        """The first, second and third rate of x₃, of x₁, x₂, x₃ and ẋ₁."""
        w = self._bandwidth
        middle, rate = w * (first - second), w * (second - third)
        second_rate = w * (middle - rate)
        return rate, second_rate, w * (w * (first_rate - middle) - second_rate)

    def after(
        self, first: Any, second: Any, third: Any, first_rate: Any
    ) -> tuple[Any, Any, Any, Any]:
        """x₁, x₂ and x₃ a period later, of a constant ẋ₁, and the integral of x₃: exact."""
        lag = first_rate / self._bandwidth  # of x₂ behind x₁ in the end; x₃ lags by twice as much
        move, decay = self._period * first_rate, self._decay
        second, third = second - first + lag, third - first + 2 * lag
        integral = (
            self._period * (first - 2 * lag + move / 2)
            + third * self._integrals[0]
            + second * self._integrals[1]
        )
        moved = first + move
        return (
            moved,
            moved - lag + second * decay,
            moved - 2 * lag + (third + self._turn * second) * decay,
            integral,
        )
