"""How a speed bound, or the whole layer, that is changed during a run takes effect: gradually."""

import math

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.optimization.problem_config import LEAST_BOUND


def raised_bound(in_force: float, wanted: float, *, period: float, change_time: float) -> float:
    """The bound (m/s) of the next update, on the way from one to a higher one.

    It rises by the height of the wanted one per `change_time`, from `LEAST_BOUND` on.
    """
    step = wanted * period / change_time
    return min(wanted, max(in_force + step, LEAST_BOUND))


def limit_step(previous: NDArray, parameters: NDArray, largest: NDArray) -> tuple[NDArray, bool]:
    """The parameters, or what lies towards them from `previous`, and whether they were limited.

    Neither ξ nor A changes by more than `largest`; all are [ξ, A] (2,).
    """
    change = parameters - previous
    excess = float(np.max(np.abs(change) / largest))
    if excess > 1:
        return previous + change / excess, True
    return parameters, False


def step_towards(
    previous: NDArray, target: NDArray, *, period: float, change_time: float
) -> NDArray:
    """The next [ξ, A] on the way to `target`, with a time constant of a quarter `change_time`."""
    return previous + (1 - math.exp(-4 * period / change_time)) * (target - previous)
