"""Whether any ξ and A keep a task's bound on the speeds and its limits, and what else would."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.analysis.carriers_along import carriers_along
from drake_nonstop.analysis.flight_envelope import LimitAlong
from drake_nonstop.analysis.task import Task
from drake_nonstop.mechanics.bowed_orbit import BowedMotion
from drake_nonstop.mechanics.planned_orbit import OrbitMotion, squared_gaps
from drake_nonstop.mechanics.signals import constant_plan
from drake_nonstop.planning.carriers import motion_above, orbit_terms
from drake_nonstop.planning.horizon_config import HorizonConfig
from drake_nonstop.planning.horizon_problem import TERMINAL_KNOTS, HorizonData, HorizonProblem
from drake_nonstop.planning.horizon_solver import HorizonSolver, receding_coefficients
from drake_nonstop.planning.limits import Of, asked
from drake_nonstop.planning.plan import Plan
from drake_nonstop.planning.problem_config import (
    amplitude_range,
    limit_tightening,
    tightened_bound,
)
from drake_nonstop.validation import ScenarioError

_TIMES = 60  # of a task, at which constant ξ and A are tried
_GRID = (24, 12)  # values of ξ and of A among them
_PHASES = 24  # of an orbit
_FINE = 0.01  # s, at least, between instants at which a plan's speeds are judged
_COARSE = 2  # by which a plan has fewer instants, at first
_FURTHER_STARTS = ((2.0, 1.0), (1.0, 2.0), (3.0, 0.5), (1.5, 1.5))  # of nominal ξ and A
_QUICK_STARTS = 2
_STARTS_FOR_LIMITS = 3  # where one keeps the bound, for the sake of other limits
_MAX_ITERATIONS, _TOLERANCE = 40, 1e-4
_FACTORS = (1.1, 1.25, 1.5, 2.0, 3.0)
_WIDER = 4.0  # bounds, at most
_BISECTIONS = 6
_EASED = (1.0, 1.1, 1.3)  # times what a plan reaches, limits that are tried
_RESERVE = 0.7  # of what the layer aims at above the bound; carriers may need it to follow
_SHOWN = 2.5  # times the plan's largest value, of the set over time


class SpeedCheck(NamedTuple):
    """Speeds that a task allows, in units of the bound ε; inf where there is no bound."""

    speed_bound: float  # m/s, ε
    times: NDArray  # (k,), s
    constant: NDArray  # (k,), the best of all constant ξ, A, of the least speed over an orbit
    plan: Plan | None  # the best one; None where ξ and A are constant
    plan_times: NDArray  # (l,), s
    parameters: NDArray  # (l, 2), [ξ (rad/s), A (N)] of the plan
    ratios: NDArray  # (l, n), of the carriers along it
    starts: tuple[float, ...]  # the least ratio of what the optimization made of each start
    target_ratio: float = 1.0  # the ratio that the layer aims at
    limits: tuple[LimitAlong, ...] = ()  # that the layer is asked for, along the plan

    @property
    def least(self) -> float:
        """The least ratio along the plan."""
        return float(self.ratios.min())

    @property
    def least_at(self) -> tuple[float, int]:
        """When that is, s, and of which carrier, from 1 on."""
        instant, carrier = np.unravel_index(np.argmin(self.ratios), self.ratios.shape)
        return float(self.plan_times[instant]), int(carrier) + 1

    @property
    def is_feasible(self) -> bool:
        """Whether the plan keeps the bound."""
        return self.least >= 1

    @property
    def is_in_doubt(self) -> bool:
        """Whether a plan keeps the bound with less than carriers may need to follow it."""
        return self.plan is not None and 1 <= self.least < 1 + _RESERVE * (self.target_ratio - 1)

    @property
    def of_limits(self) -> float:
        """The least margin of the other limits, of each, at most 0."""
        return min([0.0, *(limit.margin for limit in self.limits)])

    @property
    def missed(self) -> tuple[LimitAlong, ...]:
        """The other limits that the plan does not keep."""
        return tuple(limit for limit in self.limits if not limit.is_kept)

    @property
    def tight_times(self) -> NDArray:
        """The times (j,), s, at which no constant ξ and A keep the bound at all phases."""
        return self.times[self.constant < 1]


class SpeedRemedy(NamedTuple):
    """A change with which the bound was found to be kept."""

    text: str
    least: float  # v/ε that is reached


def check_speeds(task: Task, *, is_quick: bool = False) -> SpeedCheck:
    """The least speeds that a task can be flown with.

    At each of some instants all constant ξ and A within the bounds are tried, at all phases of the
    orbit: what they keep is on the safe side. The judge is a smooth plan of the whole task with
    predicted phases: of what the optimization makes of several starts it is the one with
    the largest least speed. Where ξ and A are constant, that is all there is. `is_quick` is to try
    two starts only, for changes of a task of which any may help.

    Raises:
        ScenarioError: a carrier's speed is not finite.
    """
    bound = task.limits.speed_bound
    times = np.linspace(0, task.duration, _TIMES)
    is_limited = bound > 0 or any(asked(task.limits))
    if not task.changes_parameters or not is_limited:
        fine = _fine_times(task)
        planned = task.planned(None, fine)
        parameters = planned[:, 1:3]
        speeds = constant_speeds(task, fine)
        ratios = _ratios(speeds, bound)
        least = np.interp(times, fine, ratios.min(axis=1))
        starts: tuple[float, ...] = (float(ratios.min()),)
        limits = _limits_in_turn(task, fine, planned)
        return SpeedCheck(
            bound, times, least, None, fine, parameters, ratios, starts, limits=limits
        )
    problem = problem_of(task)
    constant = np.full(len(times), np.inf)
    if bound > 0:
        speeds = feasible_speeds(problem, task, times, *_grid(task, *_GRID))
        constant = speeds.max(axis=(1, 2)) / bound
    found = _planned(task, most=_QUICK_STARTS if is_quick else None)
    best = max(found, key=lambda each: (min(each.least, 1.0), each.of_limits, each.least))
    starts = tuple(each.least for each in found)
    return best._replace(times=times, constant=constant, starts=starts)


def _ratios(speeds: NDArray, bound: float) -> NDArray:
    return speeds / bound if bound > 0 else np.full(speeds.shape, np.inf)


def _limits_in_turn(task: Task, times: NDArray, planned: NDArray) -> tuple[LimitAlong, ...]:
    """The limits of aircraft whose load turns at a ξ that a layer changes, see `Task.planned`."""
    aircraft, asked_for = task.flown.aircraft, [*asked(task.limits, Of.FLIGHT)]
    if task.turn is None or aircraft is None or not asked_for:
        return ()
    carriers = carriers_along(task, times)
    needs = carriers.needs(carriers.motion(planned))
    return tuple(
        LimitAlong(limit, stated, times, limit.values(aircraft, needs))
        for limit, stated in asked_for
    )


def feasible_speeds(
    problem: HorizonProblem, task: Task, times: NDArray, frequencies: NDArray, amplitudes: NDArray
) -> NDArray:
    """The least speed (k, x, a), m/s, over an orbit, of constant ξ (k, x) and A (k, a) at times."""
    angles, least = 2 * np.pi * np.arange(_PHASES) / _PHASES, []
    for time, of_xi, of_A in zip(times, frequencies, amplitudes, strict=True):
        tried = np.stack([part.ravel() for part in np.meshgrid(of_xi, of_A, indexing="ij")])
        orbits = constant_plan(np.tile(angles, tried.shape[1]), *np.repeat(tried, _PHASES, axis=1))
        squares = problem.squared_speeds(orbits.T, task.reference(time), task.counted_wind(time))
        shape = len(of_xi), len(of_A), -1
        least.append(squares.min(axis=0).reshape(shape).min(axis=-1))
    return np.sqrt(np.maximum(np.stack(least), 0.0))


def set_over_time(
    task: Task, found: SpeedCheck, column: int, count: int = 120
) -> tuple[NDArray, NDArray, NDArray] | None:
    """Times (k,), ξ or A (c,), and the least v/ε (k, c) over an orbit beside the plan's other one.

    `column` is 0 for ξ and 1 for A. None: there is no bound, or the pattern has no such set.
    """
    if task.limits.speed_bound == 0 or task.model.pattern.is_constant:
        return None
    times = np.linspace(0, task.duration, count)
    used = np.stack(
        [np.interp(times, found.plan_times, values) for values in found.parameters.T], axis=1
    )
    bounds = [task.limits.frequency_bounds, amplitude_range(task.limits, task.model)][column]
    most = min(bounds[1], _SHOWN * found.parameters[:, column].max())
    values = np.linspace(bounds[0], max(most, bounds[0] * 1.01), count)
    tried, others = np.tile(values, (count, 1)), used[:, 1 - column, None]
    problem = problem_of(task)
    if column == 0:
        ratios = feasible_speeds(problem, task, times, tried, others)[:, :, 0]
    else:
        ratios = feasible_speeds(problem, task, times, others, tried)[:, 0]
    return times, values, ratios / task.limits.speed_bound


def constant_speeds(task: Task, times: NDArray) -> NDArray:
    """The carriers' speeds (k, n), m/s, at times (k,), with the nominal ξ and A; any pattern."""
    model, winds = task.model, [task.wind_at(time) for time in times]
    references = np.array([task.reference(time) for time in times])
    terms = orbit_terms(model, references, np.array(winds))
    velocities = motion_above(model, terms, task.planned(None, times)).velocities
    if task.counts_wind:
        velocities = velocities - np.array(winds)[:, None]
    return np.linalg.norm(velocities, axis=-1)


def find_speed_remedies(task: Task, found: SpeedCheck) -> list[SpeedRemedy]:
    """Remedies that keep the bound of an infeasible task, each tried.

    That are a layer that changes ξ and A, other bounds of them, a faster orbit at the start, longer
    cables, slower motion, and the largest ε that can be kept.
    """
    remedies = []
    if not task.changes_parameters and not task.model.pattern.is_constant:
        layer = replace(task, changes_parameters=True)
        said = "a layer that changes xi and A: optimization_layer=RecedingHorizonOptimizer"
        if (remedy := _tried(layer, said)) is not None:
            remedies.append(remedy)
    remedies += _wider_bounds(task)
    for make in (_faster_start, _longer_cables, _slower_motion):
        remedies += itertools.islice(_of_factors(partial(make, task)), 1)
    remedies += _lower_bound(task, found)
    return remedies


def _grid(task: Task, count: int, amplitude_count: int) -> tuple[NDArray, NDArray]:
    """ξ and A within their bounds, the nominal ones among them, the same (1, x) and (1, a)."""
    low, high = task.limits.frequency_bounds
    frequencies = np.append(np.geomspace(low, high, count - 1), task.limits.frequency)
    low, high = amplitude_range(task.limits, task.model)
    amplitudes = np.append(np.linspace(low, high, amplitude_count - 1), task.limits.amplitude)
    return np.tile(frequencies, (_TIMES, 1)), np.tile(amplitudes, (_TIMES, 1))


def _fine_times(task: Task) -> NDArray:
    spacing = max(_FINE, task.horizon.knot_spacing / task.horizon.instants / 2)
    return np.linspace(0, task.duration, max(2, math.ceil(task.duration / spacing) + 1))


def problem_of(task: Task, config: HorizonConfig | None = None) -> HorizonProblem:
    """The problem of a task's plans, of its horizon or of another one."""
    config = config or task.horizon
    shape = task.response.references.shape
    return HorizonProblem(task.model, task.limits, config, shape=shape)


class _Along:
    """Motion of a task's carriers under a plan, at fine times."""

    def __init__(self, task: Task):
        self.times, self._task = _fine_times(task), task
        self._carriers = carriers_along(task, self.times)

    def planned(self, plan: Plan) -> SpeedCheck:
        """All that is known of a plan, without other starts and without constant ξ and A."""
        values = self._task.planned(plan, self.times)
        straight = self._carriers.motion(values)
        bowed = self._carriers.bowed(values, straight)
        speeds = self._values(Of.SPEED, straight, bowed)
        bound = self._task.limits.speed_bound
        ratios = _ratios(speeds, bound)
        none = np.zeros(0)
        return SpeedCheck(
            *(bound, none, none, plan, self.times, values[:, 1:3], ratios, ()),
            target_ratio=tightened_bound(self._task.limits, bound) / bound if bound > 0 else 1.0,
            limits=tuple(self._limits(straight, bowed)),
        )

    def _values(self, of: Of, straight: OrbitMotion, bowed: BowedMotion | None) -> NDArray:
        """Speeds, tensions or separations (k, c) of the carriers, cables or pairs, m/s, N or m."""
        carriers, motion = self._carriers, straight if bowed is None else bowed.motion
        if of is Of.TENSION:  # at the load
            return np.linalg.norm(straight.forces, axis=-1)
        if of is Of.SEPARATION:
            pairs = np.array(np.triu_indices(carriers.believed.n, 1))
            return np.sqrt(squared_gaps(motion.positions, pairs))
        velocities = motion.velocities
        if self._task.counts_wind:
            velocities = velocities - carriers.winds[:, None]
        return np.linalg.norm(velocities, axis=-1)

    def _limits(self, straight: OrbitMotion, bowed: BowedMotion | None) -> Iterator[LimitAlong]:
        aircraft = self._task.flown.aircraft
        for limit, stated in asked(self._task.limits):
            if limit.is_of_aircraft and aircraft is not None:
                found = limit.values(aircraft, self._carriers.needs(straight, bowed))
            else:
                found = self._values(limit.of, straight, bowed)
            yield LimitAlong(limit, stated, self.times, found)


def _planned(task: Task, *, most: int | None) -> list[SpeedCheck]:
    """Optimizes one start after the other, until a plan keeps all limits.

    Where one keeps the bound on the speeds alone, few others are tried.
    """
    spacing = task.horizon.knot_spacing
    intervals = max(TERMINAL_KNOTS, round(task.duration / spacing))
    whole = replace(task.horizon, intervals=intervals)
    coarse = replace(whole, instants=max(2, whole.instants // _COARSE))
    bound = task.limits.speed_bound
    along: _Along | None = None
    found: list[SpeedCheck] = []
    for config in (coarse, whole):
        problem = problem_of(task, config)
        along = along or _Along(task)
        nominal = along.planned(
            Plan(0.0, 0.0, spacing, problem.nominal, problem.nominal_coefficients())
        )
        if task.changes_parameters and not (nominal.is_feasible and not nominal.missed):
            # A layer then starts with others.
            problem = problem_of(task, replace(config, fixed_coefficients=0))
        solver = HorizonSolver(problem)
        winds = np.array([task.planned_wind(time) for time in problem.times(0.0)])
        data = problem.data(0.0, 0.0, task.reference, bound, wind=winds)
        for start in _starts(task, solver, data, intervals):
            answer = solver.solve(data, start, max_iterations=_MAX_ITERATIONS, tolerance=_TOLERANCE)
            found.append(along.planned(answer.plan))
            is_enough = len(found) >= _STARTS_FOR_LIMITS and any(p.is_feasible for p in found)
            is_good = found[-1].is_feasible and not found[-1].missed
            if is_good or is_enough or len(found) == most:
                return found
    return found


def _starts(
    task: Task, solver: HorizonSolver, data: HorizonData, intervals: int
) -> Iterator[NDArray]:
    """Coefficients to begin with: constant ones, what a receding horizon makes, and others."""
    problem = solver.problem
    yield solver.first_guess(data)
    yield problem.nominal_coefficients()
    receding = problem_of(task)
    bound = task.limits.speed_bound
    yield receding_coefficients(receding, task.reference, intervals, bound, wind=task.planned_wind)[
        0
    ]
    for factors in _FURTHER_STARTS:
        start = problem.nominal_coefficients()
        start[:, solver.fixed :] *= np.array(factors)[:, None]
        yield start


def _tried(task: Task, text: str) -> SpeedRemedy | None:
    """The remedy, if the task keeps its bound and its limits."""
    try:
        found = check_speeds(task, is_quick=True)
    except ScenarioError:  # a formation that cannot be
        return None
    return SpeedRemedy(text, found.least) if found.is_feasible and not found.missed else None


def _with_limits(task: Task, **fields: object) -> Task:
    return replace(task, limits=dataclasses.replace(task.limits, **fields))  # type: ignore[arg-type]


def find_limit_remedies(task: Task, found: SpeedCheck) -> list[SpeedRemedy]:
    """The values of missed limits, near those that a plan reaches, with which all are kept."""

    def eased(factor: float) -> tuple[Task, str]:
        fields = {}
        for each in found.missed:
            side, tightening = each.limit.side, limit_tightening(task.limits)
            value = each.worst / (1 + side * tightening) * factor**-side
            fields[each.limit.field] = _rounded(value, -side)
        said = " and ".join(f"optimization_layer.{name}={at:g}" for name, at in fields.items())
        return _with_limits(task, **fields), said

    return list(itertools.islice(_of_factors(eased, _EASED), 1))


def _wider_bounds(task: Task) -> Iterator[SpeedRemedy]:
    """Bounds of ξ and A as far as a plan with much wider ones needs them."""
    if not task.changes_parameters:
        return
    of_amplitude = amplitude_range(task.limits, task.model)
    low, high = task.limits.frequency_bounds
    wide = _with_limits(
        task,
        frequency_bounds=[low / _WIDER, high * _WIDER],
        amplitude_bounds=[of_amplitude[0] / _WIDER, of_amplitude[1] * _WIDER],
    )
    found = check_speeds(wide, is_quick=True)
    if not found.is_feasible:
        return
    assert found.plan is not None
    used = found.plan.coefficients * found.plan.nominal[:, None]
    bounds = [
        [_rounded(min(low, row.min()), -1), _rounded(max(high, row.max()), 1)]
        for row, (low, high) in zip(used, [(low, high), of_amplitude], strict=True)
    ]
    text = (
        f"optimization_layer.frequency_bounds={bounds[0]} and "
        f"optimization_layer.amplitude_bounds={bounds[1]}"
    )
    remedy = _tried(
        _with_limits(task, frequency_bounds=bounds[0], amplitude_bounds=bounds[1]), text
    )
    if remedy is not None:
        yield remedy


def _rounded(value: float, side: int) -> float:
    """To three digits, towards a side."""
    digits = 2 - math.floor(math.log10(abs(value)))
    scaled = value * 10.0**digits
    return float(f"{(math.ceil if side > 0 else math.floor)(scaled) / 10.0**digits:.3g}")


def _of_factors(
    make: Callable[[float], tuple[Task, str] | None], factors: tuple[float, ...] = _FACTORS
) -> Iterator[SpeedRemedy]:
    for factor in factors:
        try:
            made = make(factor)
        except ScenarioError:
            continue
        if made is not None and (remedy := _tried(*made)) is not None:
            yield remedy


def _faster_start(task: Task, factor: float) -> tuple[Task, str] | None:
    frequency = _rounded(factor * task.limits.frequency, 1)
    if task.changes_parameters and frequency > task.limits.frequency_bounds[1]:
        return None
    changed = _with_limits(task, frequency=frequency)
    return changed, f"optimization_layer.frequency={frequency:g}"


def _longer_cables(task: Task, factor: float) -> tuple[Task, str]:
    lengths = [_rounded(factor * length, 1) for length in np.ravel(task.model.cable_length)]
    length: Any = lengths if isinstance(task.model.system.cable_length, list) else lengths[0]
    return task.changed(cable_length=length), f"system.cable_length={length}"


def _slower_motion(task: Task, factor: float) -> tuple[Task, str]:
    return task.slowed(factor), f"a motion of the load {factor:g} times as slow"


def _lower_bound(task: Task, found: SpeedCheck) -> Iterator[SpeedRemedy]:
    """The largest ε that is kept, by bisection."""
    bound = task.limits.speed_bound

    def least(speed_bound: float) -> float:
        return check_speeds(_with_limits(task, speed_bound=speed_bound), is_quick=True).least

    low, high, reached = 0.98 * min(found.least, 1.0) * bound, bound, 0.0
    if low < 1e-3 or (reached := least(low)) < 1:
        return
    if not task.changes_parameters:
        low = found.least * bound
        reached = 1.0
    else:
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            value = least(middle)
            if value >= 1:
                low, reached = middle, value
            else:
                high = middle
    shown = math.floor(low * 1e4) / 1e4
    yield SpeedRemedy(f"optimization_layer.speed_bound={shown:g}", reached)
