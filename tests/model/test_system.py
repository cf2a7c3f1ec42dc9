"""What follows from a system's fields, its aircraft among them, and what no system can be."""

import dataclasses
import inspect
import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers import INERTIA, irregular, regular, spatial

from drake_nonstop import AircraftParameters, Model, Scenario, ScenarioError, SystemParameters
from drake_nonstop.mechanics.aircraft import stall_speed
from drake_nonstop.mechanics.grasp import grasp_matrix
from drake_nonstop.model.pattern import HamiltonianCycleConfig

RASCAL = "rascal_110"
FIGURES = sorted(Path(inspect.getfile(AircraftParameters)).parent.glob("aircraft_table/*.yaml"))


def make(control_period=0.0, **fields):
    system = SystemParameters(**fields)
    if "aircraft" in fields:
        system.aircraft = AircraftParameters(**({"model": RASCAL} | fields["aircraft"]))
    return Model(system, HamiltonianCycleConfig(), control_period)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("shape", [regular(3), irregular(5), spatial(6)])
def test_constants_that_follow_from_the_system(shape, scale):
    model = make(attachments=(scale * shape).tolist(), load_inertia=INERTIA.tolist())
    grasp = grasp_matrix(scale * shape)
    assert (model.n, model.m) == (len(shape), len(shape))
    np.testing.assert_allclose(grasp @ model.pseudo_inverse, np.eye(6), rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        model.pseudo_inverse, grasp.T @ np.linalg.inv(grasp @ grasp.T), rtol=1e-6, atol=1e-9 / scale
    )
    np.testing.assert_allclose(model.load.inertia_inverse @ INERTIA, np.eye(3), rtol=0, atol=1e-13)
    assert model.cable_compliance == 1 / 500


def test_values_at_the_ends_of_their_ranges():
    assert make(cable_stiffness=math.inf).cable_compliance == 0
    assert make(load_drag=0.0, cable_damping=0.0).load.drag == 0
    plate = make(load_inertia=[[0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3]])
    assert np.diag(plate.load.inertia).tolist() == [0.1, 0.2, 0.3]


def test_each_field_of_the_system_may_differ_in_what_is_simulated():
    scenario = Scenario()
    own, simulated = (dataclasses.fields(part) for part in (scenario.system, scenario.simulated))
    assert {field.name for field in own} == {field.name for field in simulated}


POSITIVE = ["load_mass", "cable_length", "carrier_mass", "gravity", "cable_stiffness"]
NON_NEGATIVE = ["load_drag", "cable_damping"]
ON_A_LINE = [[1.0, 2, 3], [2.0, 4, 6], [-1.0, -2, -3]]
TWICE = [[1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0], [-1.0, 0, 0]]
NO_BODY = "triangle inequality"

# Fields, the value that is told, and the remedy.
REFUSED = [
    *(
        ({name: value}, f"system.{name} = {value}", "give a")
        for name in (*POSITIVE, *NON_NEGATIVE)
        for value in (-1.0, math.nan, -math.inf, True, "1.0", None)
    ),
    *(({name: 0.0}, f"system.{name} = 0.0", "give a") for name in POSITIVE),
    *(
        ({name: math.inf}, f"system.{name} = inf", "finite")
        for name in (*POSITIVE[:-1], *NON_NEGATIVE)
    ),
    *(({"control_period": p}, f"control_period = {p}", "give") for p in (-0.01, math.nan)),
    ({"attachments": [[0.0, 0, 0]]}, "system.attachments", "3 or more"),
    *(
        ({"attachments": value}, "system.attachments", "give n x 3 finite numbers")
        for value in ([], [[1.0, 0], [0, 1.0]], [[1.0, 0, 0], [0, 0]], [[0, 0, math.nan]], "square")
    ),
    *(
        ({"attachments": value}, "system.attachments", "rank below 6")
        for value in (ON_A_LINE, [[0.0, 0, 0]] * 4)
    ),
    ({"attachments": TWICE}, "system.attachments", "different attachment"),
    *(
        ({"load_inertia": value}, "system.load_inertia", NO_BODY)
        for value in (
            [[0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.03]],
            [[0.01, 0, 0], [0, -0.01, 0], [0, 0, 0.01]],
            [[0.0, 0, 0], [0, 0.01, 0], [0, 0, 0.01]],
            [[0.01, 0.001, 0], [0, 0.01, 0], [0, 0, 0.01]],
            [[0.01, 0.02, 0], [0.02, 0.01, 0], [0, 0, 0.01]],
        )
    ),
    *(
        ({"load_inertia": value}, "system.load_inertia", "give 3 x 3 finite numbers")
        for value in ([[0.01, 0, 0]], [[math.nan, 0, 0], [0, 1, 0], [0, 0, 1]], None)
    ),
    ({"aircraft": {"model": "rascal"}}, "system.aircraft.model = rascal", "did you mean"),
    ({"aircraft": {"wing_area": -1.0}}, "system.aircraft.wing_area = -1.0", "greater"),
    ({"aircraft": {"efficiency": 1.2}}, "system.aircraft.efficiency = 1.2", "share"),
    ({"aircraft": {"lift_lag": 1e-6}}, "system.aircraft.lift_lag = 1e-06", "0.001 s"),
    ({"aircraft": {"max_lift": 0.2}}, "lift_at_zero_angle = 0.25", "below max_lift, 0.2"),
    ({"aircraft": {"mass": 80.0}}, "system.aircraft", "level flight without a cable needs"),
    ({"aircraft": {"max_thrust": [4.0, 0.0, 0.0]}}, "max_thrust", "needs 4.5"),
    ({"aircraft": {"min_thrust": [0.0, 3.0, 0.0]}}, "min_thrust = [0.0, 3.0, 0.0]", "give less"),
    ({"aircraft": {"max_thrust": [1.0, 2.0]}}, "max_thrust = [1.0, 2.0]", "3 finite numbers"),
    (
        {"aircraft": {"zero_lift_drag": 0.0, "induced_drag": 0.0}},
        "zero_lift_drag = 0.0",
        "above zero",
    ),
    ({"aircraft": {}, "carrier_mass": 5.0}, "system.carrier_mass = 5.0", "leave it out"),
]


@pytest.mark.parametrize(("fields", "value", "remedy"), REFUSED)
def test_what_is_no_system_is_told(fields, value, remedy):
    with pytest.raises(ScenarioError, match=f"{re.escape(value)}.*: .*{remedy}") as error:
        make(**fields)
    assert "\n" not in str(error.value)


def test_the_table_of_aircraft_flies():
    """The stall speeds are those of the sources; the class of 2 kg has a higher one."""
    made = {path.stem: make(aircraft={"model": path.stem}, cable_length=150.0) for path in FIGURES}
    speeds = {name: float(stall_speed(model.aircraft)) for name, model in made.items()}
    assert speeds == pytest.approx({RASCAL: 8.4, "ultrastick_25e": 9.6}, abs=0.05)


def test_an_aircraft_of_ones_own_has_all_fields():
    own = yaml.safe_load(next(p for p in FIGURES if p.stem == RASCAL).read_text())
    made = make(aircraft=own | {"model": AircraftParameters().model})
    assert str(made.aircraft) == str(make(aircraft={}).aircraft)
    del own["wing_area"]
    with pytest.raises(ScenarioError, match=r"system.aircraft.wing_area = not given: give it"):
        make(aircraft=own | {"model": AircraftParameters().model})
