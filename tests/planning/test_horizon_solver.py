"""Plans: what they keep, how good they are, and what happens where limits cannot be kept."""

import functools
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from helpers import nightly_beyond
from plan_checks import (
    AT_REST,
    NO_LIMITS,
    NO_SHARES,
    SMALL,
    aircraft_problem,
    along,
    carriers,
    data_of,
    drawn_coefficients,
    example,
    expected_margins,
    motion_at,
    points_problem,
)
from whole_task_plans import plan_task, receding_coefficients

from drake_nonstop.blocks import load_trajectory
from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.model.pattern import HamiltonianCycleConfig
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.planning.diagnostics import BOUND
from drake_nonstop.planning.horizon_config import HorizonConfig
from drake_nonstop.planning.horizon_problem import HorizonProblem
from drake_nonstop.planning.horizon_solver import (
    HorizonSolver,
)
from drake_nonstop.planning.limits import LIMITS
from drake_nonstop.planning.problem_config import LimitsConfig
from drake_nonstop.planning.step_program import SOLVERS, StepProgram
from drake_nonstop.systems.tracing import NotFiniteError

COARSE = HorizonConfig(knot_spacing=0.4, instants=10)  # faster, and enough for these


def limits(speed_bound):
    return LimitsConfig(speed_bound=speed_bound, tightening=0.02)


def paper_task(name):
    """The paper's, the second one shorter: the model, ε, the reference and the duration."""
    system = Model(
        SystemParameters(), HamiltonianCycleConfig(phases=[0.0, np.pi / 2, 0.0, np.pi / 2])
    )
    if name == "quintic":
        config = load_trajectory.RestToRestConfig(
            displacement=[1.0, 1.0, 1.0], roll_pitch_yaw=[np.pi / 36, np.pi / 18, 0.0]
        )
        bound, block, duration = 0.55, load_trajectory.RestToRest(system, config), 12.0
    else:
        config = load_trajectory.ConstantVelocityMoveConfig(start_time=2.0, move_time=6.0)
        bound, block, duration = 0.2, load_trajectory.ConstantVelocityMove(system, config), 10.0
    context, port = block.CreateDefaultContext(), block.GetOutputPort("reference")

    def reference(time):
        context.SetTime(time)
        return port.Eval(context).copy()

    return system, bound, reference, duration


@functools.cache
def plans_of(name):
    """The plans of a task that is known beforehand, the best first."""
    system, bound, reference, duration = paper_task(name)
    return plan_task(system, limits(bound), reference, duration, config=COARSE)


def least_speed(system, plan, reference, start, end, step=0.007):
    """The slowest carrier's, m/s, by differences of positions at times that are no instants."""
    places = np.array(
        [
            carriers(system, reference(time), *along(plan)(time))[0]
            for time in np.arange(start, end, step)
        ]
    )
    return np.linalg.norm(places[2:] - places[:-2], axis=-1).min() / (2 * step)


@pytest.mark.slow
@pytest.mark.parametrize("name", nightly_beyond(1, "studies", ["quintic", "line"]))
def test_the_best_plan_of_a_task_keeps_the_bound_between_instants_too(name):
    system, bound, reference, _ = paper_task(name)
    best, *others = plans_of(name)
    assert best.is_feasible
    assert all(best.cost <= other.cost + 1e-9 for other in others if other.is_feasible)
    assert least_speed(system, best.plan, reference, 0, best.plan.end_time) >= bound
    for knot in COARSE.knot_spacing * np.arange(1, best.plan.intervals):
        before, after = (best.plan.planned(knot + side) for side in (-1e-9, 1e-9))
        np.testing.assert_allclose(before[:7], after[:7], atol=1e-6)
    np.testing.assert_allclose(best.coefficients[:, -3:], 1.0, atol=0.02)


def test_the_receding_horizon_keeps_the_bound_and_is_close_to_the_best_plan():
    system, bound, reference, _ = paper_task("quintic")
    problem = HorizonProblem(system, limits(bound), COARSE)
    flown, plans = receding_coefficients(problem, reference, 30, bound)
    assert all(plan.slack < 1e-3 for plan in plans)
    for answer in plans:
        start = answer.plan.start_time
        assert least_speed(system, answer.plan, reference, start, start + 0.42, 0.013) >= bound
    whole = HorizonProblem(system, limits(bound), HorizonConfig(intervals=30, knot_spacing=0.4))
    assert whole.cost(flown) <= 1.05 * plans_of("quintic")[0].cost


def pulled(time):
    """At rest, but for a push to and fro along x between 1 and 3 s, of 0.3 m/s² at most.

    Without drag the cables' forces are those of a load that does move.
    """
    reference = AT_REST.copy()
    x = np.clip(time - 1, 0, 2) * np.pi
    reference[16] = 0.3 * np.sin(x) ** 3
    reference[19] = 0.9 * np.pi * np.sin(x) ** 2 * np.cos(x)
    return reference


def best_plan(problem, bound, reference=pulled):
    data = problem.data(0.0, 0.0, reference, bound)
    solver = HorizonSolver(problem)
    return data, solver.solve(data, solver.first_guess(data), max_iterations=40)


KEPT_BY_POINTS = {"max_speed": 0.83, "min_tension": 1.562, "max_tension": 2.705}
KEPT_BY_POINTS |= {"min_separation": 0.8428}
KEPT_BY_AIRCRAFT = {"max_lift_share": 0.5, "max_bank": 0.525, "max_climb": 0.292}
KEPT_BY_AIRCRAFT |= {"max_thrust_share": 0.47}


def with_limit(field, value):
    """A problem with one limit that is ever reached, and with the speed bound."""
    fields = {"tightening": 0.002, field: value}
    if field in KEPT_BY_AIRCRAFT:
        return aircraft_problem(fixed=0, speed_bound=10.0, **NO_SHARES | fields)
    horizon = replace(SMALL, instants=20)  # with fewer ones more is exceeded between them
    system = {"load_drag": 0.0}
    return points_problem("spread-7", system=system, horizon=horizon, **NO_LIMITS | fields)


@pytest.mark.slow
@pytest.mark.parametrize(("field", "value"), (KEPT_BY_POINTS | KEPT_BY_AIRCRAFT).items())
def test_a_plan_keeps_a_limit_that_the_plan_without_it_exceeds(field, value):
    """Also between instants, but for the tightening."""
    limited, free = with_limit(field, value), with_limit(field, (NO_LIMITS | NO_SHARES)[field])
    (name,) = (limit.name for limit in LIMITS if limit.field == field)
    bound, room = limited.limits.speed_bound, 2.1 * limited.limits.tightening
    reference = pulled if field in KEPT_BY_POINTS else lambda time: AT_REST
    for problem in (free, limited):
        data, answer = best_plan(problem, bound, reference)
        assert answer.is_feasible
        assert answer.converged
        times = np.linspace(0.01, 0.99, 60) * answer.plan.end_time
        motions = [
            motion_at(problem, reference, along(answer.plan), time, STILL_AIR) for time in times
        ]
        margins = np.min(
            [expected_margins(limited, own, data.speed_bounds, 0.0) for own in motions], axis=0
        )
        assert margins[limited.names == BOUND].min() >= -room
        assert (margins[limited.names == name].min() >= -room) == (problem is limited)


def speeds_at_instants(problem, data, margins):
    """The speeds (n, k), m/s, of margins."""
    shares = margins[: problem.model.n, : len(problem.instants)]
    bounds = data.speed_bounds[:, None]
    units = np.where(bounds > 0, bounds, 1.0)
    return np.sqrt(shares * units**2 + bounds**2)


def test_limits_that_exclude_each_other_give_a_finite_plan_that_prefers_the_speed_bound():
    problem = points_problem("cycle-4", max_speed=0.9)
    data, answer = best_plan(problem, 0.8)
    assert np.isfinite(answer.coefficients).all()
    squares = speeds_at_instants(problem, data, answer.margins)[:, 30:] ** 2
    below = 1 - squares.min() / (1.02 * 0.8) ** 2
    above = squares.max() / (0.98 * 0.9) ** 2 - 1
    assert above > max(below, 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cycle-3", "aircraft"])
def test_all_solvers_find_the_same_steps(name):
    """Of recorded programs cost and constraints are equal."""
    programs: list[StepProgram] = []
    solved = StepProgram.solved

    def recorded(program, solver):
        programs.append(program)
        return solved(program, solver)

    problem = example(name)
    with patch.object(StepProgram, "solved", recorded):
        start = drawn_coefficients(problem, 3, 0.05)
        HorizonSolver(problem).solve(data_of(name), start, max_iterations=4)
    assert len(programs) > 3
    for program in programs[:: len(programs) // 4]:
        found = {solver: solved(program, solver) for solver in SOLVERS}
        best = min(program.value(x) for x in found.values())
        for x in found.values():
            assert program.value(x) == pytest.approx(best, rel=1e-8, abs=1e-8)
            rows = program.rows @ x
            parts = x - program.lower, program.upper - x, rows - program.least, program.most - rows
            assert min(part.min() for part in parts) > -1e-8


def test_a_plan_that_is_no_number_is_said():
    solver = HorizonSolver(example("cycle-3"), lambda: "the layer")
    with pytest.raises(NotFiniteError, match=r"the layer.*not finite"):
        solver.solve(data_of("cycle-3"), np.full((2, solver.problem.count), np.nan))
