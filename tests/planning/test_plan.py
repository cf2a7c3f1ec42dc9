import numpy as np
import pytest
from scipy.interpolate import BSpline

from drake_nonstop.planning.plan import Plan, spline_rows
from drake_nonstop.systems.tracing import TracedFunction

SPACING = 0.4
COEFFICIENTS = np.random.default_rng(1).uniform(0.5, 1.5, (2, 12))
PLAN = Plan(3.0, 0.7, SPACING, np.array([2.0, 1.2]), COEFFICIENTS)


def test_rows_are_those_of_scipy():
    times = np.linspace(0, 8 * SPACING, 23)[:-1]
    rows = spline_rows(times, 8, SPACING)
    spline = BSpline(SPACING * np.arange(-4, 13), np.eye(12), 4)
    np.testing.assert_allclose(rows.value, spline(times), atol=1e-12)
    np.testing.assert_allclose(rows.rate, spline(times, 1), atol=1e-11)
    np.testing.assert_allclose(rows.second_rate, spline(times, 2), atol=1e-10)
    np.testing.assert_allclose(rows.third_rate, spline(times, 3), atol=1e-9)
    integral = spline.antiderivative()
    np.testing.assert_allclose(rows.integral, integral(times) - integral(0.0), atol=1e-12)


@pytest.mark.parametrize("count", [1, 3])
def test_a_shifted_plan_goes_on_as_the_plan_with_three_continuous_rates(count):
    shifted = PLAN.shifted(count)
    for time in np.linspace(shifted.start_time, PLAN.end_time - 1e-9, 9):
        np.testing.assert_allclose(shifted.planned(time), PLAN.planned(time), atol=1e-9)
    changed = shifted.coefficients.copy()
    changed[:, 4:] += 1
    other = Plan(shifted.start_time, shifted.start_angle, SPACING, PLAN.nominal, changed)
    start = shifted.start_time
    np.testing.assert_allclose(other.planned(start), PLAN.planned(start), atol=1e-8)
    assert not np.allclose(other.planned(start + SPACING), PLAN.planned(start + SPACING))


def test_traced_values_are_those_of_the_plan():
    """At knots, a rounding beside them, between them and after the end."""
    coefficients = np.random.default_rng(3).uniform(0.8, 1.2, (2, 9))
    plan = Plan(0.3, 0.7, 0.16, np.array([2.0, 1.1]), coefficients)

    def values(numbers, time):
        own = Plan(numbers[0], numbers[1], 0.16, numbers[2:4], numbers[4:].reshape(2, -1))
        return own.planned(time[0])

    traced = TracedFunction(values, [22, 1], name=lambda: "plan")
    numbers = np.concatenate([[0.3, 0.7], plan.nominal, coefficients.ravel()])
    knots = 0.3 + 0.16 * np.arange(7)
    for time in (*knots, *(knots[1:] - 1e-15), *(knots + 0.05), 3.0):
        (found,) = traced(numbers, np.array([time]))
        np.testing.assert_allclose(found, plan.planned(time), rtol=1e-12, atol=1e-12)
