"""How drag bows cables, of an independent derivation and by their differential equation."""

import numpy as np
import pytest

from drake_nonstop.analysis.flight_envelope import BowedCables
from drake_nonstop.model.aircraft import AircraftParameters, make_aircraft

LENGTH, SPEED, TENSION = 150.0, 15.3, 25.0


def cables(diameter):
    parameters = AircraftParameters(model="rascal_110")
    aircraft = make_aircraft(parameters, cable_length=LENGTH, gravity=9.81, cable_diameter=diameter)
    one = np.ones((1, 1))
    return aircraft, BowedCables.of(aircraft, SPEED * one, TENSION * one[..., None], np.eye(2))


@pytest.mark.parametrize(
    ("diameter", "bow", "shortening", "mass"),
    [(0.7e-3, 3.9, 0.29, 0.06), (1e-3, 5.6, 0.60, 0.11), (2e-3, 11.2, 2.4, 0.46)],
)
def test_bow_shortening_and_mass_of_an_independent_derivation(diameter, bow, shortening, mass):
    """Of 150 m of Dyneema that an aircraft pulls at with 25 N and 15.3 m/s."""
    _, found = cables(diameter)
    assert found.bow == pytest.approx(bow, abs=0.05)
    assert found.shortening[1] == pytest.approx(shortening, rel=0.02)
    assert found.mass == pytest.approx(mass, abs=0.005)


def test_a_bowed_cable_is_that_of_its_differential_equation():
    """T y'' = -w_d (s/L)^2 with y = 0 at both ends; the arc is longer by the sum of y'^2/2."""
    aircraft, found = cables(1e-3)
    drag = aircraft.air_density / 2 * aircraft.cable_drag * 1e-3 * SPEED**2
    s = np.linspace(0, LENGTH, 20001)
    step = s[1]
    bent = -drag / TENSION * (s / LENGTH) ** 2
    slope = np.concatenate([[0], np.cumsum((bent[1:] + bent[:-1]) / 2)]) * step
    y = np.concatenate([[0], np.cumsum((slope[1:] + slope[:-1]) / 2)]) * step
    slope, y = slope - y[-1] / LENGTH, y - y[-1] * s / LENGTH
    assert found.bow == pytest.approx(y.max(), rel=1e-6)
    longer = np.sum((slope[1:] ** 2 + slope[:-1] ** 2) / 4) * step
    assert found.shortening[0] == pytest.approx(longer, rel=1e-6)
