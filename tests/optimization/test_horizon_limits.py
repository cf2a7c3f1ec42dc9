"""Limits of plans: their gradients, what they keep, and what happens where they cannot be kept."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from helpers import Motion, difference, irregular, nightly_beyond, regular, spatial
from plan_checks import require_equal_plans, require_equal_steps

from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.mechanics.grasp import cable_forces_and_rates
from drake_nonstop.mechanics.planned_orbit import OrbitTerms, PlannedOrbit, planned_speeds
from drake_nonstop.mechanics.wrench import NO_FEEDBACK, wrench_and_rate
from drake_nonstop.model.pattern import (
    EllipticCarouselConfig,
    HamiltonianCycleConfig,
    SpreadCarouselConfig,
)
from drake_nonstop.model.system import Model, SystemParameters
from drake_nonstop.optimization.diagnostics import BOUND
from drake_nonstop.optimization.horizon_config import HorizonConfig
from drake_nonstop.optimization.horizon_motion import references_at
from drake_nonstop.optimization.horizon_problem import HorizonProblem
from drake_nonstop.optimization.horizon_solver import HorizonSolver
from drake_nonstop.optimization.limits import Of, limits_of
from drake_nonstop.optimization.problem_config import LimitsConfig
from drake_nonstop.optimization.separation import OrbitDistances

SMALL = HorizonConfig(
    horizon=4.0, knot_spacing=0.4, instants=10, terminal_phases=36, terminal_amplitudes=17
)
PATTERNS = {
    "cycle-3": (regular(3), HamiltonianCycleConfig()),
    "cycle-4": (irregular(4), HamiltonianCycleConfig()),
    "cycle-5": (spatial(5), HamiltonianCycleConfig()),
    "ellipse-6": (
        regular(6),
        EllipticCarouselConfig(spread=1.0, radial=1.2, tangential=0.7, vertical=0.3),
    ),
    "spread-7": (regular(7), SpreadCarouselConfig(spread=1.5)),
    "cycle-8": (irregular(8), HamiltonianCycleConfig()),
}


@functools.cache
def problem_of(name, **fields):
    attachments, pattern = PATTERNS[name]
    system = Model(SystemParameters(attachments=attachments.tolist()), pattern)
    fields = {"tightening": 0.02} | fields
    limits = LimitsConfig(speed_bound=0.4, amplitude=0.8, **fields)
    return HorizonProblem(system, limits, SMALL, lambda: name)


def limited(name):
    return problem_of(name, max_speed=2.0, min_tension=1.5, max_tension=6.0, min_separation=0.5)


@pytest.mark.parametrize(
    "limit", limits_of(Of.SPEED, Of.TENSION, Of.SEPARATION), ids=lambda row: row.name
)
def test_what_is_missed_has_the_name_of_its_row(limit):
    for beyond, names in ((True, {limit.name}), (False, set())):
        value = 100.0 if limit.is_least == beyond else 0.01
        problem = problem_of("cycle-4", **{limit.field: value})
        data = problem.data(0.0, 0.0, Motion(2).reference, 0.4)
        margins = problem.linearization(data, problem.nominal_coefficients()).margins
        assert problem.missed(margins, 1e-3) - {BOUND} == names


def drawn_coefficients(problem, seed):
    return 1 + 0.15 * np.random.default_rng(seed).normal(size=(2, problem.count))


@functools.cache
def moving_data(name):
    return limited(name).data(1.0, 0.3, Motion(2).reference, 0.4)


@pytest.mark.parametrize(
    "name",
    nightly_beyond(
        2, "studies", sorted(PATTERNS, key=lambda name: name not in ("cycle-5", "ellipse-6"))
    ),
)
def test_gradients_of_all_margins_are_central_differences(name):
    problem, data = limited(name), moving_data(name)
    x = drawn_coefficients(problem, 4)
    found = problem.linearization(data, x)
    step = np.random.default_rng(5).normal(size=x.shape)

    def margins(h):
        return problem.linearization(data, x + h * step).margins

    slopes = difference(margins, 0.0, 1e-5)
    rows = found.jacobian(np.arange(len(slopes)))
    np.testing.assert_allclose(rows @ step.ravel(), slopes, rtol=2e-5, atol=2e-5)
    np.testing.assert_allclose(found.changes(step), slopes, rtol=2e-5, atol=2e-5)
    few = np.arange(3, len(slopes), 17)
    free = problem.count - 4
    part = np.concatenate([np.arange(4, problem.count), problem.count + np.arange(4, 4 + free)])
    np.testing.assert_allclose(found.jacobian(few, 4), rows[few][:, part])


def commanded(problem, plan, reference, times):
    """Positions, velocities (k, n, 3) and tensions (k, n), as the loop's blocks command them."""
    system, found = problem.model, []
    for time in times:
        values, motion = plan.values(time), reference(time)
        angles = values.angle + system.pattern.phases
        internal = [
            values.amplitude * np.cos(angles),
            values.amplitude_rate * np.cos(angles)
            - values.amplitude * values.frequency * np.sin(angles),
        ]
        wrenches = wrench_and_rate(
            system.load, motion[:13], motion, np.zeros(6), feedforward=1.0, **NO_FEEDBACK
        )
        forces, rates = cable_forces_and_rates(
            motion,
            *wrenches,
            np.concatenate(internal),
            pseudo_inverse=system.pseudo_inverse,
            basis=system.pattern.basis,
            offset=system.pattern.offset,
        )
        found.append(
            [
                *carrier_motion(
                    motion,
                    forces,
                    rates,
                    attachments=system.attachments,
                    rest_length=problem.rest_length,
                    compliance=problem.compliance,
                ),
                forces,
            ]
        )
    positions, velocities, forces = (np.array(part) for part in zip(*found, strict=True))
    return positions, velocities, np.linalg.norm(forces, axis=-1)


def least_distances(positions):
    first, second = np.triu_indices(positions.shape[1], 1)
    return np.linalg.norm(positions[:, first] - positions[:, second], axis=-1)


def test_margins_are_those_of_what_the_blocks_command():
    name = "spread-7"
    problem, data = limited(name), moving_data(name)
    x = drawn_coefficients(problem, 6)
    plan, n = problem.plan(data, x), problem.model.n
    times = data.start_time + problem.instants
    positions, velocities, tensions = commanded(problem, plan, Motion(2).reference, times)
    squares = (velocities**2).sum(axis=-1)
    expected = [
        (squares - data.target_speeds**2) / (1.02 * 0.4) ** 2,
        1 - squares / (0.98 * 2.0) ** 2,
        (tensions / (1.02 * 1.5)) ** 2 - 1,
        1 - (tensions / (0.98 * 6.0)) ** 2,
        (least_distances(positions) / (1.02 * 0.5)) ** 2 - 1,
    ]
    every = np.concatenate(expected, axis=1)
    found = problem.linearization(data, x)
    table = found.margins[: every.size].reshape(every.shape)
    is_between = found.weights[:, : every.size].any(axis=0).reshape(every.shape)
    np.testing.assert_allclose(table[~is_between], every[~is_between], rtol=1e-7, atol=1e-9)
    assert np.all(table <= every + 1e-9)
    assert is_between[:, :n].any()
    # The minima between instants, on a grid four times as fine.
    fine = np.linspace(times[1], times[-2], 4 * (len(times) - 3) + 1)
    speeds = (commanded(problem, plan, Motion(2).reference, fine)[1] ** 2).sum(axis=-1)
    target_speeds = np.array([np.interp(fine, times, speed) for speed in data.target_speeds.T]).T
    least = (speeds - target_speeds**2).min(axis=0) / (1.02 * 0.4) ** 2
    np.testing.assert_allclose(table[1:-1, :n].min(axis=0), least, atol=5e-3)


def test_speeds_have_margins_of_their_own_after_jumps_of_the_jerk_and_beside_fast_orbits():
    still = references_at(Motion(0).reference, np.zeros(1))[0]
    still[7:] = 0
    jumping = still.copy()
    jumping[19:] = [1.0, -2.0, 0.5]  # the jerk, m/s³
    before = problem_of("cycle-4")
    config = replace(SMALL, overshoot=0.4, settling_time=0.1, orbit_tightening=0.0)
    problem = HorizonProblem(before.model, before.limits, config, lambda: "test")
    data = problem.data(0.0, 0.0, lambda time: still if time < 0.33 else jumping, 0.4)
    terms = OrbitTerms.view(problem.all_terms(np.array([still, jumping])))
    rates, tensions = terms.rates, np.linalg.norm(terms.forces[0], axis=-1)
    jumps = (problem.rest_length / tensions + problem.compliance) * np.linalg.norm(
        rates[1] - rates[0], axis=-1
    )
    is_after = (problem.instants > 0.33) & (problem.instants < 0.33 + 0.12)
    np.testing.assert_allclose(data.target_speeds[~is_after], 1.02 * 0.4)
    expected = np.broadcast_to(1.02 * 0.4 + 0.4 * jumps, data.target_speeds[is_after].shape)
    np.testing.assert_allclose(data.target_speeds[is_after], expected, rtol=1e-6)

    config = replace(SMALL, orbit_tightening=0.1)
    problem = HorizonProblem(before.model, before.limits, config, lambda: "test")
    slow = problem.data(0.0, 0.0, lambda time: still, 0.01)
    speeds = problem.speeds(slow, problem.nominal_coefficients())
    shares = (slow.target_speeds - 0.01) / speeds.max(axis=0)
    assert np.all((shares > 0.07) & (shares < 0.1))


@pytest.mark.parametrize("name", nightly_beyond(1, "studies", ["ellipse-6", "cycle-4"]))
def test_the_terminal_set_keeps_the_limits_at_all_phases(name):
    problem, data = limited(name), moving_data(name)
    system, terminal = problem.model, data.terminal
    k, j = 3, 9
    A = float(terminal.amplitudes[j])
    terms = OrbitTerms.view(data.flat_terms[problem.terminal_at[k], None])
    angles = np.linspace(0, 2 * np.pi, 721)

    def squares(s):
        shared = OrbitTerms(*(np.repeat(part, len(angles), axis=0) for part in terms))
        return planned_speeds(
            shared,
            problem.axes,
            PlannedOrbit.constant(angles, s / A, A),
            rest_length=problem.rest_length,
            compliance=problem.compliance,
        )

    least, most, others = terminal.at(np.full(len(problem.terminal_at), A))[0][:, k]
    assert np.sqrt(squares(least)[0].min()) == pytest.approx(1.02 * 0.4, rel=0.01)
    assert np.sqrt(squares(1.02 * least)[0].min()) > 1.02 * 0.4
    assert np.sqrt(squares(most)[0].max()) == pytest.approx(0.98 * 2.0, rel=0.01)
    tensions = np.sqrt(squares(1.0)[1])
    distances = OrbitDistances(problem.axes)
    apart = distances.least_squares(
        distances.every(),
        np.array([A]),
        terms.forces[0],
        system.attachments,
        rest_length=problem.rest_length,
        compliance=problem.compliance,
    )
    margin = min(
        (tensions.min() / 1.53) ** 2 - 1,
        1 - (tensions.max() / 5.88) ** 2,
        apart.min() / 0.51**2 - 1,
    )
    assert others == pytest.approx(margin, abs=2e-3)


def best_plan(problem, reference, bound):
    data = problem.data(0.0, 0.0, reference, bound)
    solver = HorizonSolver(problem)
    return data, solver.solve(data, solver.first_guess(data), max_iterations=30)


def resting(time):
    return np.array([1.0, *np.zeros(21)])


def pulled(time):
    """At rest, but for a push to and fro along x between 1 and 3 s, of 0.3 m/s² at most."""
    reference = resting(time)
    x = np.clip(time - 1, 0, 2) * np.pi
    reference[16] = 0.3 * np.sin(x) ** 3
    reference[19] = 0.9 * np.pi * np.sin(x) ** 2 * np.cos(x)
    return reference


@pytest.mark.parametrize(
    ("name", "limit", "value"),
    [
        ("max_speed", "most", 0.83),
        ("min_tension", "least", 1.562),
        ("max_tension", "most", 2.705),
        ("min_separation", "least", 0.8428),
    ],
)
def test_a_plan_keeps_a_limit_that_the_plan_without_it_exceeds(name, limit, value):
    def extreme(problem):
        _, answer = best_plan(problem, pulled, 0.4)
        assert answer.is_feasible
        times = np.linspace(0.02, 3.98, 60)
        positions, velocities, tensions = commanded(problem, answer.plan, pulled, times)
        speeds = np.linalg.norm(velocities, axis=-1)
        assert speeds.min() > 0.4
        quantity = {
            "max_speed": speeds,
            "min_tension": tensions,
            "max_tension": tensions,
            "min_separation": least_distances(positions),
        }[name]
        return quantity.min() if limit == "least" else quantity.max()

    free = extreme(problem_of("spread-7", tightening=0.002))
    kept = extreme(problem_of("spread-7", tightening=0.002, **{name: value}))
    assert (free < value <= kept) if limit == "least" else (free > value >= kept)


def test_rates_keep_their_limits_at_all_times():
    limits = {"max_frequency_rate": 0.1, "max_amplitude_rate": 0.05}
    problem = problem_of("cycle-4", **limits)
    _, answer = best_plan(problem, pulled, 0.8)
    values = np.array([answer.plan.values(time) for time in np.linspace(0, 4, 200)])
    assert np.abs(values[:, 3]).max() <= 0.1 + 1e-6
    assert np.abs(values[:, 4]).max() <= 0.05 + 1e-6
    free = best_plan(problem_of("cycle-4"), pulled, 0.8)[1]
    values = np.array([free.plan.values(time) for time in np.linspace(0, 4, 200)])
    assert np.abs(values[:, 3]).max() > 0.1
    assert np.abs(values[:, 4]).max() > 0.05


def test_without_a_bound_the_plan_returns_to_the_nominal_parameters():
    problem = problem_of("cycle-5")
    data = problem.data(0.0, 0.0, pulled, 0.0)
    solver = HorizonSolver(problem)
    start = np.full((2, problem.count), 1.2)
    answer = solver.solve(data, start, max_iterations=6)
    assert answer.converged
    assert answer.slack == 0
    assert answer.cost < problem.cost(start) / 5
    np.testing.assert_allclose(answer.coefficients[:, -4:], 1.0, atol=0.01)


def test_a_start_below_the_bound_is_left_as_soon_as_the_rates_allow():
    problem = problem_of("cycle-4")
    data = problem.data(0.0, 0.0, resting, 1.0)
    speeds = problem.speeds(data, problem.nominal_coefficients())
    assert speeds.max() < 1.0
    solver = HorizonSolver(problem)
    start = problem.nominal_coefficients()
    answer = solver.solve(data, start, max_iterations=20, tolerance=1e-4)
    assert np.isfinite(answer.coefficients).all()
    assert not answer.is_feasible
    slowest = problem.speeds(data, answer.coefficients).min(axis=1)
    is_slow = slowest < 1.0
    late = problem.instants[is_slow].max()
    assert late < 1.0
    assert problem.slacks(problem.linearization(data, answer.coefficients).margins)[3:].max() < 1e-3


def test_limits_that_exclude_each_other_give_a_finite_plan_that_prefers_the_speed_bound():
    problem = problem_of("cycle-4", max_speed=0.9)
    data = problem.data(0.0, 0.0, pulled, 0.8)
    solver = HorizonSolver(problem)
    answer = solver.solve(data, solver.first_guess(data), max_iterations=20)
    assert np.isfinite(answer.coefficients).all()
    squares = problem.speeds(data, answer.coefficients)[30:] ** 2
    below = 1 - squares.min() / (1.02 * 0.8) ** 2
    above = squares.max() / (0.98 * 0.9) ** 2 - 1
    assert above > max(below, 1e-3)


def test_entries_of_the_tables_are_those_of_the_whole_terminal_set():
    problem, terminal = limited("cycle-4"), moving_data("cycle-4").terminal
    expected = problem.terminal_set(
        terminal.flat_terms, terminal.bounds[:, :, None], terminal.amplitudes
    )
    for j, amplitude in enumerate(terminal.amplitudes[:-1]):
        found, slopes = terminal.at(np.full(len(terminal.bounds), amplitude))
        for limits, slope, table in zip(found, slopes, expected[1:], strict=True):
            np.testing.assert_allclose(limits, table[:, j], rtol=1e-9)
            at_next = limits + slope * terminal.spacing
            np.testing.assert_allclose(at_next, table[:, j + 1], rtol=1e-9)


@pytest.mark.parametrize("name", ["cycle-3", "cycle-8"])
def test_plans_in_c_are_those_in_python(name):
    require_equal_plans(limited(name), moving_data(name))


def test_all_solvers_find_the_same_steps():
    require_equal_steps(limited("cycle-3"), moving_data("cycle-3"))


@pytest.mark.parametrize("compiles", [True, False])
def test_a_plan_that_is_no_number_is_said(compiles):
    solver = HorizonSolver(limited("cycle-3"), compiles=compiles)
    with pytest.raises(ArithmeticError, match="not finite"):
        solver.solve(moving_data("cycle-3"), np.full((2, solver.problem.count), np.nan))
