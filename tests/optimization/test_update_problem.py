import numpy as np
import pytest
from nonstop_cases import (
    AT_REST,
    START,
    TIGHTENING,
    carrier_speeds,
    change_cost,
    moving,
    update_data,
    update_solver,
)

from drake_nonstop.optimization import update_problem
from drake_nonstop.optimization.diagnostics import Outcome
from drake_nonstop.optimization.limits import Of, limits_of
from drake_nonstop.systems.tracing import NotFiniteError


@pytest.mark.parametrize("orbit_points", [1, 16])
def test_search_problem_has_the_speeds_of_every_amplitude_and_frequency(orbit_points):
    inputs = moving(6)
    problem = update_solver(orbit_points=orbit_points).problem(update_data(inputs, 0.5))
    for x in np.random.default_rng(6).uniform([0.3, 0.2], [6, 4], (10, 2)):
        margins = problem.search_problem.speed_margins(x)
        of_now = 0.5 * (1 + TIGHTENING) * np.sqrt(margins[:4] + 1)
        np.testing.assert_allclose(of_now, carrier_speeds(x, inputs), rtol=1e-6)
        assert np.min(margins) == pytest.approx(problem.worst_margin(x), abs=1e-9)


def test_cost_is_the_written_out_one():
    inputs = moving(6)
    problem = update_solver().problem(update_data(inputs, 0.5))
    for x in np.random.default_rng(6).uniform([0.3, 0.2], [6, 4], (10, 2)):
        assert problem.cost(x) == pytest.approx(change_cost(x, inputs), rel=1e-12)


def test_slowest_speed_is_that_of_first_principles():
    inputs = moving(6)
    for fields in ({}, {"max_speed": 5.0, "min_tension": 0.1}):
        solver = update_solver(look_ahead_points=1, **fields)
        for bound in (0.0, 0.5):
            problem = solver.problem(update_data(inputs, bound, updates=solver))
            x = np.array([1.7, 0.9])
            expected = np.min(carrier_speeds(x, inputs))
            assert problem.slowest_speed(x) == pytest.approx(expected, rel=1e-6)


def test_feasible_cost_is_infinite_where_the_bound_is_missed():
    for bound, expected in ((0.1, 0.0), (100.0, np.inf)):
        problem = update_solver().problem(update_data(AT_REST, bound))
        assert problem.feasible_cost(START) == expected


def test_bounds_are_within_reach():
    solver = update_solver(max_frequency_rate=10.0, frequency_bounds=(1.95, 10.0))
    lower, upper = solver.problem(update_data(AT_REST, 0.3)).bounds
    assert (lower[0], upper[0]) == pytest.approx((1.95, 2.1), rel=1e-12)
    assert lower[1] < START[1] < upper[1]


@pytest.mark.parametrize("solver", ["search", "snopt"])
def test_many_speeds_are_judged_as_few_are(solver, monkeypatch):
    updates = update_solver(solver=solver)
    outcomes = set()
    for seed in range(8):
        inputs = moving(seed)
        data = update_data(inputs, 0.3 + 0.1 * seed, updates=updates)
        found = updates.solve(data)
        monkeypatch.setattr(update_problem, "MIN_SPEEDS_FOR_ARRAYS", 1)
        many = updates.solve(data)
        monkeypatch.undo()
        np.testing.assert_allclose(many[0], found[0], rtol=1e-9)
        assert many[1] == found[1]
        assert many[2] == pytest.approx(found[2], rel=1e-9)
        outcomes.add(found[1])
    assert {Outcome.KEPT, Outcome.SOLVED} <= outcomes


@pytest.mark.parametrize("fewest", [1, 10**9])
def test_a_cable_without_tension_is_an_error_for_few_speeds_and_for_many(fewest, monkeypatch):
    monkeypatch.setattr(update_problem, "MIN_SPEEDS_FOR_ARRAYS", fewest)
    inputs = moving(2)
    inputs["wrench"] = inputs["wrench_rate"] = np.zeros(6)
    with pytest.raises(NotFiniteError, match="optimization_layer made"):
        update_solver().solve(update_data(inputs, 0.5, previous=np.array([2.0, 0.0])))


@pytest.mark.parametrize(
    "limit", limits_of(Of.SPEED, Of.TENSION, Of.SEPARATION), ids=lambda row: row.name
)
def test_what_is_missed_has_the_name_of_its_row(limit):
    data = update_data(AT_REST, 0.0)
    for beyond, names in ((True, [limit.name]), (False, [])):
        value = 100.0 if limit.is_least == beyond else 0.01
        assert update_solver(**{limit.field: value}).problem(data).missed_kinds(START) == names
