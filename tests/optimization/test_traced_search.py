"""The search in C finds what the one in Python does, and leaves the rest to that."""

import ctypes

import numpy as np
import pytest
from benchmarks.instances import draw_instances, make_solvers
from nonstop_cases import AT_REST, moving, update_data, update_solver

from drake_nonstop.optimization.diagnostics import Outcome
from drake_nonstop.systems.compilation import compiled, compiler

FIELDS = [
    {},
    {"max_speed": 8.0},
    {"anchor_weight": 0.3, "orbit_points": 1, "orbit_updates": 1},
    {"look_ahead_points": 1, "internal_force_weight": 0.5, "max_frequency_rate": 40.0},
]
TOGETHER = {  # of one system, for which alone C is made and compiled
    "max_speed": 8.0,
    "anchor_weight": 3.0,
    "orbit_points": 1,
    "orbit_updates": 1,
    "internal_force_weight": 0.5,
    "max_frequency_rate": 400.0,
}


def search_in_c(solver):
    made = solver.traced_search
    call = compiled(made.functions, besides=made.text).library.search
    call.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p]

    def search(data):
        x = np.zeros(2)
        return call(data.ctypes.data, made.tolerance, x.ctypes.data), x

    return search


def assert_same_answers(updates, least_solved):
    """Of pairs of a solver and the data of an update."""
    searches = {}
    solved = missed = 0
    for solver, data in updates:
        search = searches.setdefault(id(solver), None) or search_in_c(solver)
        searches[id(solver)] = search
        answer = solver.solve(data)
        found, x = search(solver.problem(data).vector.copy())
        if answer.outcome != Outcome.SOLVED:
            assert not found
            continue
        solved += 1
        missed += not found  # what the grid finds has to be asked for
        if found:
            np.testing.assert_allclose(x, answer.parameters, rtol=1e-9)
    assert solved > least_solved
    assert missed <= 0.02 * solved


needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")


@needs_compiler
@pytest.mark.slow
def test_drawn_updates_of_a_system_have_the_same_answers():
    solver, rng = update_solver(**TOGETHER), np.random.default_rng(7)
    bounds = rng.uniform(0.3, 3.0, 60)
    updates = [update_data(moving(k), bound, updates=solver) for k, bound in enumerate(bounds)]
    # From slow and fast parameters at rest, where alone there is an anchor: it leads back as far as
    # the bound or the cost allow.
    away = np.array([[1.0, 0.6], [1.2, 0.8], [1.1, 0.9], [0.8, 0.6], [3.0, 1.6], [2.4, 1.5]])
    updates += [update_data(AT_REST, 0.6, x, solver) for x in away]
    assert_same_answers([(solver, data) for data in updates], 20)


@needs_compiler
@pytest.mark.nightly("engines")
@pytest.mark.parametrize("fields", FIELDS, ids=lambda fields: ",".join(fields) or "default")
def test_drawn_updates_have_the_same_answers(fields):
    solvers = make_solvers(**fields)
    instances = draw_instances(300, 7, solvers)
    assert_same_answers([(solvers[drawn.system], drawn.data) for drawn in instances], 50)


@pytest.mark.parametrize(
    "fields", [{"max_tension": 9.0}, {"min_separation": 0.2}, {"solver": "grid"}]
)
def test_other_constraints_and_solvers_are_not_searched_in_c(fields):
    assert update_solver(**fields).traced_search is None
