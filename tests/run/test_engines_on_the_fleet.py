"""Whole flights of the fleet by both engines: the same signals, steps, outcome and endings."""

import numpy as np
import pytest
from fleet import BY_BOTH_ENGINES, FLEET

from drake_nonstop.scenario.schema import DIAGRAM

TOLERANCE = {"that_diverges": 1e-5}  # rounding grows tenfold every few steps


def assert_both_engines_agree(name, fleet):
    run, metrics = fleet.evaluated(name)  # compiled
    expected, expected_metrics = fleet.evaluated(name, DIAGRAM)
    tolerance = TOLERANCE.get(name, 1e-8)
    np.testing.assert_array_equal(run.time, expected.time)
    np.testing.assert_allclose(run.steps["time"], expected.steps["time"], atol=1e-12)
    for of_one, of_other in ((run.signals, expected.signals), (run.steps, expected.steps)):
        assert of_one.keys() == of_other.keys()
        for signal, values in of_other.items():
            if signal not in ("time", "solve_time"):  # the latter is measured with a clock
                atol = tolerance * (1 + np.abs(values).max(initial=0.0))
                np.testing.assert_allclose(of_one[signal], values, rtol=0, atol=atol)
    assert (run.stopped, run.step, run.unresolved) == (
        expected.stopped,
        expected.step,
        expected.unresolved,
    )
    assert metrics["outcome"] == expected_metrics["outcome"]


@pytest.mark.parametrize("name", BY_BOTH_ENGINES)
def test_both_engines_fly_the_same(name, fleet):
    assert_both_engines_agree(name, fleet)


@pytest.mark.nightly("engines")
@pytest.mark.parametrize("name", [name for name in FLEET if name not in BY_BOTH_ENGINES])
def test_both_engines_fly_the_same_on_everything(name, fleet):
    assert_both_engines_agree(name, fleet)
