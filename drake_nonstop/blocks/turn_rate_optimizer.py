"""The variant of box "Optimization Layer" for a load that turns with its aircraft."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import Context

from drake_nonstop.blocks import load_trajectory, phase
from drake_nonstop.blocks.speed_bound_layer import BOX, WIND, PeriodicLayer
from drake_nonstop.model.block import (
    BlockParameters,
    required_aircraft,
)
from drake_nonstop.model.descriptions import TurnRate
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.constraints import Constraints
from drake_nonstop.optimization.problem_config import (
    AircraftLimits,
    SpeedBound,
    above_zero,
    below_one,
    check_flight_limits,
    check_initial,
    check_samples,
    check_speed_bound,
    points,
)
from drake_nonstop.optimization.turn_rate import TurnRateSolver, turn_update
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.validation import (
    StrictFields,
    checked,
    non_negative,
    positive,
    require,
    require_period,
    require_ranges,
)


@dataclass(kw_only=True)
class _Turn(StrictFields):
    speed_bound: SpeedBound = checked(10.0, check_speed_bound)  # m/s, ε; also "1.4 V_s"
    tightening: float = non_negative(0.01, below_one)  # the solver aims at (1 + tightening) ε
    frequency: float = positive(0.4)  # rad/s, ξ at the start
    frequency_bounds: list[float] = field(default_factory=lambda: [0.1, 2.0])  # rad/s
    max_frequency_rate: float = checked(0.005, above_zero)  # rad/s²


@dataclass(kw_only=True)
class TurnRateOptimizerConfig(AircraftLimits, _Turn):
    """The bound on the airspeed, the limits of the aircraft, and the rate of the turn."""

    max_lift_share: float = checked(0.85, above_zero)  # of C_Lmax, what aircraft need at most
    max_bank: float = checked(0.85, above_zero)  # rad, of aircraft, to either side
    # of the range of an aircraft's thrust, about its middle
    max_thrust_share: float = checked(1.0, above_zero)
    anchor_weight: float = non_negative(0.0)  # of the distance from the initial ξ
    orbit_points: int = points(16, 64)  # phases of a turn at which all this holds
    period: float = checked(0.04, require_period)  # s, between updates


class TurnRateOptimizer(PeriodicLayer):
    """Changes ξ, at which a load turns with its aircraft, as little as keeps them flying.

    Of a pattern without orbits, `ConstantSpread`, and a load that turns at ξ, `PlannedTurn`. At
    each update, with the last value ξ⁻,

        min (ξ − ξ⁻)² + w (ξ − ξ₀)²  such that  ‖v_i − w‖ ≥ (1 + tightening) ε,  i = 1 … n,

    and the limits of lift, bank, climb and thrust are kept, at even phases of a whole turn of the
    load at ξ, with the present motion of its reference and the present wrench. The squared airspeed
    is quadratic in ξ; the set of all that is allowed is a few intervals, see
    `optimization.turn_rate`. Where it is empty ξ is the least infeasible one; the airspeed comes
    first.

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
        points = self.config.orbit_points
        self._solver = TurnRateSolver(model, Constraints(self.config), points)

    def parts(self, model: Model, config: Any) -> dict[str, ArrayLike]:
        """The parameters."""
        return {"parameters": [config.frequency, 0.0]}

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        """The bound, which a context can change."""
        return BlockParameters(model, config=config, own=("speed_bound",))

    def describe_response(self) -> TurnRate:
        def updated(period: float, rate: float, motion: NDArray, *others: NDArray) -> float:
            config = replace(self.config, period=period)
            update = turn_update(config, float(config.speed_bound), rate, motion, *others)
            return self._solver.solve(update).rate

        return TurnRate(self.config.frequency, self.config.period, updated)

    def answer(self, context: Context) -> NDArray:
        """The state after an update."""
        states, bound = self.states(context), float(self.bound_in(context)[0])
        signals = [self.input(context, name) for name in self.reads]
        update = turn_update(self.config, bound, states["parameters"][0], *signals)
        start = time.perf_counter()
        answer = self._solver.solve(update)
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
        check_samples(BOX, config.period, model)
