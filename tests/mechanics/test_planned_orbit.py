import numpy as np
import pytest
from helpers import Motion, model

from drake_nonstop.mechanics import nonstop
from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.mechanics.grasp import cable_forces_and_rates
from drake_nonstop.mechanics.internal_force import orbit_axes
from drake_nonstop.mechanics.planned_orbit import (
    OrbitTerms,
    PlannedOrbit,
    orbit_along_reference,
    orbit_directions,
    planned_speeds,
)
from drake_nonstop.mechanics.wrench import NO_FEEDBACK, wrench_and_rate

CABLES = {"rest_length": 0.8, "compliance": 1 / 500}


def terms_of(system, references):
    flat = [
        orbit_along_reference(
            system.load,
            reference,
            pseudo_inverse=system.pseudo_inverse,
            offset=system.pattern.offset,
            attachments=system.attachments,
        )
        for reference in references
    ]
    return OrbitTerms.view(np.array(flat))


def axes_of(system):
    return orbit_axes(system.pattern.basis, system.pattern.phases)


@pytest.mark.parametrize("n", [3, 4, 7])
def test_speeds_are_those_that_force_distribution_and_carrier_trajectory_command(n):
    system, motion = model(n), Motion(n)
    rng = np.random.default_rng(n)
    times = rng.uniform(0, 9, 5)
    numbers = rng.uniform([0, 0.5, 0.3, -0.5], [6, 3, 1.5, 0.5], (5, 4))
    (angles, frequencies, amplitudes, rates), none = numbers.T, np.zeros(5)
    orbit = PlannedOrbit(angles, frequencies, none, amplitudes, rates, none)
    references = [motion.reference(time) for time in times]
    speeds, _ = planned_speeds(terms_of(system, references), axes_of(system), orbit, **CABLES)
    for reference, (angle, xi, A, rate), squares in zip(references, numbers, speeds, strict=True):
        angles = angle + system.pattern.phases
        internal = [A * np.cos(angles), rate * np.cos(angles) - A * xi * np.sin(angles)]
        wrenches = wrench_and_rate(
            system.load, reference[:13], reference, np.zeros(6), feedforward=1.0, **NO_FEEDBACK
        )
        forces, rates = cable_forces_and_rates(
            reference,
            *wrenches,
            np.concatenate(internal),
            pseudo_inverse=system.pseudo_inverse,
            basis=system.pattern.basis,
            offset=system.pattern.offset,
        )
        velocities = carrier_motion(
            reference, forces, rates, attachments=system.attachments, **CABLES
        )[1]
        np.testing.assert_allclose(squares, (velocities**2).sum(axis=1), rtol=1e-9)


def test_at_constant_parameters_they_are_the_speeds_of_one_update():
    system, motion = model(5), Motion(8)
    reference, (angle, xi, A) = motion.reference(1.3), (2.1, 1.9, 0.8)
    terms = terms_of(system, [reference])
    u, along, _ = orbit_directions(axes_of(system), np.array([angle]))
    polynomials = nonstop.speed_polynomials(terms, u, along)
    c, b, a, tension_squared = nonstop.speed_squares(
        nonstop.polynomial_values(polynomials, A), **CABLES
    )
    orbit = PlannedOrbit.constant(np.array([angle]), xi, A)
    squares, tension_squares = planned_speeds(terms, axes_of(system), orbit, **CABLES)
    s = A * xi
    np.testing.assert_allclose(squares, c + 2 * b * s + a * s * s, rtol=1e-9)
    np.testing.assert_allclose(tension_squares, tension_squared, rtol=1e-9)
