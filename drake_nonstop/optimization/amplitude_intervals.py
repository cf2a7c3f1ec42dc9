"""Intervals of the amplitude A that the constraints allow which do not depend on ξ."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

_AMPLITUDES = 32  # tried from bound to bound
_AMPLITUDES_ABOUT_EXTREMUM = 8  # tried in each zoom
_ZOOMS = 2  # into an extremum of the margins, where a narrow interval may hide
_MOST_STEPS = 40  # of the iteration to an end of an interval
_WIDTH_TOLERANCE = 1e-9  # relative, of an amplitude
_MARGIN_TOLERANCE = 1e-9  # of margins, which have no unit


def allowed_intervals(
    margins: Callable[[NDArray], NDArray], low: float, high: float, start: float
) -> list[tuple[float, float]]:
    """Returns the intervals, N, between `low` and `high` in which the margins are not negative.

    It finds those that hold one of 32 amplitudes from `low` to `high`, or `start`, and narrow ones
    about extrema of the margins between these.

    Args:
        margins: gives the least margin (k,) of all constraints at amplitudes (k,), N.
        low: the least amplitude, N, above zero; turn rates in rad/s may stand for amplitudes.
        high: the largest amplitude, N.
        start: an amplitude, N, that is tried, too.
    """
    amplitudes = np.geomspace(low, high, _AMPLITUDES).clip(low, high)
    amplitudes = np.sort(np.append(amplitudes, start))
    values = margins(amplitudes)
    for _ in range(_ZOOMS):
        between = _between_neighbours(amplitudes, _hidden_extrema(values))
        if len(between) == 0:
            break
        order = np.argsort(np.concatenate([amplitudes, between]), kind="stable")
        values = np.concatenate([values, margins(between)])[order]
        amplitudes = np.concatenate([amplitudes, between])[order]
    is_allowed = values >= 0
    i = np.flatnonzero(is_allowed[1:] != is_allowed[:-1])
    inner, outer = np.where(is_allowed[i], (i, i + 1), (i + 1, i))
    points = np.stack([amplitudes, values], axis=1).tolist()
    ends = [_end(margins, points[j], points[k]) for j, k in zip(inner, outer, strict=True)]
    if is_allowed[0]:
        ends.insert(0, low)
    if is_allowed[-1]:
        ends.append(high)
    return list(zip(ends[::2], ends[1::2], strict=True))


def _hidden_extrema(values: NDArray) -> NDArray:
    """The indices of the values that are the closest to zero among neighbours of their own sign."""
    size, is_allowed = np.abs(values), values >= 0
    is_closest = (size[1:-1] < size[:-2]) & (size[1:-1] <= size[2:])
    is_alike = (is_allowed[1:-1] == is_allowed[:-2]) & (is_allowed[1:-1] == is_allowed[2:])
    return 1 + np.flatnonzero(is_closest & is_alike)


def _between_neighbours(amplitudes: NDArray, indices: NDArray) -> NDArray:
    """Amplitudes, evenly apart, between the two neighbours of each that has one of the indices."""
    shares = np.arange(1, _AMPLITUDES_ABOUT_EXTREMUM + 1) / (_AMPLITUDES_ABOUT_EXTREMUM + 1)
    low, high = amplitudes[indices - 1], amplitudes[indices + 1]
    return np.sort((low[:, None] + (high - low)[:, None] * shares).ravel())


def _end(margins: Callable[[NDArray], NDArray], inside: list[float], outside: list[float]) -> float:
    """The last allowed amplitude, N, from `inside` to `outside`: [amplitude, margin] each.

    Regula falsi with the weights of Illinois (M. Dowell and P. Jarratt, BIT 11, 1971, 168-174).
    """
    (low, low_margin), (high, high_weight) = inside, outside
    low_weight, was_allowed = low_margin, None
    for _ in range(_MOST_STEPS):
        if abs(high - low) <= _WIDTH_TOLERANCE * low or low_margin <= _MARGIN_TOLERANCE:
            break
        share = low_weight / (low_weight - high_weight)
        middle = low + (share if 0 < share < 1 else 0.5) * (high - low)
        value = float(margins(np.array([middle]))[0])
        is_allowed = value >= 0
        # An end that stays twice counts half.
        factor = 0.5 if is_allowed == was_allowed else 1.0
        if is_allowed:
            low, low_margin, low_weight, high_weight = middle, value, value, factor * high_weight
        else:
            high, high_weight, low_weight = middle, value, factor * low_weight
        was_allowed = is_allowed
    return low
