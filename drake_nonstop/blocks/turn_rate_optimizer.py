"""The variant of box "Optimization Layer" for a load that turns with its aircraft.

The carriers keep their places above the load. At each phase of a turn the squared airspeed is
quadratic in the rate, and what the aircraft need is smooth in it: the search is one over intervals
of one number.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import Context

from drake_nonstop.blocks import load_trajectory, phase
from drake_nonstop.blocks.speed_bound_layer import BOX, WIND, PeriodicLayer
from drake_nonstop.mechanics.planned_orbit import needs_of_motion, orbit_motion, turning_terms
from drake_nonstop.model.block import BlockParameters, required_aircraft
from drake_nonstop.model.system import Model
from drake_nonstop.planning.constraints import FEASIBILITY_TOLERANCE, Constraints
from drake_nonstop.planning.diagnostics import BOUND, Outcome
from drake_nonstop.planning.limits import Of
from drake_nonstop.planning.problem_config import (
    AircraftLimits,
    SpeedBound,
    above_zero,
    below_one,
    check_flight_limits,
    check_initial,
    check_speed_bound,
    points,
    require_samples,
)
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.validation import (
    checked,
    non_negative,
    positive,
    require,
    require_period,
    require_ranges,
)

_RATES, _RELAXED_RATES = 32, 64  # at which margins are looked at, and the least infeasible one
_TOLERANCE = 1e-6  # relative, of a rate
_END_STEPS, _END_TOLERANCE = 40, 1e-9  # of the iteration to an end of an interval


@dataclass(kw_only=True)
class TurnRateOptimizerConfig(AircraftLimits):
    """The bound on the airspeed, the limits of the aircraft, and the rate of the turn."""

    speed_bound: SpeedBound = checked(10.0, check_speed_bound)  # m/s, ε; also "1.4 V_s"
    tightening: float = non_negative(0.01, below_one)  # the solver aims at (1 + tightening) ε
    frequency: float = positive(0.4)  # rad/s, ξ at the start
    frequency_bounds: list[float] = field(default_factory=lambda: [0.1, 2.0])  # rad/s
    max_frequency_rate: float = checked(0.005, above_zero)  # rad/s²
    max_lift_share: float = checked(0.85, above_zero)  # of C_Lmax, what aircraft need at most
    max_bank: float = checked(0.85, above_zero)  # rad, of aircraft, to either side
    # of the range of an aircraft's thrust, about its middle
    max_thrust_share: float = checked(1.0, above_zero)
    anchor_weight: float = non_negative(0.0)  # of the distance from the initial ξ
    orbit_points: int = points(16, 64)  # phases of a turn at which all this holds
    period: float = checked(0.04, require_period)  # s, between updates


class TurnAnswer(NamedTuple):
    """The answer of one update."""

    rate: float  # rad/s
    outcome: Outcome
    slowest_speed: float  # m/s, predicted, through the air
    missed: list[str]  # names of limits, as of `missed_limits`


class TurnRateSolver:
    """Changes the rate as little as keeps the airspeed and the limits of aircraft over a turn."""

    def __init__(self, model: Model, config: TurnRateOptimizerConfig):
        self._model, self._config, self._constraints = model, config, Constraints(config)
        self._angles = 2 * np.pi * np.arange(config.orbit_points) / config.orbit_points

    def margins(
        self, speed_bound: float, rates: NDArray, signals: tuple[NDArray, ...]
    ) -> tuple[NDArray, NDArray]:
        """The worst margin (1 + limits, k) of the airspeed and of each limit, at rates (k,).

        And the least airspeed (k,), m/s. The bound is tightened; 0: there is none. The signals are
        the load's motion (22,), its wrench (6,) and the rate of it, and the wind (3,).
        """
        model, count = self._model, len(self._angles)
        assert model.aircraft is not None
        *of_load, wind = signals
        terms = turning_terms(
            *of_load,  # type: ignore[misc]  # three arrays
            rates=np.repeat(rates, count),
            angles=np.tile(self._angles, len(rates)),
            pseudo_inverse=model.pseudo_inverse,
            offset=model.pattern.offset,
        )
        cables = {"rest_length": model.cable_length, "compliance": model.cable_compliance}
        # A pattern without amplitude.
        motion = orbit_motion(terms, 0.0, attachments=model.attachments, **cables)
        needs = needs_of_motion(model.aircraft, motion, wind)
        squares, unit = needs.airspeed * needs.airspeed, speed_bound or 1.0
        of_limits = self._constraints.of_flight(model.aircraft, needs)
        margins = [(squares - speed_bound**2) / unit**2, *of_limits]
        worst = [margin.reshape(len(rates), -1).min(axis=1) for margin in margins]
        return np.stack(worst), np.sqrt(squares.reshape(len(rates), -1).min(axis=1))

    def solve(
        self, speed_bound: float, last: float, *signals: NDArray, period: float = 0.0
    ) -> TurnAnswer:
        """The answer of one update, for ε in m/s, the last rate in rad/s, and a period in s.

        The period is the config's where it is 0; the signals are those of `margins`.
        """
        config = self._config
        bound, weight = (1 + config.tightening) * speed_bound, config.anchor_weight
        step = config.max_frequency_rate * (period or config.period)
        least, most = config.frequency_bounds
        low, high = max(least, last - step), min(most, last + step)
        wanted = min(max((last + weight * config.frequency) / (1 + weight), low), high)

        def answer(rate: float, found: Outcome, unchanged: Outcome) -> TurnAnswer:
            margins, (slowest,) = self.margins(bound, np.array([rate]), signals)
            kinds = np.array([BOUND, *self._constraints.names(Of.FLIGHT)])
            missed = kinds[margins[:, 0] < -FEASIBILITY_TOLERANCE].tolist()
            outcome = unchanged if abs(rate - last) <= _TOLERANCE * last else found
            return TurnAnswer(rate, outcome, float(slowest), missed)

        at_wanted = answer(wanted, Outcome.SOLVED, Outcome.KEPT)
        if not at_wanted.missed:
            return at_wanted
        previous = min(max(last, low), high)
        rates = np.sort(np.append(np.geomspace(low, high, _RATES).clip(low, high), previous))
        ends = allowed_ends(lambda r: self.margins(bound, r, signals)[0].min(axis=0), rates)
        if ends:
            nearest = min(ends, key=lambda rate: abs(rate - wanted))
            return answer(nearest, Outcome.SOLVED, Outcome.SOLVED)
        rates = np.append(np.geomspace(low, high, _RELAXED_RATES), previous)
        margins, _ = self.margins(bound, rates, signals)
        # The speeds come first, and where they are kept what lacks the least.
        order = np.lexsort([margins.min(axis=0), np.minimum(margins[0], 0.0)])
        return answer(float(rates[order[-1]]), Outcome.RELAXED, Outcome.HELD)


def allowed_ends(margins: Callable[[NDArray], NDArray], rates: NDArray) -> list[float]:
    """The ends of the intervals, from the first of rates (k,) to the last, of margins ≥ 0.

    Intervals between two neighbours, of which neither is allowed, are not looked for.
    """
    values = margins(rates)
    allowed = values >= 0
    ends = rates[[0, -1]][allowed[[0, -1]]].tolist()
    for i in np.flatnonzero(allowed[1:] != allowed[:-1]):
        inside, outside = (i, i + 1) if allowed[i] else (i + 1, i)
        inner, outer = ((float(rates[j]), float(values[j])) for j in (inside, outside))
        ends.append(_end(margins, inner, outer))
    return ends


def _end(
    margins: Callable[[NDArray], NDArray],
    inside: tuple[float, float],
    outside: tuple[float, float],
) -> float:
    """The last allowed rate from `inside` to `outside`: (rate, margin) each.

    Regula falsi with the weights of Illinois (M. Dowell and P. Jarratt, BIT 11, 1971, 168-174).
    """
    (low, low_margin), (high, high_weight) = inside, outside
    low_weight, was_allowed = low_margin, None
    for _ in range(_END_STEPS):
        if abs(high - low) <= _END_TOLERANCE * low or low_margin <= _END_TOLERANCE:
            break
        share = low_weight / (low_weight - high_weight)
        middle = low + (share if 0 < share < 1 else 0.5) * (high - low)
        value = float(margins(np.array([middle]))[0])
        is_allowed = value >= 0
        factor = 0.5 if is_allowed == was_allowed else 1.0  # an end that stays twice counts half
        if is_allowed:
            low, low_margin, low_weight, high_weight = middle, value, value, factor * high_weight
        else:
            high, high_weight, low_weight = middle, value, factor * low_weight
        was_allowed = is_allowed
    return low


class TurnRateOptimizer(PeriodicLayer):
    """Changes ξ, at which a load turns with its aircraft, as little as keeps them flying.

    Of a pattern without orbits, `ConstantSpread`, and a load that turns at ξ, `PlannedTurn`. At
    each update, with the last value ξ⁻,

        min (ξ − ξ⁻)² + w (ξ − ξ₀)²  such that  ‖v_i − w‖ ≥ (1 + tightening) ε,  i = 1 … n,

    and the limits of lift, bank, climb and thrust are kept, at even phases of a whole turn of the
    load at ξ, with the present motion of its reference and the present wrench. The set of all that
    is allowed is a few intervals. Where it is empty ξ is the least infeasible one; the airspeed
    comes first.

    A of the `parameters` is 0. `diagnostics` are the fields of `Diagnostics`; `missed_limits` tells
    how many updates ended without keeping the bound, and each limit that is asked for. All outputs
    are state or parameters.

    Raises:
        ScenarioError: the system has no aircraft, a parameter is out of range, or the period is no
            multiple of the control period.
    """

    reads = ("reference", "wrench", "wrench_rate", "wind_estimate")

    where: ClassVar = {}  # the carriers are aircraft
    optional_inputs = (WIND,)

    def requires(self, loop: LoopBlocks) -> Iterator[str]:
        """Raises ScenarioError where the load does not turn at the rate that it makes."""
        require(
            loop.believed.pattern.is_constant,
            BOX,
            "TurnRateOptimizer",
            "the pattern has orbits, which it does not size; give pattern: !ConstantSpread and "
            "load_trajectory: !PlannedTurn, or another optimization_layer",
        )
        trajectory, shaper = loop.get("load_trajectory"), loop.get("phase")
        require(
            not isinstance(trajectory, load_trajectory.VARIANTS)
            or isinstance(trajectory, load_trajectory.PlannedTurn),
            "load_trajectory",
            type(trajectory).__name__,
            "the load does not turn at the rate that optimization_layer = TurnRateOptimizer makes; "
            "give !PlannedTurn, and phase: !ShapedPhase, or another optimization_layer",
        )
        require(
            not isinstance(shaper, phase.VARIANTS) or isinstance(shaper, phase.ShapedPhase),
            "phase",
            type(shaper).__name__,
            "its ξ has no rates, which the load's turn follows; give !ShapedPhase",
        )
        yield from super().requires(loop)

    def __init__(self, model: Model, config: TurnRateOptimizerConfig | None = None):
        required_aircraft(model, BOX, "TurnRateOptimizer")
        super().__init__(model, config)
        self._solver = TurnRateSolver(model, self.config)

    def parts(self, model: Model, config: Any) -> dict[str, ArrayLike]:
        """The parameters."""
        return {"parameters": [config.frequency, 0.0]}

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        """The bound, which a context can change."""
        return BlockParameters(model, config=config, own=("speed_bound",))

    def answer(self, context: Context) -> NDArray:
        """The state after an update."""
        states, bound = self.states(context), float(self.bound_in(context)[0])
        signals = [self.input(context, name) for name in self.reads]
        start = time.perf_counter()
        answer = self._solver.solve(bound, float(states["parameters"][0]), *signals)
        solve_time = time.perf_counter() - start
        margin = answer.slowest_speed - bound
        made = {"parameters": [answer.rate, 0.0], "solve_time": solve_time}
        counts = self.counted_update(states, answer.outcome, margin, answer.missed)
        return self.flat(states | made | counts)

    @classmethod
    def check(cls, model: Model, config: TurnRateOptimizerConfig) -> None:
        """Raises ScenarioError for a config that cannot be used with the model."""
        require_ranges(BOX, config)
        check_flight_limits(BOX, config, model.aircraft)
        check_initial(BOX, "frequency", config.frequency, config.frequency_bounds)
        require_samples(f"{BOX}.period", config.period, model)
