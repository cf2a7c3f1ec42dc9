"""Box "Optimization Layer" of the figure."""

import math
import time
from dataclasses import dataclass, field

import numpy as np
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteValues,
    NumericParameterIndex,
)

from drake_nonstop.model.system import Model
from drake_nonstop.optimization.local_solver import LocalSolver
from drake_nonstop.optimization.speed_program import Outcome, SpeedProgram, amplitude_bounds
from drake_nonstop.systems.block import LeafBlock
from drake_nonstop.systems.tracing import LARGEST
from drake_nonstop.validation import (
    is_number,
    require,
    require_array,
    require_non_negative,
    require_positive,
)

LEAST_BOUND = 1e-3  # m/s, but for none at all: margins are relative to the bound
_SOLVERS = ("search", "grid", *LocalSolver.NAMES)


@dataclass(kw_only=True)
class NonstopOptimizerConfig:
    """The bound, the problem of eqs. 24-26 and how it is solved."""

    speed_bound: float = 0.2  # m/s, ε
    tightening: float = 0.01  # the solver aims at (1 + tightening) ε
    look_ahead_points: int = 2  # instants from now to the next update; 1: now, as printed
    orbit_points: int = 16  # phases of the orbit ahead; 1: the present one only, as printed
    orbit_updates: int = 4  # that take turns in them
    load_motion: str = "desired"  # what the carriers move with; "measured": as printed
    frequency: float = 2.0  # rad/s, ξ at the start
    amplitude: float = 1.2  # N, A at the start
    frequency_bounds: list[float] = field(default_factory=lambda: [0.1, 20.0])  # rad/s
    amplitude_bounds: list[float] = field(default_factory=list)  # N; none: see the block
    max_frequency_rate: float = math.inf  # rad/s²
    max_amplitude_rate: float = math.inf  # N/s
    max_speed: float = math.inf  # m/s, of a carrier
    min_tension: float = 0.0  # N; 0: any
    max_tension: float = math.inf  # N
    min_separation: float = 0.0  # m, of two carriers over a whole orbit; 0: any
    internal_force_weight: float = 1.0  # w_pos of eq. 26
    internal_force_rate_weight: float = 1.0  # w_vel of eq. 26
    anchor_weight: float = 0.0  # of the way back to the initial ξ and A, at rest
    period: float = 0.01  # s, between updates
    change_time: float = 2.0  # s, in which a bound or a switch set during a run takes effect
    solver: str = "search"  # or "grid", "snopt", "ipopt", "nlopt"
    global_search: bool = True  # compare what snopt, ipopt or nlopt finds with the search


class NonstopOptimizer(LeafBlock):
    """Changes ξ and A as little as keeps every carrier at or above ε (eqs. 23-26).

    At each update, with x = [ξ, A] and x⁻ the previous value,

        min J(x)  such that  ‖v_i(x, τ)‖² ≥ ((1 + tightening) ε)²,  i = 1 … n,

    at `look_ahead_points` instants τ spread over the interval to the next update. In it
    the phase goes on at ξ⁻, the wrench at its rate and the rate's last change, and the load
    at the acceleration that the wrench gives it; the reference goes on at its own. The
    paper constrains the instant of the update only, and the load's measured motion; the
    carriers are sent where the desired motion takes them, so that is constrained unless
    `load_motion` says "measured".

    The bound is asked for, too, at `orbit_points` phases of a whole turn, the load moving
    on as it does; each of `orbit_updates` updates in succession takes its share of them, as
    evenly spread. What a carrier will need when it next flies against the load's motion is
    then provided little by little as the load sets off. Without this foresight the need
    shows in the last instant, and x goes to whichever branch is nearer: on the slower one
    (orbits slower than the load) it has to follow the load down as that comes to rest, in
    steps so large that the carriers, ringing after each, fall below the bound.

    **Other constraints**, off by default: `min_tension` and `max_tension` of the cables and
    `max_speed` of the carriers, at the same instants and phases, `min_separation` of any two
    carriers over a whole orbit, each tightened likewise, and limits of the rates of ξ and A.
    With an `anchor_weight` w, J grows by w ‖x − x_start‖² while the reference rests: x comes
    back to where it started, the faster the larger w, and as far as the constraints allow.

    **The answer.** If x⁻ fulfils the constraints (and nothing pulls it back) it is the
    optimum, J = 0, and is kept without a solve. Else `solver` looks for the optimum: "search"
    over all of the bounds (`speed_search`), exact in ξ; "grid" over both, which is slower,
    coarser, and what a printed phase needs, which jumps with ξ; or Drake's SNOPT, IPOPT or
    NLopt from x⁻ on, whose answer is compared with that of the search unless `global_search`
    is false: the cheaper feasible one wins. Where no feasible point is found, that of the
    largest worst speed is taken, or, where the speeds can be kept above ε but not the other
    constraints, the one among these that misses them least; if it is better than x⁻.
    `Outcome` names the cases, and `diagnostics` counts them. Nothing is carried over from one
    solve to the next.

    Where `amplitude_bounds` are not given, A stays between 0.004 and 3 times a cable's share
    of the load's weight, or half and twice the initial A where that is wider: far above its
    weight a load is shaken rather than held.

    **In continuous time** these separate the simulated speed from the constrained one:

    - The carriers lag behind their references. A PID on a mass m with the reference's
      position and velocity follows an acceleration a with an error of m a/K_p, and so its
      speed errs by m/K_p times the jerk; references that go on along their velocity for a
      sample T add T²/6 + K_d T/(2 K_p) to that factor. With the default gains and 10 ms it is
      1.7e-4 s². A carrier that flies ξ = 2 rad/s at 0.5 m/s has a jerk of ξ² v = 2 m/s³: the
      speed errs by 0.3 mm/s, 0.07 %.
    - Within a sample the reference's velocity is held: it ripples by T a/2, of which the
      carriers show a tenth (measured): 5e-4 s times the acceleration, 0.5 mm/s.
    - After a step of ξ the phase goes on at the new value: the constraint is late by
      (ξ − ξ⁻) τ rad, 1e-4 in steps of 0.01 rad/s.
    - A step of A moves the commanded position by ∂p/∂A ΔA, and the carriers ring after it:
      at a damping ratio of 0.5 their speed is off by up to 0.55 √(K_p/m) ∂p/∂A ΔA. Foresight
      along the orbit keeps these steps small, and `max_amplitude_rate` can bound them.

    - Between two instants of the look-ahead the speed can dip by T²/8 times its second rate:
      2.5e-5 m/s at ξ² v = 2 m/s³.

    All but the step of A add up to some 0.2 % of ε on the default scenarios; `tightening` is
    five times that, 1 %. The step of A has no bound of its own: that it stays within the rest is
    measured, by tests/evals/test_bound_always_holds.py.

    **During a run** `set_speed_bound` and `set_enabled` change two parameters of the context,
    as a live view does. The carriers' commands follow without a jump. A raised bound is asked
    for little by little, at its height per `change_time`, and so is one that comes back into
    force; until all constraints are fulfilled again ξ and A change by no more than their initial
    values per `change_time`, and an update that this cuts short counts as relaxed. A layer that is
    switched off leads ξ and A back to where they started, with a time constant of a quarter of
    `change_time`, and counts no updates.

    .. pydrake_system::

        name: NonstopOptimizer
        input_ports:
        - measured_load_state
        - reference
        - wrench
        - wrench_rate
        - phase
        output_ports:
        - parameters
        - diagnostics
        - solve_time
        - speed_bound

    `measured_load_state` (13), `reference` (22), `wrench` and `wrench_rate` (6, [torque;
    force]), all in W; `phase` (2) = [θ, ∂θ/∂ξ]; `parameters` (2) = [ξ (rad/s), A (N)];
    `diagnostics` (7) = [outcome, updates, kept, solved, relaxed, held, predicted smallest
    speed minus the untightened ε (m/s)]; `solve_time` (1) is the wall time in s that the
    last update took, from its inputs to its answer; `speed_bound` (1) is the ε that is asked for,
    in m/s. All outputs are state or parameters: nothing feeds through.

    Raises:
        ScenarioError: a parameter is out of range, or the period is no multiple of the
            control period.
    """

    is_sampled = True

    def __init__(self, model: Model, config: NonstopOptimizerConfig | None = None):
        super().__init__()
        config = config or NonstopOptimizerConfig()
        _check(config, model)
        self.program = SpeedProgram(model, config, self.get_name)
        self._measured_load_state = self.DeclareVectorInputPort("measured_load_state", 13)
        self._reference = self.DeclareVectorInputPort("reference", 22)
        self._wrench = self.DeclareVectorInputPort("wrench", 6)
        self._wrench_rate = self.DeclareVectorInputPort("wrench_rate", 6)
        self._phase = self.DeclareVectorInputPort("phase", 2)
        self._parameters = self.DeclareDiscreteState([config.frequency, config.amplitude])
        self._diagnostics = self.DeclareDiscreteState(7)
        self._solve_time = self.DeclareDiscreteState(1)
        self._last_wrench_rate = self.DeclareDiscreteState(6)
        self._bound_in_force = self.DeclareDiscreteState([config.speed_bound])
        self._is_changing = self.DeclareDiscreteState(1)
        self._speed_bound = self.DeclareNumericParameter(BasicVector([config.speed_bound]))
        self._enabled = self.DeclareNumericParameter(BasicVector([1.0]))
        self.highest_speed_bound = config.max_speed / _tightened(config)
        self._start = np.array([config.frequency, config.amplitude])
        self._period, self._change_time = config.period, config.change_time
        self.DeclareStateOutputPort("parameters", self._parameters)
        self.DeclareStateOutputPort("diagnostics", self._diagnostics)
        self.DeclareStateOutputPort("solve_time", self._solve_time)
        self.DeclareVectorOutputPort(
            "speed_bound",
            1,
            self._calc_speed_bound,
            {self.numeric_parameter_ticket(NumericParameterIndex(self._speed_bound))},
        )
        # Offset = period: with offset 0 the periodic event would repeat the first one.
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        # At the controllers' samples, of which every so-manieth is taken: with a period of its
        # own the event would fall, by rounding, now together with theirs and now before.
        self._sample_period = model.control_period or config.period
        self._samples = round(config.period / self._sample_period)
        self.DeclarePeriodicDiscreteUpdateEvent(
            self._sample_period, self._sample_period, self._update_at_sample
        )

    def set_speed_bound(self, context: Context, speed_bound: float) -> None:
        """Asks for another ε (m/s) from the next update on; the context is the block's own.

        Raises:
            ScenarioError: the bound is neither 0 nor at least 1e-3 m/s, or above
                `highest_speed_bound`.
        """
        _check_speed_bound(speed_bound)
        require(
            speed_bound < self.highest_speed_bound,
            "optimization_layer.speed_bound",
            speed_bound,
            f"give less than {self.highest_speed_bound:g} m/s, for the sake of max_speed",
        )
        context.get_mutable_numeric_parameter(self._speed_bound).SetFromVector([speed_bound])

    def set_enabled(self, context: Context, enabled: bool) -> None:
        """Switches the layer on or off from the next update on; the context is the block's own."""
        context.get_mutable_numeric_parameter(self._enabled).SetFromVector([float(enabled)])

    def _calc_speed_bound(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_numeric_parameter(self._speed_bound).value())

    def _update_at_sample(self, context: Context, discrete_state: DiscreteValues) -> None:
        if round(context.get_time() / self._sample_period) % self._samples == 0:
            self._update(context, discrete_state)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        previous = context.get_discrete_state(self._parameters).CopyToVector()
        if not context.get_numeric_parameter(self._enabled).value()[0]:
            share = 1 - math.exp(-4 * self._period / self._change_time)
            discrete_state.set_value(self._parameters, previous + share * (self._start - previous))
            discrete_state.set_value(self._bound_in_force, [0.0])
            discrete_state.set_value(self._is_changing, [1.0])
            discrete_state.set_value(self._last_wrench_rate, self._wrench_rate.Eval(context))
            return
        bound = context.get_numeric_parameter(self._speed_bound).value()[0]
        before = context.get_discrete_state(self._bound_in_force).value()[0]
        is_changing = context.get_discrete_state(self._is_changing).value()[0] > 0
        is_rising = before < bound
        if is_rising:
            step = bound * self._period / self._change_time
            bound = min(bound, max(before + step, LEAST_BOUND))
        diagnostics = context.get_discrete_state(self._diagnostics).CopyToVector()
        wrench_rate = self._wrench_rate.Eval(context)
        last_wrench_rate = wrench_rate
        if diagnostics[1] > 0:
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
        data = self.program.update_data(*inputs, speed_bound=bound, updates=int(diagnostics[1]))
        parameters, outcome, slowest = self.program.solve(data)
        if is_changing or is_rising:
            change = parameters - previous
            longest = self._start * self._period / self._change_time
            excess = float(np.max(np.abs(change) / longest))
            if excess > 1:
                parameters, outcome = previous + change / excess, Outcome.RELAXED
                slowest = self.program.slowest(parameters, data)
            is_changing = is_rising or outcome > Outcome.SOLVED
        solve_time = time.perf_counter() - start
        diagnostics[0] = outcome
        diagnostics[1] += 1
        diagnostics[1 + outcome] += 1
        diagnostics[6] = slowest - bound
        discrete_state.set_value(self._parameters, parameters)
        discrete_state.set_value(self._diagnostics, diagnostics)
        discrete_state.set_value(self._last_wrench_rate, wrench_rate)
        discrete_state.set_value(self._solve_time, [solve_time])
        discrete_state.set_value(self._bound_in_force, [bound])
        discrete_state.set_value(self._is_changing, [float(is_changing)])


def _tightened(config: NonstopOptimizerConfig) -> float:
    """How much further apart a lower and an upper bound on the same have to be than equal."""
    return (1 + config.tightening) / (1 - config.tightening)


def _check_speed_bound(speed_bound: float) -> None:
    require(
        speed_bound == 0 or (is_number(speed_bound) and speed_bound >= LEAST_BOUND),
        "optimization_layer.speed_bound",
        speed_bound,
        f"give 0 (no bound) or at least {LEAST_BOUND:g} m/s",
    )


def _check(config: NonstopOptimizerConfig, model: Model) -> None:
    owner = "optimization_layer"
    require_non_negative(
        owner,
        tightening=config.tightening,
        internal_force_weight=config.internal_force_weight,
        internal_force_rate_weight=config.internal_force_rate_weight,
        anchor_weight=config.anchor_weight,
        min_tension=config.min_tension,
        min_separation=config.min_separation,
    )
    require_positive(
        owner,
        frequency=config.frequency,
        amplitude=config.amplitude,
        period=config.period,
        change_time=config.change_time,
    )
    _check_speed_bound(config.speed_bound)
    for name in ("min_tension", "max_tension", "max_speed", "min_separation", "speed_bound"):
        value = getattr(config, name)
        require(
            value <= LARGEST or value == math.inf,
            f"{owner}.{name}",
            value,
            f"give at most {LARGEST:g}, in SI units",
        )
    require(config.tightening < 1, f"{owner}.tightening", config.tightening, "give less than 1")
    tightened = _tightened(config)
    for name, least in (
        ("max_frequency_rate", 0.0),
        ("max_amplitude_rate", 0.0),
        ("max_speed", tightened * config.speed_bound),
        ("max_tension", tightened * config.min_tension),
    ):
        value = getattr(config, name)
        require(
            (is_number(value) and value > least) or value == math.inf,
            f"{owner}.{name}",
            value,
            f"give a number greater than {least:g}, or .inf for no limit",
        )
    require(
        isinstance(config.look_ahead_points, int) and 1 <= config.look_ahead_points <= 50,
        f"{owner}.look_ahead_points",
        config.look_ahead_points,
        "give 1 (the instant of the update only) to 50",
    )
    require(
        isinstance(config.orbit_points, int) and 1 <= config.orbit_points <= 64,
        f"{owner}.orbit_points",
        config.orbit_points,
        "give 1 (the present phase only) to 64",
    )
    require(
        isinstance(config.orbit_updates, int)
        and config.orbit_updates >= 1
        and (config.orbit_points == 1 or config.orbit_points % config.orbit_updates == 0),
        f"{owner}.orbit_updates",
        config.orbit_updates,
        f"give a whole number that divides orbit_points = {config.orbit_points}",
    )
    require(
        config.load_motion in ("desired", "measured"),
        f"{owner}.load_motion",
        config.load_motion,
        'give "desired" or "measured"',
    )
    require(
        config.solver in _SOLVERS,
        f"{owner}.solver",
        config.solver,
        f"give one of {', '.join(_SOLVERS)}",
    )
    for name, start, bounds in (
        ("frequency", config.frequency, config.frequency_bounds),
        ("amplitude", config.amplitude, amplitude_bounds(config, model)),
    ):
        low, high = require_array(f"{owner}.{name}_bounds", bounds, [2], "lower, upper")
        require(
            0 < low <= start <= high,
            f"{owner}.{name}_bounds",
            bounds,
            f"give bounds above zero that hold the initial {name} {start}",
        )
    if model.control_period > 0:
        ratio = config.period / model.control_period
        require(
            round(ratio) >= 1 and abs(ratio - round(ratio)) < 1e-9,
            f"{owner}.period",
            config.period,
            f"give a multiple of the control period {model.control_period}",
        )


@dataclass(kw_only=True)
class ConstantParametersConfig:
    """The internal force's parameters, and the bound that the metrics compare with."""

    frequency: float = 2.0  # rad/s, ξ
    amplitude: float = 1.2  # N, A
    speed_bound: float = 0.2  # m/s, ε; reported, not enforced


class ConstantParameters(LeafBlock):
    """Constant ξ and A: the loop without optimization.

    .. pydrake_system::

        name: ConstantParameters
        output_ports:
        - parameters
        - speed_bound

    `parameters` (2) = [ξ (rad/s), A (N)]; `speed_bound` (1) is ε in m/s, which nothing enforces
    and `set_speed_bound` changes during a run.

    Raises:
        ScenarioError: frequency or amplitude is not positive, or the bound negative.
    """

    is_sampled = True

    def __init__(self, model: Model, config: ConstantParametersConfig | None = None):
        super().__init__()
        config = config or ConstantParametersConfig()
        require_positive(
            "optimization_layer", frequency=config.frequency, amplitude=config.amplitude
        )
        require_non_negative("optimization_layer", speed_bound=config.speed_bound)
        self._parameters = np.array([config.frequency, config.amplitude])
        self.DeclareVectorOutputPort(
            "parameters", 2, self._calc_parameters, {self.nothing_ticket()}
        )
        self._speed_bound = self.DeclareNumericParameter(BasicVector([config.speed_bound]))
        self.DeclareVectorOutputPort(
            "speed_bound",
            1,
            self._calc_speed_bound,
            {self.numeric_parameter_ticket(NumericParameterIndex(self._speed_bound))},
        )

    def set_speed_bound(self, context: Context, speed_bound: float) -> None:
        """Compares with another ε (m/s) from now on; the context is the block's own."""
        require_non_negative("optimization_layer", speed_bound=speed_bound)
        context.get_mutable_numeric_parameter(self._speed_bound).SetFromVector([speed_bound])

    def _calc_parameters(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._parameters)

    def _calc_speed_bound(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_numeric_parameter(self._speed_bound).value())


VARIANTS = (
    NonstopOptimizer,
    ConstantParameters,
)  # of the box, the default first
