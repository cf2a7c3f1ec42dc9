"""Constant ξ and A that keep a task's bound on the speeds at all phases of the orbit."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.task import Task
from drake_nonstop.mechanics.signals import constant_plan
from drake_nonstop.planning.horizon_problem import HorizonProblem
from drake_nonstop.planning.problem_config import amplitude_range

_TIMES = 40  # of a task, at which constant ξ and A are tried
_GRID = (24, 12)  # values of ξ and of A among them
_PHASES = 18  # of an orbit
_SHOWN = 2.5  # times the largest flown value, of the set over time


class FeasibleParameters(NamedTuple):
    """The largest of the least speeds, over the bound, that constant ξ and A reach."""

    times: NDArray  # (k,), s
    ratios: NDArray  # (k,)
    best: NDArray  # (k, 2), [ξ (rad/s), A (N)] that reach it

    @property
    def tight_times(self) -> NDArray:
        """The times (j,), s, at which no constant ξ and A keep the bound at all phases."""
        return self.times[self.ratios < 1]

    @property
    def text(self) -> str:
        """Where the bound is hardest to keep, and with which ξ and A."""
        tight = self.tight_times
        if len(tight) == 0:
            return "constant xi and A can keep the bound at all phases and at all times"
        k = int(np.argmin(self.ratios))
        ratio, time, (xi, amplitude) = self.ratios[k], self.times[k], self.best[k]
        return (
            f"no constant xi and A keep the bound at all phases from t = {tight[0]:.1f} to "
            f"{tight[-1]:.1f} s: at t = {time:.1f} s at most {ratio:.3g} of it, with "
            f"xi = {xi:.3g} rad/s and A = {amplitude:.3g} N"
        )


def has_set(task: Task) -> bool:
    """Whether there are a bound and orbits, whose speeds follow from ξ and A."""
    return task.limits.speed_bound > 0 and not task.model.pattern.is_constant


def feasible_parameters(task: Task) -> FeasibleParameters:
    """Tries all constant ξ and A within the layer's bounds, the nominal ones among them."""
    times, limits = np.linspace(0, task.duration, _TIMES), task.limits
    low, high = limits.frequency_bounds
    frequencies = np.append(np.geomspace(low, high, _GRID[0] - 1), limits.frequency)
    low, high = amplitude_range(limits, task.model)
    amplitudes = np.append(np.linspace(low, high, _GRID[1] - 1), limits.amplitude)
    tried = [np.tile(values, (_TIMES, 1)) for values in (frequencies, amplitudes)]
    ratios = least_speeds(task, times, *tried) / limits.speed_bound
    flat = ratios.reshape(_TIMES, -1)
    at_xi, at_amplitude = np.unravel_index(flat.argmax(axis=1), ratios.shape[1:])
    best = np.stack([frequencies[at_xi], amplitudes[at_amplitude]], axis=1)
    return FeasibleParameters(times, flat.max(axis=1), best)


def least_speeds(task: Task, times: NDArray, frequencies: NDArray, amplitudes: NDArray) -> NDArray:
    """The least speed (k, x, a), m/s, over an orbit, of constant ξ (k, x) and A (k, a) at times."""
    problem = HorizonProblem(task.model, task.limits, task.horizon, shape=task.references.shape)
    angles, least = 2 * np.pi * np.arange(_PHASES) / _PHASES, []
    for time, of_xi, of_A in zip(times, frequencies, amplitudes, strict=True):
        tried = np.stack([part.ravel() for part in np.meshgrid(of_xi, of_A, indexing="ij")])
        orbits = constant_plan(np.tile(angles, tried.shape[1]), *np.repeat(tried, _PHASES, axis=1))
        squares = problem.squared_speeds(orbits.T, task.reference(time), task.counted_wind(time))
        least.append(squares.min(axis=0).reshape(len(of_xi), len(of_A), -1).min(axis=-1))
    return np.sqrt(np.maximum(np.stack(least), 0.0))


def set_over_time(
    task: Task, flown: tuple[NDArray, NDArray], column: int, count: int = _TIMES
) -> tuple[NDArray, NDArray, NDArray] | None:
    """Times (k,), ξ or A (c,), and the least v/ε (k, c) over an orbit beside the other one's value.

    `flown` are times (l,), s, and the [ξ, A] (l, 2) that were flown then; `column` is 0 for ξ and 1
    for A. None: there is no such set.
    """
    if not has_set(task) or not np.all(np.isfinite(flown[1])):
        return None
    times = np.linspace(0, task.duration, count)
    used = np.stack([np.interp(times, flown[0], values) for values in flown[1].T], axis=1)
    bounds = [task.limits.frequency_bounds, amplitude_range(task.limits, task.model)][column]
    most = min(bounds[1], _SHOWN * flown[1][:, column].max())
    values = np.linspace(bounds[0], max(most, bounds[0] * 1.01), count)
    both = [used[:, :1], used[:, 1:]]
    both[column] = np.tile(values, (count, 1))
    ratios = least_speeds(task, times, *both).reshape(count, count)
    return times, values, ratios / task.limits.speed_bound
