"""Tasks drawn at random, a few of them flown; `tests/drawn_study.py` and others fly all."""

import numpy as np
import pandas as pd
import pytest
from drawn_study import VARIANTS, compared, fly
from drawn_tasks import aircraft_task
from drawn_verdicts import CANNOT, MIXED, OK, TASKS, judged, looked_at
from helpers import nightly_beyond

from drake_nonstop import aircraft_margins

FAILS_TODAY = 1029  # a task on which the layer of one sample falls below the bound


@pytest.mark.nightly("studies")
@pytest.mark.parametrize("seed", [1001, FAILS_TODAY])
def test_the_horizon_keeps_the_bound_smoothly(seed):
    figures = fly("carriers", seed, VARIANTS["horizon"])
    assert figures["outcome"] == "ok"
    assert figures["least"] >= 1.002
    assert figures["error"] <= 0.05
    assert max(figures["A_step"], figures["xi_step"]) <= 0.02


@pytest.mark.nightly("studies")
def test_one_sample_ahead_does_not_keep_it():
    figures = fly("carriers", FAILS_TODAY, VARIANTS["one sample"])
    assert figures["outcome"] == "bound_missed"
    assert figures["least"] < 1


@pytest.mark.nightly("studies")
def test_aircraft_can_fly_their_tasks_at_rest():
    for seed in (2000, 2001):
        assert aircraft_margins(aircraft_task(seed)).is_flyable


def test_variants_are_compared_on_the_tasks_that_both_complete():
    rows = pd.DataFrame(
        {
            "variant": ["first"] * 3 + ["second"] * 3,
            "seed": [*range(3)] * 2,
            "outcome": ["ok"] * 3 + ["bound_missed", "load_lost", "stopped"],
            "is_whole": [True] * 5 + [False],
            "below": [0.0] * 3 + [0.1] * 3,
            "peak": [2.0, 2.0, 2.0, 3.0, 3.0, 9.0],
            "error": [0.0, 1.0, 2.0] * 2,
        }
    ).assign(least=1.1, squares=4.0, A_step=0.1, xi_step=0.1, tension=0.1)
    first, second = compared(rows).to_numpy()
    np.testing.assert_allclose(first, [0, 0, 0, 1.1, 1, 1, 1, 1, 2, 0.1, 0.1, 0.1])
    np.testing.assert_allclose(second, [2, 1, 1, 1.1, 1.5, 1.5, 1, 0.5, 2, 0.1, 0.1, 0.1])


def test_verdicts_are_contradicted_by_flights_in_other_seeds():
    for verdict, outcomes, is_wrong in (
        (OK, ["ok", "collision"], True),
        (f"{CANNOT}, narrow", ["collision", "ok"], True),
        (OK, ["ok"], False),
        (CANNOT, ["stalled"], False),
        (MIXED, ["ok", "stopped"], False),
    ):
        assert judged(verdict, [], outcomes)["contradicted"] == is_wrong


CASES = [(kind, seed) for kind in TASKS for seed in (2, 8, 1, 4, 5, 6, 7)]


@pytest.mark.parametrize(("kind", "seed"), nightly_beyond(1, "studies", CASES))
def test_no_flight_contradicts_what_is_said_of_its_task(kind, seed):
    found = looked_at(kind, seed)
    assert not found["contradicted"], found["said"]
