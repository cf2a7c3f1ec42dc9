"""What plans keep, that all solvers find them, and what happens where limits cannot be kept."""

from dataclasses import replace

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
    data_of,
    drawn_coefficients,
    example,
    expected_margins,
    motion_at,
    points_problem,
)

from drake_nonstop.mechanics.rigid_load import STILL_AIR
from drake_nonstop.planning.horizon_solver import HorizonSolver
from drake_nonstop.planning.step_program import StepProgram

SOLVERS = "daqp", "clarabel", "snopt", "ipopt"


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


# Of each limit the name of its rows, and a value that is kept; flights keep others.
KEPT_BY_POINTS = {
    "max_tension": ("largest_tension", 2.705),
    "min_separation": ("separation", 0.8428),
}
KEPT_BY_AIRCRAFT = {
    "max_lift_share": ("lift", 0.5),
    "max_bank": ("bank", 0.525),
    "max_climb": ("climb", 0.292),
    "max_thrust_share": ("thrust", 0.47),
}


def with_limit(field, value):
    """A problem with one limit that is ever reached, and with the speed bound."""
    fields = {"tightening": 0.002, field: value}
    if field in KEPT_BY_AIRCRAFT:
        return aircraft_problem(fixed=0, speed_bound=10.0, **NO_SHARES | fields)
    horizon = replace(SMALL, instants=20)  # with fewer ones more is exceeded between them
    system = {"load_drag": 0.0}
    return points_problem("spread-7", system=system, horizon=horizon, **NO_LIMITS | fields)


@pytest.mark.slow
@pytest.mark.parametrize(
    "field", nightly_beyond(1, "flights", [*KEPT_BY_AIRCRAFT, *KEPT_BY_POINTS])
)
def test_a_plan_keeps_a_limit_that_the_plan_without_it_exceeds(field):
    """Also between instants, but for the tightening."""
    name, value = (KEPT_BY_POINTS | KEPT_BY_AIRCRAFT)[field]
    limited, free = with_limit(field, value), with_limit(field, (NO_LIMITS | NO_SHARES)[field])
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
        assert margins[limited.names == "airspeed"].min() >= -room
        assert (margins[limited.names == name].min() >= -room) == (problem is limited)


def test_limits_that_exclude_each_other_give_a_finite_plan_that_prefers_the_speed_bound():
    problem = points_problem("cycle-4", max_speed=0.9)
    data, answer = best_plan(problem, 0.8)
    assert np.isfinite(answer.coefficients).all()
    shares = answer.margins[: problem.model.n, 30 : len(problem.instants)]
    squares = (1 + shares) * data.speed_bounds[:, None] ** 2
    below = 1 - squares.min() / (1.02 * 0.8) ** 2
    above = squares.max() / (0.98 * 0.9) ** 2 - 1
    assert above > max(below, 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", nightly_beyond(1, "engines", ["cycle-3", "aircraft"]))
def test_all_solvers_find_the_same_steps(name, monkeypatch):
    """Of recorded programs cost and constraints are equal."""
    programs, solved = [], StepProgram.solved

    def recorded(program, solver):
        programs.append(program)
        return solved(program, solver)

    monkeypatch.setattr(StepProgram, "solved", recorded)
    problem = example(name)
    start = drawn_coefficients(problem, 3, 0.05)
    HorizonSolver(problem).solve(data_of(name), start, max_iterations=4)
    assert len(programs) > 3
    for program in programs[:: len(programs) // 4]:
        found = [solved(program, solver) for solver in SOLVERS]
        best = min(map(program.value, found))
        for x in found:
            assert program.value(x) == pytest.approx(best, rel=1e-8, abs=1e-8)
            rows = program.rows @ x
            parts = x - program.lower, program.upper - x, rows - program.least, program.most - rows
            assert min(part.min() for part in parts) > -1e-8


def test_a_program_without_a_solution_has_none():
    one = np.ones((1, 1))
    apart = StepProgram(one, one[0], -one[0], one[0], one, 3 * one[0], 4 * one[0])
    assert [apart.solved(solver) for solver in SOLVERS] == [None] * len(SOLVERS)


def test_a_plan_that_is_no_number_is_said():
    solver = HorizonSolver(example("cycle-3"), lambda: "the layer")
    with pytest.raises(ArithmeticError, match=r"the layer.*not finite"):
        solver.solve(data_of("cycle-3"), np.full((2, solver.problem.count), np.nan))
