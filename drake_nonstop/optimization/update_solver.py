"""The answer to the nonstop problem of each update: keep, solve, relax or hold."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.signals import LoadReference
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.diagnostics import Outcome
from drake_nonstop.optimization.flight_search import nearest_within_limits
from drake_nonstop.optimization.local_solver import LocalSolver
from drake_nonstop.optimization.problem_config import (
    NonstopProblemConfig,
    tightened_bound,
)
from drake_nonstop.optimization.search_problem import FEW, MANY, best_on_grid, nearest_feasible
from drake_nonstop.optimization.traced_problem import TracedProblem
from drake_nonstop.optimization.update_data import UpdateData
from drake_nonstop.optimization.update_problem import UpdateProblem
from drake_nonstop.systems.tracing import TracedFunction

_NOT_GIVEN = np.zeros(0)
_STILL_AIR = np.zeros(3)
_COST_TOLERANCE = 1e-4  # relative; what the global search finds has to be cheaper by more
_AT_ANCHOR = 1e-6  # relative, of ξ and A
_REST_TOLERANCE = 1e-3  # m/s, rad/s, m/s², rad/s²; a reference that moves less is at rest


class Answer(NamedTuple):
    """The answer of one update."""

    parameters: NDArray  # (2,), the next [ξ, A], rad/s and N
    outcome: Outcome
    slowest_speed: float  # m/s, predicted, of aircraft through the air


class UpdateSolver:
    """Solves the nonstop problem, built once, with the data of each update.

    Answers depend on the data alone, which come from `update_data`.

    Args:
        model: what the controllers believe.
        config: its values are taken to be valid, see `check_problem`.
        name: tells what evaluates the functions, for the error of a value that is not finite.
    """

    def __init__(self, model: Model, config: NonstopProblemConfig, name: Callable[[], str]):
        self._config = config
        self._orbit_turns = [
            np.array([2 * math.pi * i / config.orbit_points]) for i in range(config.orbit_updates)
        ]
        self._anchor_weight, self._no_anchor = np.array([config.anchor_weight]), np.zeros(1)
        self._traced = TracedProblem(model, config, name)
        self.data_size = self._traced.data_size  # of the data's flat vector
        self._local: LocalSolver | None = None
        if config.solver in LocalSolver.NAMES:
            self._local = LocalSolver(
                config.solver,
                *self._traced.with_gradients(),
                self._traced.speed_count,
                self._traced.data_size,
            )

    def update_data(
        self,
        previous: NDArray,
        phase: NDArray,
        load_state: NDArray,
        reference: NDArray,
        wrench: NDArray,
        wrench_rate: NDArray,
        wrench_second_rate: NDArray,
        speed_bound: float,
        updates: int = 0,
        beliefs: NDArray | None = None,
        wind: NDArray = _STILL_AIR,
    ) -> UpdateData:
        """The data of an update: parts of `UpdateData`, with ε in m/s before it is tightened.

        `updates` is how many there were before, which selects the phases of the orbit ahead;
        without `beliefs`, those of model and config count.
        """
        config = self._config
        # A reference that moves switches the anchor off.
        is_moving = config.anchor_weight > 0 and np.abs(_rates(reference)).max() > _REST_TOLERANCE
        anchor_weight = self._no_anchor if is_moving else self._anchor_weight
        bound = np.array([tightened_bound(config, speed_bound)])
        return UpdateData(
            previous=previous,
            phase=phase,
            load_state=load_state,
            reference=reference,
            wrench=wrench,
            wrench_rate=wrench_rate,
            wrench_second_rate=wrench_second_rate,
            speed_bound=bound,
            speed_unit=bound if speed_bound else np.ones(1),  # without a bound any speed is enough
            orbit_turn=self._orbit_turns[updates % config.orbit_updates],
            anchor_weight=anchor_weight,
            wind=wind,
            beliefs=_NOT_GIVEN if beliefs is None else beliefs,
        )

    def problem(self, data: UpdateData) -> UpdateProblem:
        """The problem of one update."""
        return UpdateProblem(self._traced, data)

    def functions(self, *, with_gradients: bool = False) -> tuple[TracedFunction, TracedFunction]:
        """The cost and the margins of x = [ξ, A] and the data's flat vector, for other solvers."""
        if with_gradients:
            return self._traced.with_gradients()
        return self._traced.cost, self._traced.margins

    def solve(self, data: UpdateData) -> Answer:
        """The answer of one update.

        Raises:
            NotFiniteError: a margin is not finite, such as that of a cable without any tension.
        """
        problem = self.problem(data)
        previous = problem.previous
        was_feasible = problem.is_feasible(previous)
        if was_feasible and not self._is_anchor_active(problem):
            return _answer(problem, previous, Outcome.KEPT)
        parameters = self._best(problem)
        is_feasible = problem.is_feasible(parameters)
        if was_feasible and (not is_feasible or problem.cost(parameters) >= problem.cost(previous)):
            return _answer(problem, previous, Outcome.KEPT)
        if is_feasible:
            return _answer(problem, parameters, Outcome.SOLVED)
        order = problem.infeasibility_order
        if order(problem.margins(parameters)) > order(problem.margins(previous)):
            return _answer(problem, parameters, Outcome.RELAXED)
        return _answer(problem, previous, Outcome.HELD)

    def _is_anchor_active(self, problem: UpdateProblem) -> bool:
        """Whether the anchor asks for something else than the previous parameters."""
        has_anchor = self._config.anchor_weight > 0 and problem.data.anchor_weight[0] > 0
        return has_anchor and not np.allclose(
            problem.previous, problem.beliefs.nominal, rtol=_AT_ANCHOR, atol=0
        )

    def _best(self, problem: UpdateProblem) -> NDArray:
        """The feasible point of the least cost; where none is found the least infeasible one."""
        if self._local is None:
            return self._searched(problem)[0]
        start, data = problem.previous, problem.vector
        parameters = self._local.nearest(start, data, *problem.known_bounds)
        while problem.learns_from(parameters):
            parameters = self._local.nearest(start, data, *problem.known_bounds)
        cost = problem.feasible_cost(parameters)
        if self._config.global_search:
            other, other_cost = self._searched(problem)
            is_best = np.isfinite(cost) and cost * (1 - _COST_TOLERANCE) <= other_cost
            return parameters if is_best else other
        if np.isfinite(cost):
            return parameters
        return self._local.fastest(start, data, *problem.bounds)

    def _searched(self, problem: UpdateProblem) -> tuple[NDArray, float]:
        """The point that a search finds and its cost, inf where it is infeasible."""
        found = self._searched_among_known(problem)
        while problem.learns_from(found[0]):
            found = self._searched_among_known(problem)
        return found

    def _searched_among_known(self, problem: UpdateProblem) -> tuple[NDArray, float]:
        """Checks with no other encounters of carriers than those that are known."""
        if self._traced.has_flight_limits:
            return nearest_within_limits(problem)
        if self._config.solver == "grid" or problem.phase_jumps:
            return best_on_grid(
                problem.margins_on_grid,
                *problem.bounds,
                MANY,
                cost=problem.cost,
                previous=problem.previous,
            )
        search_problem = problem.search_problem
        parameters, cost = nearest_feasible(search_problem)
        if np.isfinite(cost):
            return parameters, cost
        parameters, _ = best_on_grid(search_problem.margins, *problem.bounds, FEW)
        cost = problem.feasible_cost(parameters)
        if not np.isfinite(cost):
            return parameters, cost
        # The grid found a feasible range of A so narrow that the search had missed it.
        nearer, lower_cost = nearest_feasible(search_problem, float(parameters[1]))
        return (nearer, lower_cost) if lower_cost < cost else (parameters, cost)


def _rates(reference: NDArray) -> NDArray:
    """The velocities and accelerations (12,) of the load's reference (22,)."""
    motion = LoadReference.view(reference)
    return np.concatenate(
        [
            motion.angular_velocity,
            motion.velocity,
            motion.angular_acceleration,
            motion.acceleration,
        ]
    )


def _answer(problem: UpdateProblem, parameters: NDArray, outcome: Outcome) -> Answer:
    return Answer(parameters, outcome, problem.slowest_speed(parameters))
