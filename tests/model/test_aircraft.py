"""Aircraft as data: the table, a user's own, and those that cannot fly."""

import dataclasses

import numpy as np
import pytest
import yaml

from drake_nonstop.mechanics.aircraft import stall_speed
from drake_nonstop.model.aircraft import (
    TABLE,
    AircraftParameters,
    aircraft_names,
    make_aircraft,
    values_of,
)
from drake_nonstop.model.pattern import HamiltonianCycleConfig
from drake_nonstop.model.system import Model, SystemOverrides, SystemParameters, overridden
from drake_nonstop.validation import ScenarioError

RASCAL = "rascal_110"


def made(**fields):
    return make_aircraft(AircraftParameters(**fields), cable_length=150.0, gravity=9.81)


def test_the_table_flies():
    """The stall speeds are those of the sources; the class of 2 kg has a higher one."""
    assert aircraft_names() == [RASCAL, "ultrastick_25e"]
    speeds = [float(stall_speed(made(model=name))) for name in aircraft_names()]
    np.testing.assert_allclose(speeds, [8.4, 9.6], atol=0.05)


@pytest.mark.parametrize("name", aircraft_names())
def test_each_figure_of_the_table_has_a_unit_and_a_source(name):
    lines = [
        line for line in (TABLE / f"{name}.yaml").read_text().splitlines() if line[0] not in "# "
    ]
    keys = [f.name for f in dataclasses.fields(AircraftParameters)][1:]
    assert [line.partition(":")[0] for line in lines] == keys[: len(lines)]
    for line in lines:
        about = line.partition("# ")[2]
        unit, _, source = about.partition("; ")
        assert unit, line
        assert source.startswith(("[", "assumed")), line


def test_single_fields_override_the_table():
    aircraft = made(model=RASCAL, mass=6.3)
    assert aircraft == made(model=RASCAL)._replace(
        mass=6.3, max_thrust=aircraft.max_thrust, min_thrust=aircraft.min_thrust
    )


def test_a_users_own_has_all_fields():
    own = yaml.safe_load((TABLE / f"{RASCAL}.yaml").read_text())
    assert values_of(AircraftParameters(**own)) == values_of(AircraftParameters(model=RASCAL))
    del own["wing_area"]
    with pytest.raises(ScenarioError, match=r"system.aircraft.wing_area = not given: give it"):
        made(**own)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"model": "rascal"}, "system.aircraft.model = rascal: there is no rascal; did you mean"),
        ({"wing_area": -1.0}, "system.aircraft.wing_area = -1.0: give a finite number greater"),
        ({"efficiency": 1.2}, "system.aircraft.efficiency = 1.2: give a share, up to 1"),
        ({"lift_lag": 1e-6}, "system.aircraft.lift_lag = 1e-06: give at least 0.001 s"),
        ({"max_lift": 0.2}, "lift_at_zero_angle = 0.25: give a number below max_lift, 0.2"),
        ({"mass": 80.0}, "level flight without a cable needs"),
        ({"max_thrust": [4.0, 0.0, 0.0]}, "level flight without a cable needs 4.5"),
        ({"min_thrust": [0.0, 3.0, 0.0]}, "min_thrust = [0.0, 3.0, 0.0]: give less"),
        ({"max_thrust": [1.0, 2.0]}, "max_thrust = [1.0, 2.0]: give 3 finite numbers"),
        ({"zero_lift_drag": 0.0, "induced_drag": 0.0}, "zero_lift_drag = 0.0: give a number abov"),
    ],
)
def test_what_cannot_fly_is_refused(fields, message):
    with pytest.raises(ScenarioError) as error:
        made(**{"model": RASCAL} | fields)
    assert message in str(error.value)


def model_of(system, **named):
    return Model(system, HamiltonianCycleConfig(), **named)


def test_the_carriers_have_the_mass_of_the_aircraft():
    system = SystemParameters(aircraft=AircraftParameters(model=RASCAL))
    model = model_of(system)
    assert model.carrier_mass == model.system.carrier_mass == model.number("carrier_mass") == 6.0
    assert system.carrier_mass == 0.1
    assert model_of(SystemParameters()).aircraft is None
    with pytest.raises(ScenarioError, match=r"system.carrier_mass = 5.0: leave it out"):
        model_of(dataclasses.replace(system, carrier_mass=5.0))


def test_the_plant_has_single_fields_of_its_own():
    system = SystemParameters(aircraft=AircraftParameters(model=RASCAL, mass=6.1))
    simulated = SystemOverrides(aircraft=AircraftParameters(max_lift=1.2))
    aircraft = model_of(overridden(system, simulated)).aircraft
    assert (aircraft.mass, aircraft.max_lift, aircraft.wing_area) == (6.1, 1.2, 0.98)


def test_the_plants_carrier_mass_is_not_given_beside_the_aircrafts():
    system = SystemParameters(aircraft=AircraftParameters(model=RASCAL))
    plant = overridden(system, SystemOverrides(carrier_mass=0.1))
    with pytest.raises(ScenarioError, match=r"simulated.carrier_mass = 0.1: leave it out"):
        model_of(plant, field="simulated", overridden=["carrier_mass"])


@pytest.mark.parametrize("given", ["system", "simulated"])
def test_what_is_no_aircraft_is_refused(given):
    fields = {name: AircraftParameters(model=RASCAL) for name in ("system", "simulated")}
    fields[given] = 1e30
    with pytest.raises(ScenarioError, match=f"{given}.aircraft = 1e\\+30: give an Aircraft"):
        overridden(
            SystemParameters(aircraft=fields["system"]),
            SystemOverrides(aircraft=fields["simulated"]),
        )
