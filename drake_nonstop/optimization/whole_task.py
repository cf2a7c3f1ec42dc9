"""The best plan of a whole task, known beforehand: a yardstick for those that see less of it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.model.system import Model
from drake_nonstop.optimization.horizon_config import HorizonConfig, timed
from drake_nonstop.optimization.horizon_problem import HorizonData, HorizonProblem, Reference
from drake_nonstop.optimization.horizon_solver import (
    LEAST_START_SCALE,
    HorizonSolver,
    PlanAnswer,
)
from drake_nonstop.optimization.plan import DEGREE
from drake_nonstop.optimization.problem_config import LimitsConfig

_FIRST_ITERATIONS = 20  # of the first plan, which has no other to begin with
_MAX_ITERATIONS = 20  # of a whole task's
_TOLERANCE = 3e-4


def receding_coefficients(
    problem: HorizonProblem,
    reference: Reference,
    intervals: int,
    speed_bound: float,
    *,
    start_angle: float = 0.0,
    max_iterations: int = 2,
    wind: Callable[[float], NDArray] = lambda time: STILL_AIR,
) -> tuple[NDArray, list[PlanAnswer]]:
    """What plans over a receding horizon make of a task that goes as it is predicted.

    Args:
        problem: of one horizon.
        reference: the load's.
        intervals: between knots, from one plan to the next.
        speed_bound: m/s, ε.
        start_angle: θ at the start, rad.
        max_iterations: of each plan but the first.
        wind: (3,), m/s, in W, that aircraft are believed to fly in, at a time in s.

    Returns:
        The coefficients (2, intervals + 4) that are flown, and each plan.
    """
    solver, spacing = HorizonSolver(problem), problem.config.knot_spacing
    answers: list[PlanAnswer] = []
    flown = np.ones((2, intervals + DEGREE))
    angle, scale, data = start_angle, 1.0, None
    start: NDArray | None = None
    for k in range(intervals):
        start_time = k * spacing
        data = problem.data(start_time, angle, reference, speed_bound, data, wind(start_time))
        if start is None:
            answer = solver.solve(data, solver.first_guess(data), max_iterations=_FIRST_ITERATIONS)
        else:
            answer = solver.solve(data, start, max_iterations=max_iterations, scale=scale)
        answers.append(answer)
        flown[:, k : k + DEGREE + 1] = answer.coefficients[:, : DEGREE + 1]
        start, scale = answer.next_start, max(answer.scale, LEAST_START_SCALE)
        angle = answer.plan.values((k + 1) * spacing).angle
    return flown, answers


def plan_task(
    model: Model,
    limits: LimitsConfig,
    reference: Reference,
    duration: float,
    *,
    name: Callable[[], str],
    config: HorizonConfig | None = None,
    start_angle: float = 0.0,
) -> list[PlanAnswer]:
    """Plans of a whole task, the best first, each from another start.

    The starts are what a receding horizon makes, the constant ξ and A that the global search finds,
    and the nominal ones. ξ and A begin at their nominal values with three rates of zero.

    Args:
        model: what the controllers believe.
        limits: ε and the others.
        reference: the load's; the task ends at rest, or goes on as at its end.
        duration: s, rounded to a whole number of intervals between knots.
        name: as of `HorizonProblem`.
        config: but for its horizon.
        start_angle: θ at the start, rad.
    """
    config = timed(config or HorizonConfig(), limits.frequency, model.control_period)
    intervals = round(duration / config.knot_spacing)
    short = HorizonProblem(model, limits, config, name)
    flown, _ = receding_coefficients(
        short, reference, intervals, limits.speed_bound, start_angle=start_angle
    )
    whole = replace(config, horizon=intervals * config.knot_spacing)
    problem = HorizonProblem(model, limits, whole, name)
    data: HorizonData = problem.data(0.0, start_angle, reference, limits.speed_bound)
    solver = HorizonSolver(problem)
    starts = [flown, solver.first_guess(data), problem.nominal_coefficients()]
    answers = [
        solver.solve(data, start, max_iterations=_MAX_ITERATIONS, tolerance=_TOLERANCE)
        for start in starts
    ]
    return sorted(answers, key=solver.merit)
