"""Plans of aircraft: against the motion that is flown, the margins at rest and differences."""

import functools
import math

import numpy as np
import pytest
from helpers import Motion, difference, model
from plan_checks import require_equal_plans, require_equal_steps

from drake_nonstop.analysis.aircraft_margins import margins_at_rest
from drake_nonstop.blocks.lumped_cables import material_of
from drake_nonstop.mechanics.aircraft import (
    flight_needs,
    needed_force,
    stall_factor,
    thrust_limits,
)
from drake_nonstop.mechanics.bowed_line import TimeWindow, bowed_lines
from drake_nonstop.mechanics.bowed_orbit import CableShape
from drake_nonstop.mechanics.wind import MeanWind
from drake_nonstop.mechanics.wrench import NO_FEEDBACK, wrench_and_rate
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.model.pattern import EllipticCarouselConfig
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.optimization import horizon_solver
from drake_nonstop.optimization.horizon_config import HorizonConfig
from drake_nonstop.optimization.horizon_problem import HorizonProblem
from drake_nonstop.optimization.horizon_solver import PLAN_TOLERANCE, HorizonSolver
from drake_nonstop.optimization.problem_config import LimitsConfig

WINDOW = TimeWindow.of(0.75, 9)
WIND = np.array([1.6, -0.7, 0.2])
SHARES = {"max_lift_share": 0.9, "max_bank": 0.75, "max_climb": 0.5, "max_thrust_share": 0.95}
TIGHTENING = 0.02
BOUND = 12.0  # m/s
CORNERS = [[1.5, 0.0, 0.0], [0.0, 1.5, 0.0], [-1.5, 0.0, 0.0], [0.0, -1.5, 0.0]]
AT_REST = np.concatenate([[1.0], np.zeros(21)])


def slow(reference):
    """A reference that moves as aircraft do: all of it in slow motion, but as far."""

    def at(time):
        return reference(0.05 * time) * 0.05 ** np.repeat([0, 1, 2, 3], [7, 6, 6, 3])

    return at


MOVING = slow(Motion(2).reference)


@functools.cache
def problem_of(fixed_coefficients=4, is_bowed=False, **limits):
    system = SystemParameters(
        load_mass=10.0,
        load_inertia=[[5.6, 0.2, 0.1], [0.2, 5.1, 0.0], [0.1, 0.0, 9.2]],
        load_drag=0.6,
        attachments=CORNERS,
        cable_length=150.0,
        cable_stiffness=120.0,
        aircraft=AircraftParameters(model="rascal_110"),
    )
    carousel = EllipticCarouselConfig(
        spread=6.75, phase_turns=2, radial=3.3, tangential=4.5, vertical=4.9
    )
    own = {"frequency": 0.595, "amplitude": 1.0, "amplitude_bounds": [0.6, 1.6]}
    config = LimitsConfig(speed_bound=BOUND, tightening=TIGHTENING, **own, **limits)
    horizon = HorizonConfig(instants=10, fixed_coefficients=fixed_coefficients)
    model = Model(system, carousel)
    shape = CableShape(4, WINDOW, material_of(model)) if is_bowed else None
    return HorizonProblem(model, config, horizon, lambda: "flight", shape=shape)


def limited():
    return problem_of(**SHARES)


def bowed():
    return problem_of(is_bowed=True, **SHARES)


@functools.cache
def moving_data(problem):
    return problem.data(1.0, 0.3, MOVING, BOUND, wind=WIND)


def drawn_coefficients(problem, seed, size=0.1):
    return 1 + size * np.random.default_rng(seed).normal(size=(2, problem.count))


def test_gradients_of_all_margins_are_central_differences():
    problem, data = limited(), moving_data(limited())
    x = drawn_coefficients(problem, 8)
    found = problem.linearization(data, x)
    step = np.random.default_rng(5).normal(size=x.shape)
    slopes = difference(lambda h: problem.linearization(data, x + h * step).margins, 0.0, 1e-5)
    rows = found.jacobian(np.arange(len(slopes)))
    np.testing.assert_allclose(rows @ step.ravel(), slopes, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found.changes(step), slopes, rtol=1e-4, atol=1e-4)


def positions_and_forces(problem, plan, time):
    """Of the carriers (n, 3) at a time in s, from the plan's values alone."""
    system, reference = problem.model, MOVING(time)
    values = plan.values(time)
    wrench, _ = wrench_and_rate(
        system.load,
        reference[:13],
        reference,
        np.zeros(6),
        WIND,
        feedforward=1.0,
        **NO_FEEDBACK,
    )
    w, x, y, z = reference[:4]
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    internal = values.amplitude * np.cos(values.angle + system.pattern.phases)
    own = np.concatenate([R.T @ wrench[:3], R.T @ wrench[3:]])
    forces = system.pseudo_inverse @ own + system.pattern.offset + system.pattern.basis @ internal
    forces = forces.reshape(-1, 3) @ R.T
    tension = np.linalg.norm(forces, axis=1, keepdims=True)
    reach = problem.rest_length / tension + problem.compliance
    return reference[4:7] + system.attachments @ R.T + reach * forces, forces


def straight_motion(problem, plan, time):
    """Velocities, accelerations and forces of the cables (n, 3) each, by differences."""
    step = 2e-3
    before, now, after = (
        positions_and_forces(problem, plan, time + shift) for shift in (-step, 0.0, step)
    )
    acceleration = (after[0] - 2 * now[0] + before[0]) / step**2
    return (after[0] - before[0]) / (2 * step), acceleration, now[1]


def bowed_motion_of_lines(problem, plan, time):
    """The same at the upper ends of lines."""
    forces, ends = [], []
    for at in time + WINDOW.times:
        carriers, own = positions_and_forces(problem, plan, at)
        tension = np.linalg.norm(own, axis=1, keepdims=True)
        ends.append(carriers - (problem.rest_length / tension + problem.compliance) * own)
        forces.append(own)
    cable = {"cable": problem.shape.cable, "nodes": problem.shape.nodes}
    lines = bowed_lines(np.array(forces), np.array(ends), WIND, WINDOW, **cable)
    _, velocity, acceleration, _ = WINDOW.at_present(lines.ends)
    return velocity, acceleration, lines.forces[len(WINDOW.times) // 2]


@pytest.mark.parametrize(
    ("make", "motion", "tolerance"),
    [(limited, straight_motion, 2e-4), (bowed, bowed_motion_of_lines, 2e-3)],
)
def test_margins_are_those_of_the_exact_inverse_on_the_path_that_is_flown(make, motion, tolerance):
    problem, data = make(), moving_data(make())
    x = drawn_coefficients(problem, 6)
    aircraft = problem.model.aircraft
    if make is bowed:  # over the window of its lines fourth rates of a drawn plan jump
        x = 1 + np.linspace([0.0, 0.0], [0.05, -0.1], problem.count).T
        aircraft = aircraft._replace(cable_drag=0.0)
    plan = problem.plan(data, x)
    found = problem.linearization(problem.bowed(data, x), x)
    all_expected = {}
    n = problem.model.n
    every = np.arange(len(problem.instants))
    tables = (every, n), (problem.flight_at, 5 * n)
    for i in problem.flight_at[[1, 9, 23, 36]]:
        time = data.start_time + problem.instants[i]
        velocity, acceleration, pull = motion(problem, plan, time)
        force = needed_force(aircraft, acceleration, pull)
        told = flight_needs(aircraft, force, velocity - WIND)
        air = velocity - WIND
        airspeed = np.linalg.norm(air, axis=1)
        climb = np.arcsin(air[:, 2] / airspeed)
        bank, thrust = told.bank, told.thrust
        shares = {name: (1 - TIGHTENING) * share for name, share in SHARES.items()}
        least, most = thrust_limits(aircraft, airspeed)
        middle, half = (most + least) / 2, shares["max_thrust_share"] * (most - least) / 2
        weight = aircraft.mass * aircraft.gravity
        factor = stall_factor(aircraft, shares["max_lift_share"])
        all_expected[i] = (
            (airspeed**2 - data.target_speeds[i] ** 2) / ((1 + TIGHTENING) * BOUND) ** 2,
            np.concatenate(
                [
                    1 - np.linalg.norm(force, axis=1) / (factor * airspeed**2),
                    1 - (bank / shares["max_bank"]) ** 2,
                    1 - (climb / shares["max_climb"]) ** 2,
                    (middle + half - thrust) / weight,
                    (thrust - middle + half) / weight,
                ]
            ),
        )
    start = 0
    for kind, (instants, width) in enumerate(tables):
        part = np.s_[start : start + len(instants) * width]
        margins = found.margins[part].reshape(-1, width)
        is_instant = ~found.weights[:, part].reshape(3, -1, width).any(axis=0)
        assert is_instant.mean() > 0.8
        for i, expected in all_expected.items():
            k = np.searchsorted(instants, i)
            chosen = is_instant[k]
            np.testing.assert_allclose(
                margins[k, chosen], expected[kind][chosen], tolerance, tolerance
            )
        start += len(instants) * width


@pytest.mark.parametrize("parameters", [(0.595, 1.0), (0.68, 0.85)])
def test_margins_of_the_last_part_are_those_of_whole_orbits_above_a_resting_load(
    parameters,
):
    """Against margins that are evaluated at 720 phases of positions' exact derivatives."""
    problem = limited()
    data = problem.data(0.0, 0.0, lambda time: AT_REST, BOUND, wind=WIND)
    x = np.tile((np.array(parameters) / problem.nominal)[:, None], problem.count)
    found = problem.linearization(data, x)
    shape = problem.config.terminal_knots, problem.config.terminal_phases, 5, problem.model.n
    worst = found.margins[-math.prod(shape) :].reshape(shape).min(axis=(0, 1, 3))
    expected = margins_at_rest(
        problem.model, AT_REST, np.array(parameters), wind=MeanWind(WIND)
    ).needs
    aircraft = problem.model.aircraft
    shares = {name: (1 - TIGHTENING) * share for name, share in SHARES.items()}
    least, most = thrust_limits(aircraft, expected.airspeed)
    middle, half = (most + least) / 2, shares["max_thrust_share"] * (most - least) / 2
    weight = aircraft.mass * aircraft.gravity
    # The lift is limited by the norm of the whole force, which is stricter by some percent.
    lift = 1 - (expected.lift / (shares["max_lift_share"] * aircraft.max_lift)).max()
    assert lift - 0.05 < worst[0] < lift + 0.005
    others = [
        1 - (np.abs(expected.bank).max() / shares["max_bank"]) ** 2,
        1 - (np.abs(expected.climb).max() / shares["max_climb"]) ** 2,
        (middle + half - expected.thrust).min() / weight,
        (expected.thrust - middle + half).min() / weight,
    ]
    np.testing.assert_allclose(worst[1:], others, atol=0.015)


def test_wind_does_not_count_for_carriers_that_are_no_aircraft():
    limits = LimitsConfig(speed_bound=0.4)
    problem = HorizonProblem(model(), limits, HorizonConfig(instants=4), lambda: "points")
    reference = Motion(2).reference
    still, windy = (problem.data(1.0, 0.3, reference, 0.4, wind=w) for w in (0 * WIND, WIND))
    np.testing.assert_array_equal(still.flat_terms, windy.flat_terms)
    amplitudes = np.linspace(0.5, 1.5, len(problem.terminal_at))
    for part, other in zip(
        still.terminal.at(amplitudes), windy.terminal.at(amplitudes), strict=True
    ):
        np.testing.assert_array_equal(part, other)


def test_data_of_another_wind_are_made_anew():
    problem = limited()
    spacing = problem.config.knot_spacing
    first = problem.data(0.0, 0.1, MOVING, BOUND, wind=0 * WIND)
    for wind, is_known in ((WIND, False), (0 * WIND, True)):
        last = problem.data(spacing, 0.1, MOVING, BOUND, first, wind)
        anew = problem.data(spacing, 0.1, MOVING, BOUND, wind=wind)
        for part in ("flat_terms", "flat_flight"):
            np.testing.assert_array_equal(getattr(last, part), getattr(anew, part))
        known = first.flat_flight[len(first.flat_flight) // problem.intervals :]
        assert np.array_equal(last.flat_flight[: len(known)], known) == is_known


@pytest.mark.parametrize(
    ("limit", "kind", "wind"),
    [
        ({"max_lift_share": 0.5}, "lift", 0.0),
        ({"max_bank": 0.525}, "bank", 0.0),
        ({"max_climb": 0.3}, "climb", 0.0),
        ({"max_thrust_share": 0.5}, "thrust", 0.0),
    ],
)
def test_a_plan_keeps_a_limit_that_the_first_parameters_do_not(limit, kind, wind):
    problem = problem_of(fixed_coefficients=0, **limit)
    data = problem.data(0.0, 0.0, lambda time: AT_REST, 10.0, wind=wind * WIND)
    start = problem.nominal_coefficients()
    assert problem.missed(problem.linearization(data, start).margins, PLAN_TOLERANCE) == {kind}
    answer = HorizonSolver(problem).solve(data, start, max_iterations=20)
    assert answer.is_feasible
    margins = problem.linearization(data, answer.coefficients).margins
    assert problem.missed(margins, PLAN_TOLERANCE) == set()


def test_limits_that_no_plan_keeps_are_told():
    problem = problem_of(max_lift_share=0.3, max_bank=0.2)
    data = problem.data(0.0, 0.0, lambda time: AT_REST, 25.0)
    margins = problem.linearization(data, problem.nominal_coefficients()).margins
    assert problem.missed(margins, PLAN_TOLERANCE) == {"airspeed", "lift", "bank"}


def test_plans_in_c_and_steps_of_all_solvers_are_those_in_python():
    require_equal_plans(limited(), moving_data(limited()))
    require_equal_steps(limited(), moving_data(limited()))


def apart():
    return problem_of(is_bowed=True, min_separation=12.0, max_speed=26.0, **SHARES)


def test_plans_on_bowed_cables_in_c_are_those_in_python(monkeypatch):
    monkeypatch.setattr(horizon_solver, "_MOST_BOWS", 1)  # later ones begin with other digits
    require_equal_plans(apart(), moving_data(apart()))


def test_losses_on_bowed_cables_are_known_to_first_order():
    """Along plans whose parameters change over a turn; the distances that carriers lose, too."""
    problem, data = apart(), moving_data(apart())
    x = np.ones((2, problem.count))
    losses = problem.bowed(data, x).losses
    for row, size in ((0, 0.004), (1, 0.01)):
        other = x.copy()
        other[row] += size * np.sin(np.pi / 4 * np.arange(problem.count))
        change = problem.bowed(data, other).losses.values - losses.values
        told = losses.at(problem.orbit(data, other), problem.layout.instants) - losses.values
        for name in dict.fromkeys(problem.layout.names):
            own = problem.layout.names == name
            assert np.abs(told - change)[own].mean() < 0.3 * np.abs(change[own]).mean(), name
