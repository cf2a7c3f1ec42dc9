"""Updates within the limits of aircraft: prediction, search, and what wind does to both."""

import functools
import math

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.solvers import ClarabelSolver, MathematicalProgram

from drake_nonstop.analysis.aircraft_margins import margins_at_rest
from drake_nonstop.analysis.flight_envelope import FlightEnvelope
from drake_nonstop.blocks.optimization_layer import NonstopOptimizerConfig
from drake_nonstop.mechanics.aircraft import stall_speed
from drake_nonstop.mechanics.wind import MeanWind
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.model.pattern import EllipticCarouselConfig
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.optimization.diagnostics import Outcome
from drake_nonstop.optimization.flight_search import nearest_in_polygon
from drake_nonstop.optimization.local_solver import LocalSolver
from drake_nonstop.optimization.update_solver import UpdateSolver

CORNERS = [[1.5, 0.0, 0.0], [0.0, 1.5, 0.0], [-1.5, 0.0, 0.0], [0.0, -1.5, 0.0]]
START = np.array([0.595, 1.0])
LIMITS = {"max_lift_share": 0.9, "max_bank": math.radians(50), "max_thrust_share": 1.0}


@functools.cache
def aircraft_model():
    system = SystemParameters(
        load_mass=10.0,
        load_inertia=[[5.6, 0.0, 0.0], [0.0, 5.6, 0.0], [0.0, 0.0, 11.2]],
        load_drag=0.6,
        attachments=CORNERS,
        cable_length=150.0,
        cable_stiffness=120.0,
        aircraft=AircraftParameters(model="rascal_110"),
    )
    carousel = EllipticCarouselConfig(
        spread=6.75, phase_turns=2, radial=3.3, tangential=4.5, vertical=4.9
    )
    return Model(system, carousel)


@functools.cache
def aircraft_solver(**fields):
    """All phases of the orbit at each update, so that at rest nothing is left out."""
    config = NonstopOptimizerConfig(
        frequency=START[0],
        amplitude=START[1],
        tightening=0.0,
        look_ahead_points=1,
        orbit_points=8,
        orbit_updates=1,
        speed_bound=10.0,
        **fields,
    )
    return UpdateSolver(aircraft_model(), config, lambda: "optimization_layer")


def resting(solver, bound, wind=(0.0, 0.0, 0.0), previous=START, angle=0.3):
    """The data of an update above a load that rests in the wind."""
    wind = np.array(wind)
    reference = np.eye(22)[0]
    wrench = np.concatenate([np.zeros(3), [0, 0, 98.1] - 0.6 * wind])
    still = np.zeros(6)
    return solver.update_data(
        previous,
        np.array([angle, 0.0]),
        reference[:13],
        reference,
        wrench,
        still,
        still,
        bound,
        wind=wind,
    )


def exact_margins(x, wind=(0.0, 0.0, 0.0)):
    """The margins of the whole orbit at rest, by name, from its exact motion in time."""
    speed = FlightEnvelope(lift_share=0.9, speed_share=1.2)
    found = margins_at_rest(
        aircraft_model(), np.eye(22)[0], x, wind=MeanWind(np.array(wind)), limits=speed
    )
    return {(margin.name, margin.is_upper): margin for margin in found.margins}


def test_the_nearest_point_of_a_polygon_is_that_of_a_quadratic_program():
    found = [assert_nearest(np.random.default_rng(seed)) for seed in range(30)]
    assert {True, False} == set(found)


def assert_nearest(rng):
    """Whether there is one: some polygons are empty."""
    normals = rng.normal(size=(rng.integers(1, 12), 2))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets, point = rng.normal(size=len(normals)) - 0.3, 2 * rng.normal(size=2)
    program = MathematicalProgram()
    z = program.NewContinuousVariables(2)
    program.AddQuadraticErrorCost(np.eye(2), point, z)
    program.AddLinearConstraint(normals, offsets, np.full(len(offsets), np.inf), z)
    expected = ClarabelSolver().Solve(program)
    found = nearest_in_polygon(point, normals, offsets)
    assert (found is not None) == expected.is_success()
    if found is not None:
        np.testing.assert_allclose(found, expected.GetSolution(z), atol=1e-5)
    return found is not None


def test_predicted_speeds_and_limits_at_rest_in_wind_are_those_of_the_exact_orbit():
    solver, wind = aircraft_solver(**LIMITS), (2.0, -1.0, 0.0)
    problem = solver.problem(resting(solver, 10.0, wind))
    exact = exact_margins(START, wind)
    least = exact["airspeed / stall speed", False].value * stall_speed(aircraft_model().aircraft)
    assert problem.slowest_speed(START) == pytest.approx(least, rel=0.02)  # 45 degrees apart
    assert problem.slowest_speed(START) >= least - 1e-9
    margins = problem.margins(START)[problem.speed_count :].reshape(4, -1).min(axis=1)
    bank = exact["bank", True].value / LIMITS["max_bank"]
    assert 1 - margins[1] == pytest.approx(bank**2, rel=0.1)
    weight = 6.0 * 9.81
    for found, is_upper in ((margins[2], True), (margins[3], False)):
        assert found * weight == pytest.approx(exact["thrust", is_upper].margin, abs=1.5)


def test_wind_moves_the_bound_on_the_airspeed_only():
    """Without limits the search by intervals keeps it; the wrench has the drag in the wind."""
    solver, wind = aircraft_solver(), (0.0, 3.0, 0.0)
    x, outcome, slowest = solver.solve(resting(solver, 12.0, wind))
    assert outcome == Outcome.SOLVED
    assert slowest == pytest.approx(12.0, rel=1e-5)
    exact = exact_margins(x, wind)["airspeed / stall speed", False]
    speed = exact.value * stall_speed(aircraft_model().aircraft)
    assert 0.97 * 12.0 < speed <= slowest + 1e-9
    assert solver.solve(resting(solver, 12.0))[1] == Outcome.KEPT


def test_a_load_that_drifts_with_the_wind_is_one_that_rests_in_still_air():
    solver, drift = aircraft_solver(**LIMITS), np.array([2.0, -1.0, 0.5])
    still = resting(solver, 12.0)
    state, reference = still.load_state.copy(), still.reference.copy()
    state[10:13] = reference[10:13] = drift
    drifting = still._replace(load_state=state, reference=reference, wind=drift)
    expected = solver.problem(still).margins(START)
    np.testing.assert_allclose(solver.problem(drifting).margins(START), expected, atol=1e-12)
    against = solver.problem(drifting._replace(wind=-drift)).margins(START)
    assert np.abs(against - expected).max() > 0.1


def test_gradients_of_the_margins_are_central_differences():
    solver = aircraft_solver(**LIMITS)
    problem = solver.problem(resting(solver, 12.0, (2.0, 1.0, 0.0)))
    _, jacobian = problem.margins_and_jacobian(START)
    step = 1e-5
    for i, unit in enumerate(np.eye(2)):
        up, down = (problem.margins_and_jacobian(START + s * unit)[0] for s in (step, -step))
        np.testing.assert_allclose(jacobian[:, i], (up - down) / (2 * step), atol=1e-6)


@pytest.mark.parametrize(
    ("bound", "wind"), nightly_beyond(1, "studies", [(12.0, 2.0), (14.3, 0.0), (13.0, 1.0)])
)
def test_the_search_within_limits_is_as_good_as_another_solver(bound, wind):
    solver = aircraft_solver(**LIMITS)
    data = resting(solver, bound, (wind, 0.0, 0.0))
    problem, found = solver.problem(data), solver.solve(data)
    assert found.outcome == Outcome.SOLVED
    functions = solver.functions(with_gradients=True)
    other = LocalSolver("snopt", *functions, problem.speed_count, solver.data_size)
    expected = other.nearest(START, problem.vector, *problem.bounds)
    assert problem.is_feasible(expected)
    assert problem.cost(found.parameters) <= 1.001 * problem.cost(expected)
    np.testing.assert_allclose(found.parameters, expected, rtol=1e-3)


def test_what_cannot_be_kept_is_told_and_the_speed_comes_first():
    """At 17 m/s everywhere the thrust of some is too small, or their bank too large."""
    solver = aircraft_solver(**LIMITS)
    data = resting(solver, 17.5, (3.0, 0.0, 0.0))
    found = solver.solve(data)
    problem = solver.problem(data)
    assert found.outcome in (Outcome.RELAXED, Outcome.HELD)
    missed = problem.missed_kinds(found.parameters)
    assert missed
    assert set(missed) <= {"airspeed", "lift", "bank", "thrust"}
    assert found.slowest_speed > problem.slowest_speed(START)
