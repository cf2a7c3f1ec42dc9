"""The search in C finds what the one in Python does, and leaves the rest to that."""

import ctypes

import numpy as np
import pytest

from drake_nonstop.benchmarks.instances import draw_instances, make_solvers
from drake_nonstop.optimization.diagnostics import Outcome
from drake_nonstop.systems.compilation import compiled, compiler

FIELDS = [
    {},
    {"max_speed": 8.0},
    {"anchor_weight": 0.3, "orbit_points": 1, "orbit_updates": 1},
    {"look_ahead_points": 1, "internal_force_weight": 0.5, "max_frequency_rate": 40.0},
]


def search_in_c(solver):
    made = solver.traced_search
    call = compiled(made.functions, besides=made.text).library.search
    call.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p]

    def search(data):
        x = np.zeros(2)
        return call(data.ctypes.data, made.tolerance, x.ctypes.data), x

    return search


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
@pytest.mark.parametrize("fields", FIELDS, ids=lambda fields: ",".join(fields) or "default")
def test_drawn_updates_have_the_same_answers(fields):
    solvers = make_solvers(**fields)
    searches = {name: search_in_c(solver) for name, solver in solvers.items()}
    solved = missed = 0
    for instance in draw_instances(300, 7, solvers):
        solver = solvers[instance.system]
        answer = solver.solve(instance.data)
        found, x = searches[instance.system](solver.problem(instance.data).vector.copy())
        if answer.outcome != Outcome.SOLVED:
            assert not found
            continue
        solved += 1
        missed += not found  # what the grid finds has to be asked for
        if found:
            np.testing.assert_allclose(x, answer.parameters, rtol=1e-9)
    assert solved > 50
    assert missed <= 0.02 * solved


@pytest.mark.parametrize(
    "fields", [{"max_tension": 9.0}, {"min_separation": 0.2}, {"solver": "grid"}]
)
def test_other_constraints_and_solvers_are_not_searched_in_c(fields):
    solver = make_solvers(**fields)["cycle of 3"]
    assert solver.traced_search is None
