"""Series in time against polynomials and closed forms, and how formulas run on them."""

import numpy as np
import pytest
from helpers import rotation
from numpy.polynomial import Polynomial

from drake_nonstop.mechanics.rotation import cross, norm, rotation_matrix
from drake_nonstop.mechanics.taylor import Taylor, turned

ORDER = 5


def drawn(rng, *shape):
    """A series with a value well away from zero."""
    rates = rng.uniform(-1, 1, (ORDER + 1, *shape))
    rates[0] += 2.5
    return Taylor.of_rates(*rates)


FORMULAS = {
    "sums": lambda x, y: 2 - x + y - np.ones(3) + (-y),
    "products": lambda x, y: 3 * x * y * x,
    "quotients": lambda x, y: x / y + 2 / x + y / 3,
    "roots": lambda x, y: np.sqrt(x * y),
    "circles": lambda x, y: np.cos(x) * np.sin(x * y),
    "matrices": lambda x, y: (np.stack([x, y, x * y]) @ y) @ np.arange(9.0).reshape(3, 3),
    "vectors": lambda x, y: cross(x, np.concatenate([y[:2], [1.5]])) / norm(y),
    "rotations": lambda x, y: rotation_matrix(np.concatenate([x, y[1:2]])).T @ y,
}


@pytest.mark.parametrize("formula", FORMULAS.values(), ids=FORMULAS)
def test_a_formula_of_series_is_the_series_of_the_formula(formula, rng):
    """In time steps h and h/2 the first term left out falls by 2⁶."""
    x, y = drawn(rng, 3), drawn(rng, 3)
    found = formula(x, y)
    wrong = []
    for time in (0.02, 0.01):
        exact = formula(x.at(time), y.at(time))
        wrong.append(np.max(np.abs(found.at(time) - exact)) / np.max(np.abs(exact)))
    assert wrong[1] < 1e-9
    assert wrong[0] / max(wrong[1], 1e-15) > 2 ** (ORDER + 0.5) or wrong[0] < 1e-14


def test_rates_and_integrals_are_those_of_the_polynomial():
    coefficients = np.array([0.3, -1.2, 0.7, 0.5, -0.25])
    series, known = Taylor([*coefficients]), Polynomial(coefficients)
    for order, rate in enumerate(series.rates):
        assert rate == pytest.approx(known.deriv(order)(0.0) if order else 0.3, rel=1e-15)
    assert series.rate().at(0.8) == pytest.approx(known.deriv()(0.8), rel=1e-14)
    assert series.integral(2.0).at(0.8) == pytest.approx(known.integ(k=2.0)(0.8), rel=1e-14)


def test_axes_turn_as_the_exponential_about_a_fixed_axis():
    axis, tilt = np.array([0.6, -0.48, 0.64]), rotation([0.9, 0.3, -0.2, 0.245])
    speed = Polynomial([0.7, -0.4, 0.5])
    spin = Taylor([coefficient * axis for coefficient in speed.coef])
    axes = turned(tilt.T, spin)
    assert len(axes.rates) == 4
    for time in (0.02, 0.01):
        angle = speed.integ()(time) / 2
        turn = rotation([np.cos(angle), *(np.sin(angle) * axis)])
        np.testing.assert_allclose(axes.at(time), (turn @ tilt).T, rtol=0, atol=0.2 * time**4)
