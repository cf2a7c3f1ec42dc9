"""A governor that slows the load's trajectory down where no ξ and A keep the limits with it.

The trajectory p(s(t)) is flown in a time of its own s = t − d(t). It is looked at before the run:
where no constant ξ and A keep the limits at all phases of the orbit, its rate ṡ is the largest at
which some do. Between such stretches the rate changes smoothly, and where that takes too much
acceleration it is lowered further. Plans of ξ and A may find a way through a faster motion; they
are not looked for. A reference governor in the sense of Garone, Di Cairano and Kolmanovsky,
Automatica 75 (2017), by time scaling.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import BsplineBasis
from pydrake.systems.framework import System
from pydrake.trajectories import BsplineTrajectory

from drake_nonstop.mechanics.planned_orbit import OrbitMotion, squared_gaps
from drake_nonstop.mechanics.reference_preview import (
    ReferencePreview,
    stretched,
    stretched_higher_rates,
)
from drake_nonstop.mechanics.signals import constant_plan
from drake_nonstop.model.block import Block, signal_sizes
from drake_nonstop.model.system import Model
from drake_nonstop.planning.carriers import motion_above, orbit_terms
from drake_nonstop.planning.constraints import Constraints
from drake_nonstop.planning.limits import Of
from drake_nonstop.planning.problem_config import (
    LimitsConfig,
    amplitude_range,
    tightened_bound,
    with_fields_of,
)
from drake_nonstop.systems.wiring import output_names
from drake_nonstop.validation import (
    ScenarioError,
    StrictFields,
    fulfilling,
    require,
    require_ranges,
)

_FIELD = "reference_governor"
_PREVIEW = "reference_preview"
_SPACING = 0.1  # s, of the instants along path and time at which orbits are looked at
_KNOTS = 5  # between knots of the rate, in `change_time`
_BISECTIONS = 7
_MOST_ROUNDS = 12  # of slowing down further where a changing rate asks for it
_RESERVE = 0.02  # of the bound, which ξ and A need to change at all
_FURTHER = 0.93  # by which the rate is then lowered, and
_NEIGHBOURS = 4  # how many instants on either side
_BATCH = 400  # instants at a time: bounds the memory
_ROUNDING = 9  # digits of references, to find equal ones
_ORDER = 5  # of the delay's spline: of fourth degree
_AT_KNOTS = np.array([1, 11, 11, 1]) / 24  # its value at a knot by its coefficients
_PHASES, _CLOSE_PHASES = 16, 64  # of an orbit, at which speeds and separations are looked at
_AMPLITUDES = 17


@dataclass(kw_only=True)
class ReferenceGovernorConfig(StrictFields):
    """How far, and how smoothly, a `ReferenceGovernor` slows the load's trajectory down."""

    least_rate: float = fulfilling(  # of the trajectory's time by real time
        0.2, lambda rate: 0.01 <= rate <= 1, "give 0.01 to 1"
    )
    change_time: float = fulfilling(  # s, in which the rate changes by 1 at the fastest
        2.0, lambda time: time >= 0.1, "give at least 0.1 s"
    )


def orbits_hold(
    model: Model, limits: LimitsConfig, references: NDArray, reserve: float = 0.0
) -> NDArray:
    """Whether constant ξ and A within their bounds keep all limits at all phases of the orbit.

    Truth values (k,) for references (k, 22). Speeds have to be above the bound by a share `reserve`
    of it.
    """
    elsewhere = np.delete(np.round(references, _ROUNDING), [4, 5, 6], axis=1)  # equal at rest
    _, first, number = np.unique(elsewhere, axis=0, return_index=True, return_inverse=True)
    parts = np.array_split(references[first], math.ceil(len(first) / _BATCH))
    found = [_unlike_orbits_hold(model, limits, part, reserve) for part in parts]
    return np.concatenate(found)[number.ravel()]


def _unlike_orbits_hold(
    model: Model, limits: LimitsConfig, references: NDArray, reserve: float
) -> NDArray:
    """The truth values (k,) of `orbits_hold`.

    The velocities of carriers are affine in s = A ξ. At each of some A the speeds therefore bound s
    to an interval, the roots of quadratic equations; tensions and separations depend on A alone.
    """
    constraints, pairs = Constraints(limits), np.array(np.triu_indices(model.n, 1))
    bound = (1 + reserve) * tightened_bound(limits, limits.speed_bound)
    terms = orbit_terms(model, references[:, None])
    found = np.zeros(len(references), dtype=bool)

    def motion(product: float, phases: int = _PHASES) -> OrbitMotion:
        """The motion (k, phases, ...) of A, and of A ξ in N/s."""
        angles = 2 * np.pi * np.arange(phases) / phases
        return motion_above(model, terms, constant_plan(angles, product / A, A))

    smallest, largest = amplitude_range(limits, model)
    for A in np.linspace(smallest, largest, _AMPLITUDES).tolist():
        at_rest = motion(0.0)
        v_0, v_1 = at_rest.velocities, motion(1.0).velocities - at_rest.velocities
        a, b, c = ((x * y).sum(axis=-1) for x, y in ((v_1, v_1), (v_0, v_1), (v_0, v_0)))
        low, high = (A * frequency for frequency in limits.frequency_bounds)
        bounds = []  # of s, at each phase and carrier: the larger root of ‖v‖² = speed²
        for speed in (bound, constraints.max_speed):
            square = np.maximum(b * b - a * (c - speed * speed), 0)
            bounds.append(np.where(square > 0, (np.sqrt(square) - b) / a, 0))
        least, most = bounds[0].max(axis=(1, 2)), bounds[1].min(axis=(1, 2))
        is_kept = np.maximum(least, low) <= np.minimum(most, high)
        margins = constraints.of_squares(Of.TENSION, (at_rest.forces**2).sum(axis=-1))
        if constraints.min_separation > 0:
            gaps = squared_gaps(motion(0.0, _CLOSE_PHASES).positions, pairs)
            margins += constraints.of_squares(Of.SEPARATION, gaps)
        for margin in margins:
            is_kept &= margin.min(axis=(1, 2)) >= 0
        found |= is_kept
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

    def stretched(self, preview: ReferencePreview) -> ReferencePreview:
        """The preview of the motion that is behind by d; exact, also its rates."""

        def own(times: NDArray) -> tuple[NDArray, NDArray]:
            """The motion's own times s (k,), and four rates (k, 4) of s."""
            delays = self.at(times)
            return times - delays[:, 0], np.array([1.0, 0.0, 0.0, 0.0]) - delays[:, 1:]

        def references(times: NDArray) -> NDArray:
            s, rates = own(times)
            return stretched(preview.at(s), rates)

        def higher_rates(time: float) -> NDArray:
            assert preview.higher_rates is not None
            (s,), (rates,) = own(np.array([time]))
            return stretched_higher_rates(preview(s), preview.higher_rates(s), rates)

        return ReferencePreview(
            lambda time: references(np.array([time]))[0],
            references=references,
            higher_rates=higher_rates,
        )


def delay_of(
    model: Model,
    limits: LimitsConfig,
    preview: ReferencePreview,
    duration: float,
    config: ReferenceGovernorConfig,
) -> PathDelay | None:
    """How a motion has to be slowed down for limits to hold, looked at for a duration in s.

    None: no instant needs it, or a load at rest would not keep the limits at one that does. Where
    the least rate is too fast, it is flown.
    """
    path = _SPACING * np.arange(math.ceil(duration / _SPACING) + 1)
    references = preview.at(path)
    slow = np.flatnonzero(~orbits_hold(model, limits, references, _RESERVE))

    def holds(rates: NDArray) -> NDArray:
        """Whether limits hold at these instants, each passed at a constant rate (k,)."""
        constant = np.column_stack([rates, np.zeros((len(rates), 3))])
        return orbits_hold(model, limits, stretched(references[slow], constant), _RESERVE)

    if orbits_hold(model, limits, references).all() or not holds(np.zeros(len(slow))).all():
        return None
    low, high = np.full(len(slow), config.least_rate), np.ones(len(slow))
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        is_low = holds(middle)
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    limit = np.ones(len(path))
    limit[slow] = low
    for _ in range(_MOST_ROUNDS):
        delay = _delay(limit, duration, config.change_time)
        is_kept = orbits_hold(model, limits, delay.stretched(preview).at(path), _RESERVE)
        behind = np.round((path - delay.at(path)[:, 0]) / _SPACING).astype(int)
        missed = behind[~is_kept]
        wrong = missed[limit[missed] > config.least_rate]
        if len(wrong) == 0:
            break
        near = wrong[:, None] + np.arange(-_NEIGHBOURS, _NEIGHBOURS + 1)
        near = np.unique(np.clip(near, 0, len(path) - 1))
        limit[near] = np.maximum(_FURTHER * limit[near], config.least_rate)
    return delay


def _delay(limit: NDArray, duration: float, change_time: float) -> PathDelay:
    """The delay of a rate that stays at or below limits (k,), `_SPACING` apart along the path.

    Spline coefficients of the rate are chosen one after the other: each is the least limit on
    the part of the path where it counts.
    """
    step, limit = _SPACING / change_time, limit.copy()
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
        first = (start - delay) / _SPACING
        last = first + (_ORDER - 1) * spacing / _SPACING
        window = limit[max(math.floor(first), 0) : math.ceil(last) + 1]
        rates[j] = 1 - np.min(window, initial=1.0)
    return PathDelay(spacing, rates)


class ReferenceGovernor(Block):
    """The load's trajectory p(s(t)), in a time of its own s = t − d(t).

    It takes the place of the trajectory's block; a motion that needs no governor stays as it is, to
    the bit. The delay d follows before the run from ε and the other limits of the optimization
    layer's config; later changes of ε and of what is believed of load and cables do not change it.
    Velocities, accelerations and the jerk are exact; the snap steps at the knots of d.

    Args:
        preview: of the trajectory, with its higher rates.
        delay: d.

    Raises:
        ScenarioError: the time of a context of AutoDiffXd has derivatives.
    """

    makes = ("reference", "reference_higher_rates", _PREVIEW, "reference_delay")

    def __init__(self, preview: ReferencePreview, delay: PathDelay):
        ahead: Any = delay.stretched(preview)
        self._ahead = ahead
        self._rows: dict[str, Callable[[NDArray], NDArray]] = {
            "reference": ahead.at,
            "reference_higher_rates": lambda times: np.stack([*map(ahead.higher_rates, times)]),
            "reference_delay": lambda times: delay.at(times)[:, :1],
        }
        super().__init__(None)

    @staticmethod
    def equations(*signals: NDArray) -> tuple[NDArray, ...]:
        return signals

    def fixed_outputs(self) -> Mapping[str, Any]:
        return {_PREVIEW: self._ahead}

    def quantities(self, model: Model) -> Mapping[str, int]:
        return signal_sizes(self, model, self._rows)

    def precomputed_inputs(self, names: Sequence[str], times: NDArray) -> list[NDArray]:
        """Rows of the signals at times (k,), s."""
        return [self._rows[name](times) for name in names]

    def precomputed_input_rates(self, names: Sequence[str], times: NDArray) -> list[NDArray]:
        """Raises ScenarioError: they are not known."""
        raise ScenarioError(
            f"time of {self.box()} = a number with derivatives: the governor does not "
            f"differentiate its references by time; leave {_FIELD} out"
        )


def governed(
    model: Model, config: ReferenceGovernorConfig, trajectory: System, layer: Any, duration: float
) -> System:
    """The `ReferenceGovernor` of a trajectory; the trajectory itself where none is needed.

    For the believed model, the config of the layer, and a duration in s of the motion.

    Raises:
        ScenarioError: a parameter cannot be used, the carriers are aircraft or have no orbits, or
            the trajectory does not tell its motion.
    """
    require_ranges(_FIELD, config)
    remedy = "give one with orbits, or leave this out: these carriers' speeds are the turn's"
    require(not model.pattern.is_constant, _FIELD, "with this pattern", remedy)
    remedy = "it does not know what aircraft need; leave it out, and give a slower motion"
    require(model.aircraft is None, _FIELD, "with system.aircraft", remedy)
    preview: Any = None
    if _PREVIEW in output_names(trajectory) and trajectory.num_input_ports() == 0:
        preview = trajectory.GetOutputPort(_PREVIEW).Eval(trajectory.CreateDefaultContext())
    is_known = isinstance(preview, ReferencePreview) and preview.end_time == np.inf
    said = f"with load_trajectory = {type(trajectory).__name__}"
    remedy = f"give this block, without inputs, an output {_PREVIEW} of a ReferencePreview with "
    is_known = is_known and preview.higher_rates is not None
    require(is_known, _FIELD, said, remedy + "higher_rates that is known for ever, of end_time inf")
    limits = with_fields_of(LimitsConfig, layer)
    if not hasattr(layer, "frequency_bounds"):  # ξ and A are constant
        limits.frequency_bounds = [limits.frequency] * 2
        limits.amplitude_bounds = [limits.amplitude] * 2
    delay = delay_of(model, limits, preview, duration, config)
    return trajectory if delay is None else ReferenceGovernor(preview, delay)
