"""The orbits above a level load, in closed form."""

import numpy as np
import pytest
from helpers import regular

from drake_nonstop.analysis.resting_carriers import resting_carriers
from drake_nonstop.mechanics.formation_orbit import CarriedLoad, FormationShape, carrier_orbit
from drake_nonstop.mechanics.signals import constant_plan
from drake_nonstop.model.pattern import ConstantSpreadConfig, EllipticCarouselConfig
from drake_nonstop.model.system import Model, SystemParameters

WIND = np.array([2.0, 1.0, 0.3])
SIZES = {"spread": 6.75, "radial": 3.3, "tangential": 4.5, "vertical": 4.9}


@pytest.mark.parametrize(
    ("pattern", "n", "yaw_rate", "turns"),
    [
        (EllipticCarouselConfig(phase_turns=2, **SIZES), 4, 0.0, 2),
        (EllipticCarouselConfig(phase_turns=3, **SIZES), 6, 0.0, 3),
        (ConstantSpreadConfig(spread=30.0), 5, 0.4, 0),
    ],
)
def test_they_are_those_of_the_general_equations(pattern, n, yaw_rate, turns):
    made = Model(
        SystemParameters(
            load_mass=10.0,
            load_inertia=np.diag([5.0, 5.0, 10.0]).tolist(),
            load_drag=0.6,
            attachments=regular(n, 1.5).tolist(),
            cable_length=150.0,
            cable_stiffness=120.0,
        ),
        pattern,
    )
    times, frequency = np.linspace(0, 9, 7), 0.6
    carriers = resting_carriers(made, made, np.eye(22)[0], times, yaw_rate=yaw_rate, load_wind=WIND)
    general = carriers.motion(constant_plan(frequency * times, frequency, 1.0))
    sizes = [getattr(pattern, name, 0.0) for name in SIZES]
    shape = FormationShape(*sizes, frequency, yaw_rate, 150.0)
    load = CarriedLoad(10.0, 0.6, 9.81, n, 1.5, 1 / 120.0)
    for i in range(n):
        place = 2 * np.pi * i / n
        found = carrier_orbit(
            shape,
            load,
            place + yaw_rate * times,
            frequency * times + turns * place,
            air_velocity=-WIND,
            acceleration=np.zeros(3),
        )
        for values, expected in (
            (found.forces, general.forces),
            (found.positions, general.positions),
            (found.velocities + WIND, general.velocities),
            (found.accelerations, general.accelerations),
        ):
            np.testing.assert_allclose(values, expected[:, i], rtol=1e-10, atol=1e-9)
