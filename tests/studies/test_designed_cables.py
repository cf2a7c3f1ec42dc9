"""Cables that follow from a designed formation: their diameter, mass and drag."""

import math

import numpy as np
import pytest

from drake_nonstop.mechanics.aircraft import needed_force
from drake_nonstop.planning.formation_program import FormationVariables
from drake_nonstop.run.metrics import compute_metrics
from drake_nonstop.run.simulate import simulate
from drake_nonstop.studies.design import design_one
from drake_nonstop.studies.design_request import read_request
from drake_nonstop.studies.designed_formation import (
    DesignedFormation,
    design_task,
    flight_of,
    formation_scenario,
)

STRENGTH, DENSITY = 1.6e9, 970.0  # Pa, kg/m³
LUMPED = ["cable_safety=5", "cables=lumped"]


@pytest.mark.parametrize("kind", ["leaning", "co_rotating"])
def test_the_diameter_follows_from_the_largest_tension(kind):
    request = read_request(None, [*LUMPED, "wind=[0, 3, 0]", "load_drag=5"])
    task = design_task(request, 4, 24)
    x = FormationVariables(0.3, 0.15, 0.2, 0.1, 0.6, 150.0, 10.0, 3.0, 3.0, 0.0)
    if kind == "co_rotating":
        x = x._replace(radial=0.0, tangential=0.0, vertical=0.0)
    aircraft, angles = task.flown_by(x), task.angles(kind, 90)
    orbits = [task.orbit(kind, x, angles, motion.at(x.speed)) for motion in task.motions]
    tension = max(np.linalg.norm(orbit.forces, axis=1).max() for orbit in orbits)
    area = math.pi / 4 * aircraft.cable_diameter**2
    assert 5 * tension <= STRENGTH * area < 6 * tension
    at_rest = orbits[0]
    borne = task.needed_force(aircraft, at_rest)
    borne -= needed_force(aircraft, at_rest.accelerations, at_rest.forces)
    # Over a turn accelerations have no mean: that is the cable's weight.
    np.testing.assert_allclose(borne.mean(axis=0), [0, 0, DENSITY * area * 150 * 9.81], atol=1e-9)
    flight = flight_of(task, kind, x, phases=8)
    scenario = formation_scenario(request, kind, 4, 2, x, flight)
    assert scenario.system.cable_diameter == pytest.approx(aircraft.cable_diameter, rel=1e-5)
    assert type(scenario.cables).__name__ == "LumpedCablesConfig"
    assert type(scenario.carrier_trajectory).__name__ == "BowedCarrierTrajectoryConfig"
    built = task.built(x)
    assert built.flown_by(x._replace(spread=9.0)).cable_diameter == aircraft.cable_diameter


@pytest.mark.nightly("studies")
def test_formations_fly_with_the_cables_that_are_asked_for():
    changes = ["carriers=[4]", *LUMPED, "starts=1", "speed=3", "cable_length=[150, 150]"]
    request = read_request(None, changes)
    found = [f for f in design_one(request, 4, "leaning") if isinstance(f, DesignedFormation)]
    assert found
    for formation in found[:1]:
        cables, x, pattern = formation.cables, formation.variables, formation.scenario.pattern
        assert cables.are_flown
        assert 5 <= cables.safety < 5.8
        metrics = compute_metrics(simulate(formation.scenario))
        assert metrics["outcome"] == "ok"
        assert metrics["aircraft"]["bank_max_rad"] == pytest.approx(formation.flight.bank, abs=0.1)
        assert pattern.spread == pytest.approx(formation.forces["spread"], rel=1e-4)
        # Of a load that rests, with the airspeed and the tension of each instant.
        task = design_task(request, 4).built(x)
        orbit = task.orbit("leaning", x, task.angles("leaning", 90), task.motions[0])
        tensions, speeds = (np.linalg.norm(v, axis=1) for v in (orbit.forces, orbit.velocities))
        drag = 1.225 * 1.1 * task.aircraft.cable_diameter * speeds**2
        shorter = 9 / 14 * 150 * (drag * 150 / (24 * tensions)) ** 2
        assert cables.shortening[1] == pytest.approx(shorter.max(), rel=0.3)
