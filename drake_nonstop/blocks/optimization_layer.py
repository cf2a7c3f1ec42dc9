"""Box "Optimization Layer" of the figure."""

import math
import time
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import Context

from drake_nonstop.blocks.nlp_layer import NlpLayer, NlpLayerConfig
from drake_nonstop.blocks.receding_horizon import (
    RecedingHorizonOptimizer,
    RecedingHorizonOptimizerConfig,
)
from drake_nonstop.blocks.speed_bound_layer import (
    BOX,
    COMMAND,
    WIND,
    CommandedBound,
    SpeedBoundLayer,
    shown_bound,
)
from drake_nonstop.blocks.turn_rate_optimizer import TurnRateOptimizer, TurnRateOptimizerConfig
from drake_nonstop.mechanics.signals import WRENCH_SIZE
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.diagnostics import Outcome, update_count
from drake_nonstop.optimization.problem_config import (
    LEAST_BOUND,
    NonstopProblemConfig,
    SpeedBound,
    check_problem,
    with_stated_bound,
)
from drake_nonstop.optimization.update_solver import UpdateSolver
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.validation import (
    StrictFields,
    checked,
    positive,
    require,
    require_non_negative,
    require_positive,
    require_ranges,
)


@dataclass(kw_only=True)
class NonstopOptimizerConfig(NonstopProblemConfig):
    """The bound, the problem of eqs. 24-26 and how it is solved.

    What `min_separation` and the solvers cost is said in docs/layers_in_detail.md.
    """


class NonstopOptimizer(SpeedBoundLayer):
    """Changes ξ and A as little as keeps every carrier at or above ε (eqs. 23-26).

    At each update, with x = [ξ, A] and x⁻ the previous value,

        min J(x)  such that  ‖v_i(x, τ)‖² ≥ ((1 + tightening) ε)²,  i = 1 … n,

    at instants τ up to the next update and at phases of the orbit `look_ahead_time` after it,
    optionally together with limits of tensions, speeds, separations and of the rates of ξ and A. x⁻
    is what the layer has asked for before, and not what is flown: behind a `ShapedPhase` ξ and A
    follow a step within 6.4/bandwidth but for 5 %, which is the default of that time. Without
    `amplitude_bounds` A stays between 0.004 and 3 times a cable's share of the load's weight, or
    half and twice the initial A where that is wider. `tightening` covers the difference between
    predicted and simulated speeds. Of aircraft v_i is the velocity through the air, in the steady
    wind that the controllers believe, and what they need of lift, bank, climb and thrust may be
    limited, too; other carriers' speeds are those over the ground. If x⁻ fulfils the constraints it
    is kept; else `solver` looks for the cheapest x that does, and where none is found the least
    infeasible one is taken. `diagnostics` tells how the update ended, see `Outcome`. The
    prediction, the constraints and the solvers are described in docs/layers_in_detail.md.

    `set_speed_bound` and `set_enabled` change parameters of the context during a run, which also
    holds the initial ξ and A, their bounds and what is believed of load, cables and pattern. Where
    `speed_bound_command` is connected it is ε, read at each update. The bound rises gradually, and
    a layer that is switched off leads ξ and A back to their initial values, both within about
    `change_time`.

    Converted to AutoDiffXd or Expression the layer holds ξ and A, and an update raises
    ScenarioError: it solves with floating-point numbers only.

    Without `wind_estimate`, which is there with aircraft, the air is still. `diagnostics` are the
    fields of `Diagnostics`; `missed_limits` tells how many updates ended without keeping each limit
    that is asked for, of aircraft also the bound. All outputs are state or parameters: nothing
    feeds through but a command to the `speed_bound`.

    Raises:
        ScenarioError: a parameter is out of range, or the period is no multiple of the
            control period; during a run, the command is out of range.
    """

    reads = (
        "measured_load_state",
        "reference",
        "wrench",
        "wrench_rate",
        "phase",
        WIND,
        COMMAND,
    )

    def requires(self, loop: LoopBlocks) -> Iterator[str]:
        """Tells of aircraft that it keeps above a speed bound, and within no limit of theirs."""
        yield from super().requires(loop)
        is_unlimited = math.isinf(self.config.max_lift_share)
        if is_unlimited and loop.reads("carrier_dynamics", "aircraft_command"):
            yield (
                "optimization_layer.max_lift_share = inf: the layer may ask of aircraft what they "
                "cannot fly; give at most the lift_share of carrier_controller, such as 0.85, and "
                "max_bank and max_thrust_share, or optimization_layer: !ConstantParameters"
            )

    def __init__(self, model: Model, config: NonstopOptimizerConfig | None = None):
        super().__init__(model, config)
        config = self.config
        if self.scalar is float:
            self.solver = UpdateSolver(model, config, self.get_name)
        self._share_of_steps = config.period / config.change_time
        self._times = {"period": config.period, "change_time": config.change_time}

    def parts(self, model: Model, config: Any) -> dict[str, ArrayLike]:
        """The parameters, and what the next update needs of the last one."""
        return {
            "parameters": [config.frequency, config.amplitude],
            "last_wrench_rate": np.zeros(WRENCH_SIZE),
            "bound_in_force": config.speed_bound,
            "is_changing": 0.0,
        }

    @classmethod
    def check(cls, model: Model, config: NonstopOptimizerConfig) -> None:
        """Raises ScenarioError for a config that cannot be used with the model."""
        check_problem(BOX, config, model)

    def begin_anew(self, context: Context) -> None:
        """Lets what has not been updated begin with the parameters of the context, its own."""
        states = self.states(context)
        if update_count(states["diagnostics"]) > 0 or states["is_changing"][0] > 0:
            return
        numbers = self._numbers_in(context)
        begun = {"parameters": numbers.nominal, "bound_in_force": numbers.speed_bound}
        context.SetDiscreteState(self.flat(states | begun))

    def answer(self, context: Context) -> NDArray:
        """The state after an update."""
        states, numbers = self.states(context), self._numbers_in(context)
        wrench_rate = self.input(context, "wrench_rate")
        previous, bound = states["parameters"], float(self.bound_in(context)[0])
        if not self.is_enabled(context):
            return self.flat(
                states
                | {
                    "parameters": step_towards(previous, numbers.nominal, **self._times),
                    "bound_in_force": 0.0,
                    "is_changing": 1.0,
                    "last_wrench_rate": wrench_rate,
                }
            )
        last_bound, is_changing = states["bound_in_force"][0], states["is_changing"][0] > 0
        is_rising = last_bound < bound
        if is_rising:
            bound = raised_bound(last_bound, bound, **self._times)
        updates = update_count(states["diagnostics"])
        last_rate = states["last_wrench_rate"] if updates else wrench_rate
        start = time.perf_counter()
        data = self.solver.update_data(
            previous=previous,
            phase=self.input(context, "phase"),
            load_state=self.input(context, "measured_load_state"),
            reference=self.input(context, "reference"),
            wrench=self.input(context, "wrench"),
            wrench_rate=wrench_rate,
            wrench_second_rate=(wrench_rate - last_rate) / self.config.period,
            wind=self.input(context, WIND),
            speed_bound=bound,
            updates=updates,
            beliefs=numbers.beliefs,
        )
        parameters, outcome, slowest_speed = self.solver.solve(data)
        if is_changing or is_rising:
            parameters, is_limited = limit_step(
                previous, parameters, numbers.nominal * self._share_of_steps
            )
            if is_limited:
                outcome = Outcome.RELAXED
                slowest_speed = self.solver.problem(data).slowest_speed(parameters)
            is_changing = is_rising or outcome > Outcome.SOLVED
        solve_time = time.perf_counter() - start
        missed: Collection[str] = ()
        if self.counted and outcome > Outcome.SOLVED:
            missed = self.solver.problem(data).missed_kinds(parameters)
        made = {
            "parameters": parameters,
            "last_wrench_rate": wrench_rate,
            "solve_time": solve_time,
            "bound_in_force": bound,
            "is_changing": float(is_changing),
        }
        counts = self.counted_update(states, outcome, slowest_speed - bound, missed)
        return self.flat(states | made | counts)


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


@dataclass(kw_only=True)
class ConstantParametersConfig(StrictFields):
    """The internal force's parameters, and the bound with which the metrics compare speeds."""

    frequency: float = positive(2.0)  # rad/s, ξ
    amplitude: float = 1.2  # N, A; 0 for a constant pattern, and for no other
    # m/s, ε; reported, not enforced; also "1.4 V_s"
    speed_bound: SpeedBound = checked(0.2, require_non_negative)


class ConstantParameters(CommandedBound):
    """Constant ξ and A: the loop without optimization.

    Nothing enforces the `speed_bound`: the `speed_bound_command`, or else what `set_speed_bound`
    changes during a run.

    Raises:
        ScenarioError: frequency or amplitude is not positive, an amplitude is given for a pattern
            without orbits, or the bound is negative; during a run, the command is negative.
    """

    reads = ("speed_bound_command",)
    makes = ("parameters", "speed_bound")

    is_trivial = True  # ξ and A never change
    is_sampled = True
    optional_inputs = (COMMAND,)

    def __init__(self, model: Model, config: ConstantParametersConfig | None = None):
        super().__init__(model, with_stated_bound(BOX, config or ConstantParametersConfig(), model))

    @classmethod
    def check(cls, model: Model, config: ConstantParametersConfig) -> None:
        """Raises ScenarioError for a config that cannot be used with the model."""
        require_ranges(BOX, config)
        if model.pattern.is_constant:
            require(
                config.amplitude == 0,
                f"{BOX}.amplitude",
                config.amplitude,
                "the pattern has no orbits that it could size; give 0, or a pattern with orbits",
            )
        else:
            require_positive(f"{BOX}.amplitude", config.amplitude)

    def check_bound(self, speed_bound: float, name: str = "speed_bound") -> None:
        """Raises ScenarioError for a negative bound (m/s)."""
        require_non_negative(f"{BOX}.{name}", speed_bound)

    @staticmethod
    def equations(
        command: NDArray, *, frequency: NDArray, amplitude: NDArray, speed_bound: NDArray
    ) -> tuple[NDArray, NDArray]:
        return np.concatenate([frequency, amplitude]), shown_bound(command, speed_bound)


# The blocks that the box can be, the default first.
VARIANTS = (
    RecedingHorizonOptimizer,
    NonstopOptimizer,
    TurnRateOptimizer,
    NlpLayer,
    ConstantParameters,
)

__all__ = [
    "RecedingHorizonOptimizer",
    "RecedingHorizonOptimizerConfig",
    "NonstopOptimizer",
    "NonstopOptimizerConfig",
    "TurnRateOptimizer",
    "TurnRateOptimizerConfig",
    "NlpLayer",
    "NlpLayerConfig",
    "ConstantParameters",
    "ConstantParametersConfig",
]
