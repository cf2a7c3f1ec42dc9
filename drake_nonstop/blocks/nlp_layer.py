"""The variant of box "Optimization Layer" whose cost and constraints are the user's own."""

import math
import pickle
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, ClassVar

import casadi
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import Context

from drake_nonstop.blocks.speed_bound_layer import (
    BOX,
    COMMAND,
    WIND,
    CommandedBound,
    PeriodicLayer,
    outputs_of,
    shown_bound,
)
from drake_nonstop.mechanics.nonstop import advanced_reference, change_cost, phase_of
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.model.block import BlockParameters
from drake_nonstop.model.system import Model
from drake_nonstop.planning.carriers import as_vector, carrier_speeds
from drake_nonstop.planning.constraints import FEASIBILITY_TOLERANCE
from drake_nonstop.planning.diagnostics import Outcome
from drake_nonstop.planning.nonlinear_program import check_solver, solved_program
from drake_nonstop.planning.problem_config import (
    LEAST_BOUND,
    SpeedBound,
    amplitude_range,
    below_one,
    check_initial,
    check_speed_bound,
    points,
    require_samples,
)
from drake_nonstop.systems.block import weakly
from drake_nonstop.systems.tracing import NotFiniteError, TracedFunction
from drake_nonstop.validation import (
    ScenarioError,
    StrictFields,
    checked,
    non_negative,
    one_line,
    positive,
    require,
    require_period,
    require_ranges,
)

_STATIONARY = 1e-9  # of the cost's gradient


@dataclass(kw_only=True)
class ProgramConfig(StrictFields):
    """The bound, ξ and A with their bounds, the solver, and weights of the cost."""

    speed_bound: SpeedBound = checked(0.2, check_speed_bound)  # m/s, ε; of aircraft also "1.4 V_s"
    tightening: float = non_negative(0.02, below_one)  # the solver aims at (1 + tightening) ε
    frequency: float = positive(2.0)  # rad/s, ξ at the start
    amplitude: float = positive(1.2)  # N, A at the start
    frequency_bounds: list[float] = field(default_factory=lambda: [0.1, 20.0])  # rad/s
    amplitude_bounds: list[float] = field(default_factory=list)  # N; none: from the load's weight
    internal_force_weight: float = non_negative(1.0)  # w_pos of eq. 26
    internal_force_rate_weight: float = non_negative(1.0)  # w_vel of eq. 26
    period: float = checked(0.01, require_period)  # s, between updates
    solver: str = checked("snopt", check_solver)  # "snopt" or "ipopt"


@dataclass(kw_only=True)
class NlpLayerConfig(ProgramConfig):
    """The bound, ξ and A with their bounds, the solver, weights of the cost, and the orbit."""

    orbit_points: int = points(16, 64, " (the present phase only)")  # at which speeds are predicted
    look_ahead_time: float = non_negative(0.12)  # s, to the load's motion that they are of


class NlpLayer(CommandedBound, PeriodicLayer):
    """Minimizes a cost of ξ and A within constraints, by one of Drake's solvers.

    At each update, with x = [ξ, A],

        min cost(x, now)  such that  constraints(x, now) ≥ 0  and x is within its bounds,

    by default the paper's problem (eqs. 24-26) at equidistant phases of the whole orbit. A subclass
    has a `cost` or `constraints` of its own, and beside it a dataclass that inherits from
    `NlpLayerConfig`; both methods find `self.model` and `self.config`. `now` has the signals of
    `reads`, which a subclass may extend, by their names, ε as `speed_bound` (1,), m/s, and the last
    x⁻ as `previous` (2,). Both methods are plain arithmetic of arrays without branches on values,
    such as that of `carrier_speeds`, and are traced once and differentiated exactly.

    The solver starts from x⁻, which is kept where it keeps the constraints and has no gradient of
    the cost, or where nothing better is found. Where the solver fails, or its answer misses a
    constraint by more than 1e-6, x⁻ stays and the update counts as `held`. The `speed_margin` of
    `diagnostics` is that of `predicted_speeds`.

    Raises:
        ScenarioError: a parameter is out of range, there is no such solver, the period is no
            multiple of the control period, or `cost` or `constraints` cannot be traced or returns
            anything but numbers; during a run, one of them is not finite at x⁻.
    """

    reads = ("phase", "measured_load_state", "reference", "wrench", "wrench_rate", WIND, COMMAND)
    makes = ("parameters", "diagnostics", "solve_time", "speed_bound")
    where: ClassVar = {WIND: "there are aircraft"}
    optional_inputs = (COMMAND, WIND)

    def __init__(self, model: Model, config: NlpLayerConfig | None = None):
        super().__init__(model, config)
        ranges = self.config.frequency_bounds, amplitude_range(self.config, model)
        self._bounds = np.transpose(ranges)
        ports = filter(self.HasInputPort, self.reads)
        self._read = [name for name in ports if name != COMMAND]
        self._sizes = [2, 1, *(self.GetInputPort(name).size() for name in self._read)]
        if self.scalar is float:
            self._cost = self._traced_function("cost", self.cost, most=1)
            self._constraints = self._traced_function("constraints", self.constraints)
            self._speeds = self._traced_function("predicted_speeds", self.predicted_speeds)

    def parts(self, model: Model, config: Any) -> dict[str, ArrayLike]:
        """The parameters."""
        return {"parameters": [config.frequency, config.amplitude]}

    def cost(self, x: NDArray, now: Any) -> Any:
        """The cost, a number: here that of the change (eq. 26)."""
        return change_cost(
            *(x, now.previous, now.phase),
            phases=self.model.pattern.phases,
            internal_force_weight=self.config.internal_force_weight,
            internal_force_rate_weight=self.config.internal_force_rate_weight,
        )

    def constraints(self, x: NDArray, now: Any) -> NDArray:
        """Values of any shape that shall not be negative: speeds above (1 + tightening) ε, m/s."""
        return self.predicted_speeds(x, now) - (1 + self.config.tightening) * now.speed_bound

    def predicted_speeds(self, x: NDArray, now: Any) -> NDArray:
        """The carriers' speeds (k, n), m/s, of the `prediction`."""
        return carrier_speeds(*self.prediction(x, now))

    def prediction(self, x: NDArray, now: Any) -> tuple[Any, ...]:
        """Arguments of `carrier_speeds`, `cable_tensions` and the like, at x and k phases.

        The motion is that of the load `look_ahead_time` ahead, and the phases are those of a whole
        orbit, from θ on.
        """
        time, points = self.config.look_ahead_time, self.config.orbit_points
        return (
            *(self.model, advanced_reference(now.reference, time)),
            *(now.wrench + time * now.wrench_rate, now.wrench_rate, x[0], x[1]),
            phase_of(x, now.previous, now.phase) + 2 * np.pi * np.arange(points) / points,
            now.wind_estimate,
        )

    def _traced_function(
        self, name: str, function: Callable, most: float = math.inf
    ) -> TracedFunction:
        """A function of x and of `now`, stacked, that makes 1 to `most` numbers; its Jacobian."""
        ends, names = np.cumsum(self._sizes)[:-1], ["previous", "speed_bound", *self._read]
        said = f"{BOX} = {type(self).__name__}.{name}"

        def of_vector(x: NDArray, vector: NDArray) -> NDArray:
            now = {WIND: STILL_AIR} | dict(zip(names, np.split(vector, ends), strict=True))
            try:
                # CasADi's, of np.sqrt(x[0]), and NumPy's of symbols, which both mean nothing.
                with warnings.catch_warnings(), np.errstate(invalid="ignore"):
                    warnings.simplefilter("ignore", FutureWarning)
                    made = as_vector(function(x, SimpleNamespace(**now)))
                count = casadi.vertcat(*made).numel()  # which refuses what is no number
            except Exception as error:  # whatever a user's own code may raise
                remedy = "compute numbers by arithmetic of arrays, without branches"
                raise ScenarioError(f"{said} = {one_line(error)}: {remedy}") from error
            remedy = "return one number" if most == 1 else "return an array of at least one"
            remedy += "; add arrays to slices, such as now.phase[:1], not to one entry of an array"
            require(1 <= count <= most and count == len(made), said, f"{count} numbers", remedy)
            return made

        try:
            key = type(self), name, pickle.dumps((self.model, self.config))
        except Exception:  # whatever a part that cannot be pickled may raise
            key = None
        sizes, box = [2, sum(self._sizes)], weakly(self.box)
        return TracedFunction(of_vector, sizes, name=box, largest=1e100, jacobian_of=0, key=key)

    @classmethod
    def check(cls, model: Model, config: Any) -> None:
        """Raises ScenarioError for a config that cannot be used with the model."""
        require_ranges(BOX, config)
        check_initial(BOX, "frequency", config.frequency, config.frequency_bounds)
        check_initial(BOX, "amplitude", config.amplitude, amplitude_range(config, model))
        require_samples(f"{BOX}.period", config.period, model)
        remedy = "the pattern has no orbits that it could change; give !ConstantParameters"
        require(not model.pattern.is_constant, BOX, cls.__name__, remedy)

    def check_bound(self, speed_bound: float, name: str = "speed_bound") -> None:
        """Raises ScenarioError for neither 0 nor at least 1e-3 m/s."""
        check_speed_bound(f"{BOX}.{name}", speed_bound)

    def block_parameters(self, model: Model, config: Any) -> BlockParameters:
        """The bound, which a context can change."""
        return BlockParameters(model, config=config, own=("speed_bound",))

    def constants(self, model: Model, config: Any) -> dict[str, Any]:
        """Constants of `PeriodicLayer`, and the place of the command among the inputs."""
        place = self.inputs(model).index(COMMAND)
        return super().constants(model, config) | {"command": place}

    @staticmethod
    def equations(state: NDArray, *inputs: Any, **numbers: Any) -> tuple[NDArray, ...]:
        """Outputs, where a command takes the place of the speed bound."""
        command = inputs[numbers["command"]]
        bound = shown_bound(command, numbers["speed_bound"], LEAST_BOUND)
        return outputs_of(state, speed_bound=bound, **numbers["shown"])

    def answer(self, context: Context) -> NDArray:
        """The state after an update."""
        states, bound = self.states(context), self.bound_in(context)
        previous = states["parameters"]
        signals = [self.input(context, name) for name in self._read]
        now, start = np.concatenate([previous, bound, *signals]), time.perf_counter()
        parameters, outcome = self._solved(previous, now)
        solve_time = time.perf_counter() - start
        margin = float(np.min(self._speeds(parameters, now)[0]) - bound[0])
        made = {"parameters": parameters, "solve_time": solve_time}
        return self.flat(states | made | self.counted_update(states, outcome, margin))

    def _solved(self, previous: NDArray, now: NDArray) -> tuple[NDArray, Outcome]:
        """The next [ξ, A] (2,), and how it was found."""
        try:
            name = "cost"
            cost, gradient = (part.copy() for part in self._cost(previous, now))
            name = "constraints"
            was_feasible = _are_kept(self._constraints(previous, now)[0])
        except NotFiniteError as error:
            if error.was_given:
                raise
            raise ScenarioError(
                f"{BOX} = {type(self).__name__}.{name} = not finite at xi = {previous[0]:g} rad/s, "
                f"A = {previous[1]:g} N: make it finite wherever the bounds let x be"
            ) from error
        if was_feasible and np.max(np.abs(gradient)) <= _STATIONARY:
            return previous, Outcome.KEPT
        try:
            program = self.config.solver, self._cost, self._constraints
            x = solved_program(*program, now, previous, self._bounds)
            is_better = not was_feasible or self._cost(x, now)[0][0] < cost[0]
            if is_better and _are_kept(self._constraints(x, now)[0]):
                return x, Outcome.SOLVED
        except NotFiniteError:  # on the solver's way
            pass
        return previous, Outcome.KEPT if was_feasible else Outcome.HELD


def _are_kept(values: NDArray) -> bool:
    return bool(np.all(values >= -FEASIBILITY_TOLERANCE))
