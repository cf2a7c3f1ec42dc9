"""Successive quadratic programs for the nonstop problem over a horizon."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.planned_orbit import OrbitTerms
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.optimization.compiled_plan import CompiledPlan, compiled_solver
from drake_nonstop.optimization.constraints import FEASIBILITY_TOLERANCE
from drake_nonstop.optimization.horizon_motion import HorizonData, Reference
from drake_nonstop.optimization.horizon_problem import HorizonProblem, Linearization
from drake_nonstop.optimization.plan import DEGREE, Plan
from drake_nonstop.optimization.search_problem import (
    FEW,
    SearchProblem,
    best_on_grid,
    nearest_feasible,
)
from drake_nonstop.optimization.step_program import DAQP, StepProgram
from drake_nonstop.optimization.terminal_set import orbit_polynomials
from drake_nonstop.systems.tracing import NotFiniteError

PLAN_TOLERANCE = 2e-4  # on the slack of a plan: 0.01 % of a speed
_ANGLE_RADIUS = 0.4  # rad, of the trust region: how far the phases may move in a step
_COEFFICIENT_RADIUS = 0.4  # likewise for the coefficients, relative to the nominal
_LARGEST_MARGIN = 0.5  # of constraints that a step takes into account from the start
_NEAR_MARGIN = 0.3  # likewise of those next to the least ones, where a minimum may move to
_MOST_ROUNDS = 6  # of a step, each with those constraints that the one before it violates
_LEAST_RATIO = 0.1  # of the decrease of the merit to the predicted one, to accept a step
_FAIR_RATIO = 0.3  # below which the trust region shrinks
_GOOD_RATIO = 0.7  # above which the trust region grows
_LEAST_SCALE, _LARGEST_SCALE = 1e-3, 4.0  # of the trust region
LEAST_START_SCALE = 0.1  # of the trust region with which a plan goes on from another
_ROW_TOLERANCE = 1e-6  # on a margin of a step
_ACTIVE_MARGIN = 0.01  # below which a constraint is likely to decide
_SETTINGS = (  # in the order of solve_plan.c
    *(_ANGLE_RADIUS, _COEFFICIENT_RADIUS, _LARGEST_MARGIN, _NEAR_MARGIN),
    *(_LEAST_RATIO, _FAIR_RATIO, _GOOD_RATIO, _LEAST_SCALE, _LARGEST_SCALE),
    *(_ROW_TOLERANCE, _ACTIVE_MARGIN, PLAN_TOLERANCE),
)
_SEARCH_PHASES = 16
_MOST_BOWS = 4  # plans, each with cables that bow as along the one before it
_SAME_BOW = 0.02  # of the nominal ξ and A, within which a plan's cables bow as another one's
_FIRST_ITERATIONS = 20  # of the first plan, which has no other to begin with


class PlanAnswer(NamedTuple):
    """A plan and what is known of it."""

    plan: Plan
    coefficients: NDArray  # (2, N), of the plan
    cost: float  # without slack
    slack: float  # the largest relative violation of a constraint, of squared speeds
    iterations: int  # quadratic programs
    scale: float  # of the trust region at the end
    converged: bool
    margins: NDArray  # (r,), of its constraints
    slowest: float  # m/s, the least speed at the instants

    @property
    def next_start(self) -> NDArray:
        """Coefficients (2, N) to begin with one interval between knots later."""
        return self.plan.shifted().coefficients

    @property
    def is_feasible(self) -> bool:
        """Whether the plan needs no slack, but for what successive programs leave."""
        return self.slack <= PLAN_TOLERANCE


class HorizonSolver:
    """Solves a `HorizonProblem` for given data; answers depend on the arguments alone.

    Each step solves a quadratic program in a trust region, by the config's `solver`: the cost is
    quadratic as it is, the constraints are linearized with exact gradients. Of thousands of
    constraints a few decide: a step begins with those that are near, and is found anew with those
    that it violates. It is accepted where cost and exact penalty of the slack fall; where they
    fall less than predicted and slack is left, a second-order correction is tried (Nocedal and
    Wright, Numerical Optimization, 2006, section 18.3). With DAQP all of it is one call of
    solve_plan.c, where that can be compiled.

    Attributes:
        problem: what all plans share.
        fixed: how many of the first coefficients are given.
        free: (f,), the numbers of the others, among both splines' coefficients.
        weights: (s,), of the slacks.
        step_hessian: (f + s, f + s), of the cost of a step.
        fixed_rows: (a + d, f + s), of the changes of θ at the knots, and of the differences of
            neighbouring coefficients with a limit.
        differences: (d, 2N), the latter by all coefficients.
        largest_differences: (d,).
    """

    def __init__(self, problem: HorizonProblem, *, compiles: bool = True):
        self.problem, self.fixed = problem, problem.config.fixed_coefficients
        self.solver = problem.config.solver
        count = problem.count
        free = np.arange(self.fixed, count)
        self.free = np.concatenate([free, count + free])
        self.weights = problem.slack_weights
        size, slacks = len(self.free), len(self.weights)
        self.step_hessian = np.zeros((size + slacks, size + slacks))
        self.step_hessian[:size, :size] = problem.hessian[np.ix_(self.free, self.free)]
        rows = _difference_rows(count, self.fixed)
        largest = np.repeat(problem.largest_differences, len(rows) // 2)
        limited = np.isfinite(largest)
        self.differences, self.largest_differences = rows[limited], largest[limited]
        angles = problem.angle_rows()[:, self.fixed :]
        of_angles = np.hstack([angles, np.zeros(angles.shape)])
        of_step = np.vstack([of_angles, self.differences[:, self.free]])
        self.fixed_rows = np.hstack([of_step, np.zeros((len(of_step), slacks))])
        self._little_slack = PLAN_TOLERANCE * float(self.weights.min())
        self._compiled: CompiledPlan | None = None
        compiles = compiles and self.solver == DAQP and problem.is_compiled
        if compiles and (solve_plan := compiled_solver()) is not None:
            settings = [*_SETTINGS, self._little_slack, _MOST_ROUNDS]
            self._compiled = CompiledPlan(solve_plan, self, settings)

    def solve(
        self,
        data: HorizonData,
        start: NDArray,
        *,
        max_iterations: int = 2,
        tolerance: float = 5e-3,
        scale: float = 1.0,
        until_feasible: bool = False,
    ) -> PlanAnswer:
        """The best plan that is found from coefficients `start` (2, N), whose first are kept.

        Args:
            data: of the plan.
            start: such as those of the last plan, shifted, or of `first_guess`.
            max_iterations: of quadratic programs.
            tolerance: a predicted decrease of the merit below this, relative to it, is converged;
                a plan that needs slack goes on as long as that can fall.
            scale: of the trust region at the start.
            until_feasible: ends with the first plan that needs no slack.

        Where cables bow the plan is made anew until it is nearly that along which they bow so.
        """
        answer, begun = None, start
        for _ in range(_MOST_BOWS if self.problem.shape is not None else 1):
            given = self.problem.bowed(data, begun)
            answer = self._solved(given, begun, max_iterations, tolerance, scale, until_feasible)
            moved = np.abs(answer.coefficients - begun).max()
            if moved <= _SAME_BOW:
                break
            begun, scale = answer.coefficients, max(answer.scale, LEAST_START_SCALE)
        assert answer is not None
        return answer

    def _solved(
        self,
        data: HorizonData,
        start: NDArray,
        max_iterations: int,
        tolerance: float,
        scale: float,
        until_feasible: bool,
    ) -> PlanAnswer:
        """Answer of `solve` for cables that bow as the data tell."""
        problem = self.problem
        x = self._within_limits(start)
        if self._compiled is not None:
            made = self._compiled.solved(
                data, x, max_iterations, tolerance, scale, until_feasible=until_feasible
            )
            return PlanAnswer(problem.plan(data, x), x, *made)
        linearization = problem.linearization(data, x)
        merit, slack = self._merit(x, linearization)
        if not math.isfinite(merit):
            raise NotFiniteError(problem.name())
        steps = _Steps(self)
        converged = False
        iterations = 0
        while iterations < max_iterations and scale >= _LEAST_SCALE:
            iterations += 1
            found = steps.step(x, linearization, scale)
            if found is None:
                scale /= 4
                continue
            candidate, predicted = found
            decrease = merit - predicted
            little = tolerance * (abs(merit) + 1e-6)
            if slack > PLAN_TOLERANCE:
                little = min(little, self._little_slack)
            if decrease <= little:
                converged = True
                break
            there = problem.linearization(data, candidate)
            new_merit, new_slack = self._merit(candidate, there)
            is_poor = not merit - new_merit > _GOOD_RATIO * decrease
            if is_poor and new_slack > PLAN_TOLERANCE and math.isfinite(new_merit):
                # The step again, with the curvature of the constraints along it.
                margins = there.margins - linearization.changes(candidate - x)
                found = steps.step(x, replace(linearization, margins=margins), scale)
                if found is not None:
                    again = problem.linearization(data, found[0])
                    again_merit, again_slack = self._merit(found[0], again)
                    if again_merit < new_merit:
                        candidate, there = found[0], again
                        new_merit, new_slack = again_merit, again_slack
            ratio = (merit - new_merit) / decrease if math.isfinite(new_merit) else -math.inf
            if ratio > _LEAST_RATIO:
                x, merit, slack, linearization = candidate, new_merit, new_slack, there
            if ratio > _GOOD_RATIO:
                scale = min(2 * scale, _LARGEST_SCALE)
            elif ratio < _FAIR_RATIO:
                scale /= 3
            if until_feasible and slack <= PLAN_TOLERANCE:
                break
        return PlanAnswer(
            plan=problem.plan(data, x),
            coefficients=x,
            cost=problem.cost(x),
            slack=slack,
            iterations=iterations,
            scale=scale,
            converged=converged,
            margins=linearization.margins,
            slowest=linearization.slowest,
        )

    def first_guess(self, data: HorizonData, fixed: NDArray | None = None) -> NDArray:
        """Coefficients (2, N) of the constant ξ and A that the global search finds.

        They keep all carriers above the bound at all instants and phases, or come near to it. The
        first coefficients are `fixed` (2, fixed), or the nominal ones.
        """
        problem = self.problem
        coefficients = problem.nominal_coefficients()
        constant = _constant_parameters(problem, data) / problem.nominal
        coefficients[:, self.fixed :] = constant[:, None]
        if fixed is not None:
            coefficients[:, : self.fixed] = fixed
        return coefficients

    def merit(self, answer: PlanAnswer) -> float:
        """Score to compare plans of the same data by: the cost and the penalty of the slack."""
        slack = 0.0 if answer.is_feasible else answer.slack
        return answer.cost + float(self.weights.sum()) * slack

    def _merit(self, x: NDArray, linearization: Linearization) -> tuple[float, float]:
        slacks = self.problem.slacks(linearization.margins)
        return self.problem.cost(x) + float(self.weights @ slacks), float(slacks.max())

    def _within_limits(self, start: NDArray) -> NDArray:
        """The coefficients with the free ones within their bounds and those of their rates."""
        problem, x = self.problem, np.array(start, order="C")
        low, high = problem.bounds
        x[:, self.fixed :] = np.clip(x[:, self.fixed :], low, high)
        difference = problem.largest_differences[:, 0]
        if np.isfinite(difference).any():
            for i in range(max(self.fixed, 1), problem.count):
                before = x[:, i - 1]
                x[:, i] = np.clip(x[:, i], before - difference, before + difference)
        return x


class _Steps:
    """The steps of a plan, each with those constraints that decide it."""

    def __init__(self, solver: HorizonSolver):
        self._owner, self._problem = solver, solver.problem
        self._active = np.zeros(0, int)  # constraints that have decided a step

    def step(
        self, x: NDArray, linearization: Linearization, scale: float
    ) -> tuple[NDArray, float] | None:
        """The next coefficients and the merit that is predicted; None where no step is found."""
        problem, owner = self._problem, self._owner
        free = owner.free
        low, high = problem.bounds
        flat, part = x.ravel(), x[:, owner.fixed :]
        radius = scale * _COEFFICIENT_RADIUS
        slacks = len(owner.weights)
        angle = np.full(problem.intervals, scale * _ANGLE_RADIUS)
        differences, most = owner.differences @ flat, owner.largest_differences
        program = StepProgram(
            hessian=owner.step_hessian,
            gradient=np.concatenate([(problem.hessian @ (flat - 1))[free], owner.weights]),
            # No change at all is always allowed.
            lower=np.append(np.clip(low - part, -radius, 0.0), np.zeros(slacks)),
            upper=np.append(np.clip(high - part, 0.0, radius), np.full(slacks, np.inf)),
            rows=owner.fixed_rows,
            least=np.concatenate([-angle, np.minimum(-most - differences, 0)]),
            most=np.concatenate([angle, np.maximum(most - differences, 0)]),
        )
        dips = linearization.dips(linearization.margins, _LARGEST_MARGIN)
        near = linearization.with_neighbours(dips, linearization.margins, _NEAR_MARGIN)
        chosen = np.union1d(self._active, near)
        for _ in range(_MOST_ROUNDS):
            values = self._with_rows(program, linearization, chosen).solved(owner.solver)
            if values is None:
                return None
            flat_step = np.zeros(x.size)
            flat_step[free], slack = values[: len(free)], values[len(free) :]
            step = flat_step.reshape(x.shape)
            margins = linearization.margins + linearization.changes(step)
            excess = margins + slack[linearization.layout.slacks]
            self._active = chosen[excess[chosen] < _ACTIVE_MARGIN]
            violated = linearization.dips(excess, -_ROW_TOLERANCE)
            new = np.setdiff1d(violated, chosen)
            if len(new) == 0:
                break
            chosen = np.union1d(chosen, linearization.with_neighbours(new, excess, _ACTIVE_MARGIN))
        candidate, penalty = x + step, float(owner.weights @ problem.slacks(margins))
        return candidate, problem.cost(candidate) + penalty

    def _with_rows(
        self, program: StepProgram, linearization: Linearization, chosen: NDArray
    ) -> StepProgram:
        """The program with chosen constraints."""
        rows = len(chosen)
        slacks = np.zeros((rows, len(self._owner.weights)))
        slacks[np.arange(rows), linearization.layout.slacks[chosen]] = 1
        own = np.hstack([linearization.jacobian(chosen, self._owner.fixed), slacks])
        return program._replace(
            rows=np.vstack([program.rows, own]),
            least=np.concatenate([program.least, -linearization.margins[chosen]]),
            most=np.concatenate([program.most, np.full(rows, np.inf)]),
        )


def _difference_rows(count: int, fixed: int) -> NDArray:
    """The matrix (2r, 2N) of both splines' differences of neighbouring coefficients.

    Of each difference one coefficient at least is free.
    """
    return np.kron(np.eye(2), (np.eye(count) - np.eye(count, k=-1))[max(fixed, 1) :])


def _constant_parameters(problem: HorizonProblem, data: HorizonData) -> NDArray:
    """The [ξ, A] (2,) nearest to the nominal ones that suit all instants and phases."""
    every = problem.config.instants
    terms = OrbitTerms.view(data.flat_terms[::every])
    polynomials = orbit_polynomials(terms, problem.axes, _SEARCH_PHASES)
    low, high = (bound[:, 0] * problem.nominal for bound in problem.bounds)
    search = SearchProblem(
        polynomials=polynomials.reshape(*polynomials.shape[:2], -1),
        rest_length=problem.rest_length,
        compliance=problem.compliance,
        amplitude_margins=problem.amplitude_margins(data, every),
        angles=np.zeros(0),
        previous=problem.nominal,
        nominal=problem.nominal,
        lower=low,
        upper=high,
        speed_bound=float(data.target_speeds.max()),
        speed_unit=data.speed_bound or 1.0,
        max_speed=problem.max_speed,
        internal_force_weight=0.0,
        internal_force_rate_weight=0.0,
        anchor_weight=0.0,
    )
    speeds, others = search.margins(problem.nominal[1:], problem.nominal[:1])
    if min(speeds.min(), others.min()) >= -FEASIBILITY_TOLERANCE:
        return problem.nominal
    found, cost = nearest_feasible(search)
    return found if np.isfinite(cost) else best_on_grid(search.margins, low, high, FEW)[0]


def receding_coefficients(
    problem: HorizonProblem,
    reference: Reference,
    intervals: int,
    speed_bound: float,
    *,
    wind: Callable[[float], NDArray] = lambda time: STILL_AIR,
) -> tuple[NDArray, list[PlanAnswer]]:
    """Plans over a receding horizon along a task that goes as it is predicted.

    Args:
        problem: of one horizon.
        reference: the load's.
        intervals: between knots, from one plan to the next.
        speed_bound: m/s, ε.
        wind: (3,), m/s, in W, that aircraft are believed to fly in, at a time in s.

    Returns:
        The coefficients (2, intervals + 4) that are flown, and each plan.
    """
    solver, spacing = HorizonSolver(problem), problem.config.knot_spacing
    answers: list[PlanAnswer] = []
    flown = np.ones((2, intervals + DEGREE))
    angle, scale, data = 0.0, 1.0, None
    start: NDArray | None = None
    for k in range(intervals):
        start_time = k * spacing
        data = problem.data(start_time, angle, reference, speed_bound, data, wind(start_time))
        if start is None:
            answer = solver.solve(data, solver.first_guess(data), max_iterations=_FIRST_ITERATIONS)
        else:
            answer = solver.solve(data, start, scale=scale)
        answers.append(answer)
        flown[:, k : k + DEGREE + 1] = answer.coefficients[:, : DEGREE + 1]
        start, scale = answer.next_start, max(answer.scale, LEAST_START_SCALE)
        angle = answer.plan.values((k + 1) * spacing).angle
    return flown, answers
