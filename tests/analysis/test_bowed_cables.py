"""How drag bows cables, of an independent derivation and by their differential equation."""

import numpy as np
import pytest
from golden.numbers import read_table
from helpers import nightly_beyond

from drake_nonstop import load_scenario
from drake_nonstop.analysis.aircraft_margins import aircraft_margins
from drake_nonstop.analysis.flight_envelope import BowedCables
from drake_nonstop.analysis.resting_carriers import resting_carriers
from drake_nonstop.blocks.lumped_cables import material_of
from drake_nonstop.mechanics.bowed_line import TimeWindow
from drake_nonstop.mechanics.bowed_orbit import CableShape
from drake_nonstop.mechanics.signals import constant_plan
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.model.pattern import HamiltonianCycleConfig
from drake_nonstop.model.system import Model, SystemParameters

LENGTH, SPEED, TENSION = 150.0, 15.3, 25.0


def cables(diameter):
    system = SystemParameters(
        aircraft=AircraftParameters(model="rascal_110"),
        cable_length=LENGTH,
        cable_diameter=diameter,
        cable_drag=1.1,
    )
    model, one = Model(system, HamiltonianCycleConfig()), np.ones((1, 4))
    return model, BowedCables.of(model, SPEED * one, TENSION * one[..., None] * [0.0, 0.0, 1.0])


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
    model, found = cables(1e-3)
    drag = model.aircraft.air_density / 2 * 1.1 * 1e-3 * SPEED**2
    s = np.linspace(0, LENGTH, 20001)
    step = s[1]
    bent = -drag / TENSION * (s / LENGTH) ** 2
    slope = np.concatenate([[0], np.cumsum((bent[1:] + bent[:-1]) / 2)]) * step
    y = np.concatenate([[0], np.cumsum((slope[1:] + slope[:-1]) / 2)]) * step
    slope, y = slope - y[-1] / LENGTH, y - y[-1] * s / LENGTH
    assert found.bow == pytest.approx(y.max(), rel=1e-6)
    longer = np.sum((slope[1:] ** 2 + slope[:-1] ** 2) / 4) * step
    assert found.shortening[0] == pytest.approx(longer, rel=1e-6)
    assert found.safety == pytest.approx(1600e6 * np.pi / 4 * 1e-6 / TENSION)
    assert f"break at {found.safety:.2g} times the largest tension" in found.text


def test_the_bow_of_each_cable_is_that_of_many_like_it():
    own = {
        "cable_length": [140.0, 150.0, 155.0, 160.0],
        "cable_diameter": [1e-3, 2e-3, 1.5e-3, 3e-3],
    }
    own["cable_stiffness"] = [100.0, 120.0, 200.0, 400.0]
    parameters = AircraftParameters(model="rascal_110")
    times = np.linspace(0, 3, 5)
    planned = constant_plan(2 * times, 2.0, 1.2)

    def bowed(**system):
        fields = {"load_mass": 10.0, "aircraft": parameters, **system}
        model = Model(SystemParameters(**fields), HamiltonianCycleConfig())
        shape = CableShape(3, TimeWindow.of(0.75, 9), material_of(model))
        carriers = resting_carriers(
            *(model, model, np.eye(7)[0], times),
            yaw_rate=0.1,
            load_wind=np.array([2.0, 1.0, 0.0]),
            shape=shape,
        )
        straight = carriers.motion(planned)
        lines = carriers.bowed(planned, straight)
        told = BowedCables.of(model, SPEED * np.ones((5, 4)), straight.forces)
        needs = carriers.needs(straight)
        return [*lines.motion, lines.nodes.swapaxes(0, 1), lines.bows, needs.thrust], told

    together, told = bowed(**own)
    shortest = []
    for i in range(4):
        alone, one = bowed(**{name: values[i] for name, values in own.items()})
        shortest.append(one)
        for unlike, alike in zip(together, alone, strict=True):
            axis = 2 if unlike.ndim == 4 else 1
            np.testing.assert_allclose(
                *(v.take(i, axis) for v in (unlike, alike)), rtol=1e-9, atol=1e-9
            )
    assert told.bow <= max(one.bow for one in shortest)
    assert told.mass == pytest.approx(max(one.mass for one in shortest))
    assert told.safety >= min(one.safety for one in shortest)


@pytest.mark.parametrize(
    "name",
    nightly_beyond(1, "flights", ["aircraft_rest_cables", "aircraft_co_rotating_cables"]),
)
def test_what_is_told_of_bowed_cables_is_what_is_flown(name):
    """Of flights of `LumpedCables`, whose load is up to 10 mm off its place."""
    found, flown = aircraft_margins(load_scenario(name)), read_table()[name]
    value = {margin.name: margin.value for margin in found.margins}
    for told, quantity, tolerance in (
        (value["bank"], "aircraft.bank_max_rad", 0.002),
        (value["C_L / C_Lmax"], "aircraft.lift_share_max", 0.004),
        (value["carriers apart"], "carriers.separation_min_m", 0.02),
        (found.ranges.airspeed[0], "aircraft.airspeed_min_m_s", 0.01),
        (found.ranges.thrust[1], "aircraft.thrust_max_N", 0.1),
        (found.ranges.thrust[0], "aircraft.thrust_min_N", 0.1),
        (found.propulsive_power, "aircraft.power_mean_W", 0.5),
        (found.cables.tension[0], "cables.tension_min_N", 0.3),
    ):
        assert told == pytest.approx(float(flown[quantity].value), abs=tolerance), quantity
    assert found.cables.are_flown
    assert "N at the carriers" in found.cables.text
    assert not found.cables.warning
