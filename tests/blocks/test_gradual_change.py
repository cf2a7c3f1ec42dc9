import numpy as np
import pytest

from drake_nonstop.blocks.optimization_layer import limit_step, raised_bound, step_towards

TIMES = {"period": 0.01, "change_time": 2.0}


def test_a_raised_bound_takes_the_change_time_for_its_height():
    bound, updates = 0.2, 0
    while bound < 0.6:
        bound = raised_bound(bound, 0.6, **TIMES)
        updates += 1
    assert bound == 0.6
    assert updates == pytest.approx(200 * 0.4 / 0.6, abs=1)


def test_a_bound_that_comes_into_force_begins_at_the_least_one():
    assert raised_bound(0.0, 0.002, **TIMES) == 1e-3


def test_a_long_step_keeps_its_direction():
    previous, largest = np.array([2.0, 1.0]), np.array([0.1, 0.2])
    short = previous + np.array([0.05, -0.2])
    parameters, is_limited = limit_step(previous, short, largest)
    assert not is_limited
    np.testing.assert_array_equal(parameters, short)
    parameters, is_limited = limit_step(previous, previous + np.array([0.4, -0.4]), largest)
    assert is_limited
    np.testing.assert_allclose(parameters - previous, [0.1, -0.1], rtol=1e-14)


def test_parameters_return_with_a_quarter_of_the_change_time():
    target = np.array([2.0, 1.2])
    start = x = np.array([3.0, 0.6])
    for _ in range(50):
        x = step_towards(x, target, **TIMES)
    np.testing.assert_allclose(x - target, (start - target) / np.e, rtol=1e-12)
