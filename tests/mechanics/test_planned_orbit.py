import numpy as np
import pytest
from helpers import Motion, model

from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.mechanics.grasp import cable_forces_and_rates
from drake_nonstop.mechanics.internal_force import harmonics, orbit_axes, orbit_forces
from drake_nonstop.mechanics.load_motion import LoadMotion
from drake_nonstop.mechanics.planned_orbit import (
    FlightTerms,
    orbit_motion,
)
from drake_nonstop.mechanics.signals import PlannedParameters
from drake_nonstop.mechanics.wrench import feedforward_wrench

CABLES = {"rest_length": 0.8, "compliance": 1 / 500}


@pytest.mark.parametrize("n", [3, 4, 7])
def test_speeds_are_those_that_force_distribution_and_carrier_trajectory_command(n):
    system, motion = model(n), Motion(n)
    pattern, rng = system.pattern, np.random.default_rng(n)
    geometry = {"pseudo_inverse": system.pseudo_inverse, "offset": pattern.offset}
    references = np.array([motion.reference(time) for time in rng.uniform(0, 9, 5)])
    planned = np.zeros((5, 8))
    planned[:, [0, 1, 2, 4]] = rng.uniform([0, 0.5, 0.3, -0.5], [6, 3, 1.5, 0.5], (5, 4))
    terms = FlightTerms.along(system.load, LoadMotion.along(references), **geometry)
    forces = orbit_forces(
        orbit_axes(pattern.basis, pattern.phases), *PlannedParameters.view(planned).series
    )
    cables = {"attachments": system.attachments, **CABLES}
    found = orbit_motion(terms, forces, **cables)
    for k, (reference, plan) in enumerate(zip(references, planned, strict=True)):
        series = PlannedParameters.view(plan).series
        internal = np.concatenate(harmonics(*series, phases=pattern.phases).rates[:2])
        wrenches = feedforward_wrench(system.load, reference)
        forces, rates = cable_forces_and_rates(
            reference, *wrenches, internal, basis=pattern.basis, **geometry
        )
        positions, velocities = carrier_motion(reference, forces, rates, **cables)
        np.testing.assert_allclose(found.forces[k], forces, rtol=0, atol=1e-11)
        np.testing.assert_allclose(found.positions[k], positions, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.velocities[k], velocities, rtol=0, atol=1e-10)
