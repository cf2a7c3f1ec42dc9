"""Steps of a number smoothed by a chain of three equal poles, with a rate that has a bound.

With the target u, the poles at −ω and a bound R on rates,

    ẋ₁ = clip(κ (u − x₁), ±R),  ẋ₂ = ω (x₁ − x₂),  ẋ₃ = ω (x₂ − x₃),

κ = ω where time is continuous. At samples a period T apart x₁ moves along a line from one to the
next, with κ = (1 − e^(−ωT))/T: it then has the values of the pole −ω at the samples, where the
bound allows it. x₃, the smoothed number, is continuous to its second rate. x₂ and x₃ are averages
of earlier x₁ with positive weights: none leaves the range of the targets, and none moves faster
than R. Numbers or arrays of any scalar type. Own derivation.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from drake_nonstop.mechanics.rotation import absolute


class Stages(NamedTuple):
    """The numbers behind each of the three poles; the last is the smoothed one."""

    first: Any
    second: Any
    third: Any


def approach(
    first: Any, target: Any, *, bandwidth: float, period: float = 0.0, max_rate: float = math.inf
) -> Any:
    """ẋ₁, until the next sample; `period` in s is zero where time is continuous."""
    gain = -math.expm1(-bandwidth * period) / period if period > 0 else bandwidth
    rate = gain * (target - first)
    if max_rate == math.inf:
        return rate
    above, below = (absolute(np.asarray(rate + bound)) for bound in (max_rate, -max_rate))
    return (above - below) / 2


def stage_rates(stages: Stages, first_rate: Any, *, bandwidth: float) -> Stages:
    """ẋ₁, ẋ₂ and ẋ₃."""
    return Stages(
        first_rate,
        bandwidth * (stages.first - stages.second),
        bandwidth * (stages.second - stages.third),
    )


def third_stage_rates(stages: Stages, first_rate: Any, *, bandwidth: float) -> tuple[Any, Any, Any]:
    """The first, second and third rate of x₃."""
    _, second_rate, rate = stage_rates(stages, first_rate, bandwidth=bandwidth)
    second = bandwidth * (second_rate - rate)
    third = bandwidth * (bandwidth * (first_rate - second_rate) - second)
    return rate, second, third


def stages_after(
    stages: Stages, first_rate: Any, *, bandwidth: float, period: float
) -> tuple[Stages, Any]:
    """The stages a period later, of a constant ẋ₁, and the integral of x₃ over it: exact."""
    lag = first_rate / bandwidth  # of x₂ behind x₁ in the end; x₃ lags by twice as much
    decay = math.exp(-bandwidth * period)
    second = stages.second - stages.first + lag
    third = stages.third - stages.first + 2 * lag
    moved = stages.first + period * first_rate
    turn = bandwidth * period
    integral = (
        period * (stages.first - 2 * lag + period * first_rate / 2)
        + third * ((1 - decay) / bandwidth)
        + second * ((1 - decay * (1 + turn)) / bandwidth)
    )
    after = Stages(
        moved, moved - lag + second * decay, moved - 2 * lag + (third + turn * second) * decay
    )
    return after, integral
