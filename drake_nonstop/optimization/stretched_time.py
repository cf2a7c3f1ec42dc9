"""A time along the load's path that passes more slowly where the speed bound asks for it.

Of aircraft the bound is on the airspeed, in the wind that is believed, and the limits of their
lift, bank, climb and thrust ask for it, too: the load's velocity and the wind enter as v − w.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.math import BsplineBasis
from pydrake.trajectories import BsplineTrajectory

from drake_nonstop.mechanics.reference_preview import (
    ReferencePreview,
    stretched_higher_rates,
    stretched_reference,
)
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.signals import WIND_SIZE
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.horizon_config import HorizonConfig, timed
from drake_nonstop.optimization.horizon_problem import HorizonProblem
from drake_nonstop.optimization.horizon_solver import receding_coefficients
from drake_nonstop.optimization.orbit_constraints import OrbitConstraints
from drake_nonstop.optimization.problem_config import (
    LimitsConfig,
    amplitude_range,
    limit_tightening,
    tightened_bound,
)

_SPACING = 0.1  # s, of the instants along path and time at which orbits are looked at,
_IN_A_TURN = 32  # and of aircraft's so many in a turn, where that is longer
_KNOTS = 5  # between knots of the rate, in `change_time`
_CATCHING_UP = 10  # knots, in which the delay falls by a factor e at most
_BISECTIONS = 7
_MOST_ROUNDS = 12  # of slowing down further where a changing rate asks for it
_RESERVE = 0.02  # of the bound, which ξ and A need to change at all
_FURTHER = 0.93  # by which the rate is then lowered, and
_NEIGHBOURS = 4  # how many instants on either side
_BATCH = 400  # instants at a time: bounds the memory
_ROUNDING = 9  # digits of terms, to find equal ones
_ORDER = 5  # of the delay's spline: of fourth degree
_AT_KNOTS = np.array([1, 11, 11, 1]) / 24  # its value at a knot by its coefficients
_WIDEST = 1.5  # times the nominal ξ and A, within which aircraft are taken to fly
_FREQUENCIES, _AMPLITUDES = 13, 7  # ξ and A there, at which their limits are looked at
_MOST_PASSES = 4  # of finding when the load is where, and what the wind is then
_SAME_WIND = 1e-3  # m/s

Winds = Callable[[NDArray, NDArray], NDArray]  # (k, 3), m/s, in W, at times (k,) along (k, 22)


def still_air(times: NDArray, references: NDArray) -> NDArray:
    """No wind at times (k,)."""
    return np.zeros((len(times), WIND_SIZE))


class OrbitFeasibility:
    """Whether some ξ and A within their bounds fulfil all limits, at all phases of the orbit.

    Of aircraft those within a factor of 1.5 of the nominal ξ and A: formations do not fly far from
    these. Where they have limits of flight ξ and A are those of a grid. Speeds have to be above the
    bound by a share `reserve` of it; model, limits, config and name are as of `OrbitConstraints`.
    """

    def __init__(
        self,
        model: Model,
        limits: LimitsConfig,
        config: HorizonConfig,
        name: Callable[[], str],
        reserve: float = 0.0,
    ):
        config = dataclasses.replace(config, terminal_phases=16, terminal_amplitudes=17)
        nominal = np.array([limits.frequency, limits.amplitude])
        if model.aircraft is not None:
            config = dataclasses.replace(config, terminal_amplitudes=_AMPLITUDES)
            bounds = np.array([limits.frequency_bounds, amplitude_range(limits, model)])
            ends = nominal[:, None] * [1 / _WIDEST, _WIDEST]
            of_frequency, of_amplitude = np.clip(ends, bounds[:, :1], bounds[:, 1:]).tolist()
            limits = dataclasses.replace(
                limits, frequency_bounds=of_frequency, amplitude_bounds=of_amplitude
            )
        self._problem = OrbitConstraints(model, limits, config, name)
        self._amplitudes = self._problem.amplitudes
        if model.aircraft is not None:
            self._amplitudes = np.union1d(self._amplitudes, nominal[1])
        low, high = limits.frequency_bounds
        frequencies = np.union1d(np.geomspace(low, high, _FREQUENCIES), nominal[0])
        # ξ, and the number of A, at which limits of flight are looked at, the nearest first.
        tried = itertools.product(frequencies.tolist(), enumerate(self._amplitudes.tolist()))
        self._tried = sorted(
            ((xi, k) for xi, (k, _) in tried),
            key=lambda x: np.abs(np.log([x[0], self._amplitudes[x[1]]] / nominal)).sum(),
        )
        self._bound = (1 + reserve) * tightened_bound(limits, limits.speed_bound)
        self._limits, self._reserve = limits, reserve

    def holds(self, references: NDArray, winds: NDArray = STILL_AIR) -> NDArray:
        """For references (k, 22) in winds (k, 3) or (3,), m/s, in W, as (k,) truth values."""
        flat = self._problem.all_terms(references, winds)
        flight = self._problem.flight_terms(references, winds)
        # At rest, and at a constant velocity, all instants are alike.
        terms = np.hstack([flat, flight])
        _, first, number = np.unique(
            np.round(terms, _ROUNDING), axis=0, return_index=True, return_inverse=True
        )
        parts = np.array_split(first, math.ceil(len(first) / _BATCH))
        found = [self._of_terms(flat[part], flight[part]) for part in parts]
        return np.concatenate(found)[number.ravel()]

    def _of_terms(self, terms: NDArray, flight: NDArray) -> NDArray:
        limits = self._problem.terminal_set(terms, self._bound, self._amplitudes)
        low, high = self._limits.frequency_bounds
        least = np.maximum(limits.least_products, low * limits.amplitudes)
        most = np.minimum(limits.most_products, high * limits.amplitudes)
        fulfilled = (least <= most) & (limits.amplitude_margins >= 0)
        if flight.shape[1] == 0:
            return np.any(fulfilled, axis=1)
        found = np.zeros(len(terms), dtype=bool)
        for xi, k in self._tried:
            A = limits.amplitudes[k]
            is_fast = (least[:, k] <= xi * A) & (xi * A <= most[:, k])
            chosen = np.flatnonzero(~found & fulfilled[:, k] & is_fast)
            if len(chosen):
                margins = self._problem.orbit_flight_margins(flight[chosen], xi, A)
                found[chosen] = margins >= self._reserve
        return found


class PathDelay:
    """By how much a motion's own time s is behind: s = t − d(t), with three continuous rates.

    d is a spline of fourth degree; at its end, and after it, d stays.

    Args:
        spacing: s, of its knots, the first of which is at 0.
        rates: ḋ as coefficients (N,) of a spline of third degree, zero in the first and the last
            three.
    """

    def __init__(self, spacing: float, rates: NDArray):
        count = len(rates) + 1
        knots = spacing * np.arange(1 - _ORDER, count + 1)
        points = spacing * np.concatenate([[0.0], np.cumsum(rates)])
        delay = BsplineTrajectory(BsplineBasis(_ORDER, knots.tolist()), points[:, None, None])
        self._delays = [delay.MakeDerivative(i) if i else delay for i in range(_ORDER)]
        self.end_time = delay.end_time()

    def at(self, times: NDArray) -> NDArray:
        """The delay d and four rates (k, 5) at times (k,) in s; the last one steps at the knots."""
        clipped = np.clip(times, 0.0, self.end_time)
        delays = np.column_stack([d.vector_values(clipped).ravel() for d in self._delays])
        delays[(times < 0) | (times >= self.end_time), -1] = 0  # the others are zero there
        return delays

    def stretched(self, preview: ReferencePreview, times: NDArray) -> NDArray:
        """The references (k, 22), at times (k,), of the motion that is behind by d."""
        own_times, rates = self._own(times)
        return stretched_reference(preview.at(own_times), rates[:, :3])

    def stretched_higher_rates(self, preview: ReferencePreview, time: float) -> NDArray:
        """The higher rates (6,), at a time, of that motion, whose preview tells its own."""
        assert preview.higher_rates is not None
        (own_time,), (rates,) = self._own(np.array([time]))
        return stretched_higher_rates(preview(own_time), preview.higher_rates(own_time), rates)

    def _own(self, times: NDArray) -> tuple[NDArray, NDArray]:
        """The motion's own times s (k,) at times (k,), and four rates (k, 4) of s."""
        delays = self.at(times)
        return times - delays[:, 0], np.array([1.0, 0.0, 0.0, 0.0]) - delays[:, 1:]


class Stretching(NamedTuple):
    """How a motion's time is stretched, and where that is not enough."""

    delay: PathDelay | None  # None: it needs not be
    too_fast: NDArray  # s, instants that the least rate is too fast for
    not_at_rest: NDArray  # s, instants that no rate would help


def stretching(
    model: Model,
    limits: LimitsConfig,
    preview: ReferencePreview,
    duration: float,
    *,
    least_rate: float,
    largest_rate: float,
    change_time: float,
    can_plan: bool,
    config: HorizonConfig,
    name: Callable[[], str],
    winds: Winds = still_air,
) -> Stretching:
    """How a motion has to be slowed down for limits to hold, if at all.

    Not at all where at every instant some ξ and A fulfil the limits at all phases of the orbit, or
    where what plans over a receding horizon make fulfils them at the phases which come. A motion
    that other plans alone would find a way through counts as infeasible: to plan the whole of it at
    once takes ten times as long. It then is slowed wherever not all phases do: there the rate is
    the largest constant one at which some ξ and A fulfil the limits at all phases; between such
    stretches it changes smoothly, and where that takes too much acceleration it is lowered further.

    The motion of the `preview` is looked at for a `duration` in s. The three numbers after it are
    those of a `ReferenceGovernorConfig`; `can_plan` tells whether plans of ξ and A, of a `config`,
    are an option. The believed `winds` count for aircraft.
    """
    config = timed(config, limits.frequency, model.control_period)
    feasibility = OrbitFeasibility(model, limits, config, name)
    spacing = _SPACING
    if model.aircraft is not None:
        spacing = max(spacing, 2 * math.pi / limits.frequency / _IN_A_TURN)
    path = spacing * np.arange(math.ceil(duration / spacing) + 1)
    references = preview.at(path)
    nothing = np.zeros(0)
    met = winds(path, references)  # on time

    def holds(rates: NDArray, chosen: NDArray) -> NDArray:
        constant = np.column_stack([rates, np.zeros((len(rates), 2))])
        return feasibility.holds(stretched_reference(references[chosen], constant), met[chosen])

    every = np.arange(len(path))
    slow = every[~holds(np.ones(len(path)), every)]
    if len(slow) == 0 or (
        can_plan and _is_planned(model, limits, preview, duration, config, name, winds)
    ):
        return Stretching(None, nothing, nothing)
    feasibility = OrbitFeasibility(model, limits, config, name, _RESERVE)
    most = np.full(len(path), largest_rate)
    delay: PathDelay | None = None
    for _ in range(_MOST_PASSES):
        slow = every[~holds(np.ones(len(path)), every)]
        is_helped = holds(np.zeros(len(slow)), slow) if len(slow) else np.ones(0, dtype=bool)
        not_at_rest, slow = path[slow[~is_helped]], slow[is_helped]
        low, high = np.full(len(slow), least_rate), np.ones(len(slow))
        is_enough = holds(low, slow) if len(slow) else np.ones(0, dtype=bool)
        too_fast = path[slow[~is_enough]]
        if len(slow) == 0:
            break
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            is_low = holds(middle, slow)
            low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
        limit = np.ones(len(path))
        if largest_rate > 1:
            limit[holds(np.full(len(path), largest_rate), every)] = largest_rate
        limit[slow] = low
        limit = most = np.minimum(limit, most)
        delay = _delay(limit, spacing, duration, largest_rate, change_time)
        late = np.interp(path, path - delay.at(path)[:, 0], path)  # when the load is there
        before, met = met, winds(late, references)
        if np.abs(met - before).max() <= _SAME_WIND:
            break
    if delay is None:
        return Stretching(None, too_fast, not_at_rest)
    for left in reversed(range(_MOST_ROUNDS + 1)):
        stretched = delay.stretched(preview, path)
        found = feasibility.holds(stretched, winds(path, stretched))
        behind = np.round((path - delay.at(path)[:, 0]) / spacing).astype(int)
        missed = np.setdiff1d(behind[~found], np.round(not_at_rest / spacing).astype(int))
        wrong = missed[limit[missed] > least_rate]
        if left == 0 or len(wrong) == 0:
            too_fast = np.union1d(too_fast, path[missed])
            break
        near = wrong[:, None] + np.arange(-_NEIGHBOURS, _NEIGHBOURS + 1)
        near = np.unique(np.clip(near, 0, len(path) - 1))
        limit[near] = np.maximum(_FURTHER * np.minimum(limit[near], 1.0), least_rate)
        delay = _delay(limit, spacing, duration, largest_rate, change_time)
    return Stretching(delay, too_fast, not_at_rest)


def _is_planned(
    model: Model,
    limits: LimitsConfig,
    preview: ReferencePreview,
    duration: float,
    config: HorizonConfig,
    name: Callable[[], str],
    winds: Winds,
) -> bool:
    """Whether plans over a receding horizon fulfil the limits, with half of the bound's margin."""
    bound, tolerance = limits.speed_bound, limit_tightening(limits)  # of squared speeds
    intervals = math.ceil(duration / config.knot_spacing)
    problem = HorizonProblem(model, limits, config, name)

    def wind(times: NDArray) -> NDArray:
        return winds(times, preview.at(times))

    flown, _ = receding_coefficients(
        problem, preview, intervals, bound, wind=lambda time: wind(np.array([time]))[0]
    )
    whole = dataclasses.replace(config, horizon=intervals * config.knot_spacing)
    problem = HorizonProblem(model, limits, whole, name)
    data = problem.data(0.0, 0.0, preview, bound, wind=wind(problem.instants))
    margins = problem.linearization(data, flown).margins
    return bool(np.min(margins) >= -tolerance)


def _delay(
    limit: NDArray, between: float, duration: float, largest_rate: float, change_time: float
) -> PathDelay:
    """The delay of a rate that stays at or below limits (k,), so many s apart along the path.

    Spline coefficients of the rate are chosen one after the other: each is the least limit on
    the part of the path where it counts, and above 1 only as far as there is delay to catch up.
    """
    step = between / change_time
    limit = limit.copy()
    for k in range(1, len(limit)):
        limit[k] = min(limit[k], limit[k - 1] + step)
    for k in range(len(limit) - 2, -1, -1):
        limit[k] = min(limit[k], limit[k + 1] + step)
    spacing = change_time / _KNOTS
    count = math.ceil(duration / spacing)
    rates = np.zeros(count + _ORDER + 1)
    sums = np.zeros(len(rates) + 1)
    for j in range(_ORDER - 2, count + _ORDER - 2):
        start = spacing * (j - (_ORDER - 2))  # from when on the coefficient counts
        sums[j] = sums[j - 1] + rates[j - 1]
        delay = spacing * float(_AT_KNOTS @ sums[j - _ORDER + 2 : j + 1])
        first = (start - delay) / between
        last = first + (_ORDER - 1) * spacing * largest_rate / between
        window = limit[max(math.floor(first), 0) : math.ceil(last) + 1]
        highest = min(largest_rate, 1 + delay / (_CATCHING_UP * spacing))
        rates[j] = 1 - min(float(np.min(window, initial=highest)), highest)
    return PathDelay(spacing, rates)
