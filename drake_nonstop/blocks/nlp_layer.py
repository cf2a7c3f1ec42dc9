"""The variant of box "Optimization Layer" whose cost and constraints are the user's own."""

import math
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import casadi
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import Context

from drake_nonstop.blocks.speed_bound_layer import BOX, COMMAND, WIND, CommandedBound, PeriodicLayer
from drake_nonstop.mechanics.nonstop import advanced_reference, change_cost, phase_of
from drake_nonstop.mechanics.signals import (
    LOAD_REFERENCE_SIZE,
    LOAD_STATE_SIZE,
    PARAMETERS_SIZE,
    PHASE_SIZE,
    WIND_SIZE,
    WRENCH_SIZE,
)
from drake_nonstop.model.block import AIRCRAFT_NUMBERS, LOAD, BlockParameters
from drake_nonstop.model.system import OFFSET, Model
from drake_nonstop.optimization.carriers import as_vector, carrier_speeds
from drake_nonstop.optimization.constraints import FEASIBILITY_TOLERANCE
from drake_nonstop.optimization.diagnostics import Outcome
from drake_nonstop.optimization.local_solver import LocalSolver
from drake_nonstop.optimization.problem_config import (
    SpeedBound,
    amplitude_range,
    below_one,
    check_initial,
    check_samples,
    check_speed_bound,
    points,
)
from drake_nonstop.systems.block import weakly
from drake_nonstop.systems.diagram_trace import InContext
from drake_nonstop.systems.tracing import NotFiniteError, TracedFunction
from drake_nonstop.validation import (
    ScenarioError,
    StrictFields,
    checked,
    non_negative,
    one_line,
    one_of,
    positive,
    require,
    require_period,
    require_ranges,
)

_STATIONARY = 1e-9  # of the cost's gradient
_FIXED = (*LOAD, *AIRCRAFT_NUMBERS, "cable_stiffness", OFFSET)


class LayerInputs(NamedTuple):
    """What an update goes by: signals in W, and ξ in rad/s with A in N as they were before."""

    previous: NDArray  # (2,), [ξ⁻, A⁻]
    phase: NDArray  # (2,), [θ, ∂θ/∂ξ], rad and s
    load_state: NDArray  # (13,), measured
    reference: NDArray  # (22,)
    wrench: NDArray  # (6,), N m and N
    wrench_rate: NDArray  # (6,)
    wind: NDArray  # (3,), m/s, believed; 0 without aircraft
    speed_bound: NDArray  # (1,), m/s, ε


_SIZES = (
    *(PARAMETERS_SIZE, PHASE_SIZE, LOAD_STATE_SIZE, LOAD_REFERENCE_SIZE),
    *(WRENCH_SIZE, WRENCH_SIZE, WIND_SIZE, 1),
)


@dataclass(kw_only=True)
class NlpLayerConfig(StrictFields):
    """The bound, ξ and A with their bounds, the solver, and weights of the cost."""

    speed_bound: SpeedBound = checked(0.2, check_speed_bound)  # m/s, ε; of aircraft also "1.4 V_s"
    tightening: float = non_negative(0.02, below_one)  # the solver aims at (1 + tightening) ε
    frequency: float = positive(2.0)  # rad/s, ξ at the start
    amplitude: float = positive(1.2)  # N, A at the start
    frequency_bounds: list[float] = field(default_factory=lambda: [0.1, 20.0])  # rad/s
    amplitude_bounds: list[float] = field(default_factory=list)  # N; none: from the load's weight
    # phases of the orbit at which speeds are predicted; 1: the present one, as in the paper
    orbit_points: int = points(16, 64, " (the present phase only)")
    look_ahead_time: float = non_negative(0.12)  # s, to the load's motion that they are of
    internal_force_weight: float = non_negative(1.0)  # w_pos of eq. 26
    internal_force_rate_weight: float = non_negative(1.0)  # w_vel of eq. 26
    anchor_weight: float = non_negative(0.0)  # of the distance from the initial ξ and A
    period: float = checked(0.01, require_period)  # s, between updates
    solver: str = checked(  # "snopt", "ipopt" or "nlopt"
        "snopt", one_of((*LocalSolver.NAMES,), f"give one of {', '.join(LocalSolver.NAMES)}")
    )


class NlpLayer(CommandedBound, PeriodicLayer):
    """Changes ξ and A to the least of a cost within constraints, by one of Drake's solvers.

    At each update, with x = [ξ, A] and the `LayerInputs` of now,

        min cost(x, now)  such that  constraints(x, now) ≥ 0  and x is within its bounds.

    As it is, that is the paper's problem (eqs. 24-26) at even phases of the whole orbit. A class
    below has a `cost` or `constraints` of its own, and a dataclass of its name and `Config` below
    `NlpLayerConfig`, with further fields; `self.model` and `self.config` are there for both. They
    are plain arithmetic of arrays, without branches on values (`carrier_speeds` and the like), are
    traced once and differentiated exactly.

    The solver starts from x⁻, the last x. Where x⁻ keeps the constraints and the gradient of the
    cost is zero, it is kept; likewise where nothing better is found. Where the solver fails, or its
    answer misses a constraint by more than 1e-6, x⁻ stays and the update counts as `held`. The
    `speed_margin` of `diagnostics` is that of `predicted_speeds`.

    Raises:
        ScenarioError: a parameter is out of range, there is no such solver, the period is no
            multiple of the control period, or `cost` or `constraints` cannot be traced or returns
            anything but numbers; during a run, one of them is not finite at x⁻.
    """

    reads = (
        *("phase", "measured_load_state", "reference", "wrench", "wrench_rate"),
        *(WIND, COMMAND),
    )
    makes = ("parameters", "diagnostics", "solve_time", "speed_bound")
    where: ClassVar = {WIND: "there are aircraft"}

    def __init__(self, model: Model, config: NlpLayerConfig | None = None):
        super().__init__(model, config)
        self.model, self.config = model, self._config
        own = self.config
        self._bounds = np.transpose([own.frequency_bounds, amplitude_range(own, model)])
        if self.scalar is float:
            self._cost = self._traced("cost", self.cost, most=1)
            self._constraints = self._traced("constraints", self.constraints)
            self._speeds = self._traced("predicted_speeds", self.predicted_speeds)
            self._solver = LocalSolver(own.solver, self._cost, self._constraints, 0, sum(_SIZES))
        self.declare(own.period, parameters=[own.frequency, own.amplitude])

    def cost(self, x: NDArray, now: LayerInputs) -> Any:
        """What is to be small, a number: eq. 26, and the anchor."""
        own = self.config
        return change_cost(
            *(x, now.previous, now.phase),
            phases=self.model.pattern.phases,
            internal_force_weight=own.internal_force_weight,
            internal_force_rate_weight=own.internal_force_rate_weight,
            anchor_weight=own.anchor_weight,
            nominal=np.array([own.frequency, own.amplitude]),
        )

    def constraints(self, x: NDArray, now: LayerInputs) -> NDArray:
        """Values of any shape that shall not be negative: speeds above (1 + tightening) ε, m/s."""
        return self.predicted_speeds(x, now) - (1 + self.config.tightening) * now.speed_bound

    def predicted_speeds(self, x: NDArray, now: LayerInputs) -> NDArray:
        """The carriers' speeds (k, n), m/s, from θ on over an orbit, `look_ahead_time` ahead."""
        own = self.config
        turns = 2 * np.pi * np.arange(own.orbit_points) / own.orbit_points
        return carrier_speeds(
            self.model,
            advanced_reference(now.reference, own.look_ahead_time),
            now.wrench + own.look_ahead_time * now.wrench_rate,
            now.wrench_rate,
            *(x[0], x[1], phase_of(x, now.previous, now.phase) + turns),
            now.wind,
        )

    def _traced(self, name: str, function: Callable, most: float = math.inf) -> TracedFunction:
        """A function of x and the flat `LayerInputs`, of 1 to `most` numbers, and its Jacobian."""
        ends, field = np.cumsum(_SIZES)[:-1], f"{BOX} = {type(self).__name__}.{name}"

        def of_vector(x: NDArray, vector: NDArray) -> NDArray:
            try:
                # CasADi's, of np.sqrt(x[0]), and NumPy's of symbols, which both mean nothing.
                with warnings.catch_warnings(), np.errstate(invalid="ignore"):
                    warnings.simplefilter("ignore", FutureWarning)
                    made = as_vector(function(x, LayerInputs(*np.split(vector, ends))))
                count = casadi.vertcat(*made).numel()  # which refuses what is no number
            except Exception as error:  # whatever a user's own code may raise
                remedy = "compute numbers by arithmetic of arrays, without branches"
                raise ScenarioError(f"{field} = {one_line(error)}: {remedy}") from error
            remedy = "return one number" if most == 1 else "return an array of at least one"
            require(1 <= count <= most and count == len(made), field, f"{count} numbers", remedy)
            return made

        return TracedFunction(
            of_vector,
            [PARAMETERS_SIZE, sum(_SIZES)],
            name=weakly(self.box),
            largest=1e100,
            jacobian_of=0,
            key=self.trace_key and (type(self), name, self.trace_key),
        )

    @classmethod
    def check(cls, model: Model, config: Any) -> None:
        """Raises ScenarioError for a config that cannot be used with the model."""
        require_ranges(BOX, config)
        check_initial(BOX, "frequency", config.frequency, config.frequency_bounds)
        check_initial(BOX, "amplitude", config.amplitude, amplitude_range(config, model))
        check_samples(BOX, config.period, model)
        remedy = "the pattern has no orbits that it could change; give !ConstantParameters"
        require(not model.pattern.is_constant, BOX, cls.__name__, remedy)

    def check_bound(self, speed_bound: float, name: str = "speed_bound") -> None:
        """Raises ScenarioError for neither 0 nor at least 1e-3 m/s."""
        check_speed_bound(f"{BOX}.{name}", speed_bound)

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        """The bound, which a context can change."""
        own = ("speed_bound",)
        return BlockParameters(model, config=config, own=own, check=self.check, fixed=_FIXED)

    def updated(self, context: Context) -> Mapping[str, ArrayLike]:
        """The states after an update."""
        at, bound = InContext(self, context), self.bound_in(context)
        states = self.states(at)
        signals = [at.input(name) for name in self.reads[:5]]
        now = LayerInputs._make([states["parameters"], *signals, self.wind(at), bound])
        data, start = np.concatenate(now), time.perf_counter()
        parameters, outcome = self._solved(now.previous, data)
        solve_time = time.perf_counter() - start
        margin = float(np.min(self._speeds(parameters, data)[0]) - bound[0])
        return {
            "parameters": parameters,
            "solve_time": [solve_time],
            **self.counted(states, outcome, margin),
        }

    def _solved(self, previous: NDArray, data: NDArray) -> tuple[NDArray, Outcome]:
        """The next [ξ, A] (2,), and how it was found."""
        cost, gradient = (part.copy() for part in self._at_last("cost", self._cost, data))
        was_feasible = _are_kept(self._at_last("constraints", self._constraints, data)[0])
        if was_feasible and np.max(np.abs(gradient)) <= _STATIONARY:
            return previous, Outcome.KEPT
        try:
            x = self._solver.nearest(previous, data, *self._bounds)
            is_better = self._cost(x, data)[0][0] < cost[0]
            if _are_kept(self._constraints(x, data)[0]) and (is_better or not was_feasible):
                return x, Outcome.SOLVED
        except NotFiniteError:  # on the solver's way
            pass
        return previous, Outcome.KEPT if was_feasible else Outcome.HELD

    def _at_last(self, name: str, function: TracedFunction, data: NDArray) -> tuple[NDArray, ...]:
        """Values of a function at x⁻."""
        try:
            return function(data[:PARAMETERS_SIZE], data)
        except NotFiniteError as error:
            if error.was_given:
                raise
            xi, amplitude = data[:PARAMETERS_SIZE]
            raise ScenarioError(
                f"{BOX} = {type(self).__name__}.{name} = not finite at xi = {xi:g} rad/s, "
                f"A = {amplitude:g} N: make it finite wherever its bounds let x be"
            ) from error


def _are_kept(values: NDArray) -> bool:
    return bool(np.all(values >= -FEASIBILITY_TOLERANCE))
