"""The best plan of a whole task, by which those over a horizon are judged."""

from dataclasses import replace

import numpy as np

from drake_nonstop import Scenario
from drake_nonstop.analysis.task import task_of
from drake_nonstop.planning.horizon_problem import HorizonProblem
from drake_nonstop.planning.horizon_solver import HorizonSolver

LEAST_SCALE = 0.1  # of the trust region with which a plan goes on from another


def cost_beside_the_best(scenario: Scenario) -> float:
    """The cost of the plans over a receding horizon, of that of the best plan that knows all.

    The task goes as it is predicted. The best plan is that of three starts: what the receding
    horizon makes, the constant ξ and A that the global search finds, and the nominal ones.
    """
    task = task_of(scenario)
    problem = HorizonProblem(task.model, task.limits, task.horizon)
    intervals = round(task.duration / problem.config.knot_spacing)
    whole = HorizonProblem(task.model, task.limits, replace(problem.config, intervals=intervals))
    solver = HorizonSolver(whole)
    data = whole.data(0.0, 0.0, task.reference, task.limits.speed_bound)
    flown = receding(problem, task, intervals)
    answers = [
        solver.solve(data, start, max_iterations=20, tolerance=3e-4)
        for start in (flown, solver.first_guess(data), whole.nominal_coefficients())
    ]
    return whole.cost(flown) / min(answers, key=solver.merit).cost


def receding(problem, task, intervals):
    """The coefficients (2, intervals + 4) that plans over a horizon fly of a task."""
    solver, degree = HorizonSolver(problem), problem.count - problem.intervals
    spacing, bound = problem.config.knot_spacing, task.limits.speed_bound
    flown, angle, data, answer = np.ones((2, intervals + degree)), 0.0, None, None
    for k in range(intervals):
        data = problem.data(k * spacing, angle, task.reference, bound, data)
        if answer is None:
            answer = solver.solve(data, solver.first_guess(data), max_iterations=20)
        else:
            start, scale = answer.plan.shifted().coefficients, max(answer.scale, LEAST_SCALE)
            answer = solver.solve(data, start, scale=scale)
        flown[:, k : k + degree + 1] = answer.coefficients[:, : degree + 1]
        angle = answer.plan.planned((k + 1) * spacing)[0]
    return flown
