"""The active-set search in C, with what it needs of an update's problem as traced functions."""

from importlib.resources import files
from typing import NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.signals import PARAMETERS_SIZE
from drake_nonstop.optimization.margins import FEASIBILITY_TOLERANCE
from drake_nonstop.optimization.traced_problem import SpeedTerms, TracedProblem
from drake_nonstop.optimization.update_data import Beliefs, UpdateData
from drake_nonstop.systems.tracing import object_array

_MOST_MEMORY = 50_000  # numbers on the stack, which threads may have half a megabyte of
_C_TEXT = files(__package__).joinpath("active_set_search.c").read_text()


class SearchFunctions(NamedTuple):
    """What is compiled for a search: `int search(data, tolerance, x)` is in `text`."""

    functions: list[casadi.Function]  # which the text calls
    text: str
    tolerance: float  # of a margin


def search_functions(problem: TracedProblem) -> SearchFunctions | None:
    """The search for a problem with constraints on speeds alone; None: it needs too much memory."""
    x = casadi.SX.sym("x", PARAMETERS_SIZE)
    data = casadi.SX.sym("d", problem.data_size)
    given = _search_problem(problem, object_array(data))
    (margins,) = problem.margins.traced(object_array(x), object_array(data))
    count = problem.constraints.speed_count
    worse = margins[:count]
    if problem.constraints.limit_high_speeds:
        worse = np.array([*map(casadi.fmin, worse, margins[count : 2 * count])])
    worst = casadi.mmin(casadi.vertcat(*margins))
    functions = [
        casadi.Function("search_problem", [data], casadi.cse([casadi.vertcat(*given)])),
        casadi.Function(
            "speed_margins",
            [casadi.vertcat(x, data)],
            casadi.cse([casadi.vertcat(*worse), worst]),
        ),
    ]
    sizes = {
        "DATA_SIZE": problem.data_size,
        "SPEEDS": count,
        "SEARCH_ARG": max(function.sz_arg() for function in functions),
        "SEARCH_RES": max(function.sz_res() for function in functions),
        "SEARCH_IW": max(1, *(function.sz_iw() for function in functions)),
        "SEARCH_W": max(1, *(function.sz_w() for function in functions)),
    }
    if 2 * sizes["SEARCH_W"] + 40 * count > _MOST_MEMORY:
        return None
    defined = "".join(f"#define {name} {size}\n" for name, size in sizes.items())
    return SearchFunctions(functions, f"\n{defined}{_C_TEXT}", FEASIBILITY_TOLERANCE)


def _search_problem(problem: TracedProblem, vector: NDArray) -> NDArray:
    """What active_set_search.c names, and the polynomials: a `SearchProblem` in symbols."""
    data, config = UpdateData.view(vector), problem.config
    beliefs, previous = Beliefs.view(data.beliefs), data.previous
    terms = SpeedTerms.from_flat(*problem.terms.traced(previous, vector))
    step = problem.largest_step
    cosines, sines = np.cos(terms.angles), np.sin(terms.angles)
    return np.concatenate(
        [
            beliefs.rest_length,
            beliefs.compliance,
            previous,
            list(map(casadi.fmax, beliefs.lower, previous - step)),
            list(map(casadi.fmin, beliefs.upper, previous + step)),
            [1 + config.internal_force_weight * (cosines * cosines).sum()],
            [config.internal_force_rate_weight * (sines * sines).sum()],
            data.anchor_weight,
            beliefs.nominal,
            data.speed_bound * data.speed_bound,
            [problem.constraints.max_speed**2],
            data.phase[1:],
            terms.polynomials.ravel(),
        ]
    )
