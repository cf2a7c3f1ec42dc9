"""Plans beside splines by SciPy."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from drake_nonstop.planning.plan import Plan

SPACING = 0.4
COEFFICIENTS = np.random.default_rng(1).uniform(0.5, 1.5, (2, 12))
PLAN = Plan(3.0, 0.7, SPACING, np.array([2.0, 1.2]), COEFFICIENTS)


def test_planned_values_are_those_of_scipys_splines_at_knots_beside_and_between_them():
    xi, A = (
        BSpline(SPACING * np.arange(-4, 13), nominal * own, 4)
        for nominal, own in zip(PLAN.nominal, COEFFICIENTS, strict=True)
    )
    turns, knots = xi.antiderivative(), SPACING * np.arange(8)
    for t in (*knots, *(knots[1:] - 1e-9), *(knots + 0.05)):
        expected = [0.7 + turns(t) - turns(0), xi(t), A(t), *(f(t, 1) for f in (xi, A))]
        expected += [f(t, 2) for f in (xi, A)] + [A(t, 3)]
        np.testing.assert_allclose(PLAN.planned(3 + t), expected, rtol=1e-9, atol=1e-6)
    end, late = PLAN.planned(PLAN.end_time), PLAN.planned(PLAN.end_time + 0.5)
    np.testing.assert_allclose(late[:3], [end[0] + 0.5 * end[1], *end[1:3]], atol=1e-9)
    np.testing.assert_array_equal(late[3:], 0)


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
