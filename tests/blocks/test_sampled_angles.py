"""Angles of samples by which a load turns in a way that may not be meant are told."""

import warnings

import numpy as np
import pytest

from drake_nonstop import ScenarioWarning, load_scenario, make_nonstop


def told_of(yaws):
    rows = [[float(t), 0.0, 0.0, 0.0, 0.0, 0.0, float(yaw)] for t, yaw in enumerate(yaws)]
    samples = f"load_trajectory=!SampledTrajectory {{samples: {rows}}}"
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", ScenarioWarning)
        make_nonstop(load_scenario("quintic", [samples]))
    return " ".join(str(warning.message) for warning in told)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("yaws", "words"),
    [
        ([3.0, 3.1, -3.08, -2.98], ["6.18 rad", "row 2 to row 3", "unwrap"]),
        ([0, 170, 190], ["170 rad", "row 1 to row 2", "in rad"]),
        (np.arange(0, 12, 2), ["10 rad", "degrees"]),
        ([0.0, -7.0], ["7 rad", "row 1 to row 2"]),
        ([0.0, 3.0, 6.0, 3.0], []),  # a turn that is meant
        ([-3.0, 0.0, 3.0], []),
    ],
)
def test_a_turn_that_may_not_be_meant_is_told(yaws, words):
    told = told_of(yaws)
    assert bool(words) == ("load_trajectory.samples" in told)
    assert all(word in told for word in words)
