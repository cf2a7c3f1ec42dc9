"""Successive quadratic programs for the nonstop problem over a horizon."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.planning.horizon_problem import (
    AMPLITUDE_WEIGHT,
    HorizonData,
    HorizonProblem,
    Linearization,
)
from drake_nonstop.planning.plan import Plan
from drake_nonstop.planning.step_program import StepProgram
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
_TRIED = (12, 8)  # values of ξ and of A of a first guess
_TRIED_SHARES = (0.5, 4.0), (0.5, 2.0)  # of the nominal ones


class PlanAnswer(NamedTuple):
    """A plan and what is known of it."""

    plan: Plan
    coefficients: NDArray  # (2, N), of the plan
    cost: float  # without slack
    slack: float  # the largest relative violation of a constraint, of squared speeds
    iterations: int  # quadratic programs
    scale: float  # of the trust region at the end
    converged: bool
    margins: NDArray  # (r, p), of its constraints
    slowest: float  # m/s, the least speed at the instants

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
    Wright, Numerical Optimization, 2006, section 18.3).

    Args:
        problem: what all plans share.
        name: tells what solves it, for the error of a value that is not finite.

    Attributes:
        fixed: how many of the first coefficients are given.
    """

    def __init__(self, problem: HorizonProblem, name: Callable[[], str] = lambda: "a plan"):
        self.problem, self.fixed = problem, problem.config.fixed_coefficients
        self._name = name
        self._solver = problem.config.solver
        count = problem.count
        free = np.arange(self.fixed, count)
        self._free = np.concatenate([free, count + free])  # among both splines' coefficients
        self._weights = problem.slack_weights
        size, slacks = len(self._free), len(self._weights)
        self._hessian = np.zeros((size + slacks, size + slacks))
        self._hessian[:size, :size] = problem.hessian[np.ix_(self._free, self._free)]
        rows = _difference_rows(count, self.fixed)
        largest = np.repeat(problem.largest_differences, len(rows) // 2)
        limited = np.isfinite(largest)
        self._differences, self._largest_differences = rows[limited], largest[limited]
        angles = problem.angle_rows()[:, self.fixed :]
        of_angles = np.hstack([angles, np.zeros(angles.shape)])
        # Of the changes of θ at the knots, and of the differences of neighbouring coefficients.
        of_step = np.vstack([of_angles, self._differences[:, self._free]])
        self._fixed_rows = np.hstack([of_step, np.zeros((len(of_step), slacks))])
        self._little_slack = PLAN_TOLERANCE * float(self._weights.min())

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

        Raises:
            NotFiniteError: the merit of the start is not finite.
        """
        problem = self.problem
        x = self._within_limits(start)
        about = problem.linearization(data, x)
        merit, slack = self._merit(x, about)
        if not math.isfinite(merit):
            raise NotFiniteError(self._name())
        steps = _Steps(self)
        converged, iterations = False, 0
        while iterations < max_iterations and scale >= _LEAST_SCALE:
            iterations += 1
            found = steps.step(x, about, scale)
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
            if is_poor and new_slack > 0 and math.isfinite(new_merit):
                # The step again, with the curvature of the constraints along it.
                margins = there.margins - about.changes(candidate - x)
                found = steps.step(x, replace(about, margins=margins), scale)
                if found is not None:
                    again = problem.linearization(data, found[0])
                    again_merit, again_slack = self._merit(found[0], again)
                    if again_merit < new_merit:
                        candidate, there = found[0], again
                        new_merit, new_slack = again_merit, again_slack
            ratio = (merit - new_merit) / decrease if math.isfinite(new_merit) else -math.inf
            if ratio > _LEAST_RATIO:
                x, merit, slack, about = candidate, new_merit, new_slack, there
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
            margins=about.margins,
            slowest=problem.slowest(data, about.margins),
        )

    def first_guess(self, data: HorizonData, fixed: NDArray | None = None) -> NDArray:
        """Coefficients (2, N) of constant ξ and A that keep the margins on whole orbits.

        Of a grid of them those nearest to the nominal ones, or where none do, the ones that miss
        least. The first coefficients are `fixed` (2, fixed), or the nominal ones.
        """
        coefficients = self.problem.nominal_coefficients()
        coefficients[:, self.fixed :] = self._constant_shares(data)[:, None]
        if fixed is not None:
            coefficients[:, : self.fixed] = fixed
        return coefficients

    def _constant_shares(self, data: HorizonData) -> NDArray:
        """The shares (2,) of the nominal ξ and A of a first guess."""
        problem = self.problem
        low, high = problem.bounds
        tried = [
            np.append(np.geomspace(*np.clip(ends, low[k, 0], high[k, 0]), count), 1.0)  # type: ignore[call-overload]
            for k, (ends, count) in enumerate(zip(_TRIED_SHARES, _TRIED, strict=True))
        ]
        shares = np.stack([part.ravel() for part in np.meshgrid(*tried)])
        worst = problem.orbit_margins(data, shares * problem.nominal[:, None]).min(axis=0)
        worst = np.nan_to_num(worst, nan=-np.inf)
        if worst.max() < 0:
            return shares[:, worst.argmax()]
        away = (shares - 1) ** 2
        cost = away[0] + AMPLITUDE_WEIGHT * away[1]
        return shares[:, np.where(worst >= 0, cost, np.inf).argmin()]

    def merit(self, answer: PlanAnswer) -> float:
        """Score to compare plans of the same data by: the cost and the penalty of the slack."""
        slack = 0.0 if answer.is_feasible else answer.slack
        return answer.cost + float(self._weights.sum()) * slack

    def _merit(self, x: NDArray, about: Linearization) -> tuple[float, float]:
        slacks = self.problem.least_slacks(about.margins)
        return self.problem.cost(x) + float(self._weights @ slacks), float(slacks.max())

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
        self._active = np.zeros(solver.problem.slacks.shape, bool)  # that have decided a step

    def step(self, x: NDArray, about: Linearization, scale: float) -> tuple[NDArray, float] | None:
        """The next coefficients and the merit that is predicted; None where no step is found."""
        problem, owner = self._problem, self._owner
        free = owner._free
        low, high = problem.bounds
        flat, part = x.ravel(), x[:, owner.fixed :]
        radius = scale * _COEFFICIENT_RADIUS
        slacks = len(owner._weights)
        angle = np.full(problem.intervals, scale * _ANGLE_RADIUS)
        differences, most = owner._differences @ flat, owner._largest_differences
        program = StepProgram(
            hessian=owner._hessian,
            gradient=np.concatenate([(problem.hessian @ (flat - 1))[free], owner._weights]),
            # No change at all is always allowed.
            lower=np.append(np.clip(low - part, -radius, 0.0), np.zeros(slacks)),
            upper=np.append(np.clip(high - part, 0.0, radius), np.full(slacks, np.inf)),
            rows=owner._fixed_rows,
            least=np.concatenate([-angle, np.minimum(-most - differences, 0)]),
            most=np.concatenate([angle, np.maximum(most - differences, 0)]),
        )
        margins = about.margins
        near = problem.with_neighbours(
            problem.dips(margins, _LARGEST_MARGIN), margins, _NEAR_MARGIN
        )
        chosen = self._active | near
        for _ in range(_MOST_ROUNDS):
            values = self._with_rows(program, about, chosen).solved(owner._solver)
            if values is None:
                return None
            flat_step = np.zeros(x.size)
            flat_step[free], slack = values[: len(free)], values[len(free) :]
            step = flat_step.reshape(x.shape)
            margins = about.margins + about.changes(step)
            excess = margins + slack[problem.slacks]
            self._active = chosen & (excess < _ACTIVE_MARGIN)
            new = problem.dips(excess, -_ROW_TOLERANCE) & ~chosen
            if not new.any():
                break
            chosen = chosen | problem.with_neighbours(new, excess, _ACTIVE_MARGIN)
        candidate, penalty = x + step, float(owner._weights @ problem.least_slacks(margins))
        return candidate, problem.cost(candidate) + penalty

    def _with_rows(
        self, program: StepProgram, about: Linearization, chosen: NDArray
    ) -> StepProgram:
        """The program with chosen constraints."""
        at = np.nonzero(chosen)
        count = len(at[0])
        slacks = np.zeros((count, len(self._owner._weights)))
        slacks[np.arange(count), self._problem.slacks[at]] = 1
        own = np.hstack([about.jacobian(at, self._owner.fixed), slacks])
        return program._replace(
            rows=np.vstack([program.rows, own]),
            least=np.concatenate([program.least, -about.margins[at]]),
            most=np.concatenate([program.most, np.full(count, np.inf)]),
        )


def _difference_rows(count: int, fixed: int) -> NDArray:
    """The matrix (2r, 2N) of both splines' differences of neighbouring coefficients.

    Of each difference one coefficient at least is free.
    """
    return np.kron(np.eye(2), (np.eye(count) - np.eye(count, k=-1))[max(fixed, 1) :])
