"""Margins over a horizon, their gradients and slacks, and the data of plans."""

import functools

import numpy as np
import pytest
from helpers import Motion, difference
from plan_checks import (
    AT_REST,
    EXAMPLES,
    NO_LIMITS,
    NO_SHARES,
    PATTERNS,
    WIND,
    aircraft_problem,
    along,
    data_of,
    drawn_coefficients,
    example,
    expected_margins,
    expected_orbit_margins,
    motion_at,
    points_problem,
    reference_of,
)

from drake_nonstop.planning.limits import LIMITS as ROWS

BOUND = "airspeed"  # the name of the rows of the speed bound
ON_THE_WAY = ["cycle-5", "spread-7", "aircraft", "bowed"]
# Beside differences; bowed lines are known to four nodes over a window of time.
TOLERANCE = dict.fromkeys(PATTERNS, 1e-6) | {"aircraft": 2e-4, "bowed": 2e-3}


def coefficients_of(name):
    """Drawn; over the window of bowed lines fourth rates of a drawn plan jump."""
    problem = example(name)
    if name == "bowed":
        return 1 + np.linspace([0.0, 0.0], [0.05, -0.1], problem.count).T
    return drawn_coefficients(problem, 6)


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_gradients_of_all_margins_are_central_differences(name):
    problem, data = example(name), data_of(name)
    x = coefficients_of(name)
    found = problem.linearization(data, x)
    step = np.random.default_rng(5).normal(size=x.shape)
    slopes = difference(lambda h: problem.linearization(data, x + h * step).margins, 0.0, 1e-5)
    tolerance = 2e-5 if problem.shape is None else 1e-2  # on bowed cables by differences
    np.testing.assert_allclose(found.changes(step), slopes, rtol=tolerance, atol=tolerance)
    every = np.nonzero(np.ones(slopes.shape))
    rows = found.jacobian(every, 0)
    np.testing.assert_allclose(rows @ step.ravel(), found.changes(step).ravel(), atol=1e-9)
    part = np.r_[4 : problem.count, problem.count + 4 : 2 * problem.count]
    few = tuple(index[::17] for index in every)
    np.testing.assert_array_equal(found.jacobian(few, 4), rows[::17, part])


def require_margins(name, margins, expected):
    """Plans take the load's angular jerk and snap as zero, by which speeds between instants go."""
    is_bound = (example(name).names == BOUND) & (name in PATTERNS)
    for rows, tolerance in ((~is_bound, TOLERANCE[name]), (is_bound, 0.035)):
        np.testing.assert_allclose(margins[rows], expected[rows], tolerance, tolerance)


@pytest.mark.parametrize("name", ON_THE_WAY)
def test_margins_at_instants_are_those_of_carriers_on_the_plan(name):
    problem, data, reference = example(name), data_of(name), reference_of(name)
    x = coefficients_of(name)
    plan = problem.plan(data, x)
    margins = problem.linearization(data, x).margins
    for k in (0, 1, 30, 55, len(problem.instants) - 12):
        time = data.start_time + problem.instants[k]
        motion = motion_at(problem, reference, along(plan), time)
        half = problem.config.knot_spacing / problem.config.instants / 2
        expected = expected_margins(problem, motion, data.speed_bounds, half)
        require_margins(name, margins[:, k], expected)
        if problem.shape is None:
            wind = WIND if name == "aircraft" else 0 * WIND
            planned = plan.planned(time)[:, None]
            squares = problem.squared_speeds(planned, reference(time), wind)[:, 0]
            speeds = np.linalg.norm(motion.velocities, axis=1)
            np.testing.assert_allclose(squares, speeds**2, rtol=1e-6)


@pytest.mark.parametrize("name", ON_THE_WAY)
def test_margins_of_the_last_part_are_those_of_whole_orbits(name):
    """Of the plan's ξ and A at two instants of each of its last four intervals, kept."""
    problem, data, reference = example(name), data_of(name), reference_of(name)
    x = coefficients_of(name)
    plan, margins = problem.plan(data, x), problem.linearization(data, x).margins
    orbits = margins[:, len(problem.instants) :].reshape(len(margins), 8, -1)
    phases = orbits.shape[2]
    for orbit, phase in ((0, 3), (3, 17), (7, 0), (7, phases - 1)):
        time = plan.end_time - (7 - orbit) * problem.config.knot_spacing / 2
        _, xi, A = plan.planned(time)[:3]
        own = 2 * np.pi * phase / phases, xi, A
        expected = expected_orbit_margins(problem, reference, data.speed_bounds, own, time)
        require_margins(name, orbits[:, orbit, phase], expected)


@pytest.mark.parametrize("limit", ROWS, ids=lambda row: row.name)
def test_what_is_missed_has_the_name_of_its_row(limit):
    make, limits = (functools.partial(points_problem, "cycle-4"), NO_LIMITS)
    if limit.is_of_aircraft:
        make, limits = aircraft_problem, NO_SHARES
    value = {"least": 100.0, "largest": 0.01}["least" if limit.is_least else "largest"]
    for own, names in ((limits | {limit.field: value}, {limit.name}), (limits, set())):
        problem = make(**own)
        data = problem.data(0.0, 0.0, lambda time: AT_REST, 0.4)
        margins = problem.linearization(data, problem.nominal_coefficients()).margins
        assert problem.missed(margins, 1e-3) - {BOUND} == names


def test_slacks_are_those_of_the_bound_of_aircraft_and_of_others_in_each_interval():
    problem = example("aircraft")
    count, intervals = len(problem.instants), problem.intervals
    ends = problem.config.knot_spacing * np.arange(1, intervals + 1) + 1e-9
    weights = {}
    for row, name in enumerate(problem.names):
        kind = 0 if name == BOUND else 2 if name in ("lift", "bank", "climb", "thrust") else 1
        for column in (0, 25, count - 1, count, problem.points - 1):
            margins = np.full(problem.slacks.shape, 0.3)
            margins[row, column] = -0.7
            place = intervals  # of all orbits
            if column < count:
                place = np.searchsorted(ends, problem.instants[column])
            slacks = problem.least_slacks(margins)
            expected = 0.7 * np.eye(3 * (intervals + 1))[kind * (intervals + 1) + place]
            np.testing.assert_array_equal(slacks, expected)
            weights[kind, place < intervals] = slacks @ problem.slack_weights
    assert weights[0, False] > weights[0, True] > weights[1, True] == weights[2, True]
    assert problem.missed(np.full(problem.slacks.shape, np.nan), 1.0) == {*problem.names}


@pytest.mark.parametrize("name", ["cycle-5", "aircraft"])
def test_data_that_continue_the_last_are_those_made_anew(name):
    problem, asked = example(name), []

    def reference(time):
        asked.append(time)
        return Motion(2).reference(time)

    spacing, last = problem.config.knot_spacing, None
    # Nine of them at once, one in another wind, and then beyond what is known.
    for knot, wind in ((3, WIND), (4, WIND), (5, 0 * WIND), (6, WIND), (15, WIND), (80, WIND)):
        asked.clear()
        last = problem.data(knot * spacing, 0.1, reference, 0.5, last, wind)
        assert knot not in (4, 5, 6) or len(asked) == problem.config.instants
        anew = problem.data(knot * spacing, 0.1, reference, 0.5, wind=wind)
        for field, values in last._asdict().items():
            np.testing.assert_array_equal(values, getattr(anew, field))
