import functools

import numpy as np
import pytest
from helpers import Motion, model, nightly_beyond
from whole_task_plans import plan_task

from drake_nonstop.blocks import load_trajectory
from drake_nonstop.mechanics.planned_orbit import OrbitTerms, PlannedOrbit, planned_speeds
from drake_nonstop.model.pattern import HamiltonianCycleConfig
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.optimization.horizon_config import HorizonConfig
from drake_nonstop.optimization.horizon_problem import HorizonProblem
from drake_nonstop.optimization.horizon_solver import (
    HorizonSolver,
    receding_coefficients,
)
from drake_nonstop.optimization.problem_config import NonstopProblemConfig

PAIRED = HamiltonianCycleConfig(phases=[0.0, np.pi / 2, 0.0, np.pi / 2])
MARGIN = 0.02
COARSE = HorizonConfig(knot_spacing=0.4, instants=10)  # faster, and enough for these


def limits(speed_bound, **fields):
    return NonstopProblemConfig(speed_bound=speed_bound, tightening=MARGIN, **fields)


def reference_of(block):
    context, port = block.CreateDefaultContext(), block.GetOutputPort("reference")

    def reference(time):
        context.SetTime(time)
        return port.Eval(context).copy()

    return reference


def paper_task(name):
    """The paper's, the second one shorter: the model, ε, the reference and the duration."""
    system = Model(SystemParameters(), PAIRED)
    if name == "quintic":
        config = load_trajectory.RestToRestConfig(
            displacement=[1.0, 1.0, 1.0], roll_pitch_yaw=[np.pi / 36, np.pi / 18, 0.0]
        )
        return system, 0.55, reference_of(load_trajectory.RestToRest(system, config)), 12.0
    config = load_trajectory.ConstantVelocityMoveConfig(start_time=2.0, move_time=6.0)
    return system, 0.2, reference_of(load_trajectory.ConstantVelocityMove(system, config)), 10.0


def drawn_task(seed):
    """One of the tasks of theory.md §9, and its nominal ξ and A."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 9))
    angles = 2 * np.pi * np.arange(n) / n
    radius, length = rng.uniform(0.5, 1.5), rng.uniform(0.6, 3)
    heights = rng.uniform(-0.1, 0.1, n)
    attachments = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), heights])
    mass = rng.uniform(0.5, 3)
    system = Model(
        SystemParameters(
            load_mass=mass, attachments=attachments.tolist(), cable_length=float(length)
        ),
        HamiltonianCycleConfig(),
    )
    share = mass * 9.81 / n
    A, xi = rng.uniform(0.3, 0.6) * share, rng.uniform(1.2, 2.5)
    duration = rng.uniform(8, 16)
    config = load_trajectory.RestToRestConfig(
        displacement=rng.uniform(-1, 1, 3).tolist(),
        roll_pitch_yaw=[0.0, 0.0, float(rng.uniform(-0.25, 0.25))],
        move_time=float(duration),
    )
    reference = reference_of(load_trajectory.RestToRest(system, config))
    bounds = limits(0.2, frequency=float(xi), amplitude=float(A))
    problem = HorizonProblem(system, bounds, HorizonConfig(), lambda: "drawn")
    data = problem.data(-100.0, 0.0, reference, 0.2)
    at_rest = problem.speeds(data, np.ones((2, problem.count))).min()
    bound = float(rng.uniform(0.4, 0.8) * at_rest)
    return system, limits(bound, frequency=float(xi), amplitude=float(A)), reference, duration + 4


@functools.cache
def plans_of(name):
    """The plans of a task that is known beforehand, the best first."""
    system, bound, reference, duration = paper_task(name)
    return plan_task(system, limits(bound), reference, duration, name=lambda: name, config=COARSE)


@functools.cache
def moving_problem():
    problem = HorizonProblem(
        model(), limits(0.5), HorizonConfig(horizon=4.0, knot_spacing=0.4), lambda: "moving"
    )
    return problem, problem.data(1.0, 0.3, Motion(2).reference, 0.5)


def test_cost_is_that_of_a_fine_sum():
    problem, data = moving_problem()
    x = 1 + 0.2 * np.random.default_rng(5).normal(size=(2, problem.count))
    plan, step, tau = problem.plan(data, x), 1e-3, 0.4 * problem.config.smoothing
    times = data.start_time + step * (np.arange(4000) + 0.5)
    values = np.array([plan.values(time) for time in times])
    xi, A = values[:, 1] / problem.nominal[0], values[:, 2] / problem.nominal[1]
    A_2, A_3 = values[:, 6:].T / problem.nominal[1]
    xi_2 = values[:, 5] / problem.nominal[0]
    xi_3 = np.gradient(xi_2, step)
    parts = (xi - 1) ** 2 + 4 * (A - 1) ** 2 + tau**4 * (xi_2**2 + A_2**2)
    expected = step * np.sum(parts + tau**6 * (xi_3**2 + A_3**2))
    assert problem.cost(x) == pytest.approx(expected, rel=1e-3)


def test_data_that_continue_the_last_are_those_made_anew():
    problem, _ = moving_problem()
    spacing, reference = problem.config.knot_spacing, Motion(2).reference
    last = None
    for knot in (*range(3, 14), 22, 40):  # 9 of them at once, then beyond what is known
        last = problem.data(knot * spacing, 0.1, reference, 0.5, last)
        anew = problem.data(knot * spacing, 0.1, reference, 0.5)
        for name in ("flat_terms", "target_speeds"):
            np.testing.assert_array_equal(getattr(last, name), getattr(anew, name))
        amplitudes = np.linspace(0.5, 1.5, len(problem.terminal_at))
        for part, other in zip(
            last.terminal.at(amplitudes), anew.terminal.at(amplitudes), strict=True
        ):
            np.testing.assert_array_equal(part, other)


def least_speed(system, problem, plan, reference, times):
    """The slowest carrier of a plan at times, which need not be its instants."""
    terms = OrbitTerms.view(problem.all_terms(np.array([reference(time) for time in times])))
    values = np.array([plan.values(time) for time in times])
    squares, _ = planned_speeds(
        terms,
        problem.axes,
        PlannedOrbit.of_planned(values),
        rest_length=system.cable_length,
        compliance=system.cable_compliance,
    )
    return np.sqrt(squares.min())


@pytest.mark.parametrize("name", nightly_beyond(1, "studies", ["quintic", "line"]))
def test_the_best_plan_of_a_task_keeps_the_bound_between_instants_too(name):
    system, bound, reference, _ = paper_task(name)
    best, *others = plans_of(name)
    assert best.is_feasible
    assert all(best.cost <= other.cost + 1e-9 for other in others if other.is_feasible)
    problem = HorizonProblem(system, limits(bound), COARSE, lambda: name)
    times = np.arange(0, best.plan.end_time, 0.007)
    assert least_speed(system, problem, best.plan, reference, times) >= bound
    for knot in COARSE.knot_spacing * np.arange(1, best.plan.intervals):
        before, after = (best.plan.values(knot + side) for side in (-1e-9, 1e-9))
        np.testing.assert_allclose(before[:7], after[:7], atol=1e-6)
    np.testing.assert_allclose(best.coefficients[:, -3:], 1.0, atol=0.02)


def test_the_receding_horizon_is_close_to_the_best_plan():
    system, bound, reference, _ = paper_task("quintic")
    problem = HorizonProblem(system, limits(bound), COARSE, lambda: "quintic")
    flown, plans = receding_coefficients(problem, reference, 30, bound)
    assert all(plan.slack < 1e-3 for plan in plans)
    whole = HorizonProblem(
        system, limits(bound), HorizonConfig(horizon=12.0, knot_spacing=0.4), lambda: "quintic"
    )
    assert whole.cost(flown) <= 1.05 * plans_of("quintic")[0].cost


def test_a_drawn_task_is_flown_above_the_bound():
    system, bounds, reference, duration = drawn_task(1)
    problem = HorizonProblem(system, bounds, HorizonConfig(), lambda: "drawn")
    intervals = round(duration / 0.4)
    _, plans = receding_coefficients(problem, reference, intervals, bounds.speed_bound)
    assert max(plan.slack for plan in plans) < 0.01
    for answer in plans:
        times = answer.plan.start_time + np.arange(0, 0.4, 0.013)
        least = least_speed(system, problem, answer.plan, reference, times)
        assert least >= bounds.speed_bound


def test_at_rest_above_the_bound_nothing_changes():
    system = model()
    problem = HorizonProblem(system, limits(0.2), HorizonConfig(), lambda: "rest")
    at_rest = np.array([1.0, *np.zeros(21)])
    data = problem.data(0.0, 0.0, lambda time: at_rest, 0.2)
    solver = HorizonSolver(problem)
    answer = solver.solve(data, solver.first_guess(data))
    assert answer.converged
    assert answer.cost == pytest.approx(0, abs=1e-12)
