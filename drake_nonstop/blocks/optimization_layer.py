"""Box "Optimization Layer" of the figure."""

import time
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import (
    BasicVector,
    BasicVector_,
    Context,
    DiscreteValues,
    InputPort,
    ValueProducer,
)

from drake_nonstop.mechanics.cable import compliance_of
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    PARAMETERS_SIZE,
    PHASE_SIZE,
    WRENCH_SIZE,
)
from drake_nonstop.model.block_parameters import LOAD, BlockParameters, Rules
from drake_nonstop.model.system import OFFSET, Model
from drake_nonstop.optimization.diagnostics import (
    DIAGNOSTICS_SIZE,
    Outcome,
    count_update,
    update_count,
)
from drake_nonstop.optimization.gradual_change import limit_step, raised_bound, step_towards
from drake_nonstop.optimization.problem_config import (
    NonstopProblemConfig,
    check_problem,
    check_speed_bound,
    highest_speed_bound,
    range_for,
)
from drake_nonstop.optimization.update_data import Beliefs
from drake_nonstop.optimization.update_solver import UpdateSolver
from drake_nonstop.systems.block import LeafBlock, weakly
from drake_nonstop.systems.parameters import declare_parameters
from drake_nonstop.validation import StrictFields, require, require_non_negative, require_positive

_BOX = "optimization_layer"
_COMMAND = "speed_bound_command"  # an optional input of the box


@dataclass(kw_only=True)
class NonstopOptimizerConfig(NonstopProblemConfig):
    """The bound, the problem of eqs. 24-26 and how it is solved.

    What `min_separation` and the solvers cost is said in diagrams/optimization_layer.md.
    """


class NonstopOptimizer(LeafBlock):
    """Changes ξ and A as little as keeps every carrier at or above ε (eqs. 23-26).

    At each update, with x = [ξ, A] and x⁻ the previous value,

        min J(x)  such that  ‖v_i(x, τ)‖² ≥ ((1 + tightening) ε)²,  i = 1 … n,

    at instants τ up to the next update and at phases of the orbit ahead, optionally together with
    limits of tensions, speeds, separations and of the rates of ξ and A. Without
    `amplitude_bounds` A stays between 0.004 and 3 times a cable's share of the load's weight, or
    half and twice the initial A where that is wider. `tightening` covers the
    difference between predicted and simulated speeds. If x⁻ fulfils the constraints it is kept;
    else `solver` looks for the cheapest x that does, and where none is found the least infeasible
    one is taken. `diagnostics` tells how the update ended, see `Outcome`. The prediction, the
    constraints and the solvers are described in diagrams/optimization_layer.md.

    `set_speed_bound` and `set_enabled` change parameters of the context during a run, which also
    holds the initial ξ and A, their bounds and what is believed of load, cables and pattern. Where
    `speed_bound_command` is connected it is ε, read at each update. The bound rises gradually, and
    a layer that is switched off leads ξ and A back to their initial values, both within about
    `change_time`.

    Converted to AutoDiffXd or Expression the layer holds ξ and A, and an update raises
    ScenarioError: it solves with floating-point numbers only.

    .. pydrake_system::

        name: NonstopOptimizer
        input_ports:
        - measured_load_state
        - reference
        - wrench
        - wrench_rate
        - phase
        - speed_bound_command
        output_ports:
        - parameters
        - diagnostics
        - solve_time
        - speed_bound

    `measured_load_state` (13), `reference` (22), `wrench` and `wrench_rate` (6, [torque;
    force]), all in W; `phase` (2) = [θ, ∂θ/∂ξ]; `speed_bound_command` (1) in m/s, of the range of
    `set_speed_bound`, may be left unconnected; `parameters` (2) = [ξ (rad/s), A (N)];
    `diagnostics` (7) = [outcome, updates, kept, solved, relaxed, held, predicted smallest
    speed minus the untightened ε (m/s)], the fields of `Diagnostics`; `solve_time` (1) is the
    wall time in s that the last update took, from its inputs to its answer; `speed_bound` (1) is
    the ε that was set or is commanded, in m/s. All outputs are state or parameters: nothing feeds
    through but a command to the `speed_bound`.

    Parameters, the fields of `NonstopOptimizerConfig`:
        speed_bound: m/s, ε
        tightening: the solver aims at (1 + tightening) ε
        look_ahead_points: instants from now to the next update; 1: now, as in the paper
        orbit_points: phases of the orbit ahead; 1: the present one, as in the paper
        orbit_updates: successive updates that share these phases
        load_motion: of the carriers; "desired", or "measured" as in the paper
        frequency: rad/s, ξ at the start
        amplitude: N, A at the start
        frequency_bounds: rad/s
        amplitude_bounds: N; none: from the load's weight
        max_frequency_rate: rad/s²
        max_amplitude_rate: N/s
        max_speed: m/s, of a carrier
        min_tension: N; 0: any
        max_tension: N
        min_separation: m, of two carriers over a whole orbit; 0: any
        internal_force_weight: w_pos of eq. 26
        internal_force_rate_weight: w_vel of eq. 26
        anchor_weight: of the distance from the initial ξ and A, at rest
        period: s, between updates
        change_time: s, in which a bound or a switch set during a run takes effect
        solver: "search", "grid", "snopt", "ipopt" or "nlopt"
        global_search: compare what snopt, ipopt or nlopt finds with the search

    Raises:
        ScenarioError: a parameter is out of range, or the period is no multiple of the
            control period; during a run, the command is out of range.
    """

    is_sampled = True
    optional_inputs = (_COMMAND,)

    def __init__(self, model: Model, config: NonstopOptimizerConfig | None = None):
        super().__init__()
        config = config or NonstopOptimizerConfig()
        check_problem(_BOX, config, model)
        self.parameters = _parameters(model, config)
        declare_parameters(self, self.parameters)
        entry = self.DeclareCacheEntry(
            "numbers",
            ValueProducer(Value(()).Clone, weakly(self._calc_numbers)),
            {self.all_parameters_ticket()},
        )
        self._numbers = entry.cache_index()  # the entry would keep this block alive
        self._enabled = self.DeclareNumericParameter(BasicVector_[self.scalar]([1.0]))
        if self.scalar is float:
            self.solver = UpdateSolver(model, config, self.get_name)
        self._measured_load_state = self.DeclareVectorInputPort(
            "measured_load_state", LOAD_STATE_SIZE
        )
        self._reference = self.DeclareVectorInputPort("reference", LOAD_REFERENCE_SIZE)
        self._wrench = self.DeclareVectorInputPort("wrench", WRENCH_SIZE)
        self._wrench_rate = self.DeclareVectorInputPort("wrench_rate", WRENCH_SIZE)
        self._phase = self.DeclareVectorInputPort("phase", PHASE_SIZE)
        self._command = self.DeclareVectorInputPort(_COMMAND, 1)
        self._state = self.DeclareDiscreteState([config.frequency, config.amplitude])
        self._diagnostics = self.DeclareDiscreteState(DIAGNOSTICS_SIZE)
        self._solve_time = self.DeclareDiscreteState(1)
        self._last_wrench_rate = self.DeclareDiscreteState(WRENCH_SIZE)
        self._bound_in_force = self.DeclareDiscreteState([config.speed_bound])
        self._is_changing = self.DeclareDiscreteState(1)
        self.highest_speed_bound = highest_speed_bound(config)
        self._share_of_steps = config.period / config.change_time
        self._times = {"period": config.period, "change_time": config.change_time}
        self._period, self._n = config.period, model.n
        self.DeclareStateOutputPort("parameters", self._state)
        self.DeclareStateOutputPort("diagnostics", self._diagnostics)
        self.DeclareStateOutputPort("solve_time", self._solve_time)
        self.DeclareVectorOutputPort(
            "speed_bound",
            1,
            self._calc_speed_bound,
            {self.all_parameters_ticket(), self.input_port_ticket(self._command.get_index())},
        )
        # Offset = period: with offset 0 the periodic event would repeat the first one.
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        # An event at each sample of the controllers, of which every `_samples_per_update`-th is an
        # update. An event of the update's own period would, by rounding, come at some of their
        # samples and just before others.
        self._sample_period = model.control_period or config.period
        self._samples_per_update = round(config.period / self._sample_period)
        self.DeclarePeriodicDiscreteUpdateEvent(
            self._sample_period, self._sample_period, self._update_at_sample
        )

    def set_speed_bound(self, context: Context, speed_bound: float) -> None:
        """Sets another ε (m/s) from the next update on; the context is the block's own.

        Raises:
            ScenarioError: the bound is neither 0 nor at least 1e-3 m/s, or not below
                `highest_speed_bound`; or `speed_bound_command` is connected.
        """
        self.require_effect(context, "speed_bound", speed_bound)
        _check_bound(self.highest_speed_bound, speed_bound)
        values = context.get_mutable_numeric_parameter(0)
        values.SetAtIndex(self.parameters.place("speed_bound").start, speed_bound)
        self.begin_anew(context)

    def require_effect(self, context: Context, name: str, value: Any) -> None:
        """Raises ScenarioError where a parameter that is set would have none in this context."""
        if name == "speed_bound":
            _require_no_command(self._command, context, value)

    def begin_anew(self, context: Context) -> None:
        """Lets what has not been updated begin with the parameters of the context, its own."""
        diagnostics = context.get_discrete_state(self._diagnostics).value()
        is_changing = context.get_discrete_state(self._is_changing).value()[0] > 0
        if update_count(diagnostics) > 0 or is_changing:
            return
        numbers = self._numbers_in(context)
        context.SetDiscreteState(self._state, numbers.nominal)
        context.SetDiscreteState(self._bound_in_force, [numbers.speed_bound])

    def set_enabled(self, context: Context, enabled: bool) -> None:
        """Switches the layer on or off from the next update on; the context is the block's own."""
        context.get_mutable_numeric_parameter(self._enabled).SetFromVector([float(enabled)])

    def _calc_speed_bound(self, context: Context, output: BasicVector) -> None:
        if self._command.HasValue(context):
            output.SetFromVector(self._commanded_bound(context))
            return
        values = self.parameters.view(context.get_numeric_parameter(0).CopyToVector())
        output.SetFromVector(values["speed_bound"])

    def _commanded_bound(self, context: Context) -> NDArray:
        bound = self._command.Eval(context)
        if self.scalar is float:
            _check_bound(self.highest_speed_bound, float(bound[0]), _COMMAND)
        return bound

    def _wanted_bound(self, context: Context, numbers: "_Numbers") -> float:
        """The ε (m/s) that is commanded, or else the one that was set."""
        if self._command.HasValue(context):
            return float(self._commanded_bound(context)[0])
        return numbers.speed_bound

    def _numbers_in(self, context: Context) -> "_Numbers":
        return self.get_cache_entry(self._numbers).Eval(context)

    def _calc_numbers(self, context: Context, value: AbstractValue) -> None:
        vector = context.get_numeric_parameter(0).CopyToVector()
        value.set_value(_numbers(self.parameters.view(vector), self._n))

    def _update_at_sample(self, context: Context, discrete_state: DiscreteValues) -> None:
        if round(context.get_time() / self._sample_period) % self._samples_per_update == 0:
            self._update(context, discrete_state)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        self.require_floats(
            "give ConstantParameters, with its frequency and amplitude, in place of "
            "NonstopOptimizer"
        )
        previous = context.get_discrete_state(self._state).CopyToVector()
        numbers = self._numbers_in(context)
        wrench_rate = self._wrench_rate.Eval(context)
        bound = self._wanted_bound(context, numbers)
        if not context.get_numeric_parameter(self._enabled).CopyToVector()[0]:
            parameters = step_towards(previous, numbers.nominal, **self._times)
            discrete_state.set_value(self._state, parameters)
            discrete_state.set_value(self._bound_in_force, [0.0])
            discrete_state.set_value(self._is_changing, [1.0])
            discrete_state.set_value(self._last_wrench_rate, wrench_rate)
            return
        last_bound = context.get_discrete_state(self._bound_in_force).value()[0]
        is_changing = context.get_discrete_state(self._is_changing).value()[0] > 0
        is_rising = last_bound < bound
        if is_rising:
            bound = raised_bound(last_bound, bound, **self._times)
        diagnostics = context.get_discrete_state(self._diagnostics).CopyToVector()
        updates = update_count(diagnostics)
        last_wrench_rate = wrench_rate
        if updates > 0:
            last_wrench_rate = context.get_discrete_state(self._last_wrench_rate).value()
        inputs = (
            previous,
            self._phase.Eval(context),
            self._measured_load_state.Eval(context),
            self._reference.Eval(context),
            self._wrench.Eval(context),
            wrench_rate,
            (wrench_rate - last_wrench_rate) / self._period,
        )
        start = time.perf_counter()
        data = self.solver.update_data(
            *inputs, speed_bound=bound, updates=updates, beliefs=numbers.beliefs
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
        count_update(diagnostics, outcome, slowest_speed - bound)
        discrete_state.set_value(self._state, parameters)
        discrete_state.set_value(self._diagnostics, diagnostics)
        discrete_state.set_value(self._last_wrench_rate, wrench_rate)
        discrete_state.set_value(self._solve_time, [solve_time])
        discrete_state.set_value(self._bound_in_force, [bound])
        discrete_state.set_value(self._is_changing, [float(is_changing)])


_OWN = ("speed_bound", "frequency", "amplitude", "frequency_bounds", "amplitude_bounds")


def _parameters(model: Model, config: NonstopOptimizerConfig) -> BlockParameters:
    """Those of a NonstopOptimizer; amplitude bounds of zero stand for those from the weight."""
    return BlockParameters(
        model,
        (*LOAD, "cable_length", "cable_stiffness", *model.offset_parameter),
        config=replace(config, amplitude_bounds=config.amplitude_bounds or [0.0, 0.0]),
        own=_OWN,
        rules=Rules(check=_check),
    )


def _check(model: Model, config: NonstopOptimizerConfig) -> None:
    if not any(config.amplitude_bounds):
        config = replace(config, amplitude_bounds=[])
    check_problem(_BOX, config, model)
    _check_bound(highest_speed_bound(config), config.speed_bound)


def _check_bound(highest: float, speed_bound: float, name: str = "speed_bound") -> None:
    check_speed_bound(_BOX, speed_bound, name)
    require(
        speed_bound < highest,
        f"{_BOX}.{name}",
        speed_bound,
        f"give less than {highest:g} m/s, for the sake of max_speed",
    )


class _Numbers(NamedTuple):
    """What an update takes of the parameters."""

    speed_bound: float  # m/s
    nominal: NDArray  # (2,), [ξ, A] at the start, rad/s and N
    beliefs: NDArray  # a flat `Beliefs`


def _numbers(values: dict[str, NDArray], n: int) -> _Numbers:
    """Of the parameters by name, for n carriers."""
    amplitudes = values["amplitude_bounds"]
    if not amplitudes.any():
        share = float(values["load_mass"][0] * values["gravity"][0]) / n
        amplitudes = np.array(range_for(share, float(values["amplitude"][0])))
    frequencies = values["frequency_bounds"]
    beliefs = Beliefs(
        load_mass=values["load_mass"],
        load_inertia=values["load_inertia"].ravel(),
        load_drag=values["load_drag"],
        load_angular_drag=values["load_angular_drag"],
        gravity=values["gravity"],
        rest_length=values["cable_length"],
        compliance=compliance_of(values["cable_stiffness"]),
        nominal=np.concatenate([values["frequency"], values["amplitude"]]),
        lower=np.array([frequencies[0], amplitudes[0]]),
        upper=np.array([frequencies[1], amplitudes[1]]),
        offset=values.get(OFFSET, np.zeros(0)),
    )
    return _Numbers(float(values["speed_bound"][0]), beliefs.nominal, np.concatenate(beliefs))


@dataclass(kw_only=True)
class ConstantParametersConfig(StrictFields):
    """The internal force's parameters, and the bound with which the metrics compare speeds."""

    frequency: float = 2.0  # rad/s, ξ
    amplitude: float = 1.2  # N, A; 0 for a constant pattern, and for no other
    speed_bound: float = 0.2  # m/s, ε; reported, not enforced


class ConstantParameters(LeafBlock):
    """Constant ξ and A: the loop without optimization.

    .. pydrake_system::

        name: ConstantParameters
        input_ports:
        - speed_bound_command
        output_ports:
        - parameters
        - speed_bound

    `parameters` (2) = [ξ (rad/s), A (N)]; `speed_bound` (1) is ε in m/s, which nothing enforces:
    the `speed_bound_command` (1), which may be left unconnected, or else what `set_speed_bound`
    changes during a run.

    Parameters, the fields of `ConstantParametersConfig`:
        frequency: rad/s, ξ
        amplitude: N, A; 0 for a constant pattern, and for no other
        speed_bound: m/s, ε; reported, not enforced

    Raises:
        ScenarioError: frequency or amplitude is not positive, an amplitude is given for a pattern
            without orbits, or the bound is negative; during a run, the command is negative.
    """

    is_sampled = True
    optional_inputs = (_COMMAND,)

    def __init__(self, model: Model, config: ConstantParametersConfig | None = None):
        super().__init__()
        config = config or ConstantParametersConfig()
        _check_constants(model, config)
        self.parameters = BlockParameters(
            model, config=config, own=asdict(config), rules=Rules(check=_check_constants)
        )
        declare_parameters(self, self.parameters)
        sources = {self.all_parameters_ticket()}
        self.DeclareVectorOutputPort("parameters", PARAMETERS_SIZE, self._calc_parameters, sources)
        self._command = self.DeclareVectorInputPort(_COMMAND, 1)
        sources = sources | {self.input_port_ticket(self._command.get_index())}
        self.DeclareVectorOutputPort("speed_bound", 1, self._calc_speed_bound, sources)

    def set_speed_bound(self, context: Context, speed_bound: float) -> None:
        """Compares with another ε (m/s) from now on; the context is the block's own.

        Raises:
            ScenarioError: the bound is negative, or `speed_bound_command` is connected.
        """
        self.require_effect(context, "speed_bound", speed_bound)
        require_non_negative(_BOX, speed_bound=speed_bound)
        values = context.get_mutable_numeric_parameter(0)
        values.SetAtIndex(self.parameters.place("speed_bound").start, speed_bound)

    def require_effect(self, context: Context, name: str, value: Any) -> None:
        """Raises ScenarioError where a parameter that is set would have none in this context."""
        if name == "speed_bound":
            _require_no_command(self._command, context, value)

    def _calc_parameters(self, context: Context, output: BasicVector) -> None:
        values = self.parameters.view(context.get_numeric_parameter(0).CopyToVector())
        output.SetFromVector(np.concatenate([values["frequency"], values["amplitude"]]))

    def _calc_speed_bound(self, context: Context, output: BasicVector) -> None:
        values = self.parameters.view(context.get_numeric_parameter(0).CopyToVector())
        bound = values["speed_bound"]
        if self._command.HasValue(context):
            bound = self._command.Eval(context)
            if self.scalar is float:
                require_non_negative(_BOX, **{_COMMAND: float(bound[0])})
        output.SetFromVector(bound)


def _check_constants(model: Model, config: ConstantParametersConfig) -> None:
    require_positive(_BOX, frequency=config.frequency)
    if model.pattern.is_constant:
        require(
            config.amplitude == 0,
            f"{_BOX}.amplitude",
            config.amplitude,
            "the pattern has no orbits that it could size; give 0, or a pattern with orbits",
        )
    else:
        require_positive(_BOX, amplitude=config.amplitude)
    require_non_negative(_BOX, speed_bound=config.speed_bound)


def _require_no_command(command: InputPort, context: Context, speed_bound: Any) -> None:
    """Raises ScenarioError where a bound that is set would be overruled."""
    require(
        not command.HasValue(context),
        f"{_BOX}.speed_bound",
        speed_bound,
        f"the signal {_COMMAND} sets the bound: change it in the block that makes that signal, or "
        "take the signal away",
    )


# The blocks that the box can be, the default first.
VARIANTS = (NonstopOptimizer, ConstantParameters)
