"""Plans of ξ and A over a receding horizon, for the box "Optimization Layer" of the figure."""

import threading
import time as clock
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

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
from drake_nonstop.mechanics.cable import compliance_of
from drake_nonstop.mechanics.reference_preview import ReferencePreview, continued_reference
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.mechanics.signals import HELD, PLANNED_SIZE, SAMPLE_TIME, CarrierStates
from drake_nonstop.model.block import LOAD, BlockParameters, rigid_load
from drake_nonstop.model.system import OFFSET, Model
from drake_nonstop.planning.diagnostics import Outcome
from drake_nonstop.planning.horizon_config import HorizonConfig, check_horizon, timed
from drake_nonstop.planning.horizon_problem import HorizonData, HorizonProblem, planned_shape
from drake_nonstop.planning.horizon_solver import (
    LEAST_START_SCALE,
    PLAN_TOLERANCE,
    HorizonSolver,
    PlanAnswer,
)
from drake_nonstop.planning.measured_margin import (
    FIRST_SHARE,
    MEASURED,
    NOTHING_MEASURED,
    deviations_of,
    margin_after,
    margin_at_next_plan,
    planned_motion,
)
from drake_nonstop.planning.model_parameters import (
    OF_CONFIG,
    OF_MODEL,
    ModelParameters,
    beliefs_from,
)
from drake_nonstop.planning.plan import DEGREE, Plan
from drake_nonstop.planning.problem_config import (
    LEAST_BOUND,
    LimitsConfig,
    check_limits,
    check_pattern,
    check_speed_bound,
    highest_speed_bound,
    points,
)
from drake_nonstop.systems.parameters import parameters_in
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.systems.tracing import NotFiniteError, where
from drake_nonstop.validation import require

_PREVIEW = "reference_preview"  # an optional input
_MANY_ITERATIONS = 20  # of a plan that no earlier one leads to
_MOST_ITERATIONS = 100  # of any other
_FAR_FROM_FEASIBLE = 0.01  # slack of plans that may be on a branch from which no step leads
_REPEATS = 4  # of the iterations of a plan that needs slack
# Factors of the ξ of its start, from which it begins again: where a carrier would all but stop, no
# small change helps, and a plan that goes on from none has several branches. 0 stands for constant
# ξ and A that are searched for.
_STARTS: tuple[float, ...] = (0.0, 1.1, 0.9)
_NO_PLAN = 0.0  # in place of a scale
_LAST = "last_plan"  # a part of the state, a flat `_PlanState`
_MARGIN = "margin"  # a part of the state, of `margin_after`
_FLOWN = f"{HELD}carrier_state"  # an optional input
_NOWHERE = 1e5  # in the place of a state of carriers that is not measured


@dataclass(kw_only=True)
class RecedingHorizonOptimizerConfig(HorizonConfig, LimitsConfig):
    """The bound, the horizon, and options of the plans."""

    # plans aim at (1 + tightening) ε; "measured": by how much slower than planned carriers fly
    tightening: float | str = MEASURED
    preview: bool = True  # plan for the motion ahead; false: as if the present motion went on
    wind: bool = True  # plan airspeeds of aircraft in the wind; false: their ground speeds
    max_iterations: int = points(2, _MOST_ITERATIONS)  # quadratic programs of a plan


class RecedingHorizonOptimizer(CommandedBound, PeriodicLayer):
    """Plans ξ and A over a horizon such that every carrier stays at or above ε.

    Every `knot_spacing` a plan of smooth ξ and A over some `intervals` is made: splines of fourth
    degree that go on from the last plan with three continuous rates, see
    `planning.horizon_problem`. The carriers' speeds along it follow from the load's reference,
    which `reference_preview` has for later times, and the wrench that moves the load along it in
    still air. Without a preview, or with `preview` false, the present motion is taken to go on. The
    plan is written to the signal `plan`, which the box `phase` reads: use `ShapedPhase`. The first
    plan starts with the initial ξ and A if these keep the constraints from the start on, and else
    with others. Until it is made, `parameters` and `plan` show the initial values.

    Where the references' cables bow, speeds, limits of aircraft and distances are those of carriers
    at the ends of bowed cables, see `planning.carrier_margins`.

    With `tightening: measured` the margin above ε follows the carriers' deviations from their
    planned velocities, as `carrier_state` shows them at each sample, see
    `planning.measured_margin`; a margin that has risen is reached within three plans. Without
    that signal, or without a control period, it stays 2 %. `measured_margin` is the margin in m/s.

    The speeds of aircraft are airspeeds, in the `wind_estimate` at the time of a plan, taken as
    steady. Where it is not connected, or `wind` is false, the air is still. Lift, bank, climb and
    thrust are limited along the plan and, at its end, on the whole orbits of ξ and A.

    An update ends as kept where the last plan, shifted, cannot be improved; as solved where a plan
    fulfils all constraints; and as relaxed where it is the least infeasible one that was found.

    The context holds ε, which `set_speed_bound` changes during a run, the initial ξ and A, their
    bounds, and the parameters of load, cables and pattern. If `speed_bound_command` is connected,
    each plan reads ε from it. A bound of 0 leads ξ and A back to their initial values.

    Converted to AutoDiffXd or Expression the layer goes on with its plan, and an update raises
    ScenarioError: it solves with floating-point numbers only.

    `diagnostics` has the fields of `Diagnostics`, with the smallest speed margin of the whole
    horizon. `missed_limits` counts the plans that do not keep each of the stated limits, and of
    aircraft also the bound.

    Raises:
        ScenarioError: a parameter is out of range, the horizon is shorter than a turn or the knots
            are no whole control periods apart; during a run, the command is out of range, or the
            preview ends before the horizon.
    """

    reads = ("reference", WIND, _FLOWN, COMMAND, SAMPLE_TIME, _PREVIEW)
    makes: ClassVar[tuple[str, ...]] = (
        *("parameters", "plan", "diagnostics", "solve_time", "speed_bound"),
        *("missed_limits", "measured_margin"),
    )

    where: ClassVar = PeriodicLayer.where | {SAMPLE_TIME: "the model has a control period"}
    optional_inputs = (_PREVIEW, WIND, COMMAND, _FLOWN)
    unconnected: ClassVar = CommandedBound.unconnected | {_FLOWN: _NOWHERE}
    counts_bow = True  # of the references' cables

    def __init__(self, model: Model, config: RecedingHorizonOptimizerConfig | None = None):
        self.reads_time = model.control_period == 0
        own = config or RecedingHorizonOptimizerConfig()
        self.makes_next_state = own.tightening == MEASURED and model.control_period > 0
        is_made = {"measured_margin": self.makes_next_state}
        self.makes = tuple(  # type: ignore[misc]
            name for name in type(self).makes if is_made.get(name, True)
        )
        super().__init__(model, config)
        self.highest_speed_bound = highest_speed_bound(self.config)
        self._times = timed(self.config, self.config.frequency, model.control_period)
        self._planner = None
        if self.scalar is float:
            self._planner = _Planner(model, self._times, self.get_name)

    def requires(self, loop: LoopBlocks) -> Iterator[str]:
        """Tells of a phase that does not follow the plan."""
        yield from super().requires(loop)
        phase = loop.maker_of("phase")
        if phase is not None and not phase.HasInputPort("plan"):
            yield (
                f"phase = {type(phase).__name__}: it does not read the plan of optimization_layer, "
                "and departs from the phase that is planned with; give phase=ShapedPhase, or "
                "optimization_layer=NlpLayer, which reads the phase"
            )

    def inputs(self, model: Model) -> tuple[str, ...]:
        """The signals that are vectors; what is measured where the margin follows it."""
        read = super().inputs(model)
        return tuple(name for name in read if name != _FLOWN or self.makes_next_state)

    def step_period(self, model: Model, config: RecedingHorizonOptimizerConfig) -> float:
        """Spacing of the knots, s."""
        return timed(config, config.frequency, model.control_period).knot_spacing

    def parts(self, model: Model, config: RecedingHorizonOptimizerConfig) -> dict[str, ArrayLike]:
        """The last plan: at first none."""
        times = timed(config, config.frequency, model.control_period)
        count = times.intervals + DEGREE
        nominal, ones = np.array([config.frequency, config.amplitude]), np.ones((2, count))
        bound = float(config.speed_bound)
        last = _PlanState(0.0, 0.0, _NO_PLAN, bound, 0.0, nominal, ones).flat()
        return {_LAST: last, _MARGIN: NOTHING_MEASURED}

    def constants(self, model: Model, config: RecedingHorizonOptimizerConfig) -> dict[str, Any]:
        """Constants of `PeriodicLayer`, the highest bound, m/s, and what speeds follow from."""
        own = {
            "highest": highest_speed_bound(config),
            "spacing": self.step_period(model, config),
            "measures_every": model.control_period if self.makes_next_state else 0.0,
            "counts_wind": model.aircraft is not None and config.wind,
            "believed": {
                "attachments": model.attachments,
                "pseudo_inverse": model.pseudo_inverse,
                "pattern": model.pattern,
                "shape": planned_shape(model.cable_shape),
            },
        }
        return super().constants(model, config) | own

    @staticmethod
    def equations(state: NDArray, *inputs: Any, **numbers: Any) -> tuple[NDArray, ...]:
        """Outputs, of which the plan is that at the sample's time, the last input."""
        reference, *others, command, time = inputs
        places = numbers["shown"]["places"]
        last = _PlanState.view(state[places[_LAST]])
        plan = where(
            last.scale != _NO_PLAN,
            last.plan(numbers["spacing"]).planned(time[0]),
            np.concatenate([np.zeros(1), last.nominal, np.zeros(PLANNED_SIZE - 3)]),
        )
        bound = shown_bound(command, numbers["speed_bound"], LEAST_BOUND, numbers["highest"])
        margin = state[places[_MARGIN]]
        own = {"plan": plan, "parameters": plan[1:3], "measured_margin": margin[1:2] * bound}
        outputs = outputs_of(state, speed_bound=bound, **own, **numbers["shown"])
        period = numbers["measures_every"]
        if not period:
            return outputs
        *winds, carriers = others
        wind = winds[0] if winds and numbers["counts_wind"] else STILL_AIR
        planned = planned_motion(
            rigid_load(**{name: numbers[name] for name in LOAD}),
            reference,
            plan,
            wind,
            offset=numbers.get(OFFSET, np.zeros(carriers.size // 2)),
            rest_length=numbers["cable_length"],
            compliance=compliance_of(numbers["cable_stiffness"]),
            **numbers["believed"],
        )
        deviations = deviations_of(planned, CarrierStates.view(carriers).velocities)
        after = margin_after(margin, deviations, bound, period)
        after = where(carriers[0] != _NOWHERE, after, margin)
        before, later = state[: places[_MARGIN].start], state[places[_MARGIN].stop :]
        return np.concatenate([before, after, later]), *outputs

    @classmethod
    def check(cls, model: Model, config: RecedingHorizonOptimizerConfig) -> None:
        """Raises ScenarioError for a config that cannot be used with the model."""
        remedy = "the pattern has no orbits that it could change; give !TurnRateOptimizer and "
        remedy += "load_trajectory: !PlannedTurn, whose load turns with its aircraft"
        can_turn = model.aircraft is not None and model.pattern.is_constant
        require(not can_turn, BOX, "RecedingHorizonOptimizer", remedy)
        check_limits(BOX, config, model, measures=True)
        check_horizon(BOX, config, config, model)
        check_pattern(BOX, model, "RecedingHorizonOptimizer")

    def block_parameters(
        self, model: Model, config: RecedingHorizonOptimizerConfig
    ) -> BlockParameters:
        """Beliefs, initial values and bounds; amplitude bounds of zero are those of the weight."""
        return BlockParameters(
            model,
            (*OF_MODEL, *model.offset_parameter),
            config=replace(config, amplitude_bounds=config.amplitude_bounds or [0.0, 0.0]),
            own=("speed_bound", *OF_CONFIG),
        )

    def check_bound(self, speed_bound: float, name: str = "speed_bound") -> None:
        """Raises ScenarioError for neither 0 nor from 1e-3 m/s to below the highest bound."""
        check_speed_bound(f"{BOX}.{name}", speed_bound)
        highest = self.highest_speed_bound
        remedy = f"give less than {highest:g} m/s, for the sake of max_speed"
        require(speed_bound < highest, f"{BOX}.{name}", speed_bound, remedy)

    def begin_anew(self, context: Context) -> None:
        """Lets what has no plan begin with the parameters of the context, its own."""
        last = self._last(context)
        if last.scale != _NO_PLAN:
            return
        begun = last._replace(nominal=self._beliefs(context).nominal)
        context.SetDiscreteState(self.flat(self.states(context) | {_LAST: begun.flat()}))

    def answer(self, context: Context) -> NDArray:
        """The state after a new plan."""
        states = self.states(context)
        _, share, reached = states[_MARGIN]
        begin = min((1 + reached) / (1 + share), 1.0)
        made = self._next(context, share, begin)
        margin = margin_at_next_plan(states[_MARGIN])
        after: dict[str, Any] = {_LAST: made.state.flat(), _MARGIN: margin}
        after["solve_time"] = made.solve_time
        above = made.slowest_speed - float(self.bound_in(context)[0])
        after |= self.counted_update(states, made.outcome, above, made.missed)
        return self.flat(states | after)

    def _next(self, context: Context, share: float, begin: float) -> "_Planned":
        """The plan that is made at the time of the context, with this share of ε as a margin.

        A share `begin` of what it aims at holds at its start.
        """
        assert self._planner is not None
        wind = self.input(context, WIND).copy() if self.config.wind else STILL_AIR
        bound = float(self.bound_in(context)[0])
        # Plans add the first share by themselves.
        aim = bound * (1 + share) / (1 + FIRST_SHARE) if self.makes_next_state else bound
        return self._planner.plan(
            context.get_time(),
            self._reference_ahead(context),
            bound,
            (aim, begin),
            self._beliefs(context),
            self._last(context),
            wind,
        )

    def _beliefs(self, context: Context) -> ModelParameters:
        """What is believed of load, cables and pattern, and the layer's own numbers."""
        return beliefs_from(parameters_in(self, context), self.model.n)

    def _last(self, context: Context) -> "_PlanState":
        return _PlanState.view(self.states(context)[_LAST])

    def _reference_ahead(self, context: Context) -> ReferencePreview:
        """The load's reference at times from now on."""
        port = self.GetInputPort(_PREVIEW)
        if self.config.preview and port.HasValue(context):
            preview = port.Eval(context)
            end = context.get_time() + self._times.intervals * self._times.knot_spacing
            require(
                preview.end_time >= end,
                f"{_PREVIEW}.end_time",
                preview.end_time,
                f"it ends before the horizon, at {end:g} s; let it tell more, or give fewer "
                f"{BOX}.intervals",
            )
            return preview
        assert self._planner is not None
        reference = self.GetInputPort("reference").Eval(context)
        return self._planner.continued(context.get_time(), reference)


class _PlanState(NamedTuple):
    """A plan as it is in the context."""

    start_time: float  # s
    start_angle: float  # rad
    scale: float  # of the trust region
    speed_bound: float  # m/s, ε
    slack: float  # that it needs
    nominal: NDArray  # (2,), [ξ, A], rad/s and N
    coefficients: NDArray  # (2, N), relative to these

    @classmethod
    def view(cls, vector: NDArray) -> "_PlanState":
        """The parts of a vector (7 + 2N,)."""
        time, angle, scale, bound, slack = vector[:5].tolist()
        return cls(time, angle, scale, bound, slack, vector[5:7], vector[7:].reshape(2, -1))

    def flat(self) -> NDArray:
        """The vector (7 + 2N,) of the parts."""
        return np.concatenate([self[:5], self.nominal, self.coefficients.ravel()])

    def plan(self, spacing: float) -> Plan:
        """The plan with knots every `spacing` s."""
        return Plan(self.start_time, self.start_angle, spacing, self.nominal, self.coefficients)


class _Planned(NamedTuple):
    """A plan, and how it came to be."""

    state: _PlanState
    outcome: Outcome
    slowest_speed: float  # m/s, along the plan
    missed: set[str]  # names of limits, as of `missed_limits`
    solve_time: float  # s, of wall time


class _Planner(threading.local):
    """Makes plans; they depend on the arguments alone.

    The last one is kept: a loop that looks for its equilibrium asks for the same again and again.
    So is what it knew of the motion, of which the next one needs most. Each thread has its own.
    """

    def __init__(self, model: Model, config: RecedingHorizonOptimizerConfig, name: Any):
        self._model, self._config, self._name = model, config, name
        # By the number of fixed coefficients: that of the config, or 0.
        self._solvers: dict[int, tuple[bytes, HorizonSolver]] = {}
        self._data: dict[int, tuple[HorizonSolver, ReferencePreview, HorizonData]] = {}
        self._continued: tuple[Any, ReferencePreview] | None = None
        self._last: tuple[tuple[Any, ...], _Planned] | None = None

    def plan(
        self,
        time: float,
        reference: ReferencePreview,
        speed_bound: float,
        aim: tuple[float, float],
        numbers: ModelParameters,
        last: _PlanState,
        wind: NDArray,
    ) -> _Planned:
        """The next plan, from a time in s on, in a wind (3,), which goes on from the last one.

        In place of ε it is for the speed, m/s, that `aim` begins with; of that a share, the other
        number, holds at the start.
        """
        began = clock.perf_counter()
        arrays = last.flat(), np.concatenate(numbers), wind
        key = (reference, time, speed_bound, aim, *(array.tobytes() for array in arrays))
        if self._last is None or self._last[0] != key:
            self._last = key, self._made(time, reference, speed_bound, aim, numbers, last, wind)
        return self._last[1]._replace(solve_time=clock.perf_counter() - began)

    def _made(
        self,
        time: float,
        reference: ReferencePreview,
        speed_bound: float,
        aim: tuple[float, float],
        numbers: ModelParameters,
        last: _PlanState,
        wind: NDArray,
    ) -> _Planned:
        """The same, made now."""
        solver = self._solver_for(numbers, self._config.fixed_coefficients)
        problem, spacing = solver.problem, self._config.knot_spacing
        start_time = spacing * np.floor(time / spacing + 1e-6)
        is_first = last.scale == _NO_PLAN
        if is_first:
            angle = numbers.nominal[0] * (start_time - time)
            start = problem.nominal_coefficients()
        else:
            before = last.plan(spacing)
            knots = round((start_time - before.start_time) / spacing)
            shifted = before.shifted(knots) if knots > 0 else before
            ratio = (last.nominal / numbers.nominal)[:, None]
            angle, start = shifted.start_angle, ratio * shifted.coefficients
        given = start_time, angle, reference, aim, wind
        data = self._data_for(solver, *given)
        is_new = is_first or speed_bound != last.speed_bound
        scale = 1.0 if is_new else max(last.scale, LEAST_START_SCALE)
        starts, repeats = _STARTS, _REPEATS
        if not is_new and last.slack > PLAN_TOLERANCE:
            # The last plan has tried all in vain: starts take turns until one needs no slack.
            repeats, starts = 1, (_STARTS[round(start_time / spacing) % len(_STARTS)],)
        answer, outcome = self._make(solver, data, start, scale, is_new, repeats, starts)
        if not np.all(np.isfinite(answer.coefficients)):
            raise NotFiniteError(self._name())
        judge, margins, slowest = problem, answer.margins, answer.slowest
        if is_first:  # nothing has to go on: the carriers start wherever the plan does
            judging = self._solver_for(numbers, 0)
            judge, judged = judging.problem, self._data_for(judging, *given)
            margins = judge.linearization(judged, answer.coefficients).margins
            slowest = judge.slowest(judged, margins)
            if judge.least_slacks(margins).max() > PLAN_TOLERANCE:
                made = self._make(judging, judged, start, scale, is_new, repeats, starts)
                answer, outcome = made
                margins, slowest = answer.margins, answer.slowest
        slack, begin = answer.slack, (start_time, angle, answer.scale, speed_bound)
        state = _PlanState(*begin, slack, numbers.nominal, answer.coefficients)
        missed = judge.missed(margins, PLAN_TOLERANCE) if slack > PLAN_TOLERANCE else set()
        return _Planned(state, outcome, slowest, missed, 0.0)

    def continued(self, now: float, reference: NDArray) -> ReferencePreview:
        """How a reference (22,) at a time in s goes on, where that is not told."""
        key = now, reference.tobytes()
        if self._continued is None or self._continued[0] != key:
            own = reference.copy()
            preview = ReferencePreview(
                lambda time: continued_reference(own, time - now),
                references=lambda times: continued_reference(own, times - now),
            )
            self._continued = key, preview
        return self._continued[1]

    def _data_for(
        self,
        solver: HorizonSolver,
        start_time: float,
        angle: float,
        reference: ReferencePreview,
        aim: tuple[float, float],
        wind: NDArray,
    ) -> HorizonData:
        """The data of a plan, with what the last one's tell of the same motion and beliefs."""
        known = self._data.get(solver.fixed)
        is_same = known is not None and known[0] is solver and known[1] is reference
        last = known[2] if known is not None and is_same else None
        speed, share = aim
        data = solver.problem.data(start_time, angle, reference, speed, last, wind, share)
        self._data[solver.fixed] = solver, reference, data
        return data

    def _make(
        self,
        solver: HorizonSolver,
        data: HorizonData,
        start: NDArray,
        scale: float,
        is_new: bool,
        repeats: int,
        starts: tuple[float, ...],
    ) -> tuple[PlanAnswer, Outcome]:
        def improved(coefficients: NDArray, scale: float) -> PlanAnswer:
            iterations = _MANY_ITERATIONS if is_new else self._config.max_iterations
            answer = solver.solve(data, coefficients, max_iterations=iterations, scale=scale)
            if is_new or answer.is_feasible:
                return answer
            return solver.solve(
                data,
                answer.coefficients,
                max_iterations=repeats * iterations,
                scale=max(answer.scale, LEAST_START_SCALE),
                until_feasible=True,
            )

        answer = improved(start, scale)
        for factor in starts:
            if not factor and (is_new or answer.slack > _FAR_FROM_FEASIBLE):
                other = solver.first_guess(data, start[:, : solver.fixed])
            elif factor and (solver.fixed == 0 or not answer.is_feasible):
                other = start.copy()
                other[0, solver.fixed :] *= factor
            else:
                continue
            answer = min(answer, improved(other, 1.0), key=solver.merit)
        if not answer.is_feasible:
            return answer, Outcome.RELAXED
        is_kept = np.array_equal(answer.coefficients, start)
        return answer, Outcome.KEPT if is_kept else Outcome.SOLVED

    def _solver_for(self, numbers: ModelParameters, fixed: int) -> HorizonSolver:
        """The solver of plans whose first coefficients are fixed, so many of them."""
        key = np.concatenate(numbers).tobytes()
        known = self._solvers.get(fixed)
        if known is None or known[0] != key:
            problem = HorizonProblem(
                self._model,
                self._config,
                replace(self._config, fixed_coefficients=fixed),
                beliefs=numbers,
                shape=self._model.cable_shape,
            )
            self._solvers[fixed] = known = key, HorizonSolver(problem, self._name)
        return known[1]
