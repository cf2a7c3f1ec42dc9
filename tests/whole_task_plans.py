"""Plans of a whole task, by which those over a horizon are judged."""

from dataclasses import replace

import numpy as np

from drake_nonstop.planning.horizon_config import HorizonConfig, timed
from drake_nonstop.planning.horizon_problem import HorizonProblem
from drake_nonstop.planning.horizon_solver import LEAST_START_SCALE, HorizonSolver
from drake_nonstop.planning.plan import DEGREE

MAX_ITERATIONS = 20
TOLERANCE = 3e-4


def receding_coefficients(problem, reference, intervals, speed_bound):
    """Plans over a receding horizon along a task that goes as it is predicted.

    Returns the coefficients (2, intervals + 4) that are flown, and each plan.
    """
    solver, spacing = HorizonSolver(problem), problem.config.knot_spacing
    answers = []
    flown = np.ones((2, intervals + DEGREE))
    angle, scale, data, start = 0.0, 1.0, None, None
    for k in range(intervals):
        data = problem.data(k * spacing, angle, reference, speed_bound, data)
        if start is None:
            first = solver.first_guess(data)
            answer = solver.solve(data, first, max_iterations=MAX_ITERATIONS)
        else:
            answer = solver.solve(data, start, scale=scale)
        answers.append(answer)
        flown[:, k : k + DEGREE + 1] = answer.coefficients[:, : DEGREE + 1]
        start = answer.plan.shifted().coefficients
        scale = max(answer.scale, LEAST_START_SCALE)
        angle = answer.plan.planned((k + 1) * spacing)[0]
    return flown, answers


def plan_task(model, limits, reference, duration, *, config=None):
    """Plans of a whole task, the best first, each from another start.

    The starts are what a receding horizon makes, the constant ξ and A that the global search finds,
    and the nominal ones. ξ and A begin at their nominal values with three rates of zero. The task
    ends at rest, or goes on as at its end; its duration in s is rounded to a whole number of
    intervals between knots.
    """
    config = timed(config or HorizonConfig(), limits.frequency, model.control_period)
    intervals = round(duration / config.knot_spacing)
    short = HorizonProblem(model, limits, config)
    flown, _ = receding_coefficients(short, reference, intervals, limits.speed_bound)
    whole = replace(config, intervals=intervals)
    problem = HorizonProblem(model, limits, whole)
    data = problem.data(0.0, 0.0, reference, limits.speed_bound)
    solver = HorizonSolver(problem)
    starts = [flown, solver.first_guess(data), problem.nominal_coefficients()]
    answers = [
        solver.solve(data, start, max_iterations=MAX_ITERATIONS, tolerance=TOLERANCE)
        for start in starts
    ]
    return sorted(answers, key=solver.merit)
