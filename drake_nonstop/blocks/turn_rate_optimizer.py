"""The variant of box "Optimization Layer" for a load that turns with its aircraft."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues

from drake_nonstop.blocks import load_trajectory, phase
from drake_nonstop.blocks.speed_bound_layer import BOX
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    WIND_SIZE,
    WRENCH_SIZE,
)
from drake_nonstop.model.block_parameters import (
    AIRCRAFT_NUMBERS,
    BlockParameters,
    Rules,
    required_aircraft,
)
from drake_nonstop.model.system import OFFSET, Model
from drake_nonstop.optimization.diagnostics import (
    DIAGNOSTICS_SIZE,
    LAYER_LAYOUTS,
    count_missed,
    count_update,
    missed_layout,
    missed_limits_of,
)
from drake_nonstop.optimization.flight_limits import FlightLimits
from drake_nonstop.optimization.problem_config import (
    AircraftLimits,
    SpeedBound,
    check_flight_limits,
    check_speed_bound,
    require_limit,
    with_stated_bound,
)
from drake_nonstop.optimization.turn_rate import TurnRateSolver, turn_update
from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.systems.parameters import declare_parameters
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.validation import (
    StrictFields,
    require,
    require_array,
    require_non_negative,
    require_period,
    require_positive,
)

_WIND = "wind_estimate"  # an optional input
_FIXED = (*AIRCRAFT_NUMBERS, "cable_stiffness", OFFSET)


@dataclass(kw_only=True)
class _Turn(StrictFields):
    speed_bound: SpeedBound = 10.0  # m/s, ε; also "1.4 V_s"
    tightening: float = 0.01  # the solver aims at (1 + tightening) ε
    frequency: float = 0.4  # rad/s, ξ at the start
    frequency_bounds: list[float] = field(default_factory=lambda: [0.1, 2.0])  # rad/s
    max_frequency_rate: float = 0.005  # rad/s²


@dataclass(kw_only=True)
class TurnRateOptimizerConfig(AircraftLimits, _Turn):
    """The bound on the airspeed, the limits of the aircraft, and the rate of the turn."""

    max_lift_share: float = 0.85  # of C_Lmax, what aircraft need at most
    max_bank: float = 0.85  # rad, of aircraft, to either side
    max_thrust_share: float = 1.0  # of the range of an aircraft's thrust, about its middle
    anchor_weight: float = 0.0  # of the distance from the initial ξ
    orbit_points: int = 16  # phases of a turn at which all this holds
    period: float = 0.04  # s, between updates


class TurnRateOptimizer(LeafBlock):
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
    makes = ("parameters", "diagnostics", "solve_time", "speed_bound", "missed_limits")

    is_sampled = True
    signal_layouts = LAYER_LAYOUTS
    optional_inputs = (_WIND,)

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
        yield from ()

    def __init__(self, model: Model, config: TurnRateOptimizerConfig | None = None):
        super().__init__()
        required_aircraft(model, BOX, "TurnRateOptimizer")
        config = with_stated_bound(BOX, config or TurnRateOptimizerConfig(), model)
        _check(model, config)
        self._config = config
        self.parameters = BlockParameters(
            model, config=config, own=("speed_bound",), rules=Rules(check=_check, fixed=_FIXED)
        )
        declare_parameters(self, self.parameters)
        self._solver = TurnRateSolver(model, FlightLimits(config), config.orbit_points)
        self._reference = self.DeclareVectorInputPort("reference", LOAD_REFERENCE_SIZE)
        self._wrench = self.DeclareVectorInputPort("wrench", WRENCH_SIZE)
        self._wrench_rate = self.DeclareVectorInputPort("wrench_rate", WRENCH_SIZE)
        self._wind = self.DeclareVectorInputPort(_WIND, WIND_SIZE)
        self._state = self.DeclareDiscreteState([config.frequency, 0.0])
        self._diagnostics = self.DeclareDiscreteState(DIAGNOSTICS_SIZE)
        self._solve_time = self.DeclareDiscreteState(1)
        self._counted = missed_limits_of(config, model)
        self._missed = self.DeclareDiscreteState(len(self._counted))
        self.DeclareStateOutputPort("parameters", self._state)
        self.DeclareStateOutputPort("diagnostics", self._diagnostics)
        self.DeclareStateOutputPort("solve_time", self._solve_time)
        self.DeclareVectorOutputPort(
            "speed_bound",
            1,
            lambda context, output: output.SetFromVector(
                context.get_numeric_parameter(0).CopyToVector()
            ),
            {self.all_parameters_ticket()},
        )
        self.DeclareStateOutputPort("missed_limits", self._missed)
        self.signal_layouts = {"missed_limits": missed_layout(self._counted)}
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        self._sample_period = model.control_period or config.period
        self._samples_per_update = round(config.period / self._sample_period)
        self.DeclarePeriodicDiscreteUpdateEvent(
            self._sample_period, self._sample_period, self._update_at_sample
        )

    def _update_at_sample(self, context: Context, discrete_state: DiscreteValues) -> None:
        if round(context.get_time() / self._sample_period) % self._samples_per_update == 0:
            self._update(context, discrete_state)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        self.require_floats(
            "give ConstantParameters, with its frequency and amplitude 0, in place of "
            "TurnRateOptimizer"
        )
        (previous, _) = context.get_discrete_state(self._state).CopyToVector()
        bound = float(context.get_numeric_parameter(0).CopyToVector()[0])
        wind = np.zeros(WIND_SIZE)
        if self._wind.HasValue(context):
            wind = self._wind.Eval(context)
        update = turn_update(
            self._config,
            bound,
            previous,
            self._reference.Eval(context),
            self._wrench.Eval(context),
            self._wrench_rate.Eval(context),
            wind,
        )
        start = time.perf_counter()
        answer = self._solver.solve(update)
        solve_time = time.perf_counter() - start
        diagnostics = context.get_discrete_state(self._diagnostics).CopyToVector()
        count_update(diagnostics, answer.outcome, answer.slowest_speed - bound)
        missed = context.get_discrete_state(self._missed).CopyToVector()
        count_missed(missed, self._counted, answer.missed)
        discrete_state.set_value(self._state, [answer.rate, 0.0])
        discrete_state.set_value(self._diagnostics, diagnostics)
        discrete_state.set_value(self._solve_time, [solve_time])
        discrete_state.set_value(self._missed, missed)


def _check(model: Model, config: TurnRateOptimizerConfig) -> None:
    require_positive(BOX, frequency=config.frequency, period=config.period)
    require_non_negative(BOX, tightening=config.tightening, anchor_weight=config.anchor_weight)
    require(config.tightening < 1, f"{BOX}.tightening", config.tightening, "give less than 1")
    require_period(f"{BOX}.period", config.period)
    check_speed_bound(BOX, config.speed_bound)
    require_limit(BOX, "max_frequency_rate", config.max_frequency_rate, 0.0)
    check_flight_limits(BOX, config, model.aircraft)
    bounds = config.frequency_bounds
    low, high = require_array(f"{BOX}.frequency_bounds", bounds, [2], "lower, upper")
    require(
        0 < low <= config.frequency <= high,
        f"{BOX}.frequency_bounds",
        bounds,
        f"give bounds above zero that hold the initial frequency {config.frequency}",
    )
    require(
        isinstance(config.orbit_points, int) and 1 <= config.orbit_points <= 64,
        f"{BOX}.orbit_points",
        config.orbit_points,
        "give 1 to 64",
    )
    if model.control_period > 0:
        ratio = config.period / model.control_period
        require(
            round(ratio) >= 1 and abs(ratio - round(ratio)) < 1e-9,
            f"{BOX}.period",
            config.period,
            f"give a multiple of the control period {model.control_period}",
        )
