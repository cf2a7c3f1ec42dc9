"""Box "Optimization Layer" of the figure."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.solvers import (
    IpoptSolver,
    MathematicalProgram,
    SnoptSolver,
    SolverInterface,
    SolverOptions,
)
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from drake_nonstop.compiled import CompiledFunction
from drake_nonstop.mechanics import nonstop
from drake_nonstop.mechanics.rigid_load import load_acceleration
from drake_nonstop.speed_search import Quadratics, SearchProblem, fastest, nearest_feasible
from drake_nonstop.system import Model
from drake_nonstop.validation import (
    require,
    require_array,
    require_non_negative,
    require_positive,
)

_FEASIBILITY_TOLERANCE = 1e-6  # on speed²/ε² − 1
_SAME_COST = 1e-4  # relative; what the global search finds has to be cheaper by more


class Outcome(IntEnum):
    """How an update of the layer ended; the first entry of `diagnostics`."""

    NONE = 0  # no update yet
    KEPT = 1  # the previous parameters fulfil the constraints: they are the optimum
    SOLVED = 2  # the solver found parameters that fulfil the constraints
    RELAXED = 3  # it found none: those of the largest worst-case speed were taken
    HELD = 4  # nor any with a larger worst-case speed: the previous ones stay


@dataclass(kw_only=True)
class NonstopOptimizerConfig:
    """The bound, the problem of eqs. 24-26 and how it is solved."""

    speed_bound: float = 0.2  # m/s, ε
    tightening: float = 0.01  # the solver aims at (1 + tightening) ε
    look_ahead_points: int = 3  # instants from now to the next update; 1: now, as printed
    orbit_points: int = 16  # phases of the orbit ahead; 1: the present one only, as printed
    load_motion: str = "desired"  # what the carriers move with; "measured": as printed
    frequency: float = 2.0  # rad/s, ξ at the start
    amplitude: float = 1.2  # N, A at the start
    frequency_bounds: list[float] = field(default_factory=lambda: [0.1, 20.0])  # rad/s
    amplitude_bounds: list[float] = field(default_factory=list)  # N; none: see the block
    internal_force_weight: float = 1.0  # w_pos of eq. 26
    internal_force_rate_weight: float = 1.0  # w_vel of eq. 26
    period: float = 0.01  # s, between updates
    solver: str = "snopt"  # or "ipopt"
    global_search: bool = True  # look for a better point elsewhere; false: the solver alone


class NonstopOptimizer(LeafSystem):
    """Changes ξ and A as little as keeps every carrier at or above ε (eqs. 23-26).

    At each update, with x = [ξ, A] and x⁻ the previous value,

        min J(x)  such that  ‖v_i(x, τ)‖² ≥ ((1 + tightening) ε)²,  i = 1 … n,

    at `look_ahead_points` instants τ spread over the interval to the next update. In it
    the phase goes on at ξ, the wrench at its rate, and the load at the acceleration that
    the wrench gives it; the reference goes on at its own. The paper constrains the
    instant of the update only, and the load's measured motion; the carriers are sent
    where the desired motion takes them, so that is constrained unless `load_motion`
    says "measured".

    The bound is asked for, too, at `orbit_points` phases of a whole turn, the load moving
    on as it does: what a carrier will need when it next flies against the load's motion is
    then provided little by little as the load sets off. Without this foresight the need
    shows in the last instant, and x goes to whichever branch is nearer: on the slower one
    (orbits slower than the load) it has to follow the load down as that comes to rest, in
    steps so large that the carriers, ringing after each, fall below the bound.

    If x⁻ fulfils the constraints it is the optimum, J = 0, and is kept without a solve.
    Else the solver starts from x⁻, and a search over all of the bounds (`speed_search`)
    looks for a cheaper point elsewhere; where there is one, the solver starts from there
    too, and the cheaper answer wins. The search is exact at the frequency that the first
    answer gives the phases ahead; a printed phase, which jumps with ξ, is beyond it, and
    then it suggests a start only.

    Where `amplitude_bounds` are not given, A stays between 0.004 and 3 times a cable's share
    of the load's weight, or twice the initial A where that is more: far above its weight a
    load is shaken rather than held.

    If neither finds a feasible point, that of the largest worst-case speed is sought, from
    the best of a grid on, and taken where it is better than x⁻. `Outcome` names the cases,
    and `diagnostics` counts them.

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

    `measured_load_state` (13), `reference` (22), `wrench` and `wrench_rate` (6, [torque;
    force]), all in W; `phase` (2) = [θ, ∂θ/∂ξ]; `parameters` (2) = [ξ (rad/s), A (N)];
    `diagnostics` (7) = [outcome, updates, kept, solved, relaxed, held, predicted smallest
    speed minus the untightened ε (m/s)]; `solve_time` (1) is the wall time in s that the
    last update took to solve. All outputs are state: nothing feeds through.

    Raises:
        ScenarioError: a parameter is out of range, or the period is no multiple of the
            control period.
    """

    def __init__(self, model: Model, config: NonstopOptimizerConfig | None = None):
        super().__init__()
        config = config or NonstopOptimizerConfig()
        _check(config, model)
        self._speed_bound = config.speed_bound
        self._program = SpeedProgram(model, config, self.get_name)
        self._measured_load_state = self.DeclareVectorInputPort("measured_load_state", 13)
        self._reference = self.DeclareVectorInputPort("reference", 22)
        self._wrench = self.DeclareVectorInputPort("wrench", 6)
        self._wrench_rate = self.DeclareVectorInputPort("wrench_rate", 6)
        self._phase = self.DeclareVectorInputPort("phase", 2)
        self._parameters = self.DeclareDiscreteState([config.frequency, config.amplitude])
        self._diagnostics = self.DeclareDiscreteState(7)
        self._solve_time = self.DeclareDiscreteState(1)
        self._last_wrench_rate = self.DeclareDiscreteState(6)
        self._period = config.period
        self.DeclareStateOutputPort("parameters", self._parameters)
        self.DeclareStateOutputPort("diagnostics", self._diagnostics)
        self.DeclareStateOutputPort("solve_time", self._solve_time)
        # Offset = period: with offset 0 the periodic event would repeat the first one.
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        self.DeclarePeriodicDiscreteUpdateEvent(config.period, config.period, self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        previous = context.get_discrete_state(self._parameters).CopyToVector()
        diagnostics = context.get_discrete_state(self._diagnostics).CopyToVector()
        wrench_rate = self._wrench_rate.Eval(context)
        last_wrench_rate = wrench_rate
        if diagnostics[1] > 0:
            last_wrench_rate = context.get_discrete_state(self._last_wrench_rate).value()
        data = np.concatenate(
            [
                previous,
                self._phase.Eval(context),
                self._measured_load_state.Eval(context),
                self._reference.Eval(context),
                self._wrench.Eval(context),
                wrench_rate,
                (wrench_rate - last_wrench_rate) / self._period,
            ]
        )
        start = time.perf_counter()
        parameters, outcome, margin = self._program.solve(previous, data)
        solve_time = time.perf_counter() - start
        diagnostics[0] = outcome
        diagnostics[1] += 1
        diagnostics[1 + outcome] += 1
        diagnostics[6] = self._program.speed(margin) - self._speed_bound
        discrete_state.set_value(self._parameters, parameters)
        discrete_state.set_value(self._diagnostics, diagnostics)
        discrete_state.set_value(self._last_wrench_rate, wrench_rate)
        discrete_state.set_value(self._solve_time, [solve_time])


class SpeedProgram:
    """The problem of one update as MathematicalPrograms, built once and reused.

    `data` (57) holds what varies from update to update: [ξ⁻, A⁻, θ, ∂θ/∂ξ, load state,
    reference, wrench and its first two rates]. A margin is ‖v_i‖²/ε² − 1 with the
    tightened ε. Answers depend on the arguments alone.
    """

    def __init__(self, model: Model, config: NonstopOptimizerConfig, name: Callable[[], str]):
        bound = (1 + config.tightening) * config.speed_bound
        self._unit = bound or 1.0  # m/s; without a bound every speed is above it
        self._least = 1.0 if bound > 0 else 0.0
        instants = np.linspace(0, config.period, config.look_ahead_points)
        if config.look_ahead_points == 1:
            instants = np.zeros(1)
        turns = 2 * np.pi * np.arange(1, config.orbit_points) / config.orbit_points
        count = (len(instants) + len(turns)) * model.n
        pattern = {
            "phases": model.pattern.phases,
            "basis": model.pattern.basis,
            "offset": model.pattern.offset,
            "pseudo_inverse": model.pseudo_inverse,
            "attachments": model.attachments,
        }

        def ahead_of(
            state: NDArray, reference: NDArray, wrench: NDArray, instant: float
        ) -> tuple[NDArray, NDArray]:
            """The load's state, and what the carriers move with, at an instant."""
            accelerations = load_acceleration(
                state,
                wrench,
                mass=model.load_mass,
                inertia=model.load_inertia,
                inertia_inverse=model.load_inertia_inverse,
                drag=model.load_drag,
                gravity=model.gravity,
            )
            ahead = nonstop.advance(state, *accelerations, instant)
            if config.load_motion == "measured":
                return ahead, ahead
            return ahead, nonstop.advance(
                reference[:13], reference[13:16], reference[16:19], instant
            )

        def margins(x: NDArray, data: NDArray) -> NDArray:
            previous, phase, state, reference, *wrenches = np.split(data, [2, 4, 17, 39, 45, 51])
            squares = []
            for instant in instants:
                ahead, motion = ahead_of(state, reference, wrenches[0], instant)
                velocities = nonstop.carrier_velocities(
                    x,
                    previous,
                    phase,
                    ahead,
                    motion,
                    *wrenches,
                    time=instant,
                    rest_length=model.cable_length,
                    compliance=model.cable_compliance,
                    **pattern,
                )
                squares.append((velocities * velocities).sum(axis=1))
            if len(turns) > 0:
                angle = nonstop.phase_of(x, previous, phase) + x[:1] * instants[-1]
                c, b, a = nonstop.speed_squares(
                    x[1:],
                    *orbit_terms(angle, state, reference, wrenches),
                    rest_length=model.cable_length,
                    compliance=model.cable_compliance,
                )
                s = x[:1] * x[1:]
                squares.append((c + s * (2 * b + s * a))[0])
            return np.concatenate(squares) / self._unit**2 - self._least

        def terms_at(
            angle: NDArray, state: NDArray, reference: NDArray, wrenches: list, instant: float
        ) -> tuple[NDArray, ...]:
            ahead, motion = ahead_of(state, reference, wrenches[0], instant)
            return nonstop.speed_terms(angle, ahead, motion, *wrenches, time=instant, **pattern)

        def orbit_terms(
            angle: NDArray, state: NDArray, reference: NDArray, wrenches: list
        ) -> tuple[NDArray, ...]:
            """The terms at the phases that the orbit has yet to come by, from `angle` on."""
            rest = state, reference, wrenches, instants[-1]
            return nonstop.turned_speed_terms(
                np.stack(terms_at(angle, *rest)),
                np.stack(terms_at(angle + np.pi / 2, *rest)),
                turns,
            )

        def terms(frequency: NDArray, data: NDArray) -> tuple[NDArray, NDArray]:
            _, phase, state, reference, *wrenches = np.split(data, [2, 4, 17, 39, 45, 51])
            parts = [
                np.stack(
                    terms_at(phase[:1] + frequency * instant, state, reference, wrenches, instant)
                )
                for instant in instants
            ]
            if len(turns) > 0:
                angle = phase[:1] + frequency * instants[-1]
                parts.append(np.stack(orbit_terms(angle, state, reference, wrenches)))
            return np.concatenate(parts, axis=1), phase[:1] + model.pattern.phases

        def cost(x: NDArray, data: NDArray) -> NDArray:
            return nonstop.change_cost(
                x,
                data[:2],
                data[2:4],
                phases=model.pattern.phases,
                internal_force_weight=config.internal_force_weight,
                internal_force_rate_weight=config.internal_force_rate_weight,
            )

        def compiled(function: Callable, jacobian_of: int | None = None) -> CompiledFunction:
            # A solver may try the far ends of the bounds, where values are huge and sound.
            return CompiledFunction(
                function, [2, 57], name=name, largest=1e100, jacobian_of=jacobian_of
            )

        self._terms = CompiledFunction(terms, [1, 57], name=name, largest=1e100)
        self._model, self._config, self._bound = model, config, bound
        self._margins = compiled(margins)
        self._cost_gradient = compiled(cost, jacobian_of=0)
        self._margin_gradients = compiled(margins, jacobian_of=0)
        self._data = np.zeros(57)
        self._solver, self._options = _solver(config.solver)
        lower, upper = np.transpose([config.frequency_bounds, _amplitude_bounds(config, model)])
        self._lower, self._upper = lower, upper
        zero, infinity = np.zeros(count), np.full(count, np.inf)

        self._nearest = MathematicalProgram()
        x = self._nearest.NewContinuousVariables(2, "x")
        self._nearest.AddBoundingBoxConstraint(lower, upper, x)
        self._nearest.AddCost(self._evaluate_cost, vars=x)
        self._nearest.AddConstraint(self._evaluate_margins, zero, infinity, vars=x)

        self._fastest = MathematicalProgram()
        x = self._fastest.NewContinuousVariables(2, "x")
        worst = self._fastest.NewContinuousVariables(1, "worst_margin")
        self._fastest.AddBoundingBoxConstraint(lower, upper, x)
        self._fastest.AddLinearCost(-worst[0])
        self._fastest.AddConstraint(
            self._evaluate_margins_above_worst, zero, infinity, vars=[*x, *worst]
        )

    def solve(self, previous: NDArray, data: NDArray) -> tuple[NDArray, Outcome, float]:
        """The next parameters [ξ, A] (2,), how they were found, and their worst margin."""
        before = self._worst_margin(previous, data)
        if before >= -_FEASIBILITY_TOLERANCE:
            return previous, Outcome.KEPT, before
        # The programs' callbacks read the data from here; set anew for every solve.
        self._data[:] = data
        nearest, cost = self._nearest_from(previous)
        problem = None
        if self._config.global_search:
            problem = self._search_problem(previous, nearest, data)
            other, estimate = nearest_feasible(problem, cheaper_than=cost * (1 - _SAME_COST))
            if estimate < cost * (1 - _SAME_COST):
                other, other_cost = self._nearest_from(other)
                if other_cost < cost:
                    nearest, cost = other, other_cost
        if not np.isfinite(cost):
            relaxed, worst = self._fastest_from(fastest(problem) if problem else previous)
            if worst < -_FEASIBILITY_TOLERANCE and worst > before:
                return relaxed, Outcome.RELAXED, worst
            if worst < -_FEASIBILITY_TOLERANCE:
                return previous, Outcome.HELD, before
            nearest, cost = self._nearest_from(relaxed)
        return nearest, Outcome.SOLVED, self._worst_margin(nearest, data)

    def _nearest_from(self, guess: NDArray) -> tuple[NDArray, float]:
        """The feasible point that the solver finds from a guess, and its cost, else inf.

        A feasible guess is kept where the solver ends outside the constraints.
        """
        for x in (self._solve_program(self._nearest, guess)[0], guess):
            if self._worst_margin(x, self._data) >= -_FEASIBILITY_TOLERANCE:
                return x, float(self._cost_gradient(x, self._data)[0][0])
        return guess, np.inf

    def _fastest_from(self, guess: NDArray) -> tuple[NDArray, float]:
        """The point of the largest worst margin, of the solver's and its guess, and the margin."""
        worst = self._worst_margin(guess, self._data)
        x, worst_of_x = self._solve_program(self._fastest, np.array([*guess, worst]))
        return (x, worst_of_x) if worst_of_x > worst else (guess, worst)

    def _search_problem(self, previous: NDArray, around: NDArray, data: NDArray) -> SearchProblem:
        """The problem with the phases ahead those of the frequency `around`."""
        terms, angles = self._terms(around[:1], data)
        terms = terms.reshape(6, -1, 3).copy()

        def quadratics(amplitudes: NDArray) -> Quadratics:
            return Quadratics(
                *nonstop.speed_squares(
                    amplitudes,
                    *terms,
                    rest_length=self._model.cable_length,
                    compliance=self._model.cable_compliance,
                )
            )

        return SearchProblem(
            quadratics=quadratics,
            angles=angles.copy(),
            previous=previous,
            lower=self._lower,
            upper=self._upper,
            bound=self._bound,
            internal_force_weight=self._config.internal_force_weight,
            internal_force_rate_weight=self._config.internal_force_rate_weight,
        )

    def speed(self, margin: float) -> float:
        """The speed (m/s) of that margin."""
        return float(np.sqrt(max(0.0, margin + self._least))) * self._unit

    def _solve_program(self, program: MathematicalProgram, guess: NDArray) -> tuple[NDArray, float]:
        """The [ξ, A] at which the solver ends, within the bounds, and its worst margin."""
        x = self._solver.Solve(program, guess, self._options).get_x_val()[:2]
        x = np.clip(x, self._lower, self._upper)  # IPOPT ends up to 1e-8 outside
        return x, self._worst_margin(x, self._data)

    def _worst_margin(self, parameters: NDArray, data: NDArray) -> float:
        return float(np.min(self._margins(parameters, data)[0]))

    # Drake calls these with floats or with AutoDiffXd, and wants the same back.
    def _evaluate_cost(self, x: NDArray) -> AutoDiffXd | float:
        if x.dtype == float:
            return float(self._cost_gradient(x, self._data)[0][0])
        cost, gradient = self._cost_gradient(ExtractValue(x)[:, 0], self._data)
        return AutoDiffXd(cost[0], gradient[0] @ ExtractGradient(x))

    def _evaluate_margins(self, x: NDArray) -> NDArray:
        if x.dtype == float:
            return self._margins(x, self._data)[0]
        margins, gradients = self._margin_gradients(ExtractValue(x)[:, 0], self._data)
        return InitializeAutoDiff(margins, gradients @ ExtractGradient(x))

    def _evaluate_margins_above_worst(self, x: NDArray) -> NDArray:
        return self._evaluate_margins(x[:2]).reshape(-1) - x[2]


_SOLVERS: dict[str, Callable[[], SolverInterface]] = {"snopt": SnoptSolver, "ipopt": IpoptSolver}


def _solver(name: str) -> tuple[SolverInterface, SolverOptions]:
    """The solver and options that keep it quiet, fast and exact on two variables."""
    options = SolverOptions()
    snopt, ipopt = SnoptSolver.id(), IpoptSolver.id()
    options.SetOption(snopt, "Major iterations limit", 50)
    options.SetOption(snopt, "Major feasibility tolerance", _FEASIBILITY_TOLERANCE / 10)
    options.SetOption(snopt, "Scale option", 0)
    options.SetOption(ipopt, "max_iter", 100)
    options.SetOption(ipopt, "constr_viol_tol", _FEASIBILITY_TOLERANCE / 10)
    options.SetOption(ipopt, "print_level", 0)
    return _SOLVERS[name](), options


def _amplitude_bounds(config: NonstopOptimizerConfig, model: Model) -> list[float]:
    """The bounds on A: the config's, or those that follow from the load's weight."""
    if config.amplitude_bounds != []:
        return config.amplitude_bounds
    share = model.load_mass * model.gravity / model.n
    return [min(0.004 * share, config.amplitude / 2), max(3 * share, 2 * config.amplitude)]


def _check(config: NonstopOptimizerConfig, model: Model) -> None:
    owner = "optimization_layer"
    require_non_negative(
        owner,
        speed_bound=config.speed_bound,
        tightening=config.tightening,
        internal_force_weight=config.internal_force_weight,
        internal_force_rate_weight=config.internal_force_rate_weight,
    )
    require_positive(
        owner,
        frequency=config.frequency,
        amplitude=config.amplitude,
        period=config.period,
    )
    require(
        config.speed_bound == 0 or config.speed_bound >= 1e-3,
        f"{owner}.speed_bound",
        config.speed_bound,
        "give 0 (no bound) or at least 1e-3 m/s",
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
        config.load_motion in ("desired", "measured"),
        f"{owner}.load_motion",
        config.load_motion,
        'give "desired" or "measured"',
    )
    require(
        config.solver in list(_SOLVERS),
        f"{owner}.solver",
        config.solver,
        f"give one of {', '.join(_SOLVERS)}",
    )
    for name, start, bounds in (
        ("frequency", config.frequency, config.frequency_bounds),
        ("amplitude", config.amplitude, _amplitude_bounds(config, model)),
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
