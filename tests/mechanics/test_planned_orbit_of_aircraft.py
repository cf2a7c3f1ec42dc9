"""What aircraft need along a planned orbit, against the inverse, and other motions."""

from dataclasses import replace

import numpy as np
from helpers import Motion

from drake_nonstop.mechanics.aircraft import (
    flight_needs,
    needed_force,
)
from drake_nonstop.mechanics.carrier import carrier_positions
from drake_nonstop.mechanics.grasp import cable_forces_and_rates, forces_along
from drake_nonstop.mechanics.internal_force import harmonics
from drake_nonstop.mechanics.load_motion import LoadMotion, in_axes
from drake_nonstop.mechanics.planned_orbit import (
    FlightTerms,
    needs_of_motion,
    orbit_motion,
    turning_terms,
)
from drake_nonstop.mechanics.rotation import quaternion_product, rotation_matrix
from drake_nonstop.mechanics.signals import PlannedParameters, constant_plan
from drake_nonstop.mechanics.taylor import Taylor
from drake_nonstop.mechanics.wrench import NO_FEEDBACK, wrench_and_rate
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.model.pattern import ConstantSpreadConfig, EllipticCarouselConfig
from drake_nonstop.model.system import Model, SystemParameters

WIND = np.array([1.9, -0.8, 0.3])
ORBIT = np.array([0.6, 0.01, 1.0, 0.02, -0.01])  # ξ, ξ̇, A, Ȧ, Ä
CORNERS = [[1.5, 0.0, 0.0], [0.0, 1.5, 0.0], [-1.5, 0.0, 0.0], [0.0, -1.5, 0.0]]


def aircraft_model(pattern=None, length=150.0, stiffness=120.0):
    system = SystemParameters(
        load_mass=10.0,
        load_inertia=[[5.6, 0.2, 0.1], [0.2, 5.1, 0.0], [0.1, 0.0, 9.2]],
        load_drag=0.6,
        attachments=CORNERS,
        cable_length=length,
        cable_stiffness=stiffness,
        aircraft=AircraftParameters(model="rascal_110"),
    )
    carousel = EllipticCarouselConfig(
        spread=6.75, phase_turns=2, radial=3.3, tangential=4.5, vertical=4.9
    )
    return Model(system, pattern or carousel)


def cables_of(model):
    return {"rest_length": model.cable_length, "compliance": model.cable_compliance}


def distribution_of(model):
    return {"pseudo_inverse": model.pseudo_inverse, "offset": model.pattern.offset}


def plan(rng, count):
    shares = rng.uniform(0.8, 1.2, (5, count))
    xi, xi_rate, A, A_rate, A_second = ORBIT[:, None] * shares
    rates = [xi, A, xi_rate, A_rate, 0 * xi, A_second, 0 * xi]
    return np.stack([rng.uniform(0, 6, count), *rates], axis=1)


def stack(references, model, wind):
    motion = LoadMotion.along(np.array(references))
    return FlightTerms.along(model.load, motion, wind, **distribution_of(model))


def needs_of(model, terms, orbit, wind=WIND):
    pattern = model.pattern.forces(*PlannedParameters.view(orbit).series)
    motion = orbit_motion(terms, pattern, attachments=model.attachments, **cables_of(model))
    return needs_of_motion(model.aircraft, motion, wind)


def slow_motion(seed, share=0.2):
    """A reference (22,) with everything in motion, in slow motion."""
    reference = Motion(seed).reference(0.7)
    powers = np.repeat([0, 1, 2, 3], [7, 6, 6, 3])
    return reference * share**powers


def commanded(model, reference, orbit, wind):
    """Carriers' velocity, acceleration and cable force in W, by the chain that commands them."""
    pattern = model.pattern
    values, rates, seconds, thirds = harmonics(
        *PlannedParameters.view(orbit).series, phases=pattern.phases
    ).rates
    wrenches = wrench_and_rate(
        model.load, reference[:13], reference, np.zeros(6), wind, feedforward=1.0, **NO_FEEDBACK
    )
    maps = {"pseudo_inverse": model.pseudo_inverse, "basis": pattern.basis}
    forces, force_rates = cable_forces_and_rates(
        reference, *wrenches, np.concatenate([values, rates]), **maps, offset=pattern.offset
    )
    motion, higher = LoadMotion.along(reference), np.concatenate([seconds, thirds])
    along = forces_along(model.load, motion, forces, force_rates, higher, wind, **maps)
    cables = {"attachments": model.attachments, **cables_of(model)}
    _, velocities, acceleration, _ = carrier_positions(motion, along, **cables).rates
    return velocities, acceleration, forces


def test_needs_are_those_of_the_exact_inverse_of_the_commanded_motion(rng):
    model = aircraft_model()
    orbit = plan(rng, 6)
    references = [slow_motion(i) for i in range(6)]
    found = needs_of(model, stack(references, model, WIND), orbit)
    for i, (reference, instant) in enumerate(zip(references, orbit, strict=True)):
        velocities, acceleration, forces = commanded(model, reference, instant, WIND)
        force = needed_force(model.aircraft, acceleration, forces)
        air = velocities - WIND
        told = flight_needs(model.aircraft, force, air)
        for name, expected in (
            ("airspeed", np.linalg.norm(air, axis=1)),
            ("force", np.linalg.norm(force, axis=1)),
            ("lift", told.lift),
            ("bank", told.bank),
            ("climb", np.arcsin(air[:, 2] / np.linalg.norm(air, axis=1))),
            ("thrust", told.thrust),
        ):
            np.testing.assert_allclose(
                getattr(found, name)[i], expected, rtol=1e-8, atol=1e-8, err_msg=name
            )


def test_closed_forms_of_level_orbits_that_turn_with_the_load():
    """theory: tan ϑ = C/f₀, tan φ = [V²/gR − μ tan ϑ]/(1 + μ), C_L = 2 (W + f₀)/(ρ S V² cos φ)."""
    spread, rate, length = 30.0, 0.4, 60.0
    model = aircraft_model(ConstantSpreadConfig(spread=spread), length, np.inf)
    model.load = replace(model.load, inertia=np.diag([5.6, 5.6, 11.2]))
    aircraft = model.aircraft
    reference = np.zeros(22)
    reference[0], reference[9] = 1.0, rate
    orbit = constant_plan(np.zeros(1), 0.4, 0.0)
    terms = stack([reference], model, np.zeros(3))
    needs = needs_of(model, terms, orbit, np.zeros(3))
    share = 10.0 * 9.81 / 4
    tangent = spread / share
    radius = 1.5 + length * tangent / np.hypot(1, tangent)
    speed, ratio = rate * radius, 10.0 / (4 * aircraft.mass)
    bank = np.arctan((speed**2 / (9.81 * radius) - ratio * tangent) / (1 + ratio))
    lift = 2 * (aircraft.mass * 9.81 + share) / (1.225 * 0.98 * speed**2 * np.cos(bank))
    np.testing.assert_allclose(needs.airspeed, speed, rtol=1e-9)
    np.testing.assert_allclose(np.abs(needs.bank), bank, rtol=1e-6)
    np.testing.assert_allclose(needs.climb, 0, atol=1e-9)
    np.testing.assert_allclose(needs.lift, lift, rtol=0.02)  # without the thrust's T sin α
    assert np.all(needs.lift < lift)


def test_terms_of_a_turning_load_are_those_of_its_turned_motion(rng):
    model = aircraft_model(ConstantSpreadConfig(spread=30.0), 60.0)
    motion = slow_motion(2)
    motion[[7, 8, 13, 14, 15]] = 0.0  # about the vertical, at a constant rate
    motion[9] = 0.0
    wrench = np.concatenate([rng.normal(size=3), [3.0, -2.0, 98.0]])
    force_rate = rng.normal(size=3)
    rates, angles = rng.uniform(0.2, 0.6, 5), rng.uniform(0, 6, 5)
    others = distribution_of(model)
    found = turning_terms(
        motion, wrench, np.concatenate([np.zeros(3), force_rate]), rates, angles, **others
    )
    for i, (rate, angle) in enumerate(zip(rates, angles, strict=True)):
        turn = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
        moved = motion.copy()
        moved[:4] = quaternion_product(turn, motion[:4])
        moved[9] = rate
        R_turn = rotation_matrix(turn)
        torque = R_turn @ wrench[:3]
        omega = np.array([0.0, 0.0, rate])
        torque_rate = np.cross(omega, torque)
        turning = LoadMotion.along(moved)
        torques = Taylor.of_rates(torque, torque_rate, np.cross(omega, torque_rate))
        force = Taylor([wrench[3:], force_rate, np.zeros(3)])
        expected = FlightTerms(turning, in_axes(torques, turning.axes), force, **others)
        series = zip((*found.motion, found.forces), (*turning, expected.forces), strict=True)
        for own, known in series:
            for order in range(3):
                np.testing.assert_allclose(own.rates[order][i], known.rates[order], atol=1e-12)
