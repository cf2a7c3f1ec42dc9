"""Box "Optimization Layer" of the figure."""

import functools
import math
import pickle
import time
from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import casadi
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import BasicVector, Context

from drake_nonstop.blocks.nlp_layer import NlpLayer, NlpLayerConfig
from drake_nonstop.blocks.receding_horizon import (
    RecedingHorizonOptimizer,
    RecedingHorizonOptimizerConfig,
)
from drake_nonstop.blocks.speed_bound_layer import (
    BOX,
    COMMAND,
    CommandedBound,
    SpeedBoundLayer,
)
from drake_nonstop.blocks.turn_rate_optimizer import TurnRateOptimizer, TurnRateOptimizerConfig
from drake_nonstop.mechanics.signals import PARAMETERS_SIZE, WRENCH_SIZE
from drake_nonstop.model.block import BlockParameters
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.diagnostics import Diagnostics, Outcome, update_count
from drake_nonstop.optimization.problem_config import (
    LEAST_BOUND,
    NonstopProblemConfig,
    SpeedBound,
    check_problem,
    with_stated_bound,
)
from drake_nonstop.optimization.update_data import UpdateData
from drake_nonstop.optimization.update_solver import UpdateSolver, traced_tightened
from drake_nonstop.systems.diagram_trace import FastUpdate, InContext, TraceContext
from drake_nonstop.systems.parameters import declare_parameters
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.systems.tracing import where
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
        "wind_estimate",
        "speed_bound_command",
    )

    def requires(self, loop: LoopBlocks) -> Iterator[str]:
        """Tells of aircraft that it keeps above a speed bound, and within no limit of theirs."""
        yield from super().requires(loop)
        is_unlimited = math.isinf(self.parameters.config.max_lift_share)
        if is_unlimited and loop.reads("carrier_dynamics", "aircraft_command"):
            yield (
                "optimization_layer.max_lift_share = inf: the layer may ask of aircraft what they "
                "cannot fly; give at most the lift_share of carrier_controller, such as 0.85, and "
                "max_bank and max_thrust_share, or optimization_layer: !ConstantParameters"
            )

    def __init__(self, model: Model, config: NonstopOptimizerConfig | None = None):
        super().__init__(model, config)
        config = self._config
        if self.scalar is float:
            self.solver = UpdateSolver(model, config, self.get_name)
        self._share_of_steps = config.period / config.change_time
        self._times = {"period": config.period, "change_time": config.change_time}
        self._period = config.period
        self.declare(
            config.period,
            parameters=[config.frequency, config.amplitude],
            last_wrench_rate=np.zeros(WRENCH_SIZE),
            bound_in_force=[config.speed_bound],
            is_changing=np.zeros(1),
        )

    @classmethod
    def check(cls, model: Model, config: NonstopOptimizerConfig) -> None:
        """Raises ScenarioError for a config that cannot be used with the model."""
        check_problem(BOX, config, model)

    @property
    def trace_key(self) -> Any:
        """Fields of the config that the check of an update depends on."""
        timing = self._period, self._sample_period, self._samples_per_update
        return pickle.dumps((self.solver.trace_key, timing))

    def trace_parameters(self, context: Context) -> NDArray:
        """The bounds (2,), 1 where enabled, `UpdateSolver.tightening` (3,), `ModelParameters`."""
        bounds, numbers = super().trace_parameters(context), self._numbers_in(context)
        enabled = [float(self.is_enabled(context))]
        return np.concatenate([bounds, enabled, self.solver.tightening, numbers.beliefs])

    def traced_fast_update(self, at: TraceContext) -> FastUpdate:
        """The states after a sample that keeps the parameters."""
        _, enabled, tightening, beliefs = np.split(at.parameters, [2, 3, 6])
        states, bound = self.states(at), self.traced_bound(at)
        target_speed = traced_tightened(bound, tightening)
        updates = Diagnostics(*states["diagnostics"]).updates
        data = UpdateData(
            **self._motion(at, states),
            speed_bound=target_speed,
            speed_unit=where(bound[0] > 0, target_speed, np.ones(1)),
            orbit_turn=np.zeros(1),
            anchor_weight=np.zeros(1),
            beliefs=beliefs,
        )
        is_kept, slowest_speed = self.solver.traced_check(data, updates)
        conditions = [
            is_kept,
            enabled[0] == 1,
            bound[0] == states["bound_in_force"][0],
            states["is_changing"][0] == 0,
            updates > 0,
        ]
        is_update, margin = self.is_update(at.time[0]), slowest_speed - bound[0]
        after = states | {
            "diagnostics": self.counted(states, Outcome.KEPT, margin)["diagnostics"],
            "solve_time": np.zeros(1),
            "last_wrench_rate": data.wrench_rate,
        }
        return FastUpdate(
            states=[where(is_update, after[name], states[name]) for name in states],
            is_valid=casadi.logic_or(
                functools.reduce(casadi.logic_and, conditions), casadi.logic_not(is_update)
            ),
        )

    def _motion(
        self, at: TraceContext | InContext, states: dict[str, NDArray]
    ) -> dict[str, NDArray]:
        """Parts of `UpdateData` that are states and inputs."""
        wrench_rate = at.input("wrench_rate")
        return {
            "previous": states["parameters"],
            "phase": at.input("phase"),
            "load_state": at.input("measured_load_state"),
            "reference": at.input("reference"),
            "wrench": at.input("wrench"),
            "wrench_rate": wrench_rate,
            "wrench_second_rate": (wrench_rate - states["last_wrench_rate"]) / self._period,
            "wind": self.wind(at),
        }

    def begin_anew(self, context: Context) -> None:
        """Lets what has not been updated begin with the parameters of the context, its own."""
        states = self.states(InContext(self, context))
        if update_count(states["diagnostics"]) > 0 or states["is_changing"][0] > 0:
            return
        numbers = self._numbers_in(context)
        context.SetDiscreteState(self._groups["parameters"], numbers.nominal)
        context.SetDiscreteState(self._groups["bound_in_force"], [numbers.speed_bound])

    def updated(self, context: Context) -> Mapping[str, ArrayLike]:
        """The states after an update."""
        at, numbers = InContext(self, context), self._numbers_in(context)
        states, wrench_rate = self.states(at), at.input("wrench_rate")
        previous, bound = states["parameters"], float(self.bound_in(context)[0])
        if not self.is_enabled(context):
            return {
                "parameters": step_towards(previous, numbers.nominal, **self._times),
                "bound_in_force": [0.0],
                "is_changing": [1.0],
                "last_wrench_rate": wrench_rate,
            }
        last_bound, is_changing = states["bound_in_force"][0], states["is_changing"][0] > 0
        is_rising = last_bound < bound
        if is_rising:
            bound = raised_bound(last_bound, bound, **self._times)
        updates = update_count(states["diagnostics"])
        if updates == 0:
            states["last_wrench_rate"] = wrench_rate
        motion = self._motion(at, states)
        start = time.perf_counter()
        data = self.solver.update_data(
            **motion, speed_bound=bound, updates=updates, beliefs=numbers.beliefs
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
        if self._counted and outcome > Outcome.SOLVED:
            missed = self.solver.problem(data).missed_kinds(parameters)
        return {
            "parameters": parameters,
            "last_wrench_rate": wrench_rate,
            "solve_time": [solve_time],
            "bound_in_force": [bound],
            "is_changing": [float(is_changing)],
            **self.counted(states, outcome, slowest_speed - bound, missed),
        }


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
        super().__init__()
        config = with_stated_bound(BOX, config or ConstantParametersConfig(), model)
        _check_constants(model, config)
        self.parameters = BlockParameters(
            model, config=config, own=asdict(config), check=_check_constants
        )
        declare_parameters(self, self.parameters)
        sources = {self.all_parameters_ticket()}
        self.DeclareVectorOutputPort("parameters", PARAMETERS_SIZE, self._calc_parameters, sources)
        command = self.DeclareVectorInputPort(COMMAND, 1)
        sources = sources | {self.input_port_ticket(command.get_index())}
        self.DeclareVectorOutputPort("speed_bound", 1, self._calc_speed_bound, sources)

    def check_bound(self, speed_bound: float, name: str = "speed_bound") -> None:
        """Raises ScenarioError for a negative bound (m/s)."""
        require_non_negative(f"{BOX}.{name}", speed_bound)

    trace_key = ()

    def traced_output(self, port: str, at: TraceContext) -> NDArray:
        values = self.parameters.view(at.parameters)
        if port == "parameters":
            return np.concatenate([values["frequency"], values["amplitude"]])
        if not at.has_input(COMMAND):
            return values["speed_bound"]
        command = at.input(COMMAND)
        return where(command[0] >= 0, command, np.array([np.nan]))

    def _calc_parameters(self, context: Context, output: BasicVector) -> None:
        values = self.parameters.view(context.get_numeric_parameter(0).CopyToVector())
        output.SetFromVector(np.concatenate([values["frequency"], values["amplitude"]]))

    def _calc_speed_bound(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self.bound_in(context))


def _check_constants(model: Model, config: ConstantParametersConfig) -> None:
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
