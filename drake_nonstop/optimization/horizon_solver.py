"""Successive quadratic programs for the nonstop problem over a horizon."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.solvers import ClarabelSolver, MathematicalProgram

from drake_nonstop.optimization.active_set_search import nearest_feasible
from drake_nonstop.optimization.grid_search import least_infeasible_on_grid
from drake_nonstop.optimization.horizon_problem import HorizonData, HorizonProblem, Linearization
from drake_nonstop.optimization.margins import FEASIBILITY_TOLERANCE
from drake_nonstop.optimization.plan import Plan
from drake_nonstop.optimization.search_problem import SearchProblem
from drake_nonstop.optimization.terminal_set import orbit_polynomials

_ANGLE_RADIUS = 0.4  # rad, of the trust region: how far the phases may move in a step
_COEFFICIENT_RADIUS = 0.4  # likewise for the coefficients, relative to the nominal
_LARGEST_MARGIN = 1.5  # above which a step is not expected to reach a constraint
_LEAST_RATIO = 0.1  # of the decrease of the merit to the predicted one, to accept a step
_GOOD_RATIO = 0.7  # above which the trust region grows
_LEAST_SCALE, _LARGEST_SCALE = 1e-3, 4.0  # of the trust region
_SEARCH_PHASES = 16


class PlanAnswer(NamedTuple):
    """A plan and what is known of it."""

    plan: Plan
    coefficients: NDArray  # (2, N), of the plan
    cost: float  # without slack
    slack: float  # the largest relative violation of a constraint, of squared speeds
    iterations: int  # quadratic programs
    scale: float  # of the trust region at the end
    converged: bool

    @property
    def next_start(self) -> NDArray:
        """Coefficients (2, N) to begin with one interval between knots later."""
        return self.plan.shifted().coefficients

    @property
    def is_feasible(self) -> bool:
        """Whether the plan needs no slack."""
        return self.slack <= FEASIBILITY_TOLERANCE


class HorizonSolver:
    """Solves a `HorizonProblem` for given data; answers depend on the arguments alone.

    Each step solves a quadratic program in a trust region, by Clarabel through
    MathematicalProgram: the cost is quadratic as it is, the constraints are linearized with exact
    gradients. A step is accepted where cost and exact penalty of the slack fall.

    Args:
        problem: what all plans share.
        fixed: how many of the first coefficients are given; none: those of the config.

    Attributes:
        problem: as given.
        fixed: how many of the first coefficients are given.
    """

    def __init__(self, problem: HorizonProblem, *, fixed: int | None = None):
        self.problem = problem
        self.fixed = problem.config.fixed_coefficients if fixed is None else fixed
        count = problem.count
        free = np.arange(self.fixed, count)
        self._free = np.concatenate([free, count + free])  # among both splines' coefficients
        self._angle_rows = problem.angle_rows()[:, self.fixed :]
        self._weights = problem.slack_weights
        self._solver = ClarabelSolver()

    def solve(
        self,
        data: HorizonData,
        start: NDArray,
        *,
        max_iterations: int = 3,
        tolerance: float = 1e-3,
        scale: float = 1.0,
    ) -> PlanAnswer:
        """The best plan that is found from coefficients `start` (2, N), whose first are kept.

        Args:
            data: of the plan.
            start: such as those of the last plan, shifted, or of `first_guess`.
            max_iterations: of quadratic programs.
            tolerance: a predicted decrease of the merit below this, relative to it, is converged.
            scale: of the trust region at the start.
        """
        problem = self.problem
        low, high = problem.bounds
        x = start.copy()
        x[:, self.fixed :] = np.clip(x[:, self.fixed :], low, high)
        merit, slack = self._merit(data, x)
        linearization: Linearization | None = None
        converged = False
        iterations = 0
        while iterations < max_iterations:
            iterations += 1
            if linearization is None:
                linearization = problem.linearization(data, x, _LARGEST_MARGIN)
            found = self._step(x, linearization, scale)
            if found is None:
                scale /= 4
                continue
            candidate, predicted = found
            decrease = merit - predicted
            if decrease <= tolerance * (abs(merit) + 1e-6):
                converged = True
                break
            new_merit, new_slack = self._merit(data, candidate)
            ratio = (merit - new_merit) / decrease
            if ratio > _LEAST_RATIO:
                x, merit, slack, linearization = candidate, new_merit, new_slack, None
            if ratio > _GOOD_RATIO:
                scale = min(2 * scale, _LARGEST_SCALE)
            elif ratio < 0.3:
                scale /= 3
            if scale < _LEAST_SCALE:
                break
        return PlanAnswer(
            problem.plan(data, x), x, problem.cost(x), slack, iterations, scale, converged
        )

    def first_guess(self, data: HorizonData, fixed: NDArray | None = None) -> NDArray:
        """Coefficients (2, N) of the constant ξ and A that the global search finds.

        They keep all carriers above the bound at all instants and phases, or come near to it.

        Args:
            data: of the plan.
            fixed: the first coefficients (2, fixed); none: the nominal ones.
        """
        problem = self.problem
        coefficients = problem.nominal_coefficients()
        constant = _constant_parameters(problem, data) / problem.nominal
        coefficients[:, self.fixed :] = constant[:, None]
        if fixed is not None:
            coefficients[:, : self.fixed] = fixed
        return coefficients

    def merit(self, answer: PlanAnswer) -> float:
        """What plans of the same data are compared by: the cost and the penalty of the slack."""
        return answer.cost + float(self._weights.sum()) * answer.slack

    def _merit(self, data: HorizonData, x: NDArray) -> tuple[float, float]:
        slacks = self.problem.slacks(self.problem.margins(data, x))
        return self.problem.cost(x) + float(self._weights @ slacks), float(slacks.max())

    def _step(
        self, x: NDArray, linearization: Linearization, scale: float
    ) -> tuple[NDArray, float] | None:
        """The next coefficients and the merit that is predicted; None where no step is found."""
        problem, free = self.problem, self._free
        low, high = problem.bounds
        flat = x.ravel()
        hessian = problem.hessian[np.ix_(free, free)]
        gradient = (problem.hessian @ (flat - 1))[free]
        rows = len(linearization.margins)
        slack_columns = np.zeros((rows, problem.slack_count))
        slack_columns[np.arange(rows), linearization.slack_of] = 1
        part = x[:, self.fixed :]
        radius = scale * _COEFFICIENT_RADIUS
        program = MathematicalProgram()
        step = program.NewContinuousVariables(len(free), "step")
        slack = program.NewContinuousVariables(problem.slack_count, "slack")
        program.AddQuadraticCost(hessian, gradient, step, is_convex=True)
        program.AddLinearCost(self._weights, 0.0, slack)
        program.AddBoundingBoxConstraint(
            np.maximum(low - part, -radius).ravel(), np.minimum(high - part, radius).ravel(), step
        )
        program.AddBoundingBoxConstraint(0.0, np.inf, slack)
        program.AddLinearConstraint(
            np.hstack([linearization.jacobian[:, free], slack_columns]),
            -linearization.margins,
            np.full(rows, np.inf),
            np.concatenate([step, slack]),
        )
        angle = scale * _ANGLE_RADIUS * np.ones(len(self._angle_rows))
        program.AddLinearConstraint(self._angle_rows, -angle, angle, step[: part.shape[1]])
        result = self._solver.Solve(program)
        if not result.is_success():
            return None
        change = result.GetSolution(step)
        new = flat.copy()
        new[free] += change
        margins = linearization.margins + linearization.jacobian[:, free] @ change
        slacks = problem.slacks(margins, linearization.slack_of)
        new = new.reshape(x.shape)
        return new, problem.cost(new) + float(self._weights @ slacks)


def _constant_parameters(problem: HorizonProblem, data: HorizonData) -> NDArray:
    """The [ξ, A] (2,) nearest to the nominal ones that suit all instants and phases."""
    angles = 2 * np.pi * np.arange(_SEARCH_PHASES) / _SEARCH_PHASES
    every = max(1, round(problem.config.knot_spacing / problem.config.instant_spacing))
    chosen = range(0, len(data.terms.forces), every)
    polynomials = [
        orbit_polynomials(type(data.terms)(*(part[k] for part in data.terms)), problem.axes, angles)
        for k in chosen
    ]
    low, high = (bound[:, 0] * problem.nominal for bound in problem.bounds)
    search = SearchProblem(
        polynomials=np.stack(polynomials, axis=2).reshape(*polynomials[0].shape[:2], -1),
        rest_length=problem.rest_length,
        compliance=problem.compliance,
        amplitude_margins=None,
        angles=np.zeros(0),
        previous=problem.nominal,
        nominal=problem.nominal,
        lower=low,
        upper=high,
        speed_bound=data.speed_bound,
        speed_unit=data.speed_bound or 1.0,
        max_speed=np.inf,
        internal_force_weight=0.0,
        internal_force_rate_weight=0.0,
        anchor_weight=0.0,
    )

    def margins_at(x: NDArray) -> NDArray:
        return search.margins(x[1:], x[:1])[0][0, 0]

    margins = margins_at(problem.nominal)
    if margins.min() >= -FEASIBILITY_TOLERANCE:
        return problem.nominal
    found, cost = nearest_feasible(search, margins, margins_at)
    return found if np.isfinite(cost) else least_infeasible_on_grid(search)
