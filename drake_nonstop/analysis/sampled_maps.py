"""Linear maps from sample to sample: over a turn of the carriers, and along a plan."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_FOLLOWED = 1e12  # times that a deviation grows, beyond which it is not followed
AT_ONCE = 64  # maps that are interpolated, so few that they stay in a core's cache


def parts_of_turn(turn: float, period: float, about: float) -> int:
    """Number of equal parts of a turn (s), of whole samples of the period (s); near `about`."""
    samples = max(1, round(turn / about / period))
    return max(1, round(turn / (samples * period)))


def interpolated(values: NDArray, turns: NDArray) -> NDArray:
    """A function (k, s, s) of even phases of a turn, at other ones (l,), in turns.

    By trigonometric interpolation, whose error for a smooth function is near rounding.
    """
    count = len(values)
    spectrum = np.fft.rfft(np.eye(count), axis=0) / count
    orders = np.arange(len(spectrum))
    weights = np.where((orders == 0) | (2 * orders == count), 1.0, 2.0)
    waves = np.exp(2j * np.pi * np.outer(turns, orders)) * weights
    found: NDArray = (waves @ spectrum).real @ values.reshape(count, -1)
    return found.reshape(len(turns), *values.shape[1:])


def map_of_turn(maps: NDArray, samples: int) -> NDArray:
    """The map (s, s) of a turn of so many samples, of maps (k, s, s) of one at even phases of it.

    Its eigenvalues are the Floquet multipliers.
    """
    turn = np.eye(maps.shape[1])
    for start in range(0, samples, AT_ONCE):
        some = np.arange(start, min(start + AT_ONCE, samples))
        for step in interpolated(maps, some / samples):
            turn = step @ turn
    return turn


class Grown(NamedTuple):
    """How many times a deviation grows at most, at least 1, and the samples from which to which."""

    times: float
    first: int
    last: int


def largest_growth(transitions: Iterable[NDArray], scale: NDArray, *, spacing: int) -> Grown:
    """By how much a deviation of the first states grows at most, while a loop changes.

    One that grows beyond 1e12 times is followed no further.

    Args:
        transitions: the maps (s, s) from sample to sample, in their order.
        scale: (k,) weighs the first k states, which begin off while all others do not, and whose
            size is the largest singular value.
        spacing: of the samples from which on deviations are followed.
    """
    k, found = len(scale), Grown(1.0, 0, 0)
    states = np.zeros((0, 0, k))
    for sample, transition in enumerate(transitions):
        if sample % spacing == 0:
            begun = np.zeros((1, len(transition), k))
            begun[0, :k] = np.diag(1 / scale)
            states = np.concatenate([states.reshape(-1, *begun.shape[1:]), begun])
        states = transition @ states
        sizes = scale[:, None] * states[:, :k]
        if np.max(np.linalg.norm(sizes, axis=(-2, -1))) <= found.times:
            continue  # the largest singular value is no larger
        largest = np.linalg.norm(sizes, 2, axis=(-2, -1))
        start = int(np.argmax(largest))
        if largest[start] > found.times:
            found = Grown(float(largest[start]), start * spacing, sample + 1)
        if not found.times < _FOLLOWED:
            break
    return found
