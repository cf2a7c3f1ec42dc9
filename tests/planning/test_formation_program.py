"""The program that designs formations, beside closed forms."""

import dataclasses
import math

import numpy as np
import pytest

from drake_nonstop.mechanics.aircraft import stall_speed, thrust_limits
from drake_nonstop.mechanics.formation_orbit import CarriedLoad
from drake_nonstop.model.aircraft import AircraftParameters, make_aircraft
from drake_nonstop.planning.formation_program import (
    CO_ROTATING,
    KINDS,
    LEANING,
    FormationProgram,
    FormationTask,
    FormationVariables,
    LoadMotion,
    Margin,
)
from drake_nonstop.planning.limits import Of, limits_of

GRAVITY, MASS, N, RADIUS = 9.81, 10.0, 4, 1.5
X = np.eye(3)[0]
MARGINS = (
    Margin("lift", "lift", -1, 0.9, 0.1),
    Margin("airspeed", "airspeed", 1, 1.2, 0.05),
    Margin("bank", "bank", -1, math.radians(50), 0.1),
    Margin("bank", "bank", 1, -math.radians(50), 0.1),
    Margin("climb", "climb", -1, 0.5, 0.05),
    Margin("climb", "climb", 1, -0.5, 0.05),
    Margin("thrust_above", "thrust_above", 1, 0.0, 0.1),
    Margin("thrust_below", "thrust_below", 1, 0.0, 0.1),
)
# All limits of aircraft that can be asked for, where the needs are on their way to them.
EVERY = tuple((limit, 0.6 * min(limit.largest, 30.0)) for limit in limits_of(Of.FLIGHT))
# Without lift at no angle, and with an angle of attack of none: T acts along the path.
STRAIGHT = {"lift_at_zero_angle": 0.0, "lift_slope": 1e9}


def task(*motions, asked=(), wind=0 * X, **aircraft):
    parameters = AircraftParameters(model="rascal_110", **aircraft)
    motions = (LoadMotion(0 * X, 0 * X), *motions)
    return FormationTask(
        aircraft=make_aircraft(parameters, cable_length=100.0, gravity=GRAVITY),
        load=CarriedLoad(MASS, 0.6, GRAVITY, N, RADIUS, 0.0),
        wind=wind,
        motions=motions,
        way=motions,
        margins=MARGINS,
        asked=asked,
        separation=8.0,
        carrier_distance=0.05,
    )


def needs_at(given, kind, values, phases, motion=0):
    program, x = FormationProgram(given, kind, 2), FormationVariables(*values)
    return program.quantities(x, given.angles(kind, phases), given.way[motion])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("asked", [(), EVERY], ids=["own", "asked"])
def test_gradients_are_central_differences(kind, asked):
    given = task(LoadMotion(X, 0.2 * X, 0.1 * X, -0.05 * X), asked=asked, wind=2 * X)
    program = FormationProgram(given, kind, 2, phases=3)
    point = np.array([0.3, 0.15, 0.2, 0.1, 0.6, 150.0, 0.5])
    _, gradients, _, power_gradient = program.rows(point)
    for i in range(len(point) - 1):
        step = 1e-5 * max(1.0, point[i])
        ends = [program.rows(point + sign * step * np.eye(7)[i]) for sign in (1, -1)]
        expected = (ends[0][0] - ends[1][0]) / (2 * step)
        np.testing.assert_allclose(gradients[:, i], expected, rtol=1e-4, atol=1e-5)
        expected = (ends[0][2] - ends[1][2]) / (2 * step)
        assert power_gradient[i] == pytest.approx(expected, rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("gust", [0.0, 1.0])
def test_the_least_rows_are_those_of_numbers_at_many_phases_at_once(kind, gust):
    motion = LoadMotion(X, 0.2 * X, 0.1 * X, -0.05 * X)
    given = dataclasses.replace(task(motion, asked=EVERY, wind=2 * X), gust=gust)
    program = FormationProgram(given, kind, 2, phases=8)
    values = np.array([0.3, 0.15, 0.2, 0.1, 0.6, 150.0, 0.5])
    rows = program.rows(values)[0]
    assert rows.min() == pytest.approx(program.on_way(values, phases=8).min(), rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_rows_are_the_distances_to_the_limits_over_their_margins(kind):
    given = task(LoadMotion(X, 0.2 * X, 0.1 * X, -0.05 * X), wind=2 * X)
    values = [0.3, 0.15, 0.2, 0.1, 0.6, 150.0, 0.5]
    if kind == CO_ROTATING:
        values[1:4] = [0.0, 0.0, 0.0]
    needs, found = needs_at(given, kind, values, 3, motion=1)
    plane = given.aircraft._replace(cable_length=150.0)
    least, most = thrust_limits(plane, needs.airspeed)
    for name, expected in (
        ("lift", needs.lift / plane.max_lift),
        ("airspeed", needs.airspeed / stall_speed(plane)),
        ("thrust_above", (most - needs.thrust) / (most - least)),
        ("thrust_below", (needs.thrust - least) / (most - least)),
    ):
        np.testing.assert_allclose(found[name], expected, rtol=1e-9, atol=1e-9)
    assert Margin("lift", "C_L", -1, 0.9, 0.1).kept(0.85) == pytest.approx(0.5)
    assert Margin("lift", "C_L", -1, 0.9, 0.1).sentence(0.5) == "C_L 0.85 (at most 0.8)"


def closed_form(plane, outward, rate, length):
    """Level circles that turn with the load: C_L, bank, thrust, airspeed, distance."""
    share, ratio = MASS * GRAVITY / N, MASS / (N * plane.mass)
    half_cone = np.arctan(outward)
    radius = RADIUS + length * np.sin(half_cone)
    speed = rate * radius
    bank = np.arctan((speed**2 / (GRAVITY * radius) - ratio * np.tan(half_cone)) / (1 + ratio))
    pressure = plane.air_density / 2 * speed**2 * plane.wing_area
    held = plane.mass * GRAVITY + share
    lift = held / (pressure * np.cos(bank))
    parasitic = plane.zero_lift_drag + 1.1 * 0.001 * length / (4 * plane.wing_area)
    thrust = pressure * parasitic + plane.induced_drag * pressure * lift**2
    return lift, bank, thrust, speed, 2 * radius * math.sin(math.pi / N)


def test_co_rotating_circles_are_those_of_the_closed_form():
    given = task(**STRAIGHT)
    values = [1.2, 0, 0, 0, 0.4, 60.0, 0.0]
    program = FormationProgram(given, CO_ROTATING, phases=5)
    found, quantities = needs_at(given, CO_ROTATING, values, 5)
    np.testing.assert_allclose(quantities["share"], 1.0)
    lift, bank, thrust, speed, apart = closed_form(given.aircraft, 1.2, 0.4, 60.0)
    np.testing.assert_allclose(found.lift, lift, rtol=1e-6)
    np.testing.assert_allclose(np.abs(found.bank), abs(bank), rtol=1e-6)
    np.testing.assert_allclose(found.thrust, thrust, rtol=1e-6)
    np.testing.assert_allclose(found.airspeed, speed, rtol=1e-9)
    assert program.separation(np.array(values)) == pytest.approx(apart, rel=1e-9)


@pytest.mark.parametrize("turns", range(N))
def test_the_separation_is_the_least_of_all_pairs(turns):
    given, values = task(), np.array([0.05, 0.6, 0.6, 0.1, 0.6, 60.0, 0.0])
    places = 2 * np.pi * np.arange(N) / N
    apart = []
    for turn in 2 * np.pi * np.arange(24) / 24:
        angles = np.stack([places, turn + turns * places])
        at = given.orbit(LEANING, FormationVariables(*values), angles).positions
        apart += [np.linalg.norm(at[i] - at[j]) for i in range(N) for j in range(i)]
    program = FormationProgram(given, LEANING, turns)
    assert program.separation(values) == pytest.approx(min(apart), rel=1e-6)


def test_leaning_circles_are_those_of_the_closed_form():
    """A = f0 tan(theta)/cos(psi), C = f0 tan(psi): a constant speed, T = D +- W sin(psi)."""
    given = task(**STRAIGHT)
    lean, half_cone, rate, length = 0.3, 0.2, 0.9, 60.0
    size = math.tan(half_cone) / math.cos(lean)
    values = [math.tan(lean), size * math.cos(lean), size, size * math.sin(lean), rate, length]
    found, _ = needs_at(given, LEANING, [*values, 0.0], 64)
    speed = rate * length * math.sin(half_cone)
    np.testing.assert_allclose(found.airspeed, speed, rtol=1e-9)
    assert np.max(np.abs(found.climb)) == pytest.approx(lean, rel=1e-9)
    plane = given.aircraft._replace(cable_length=length)
    pressure = plane.air_density / 2 * speed**2 * plane.wing_area
    drag = pressure * (
        plane.zero_lift_drag + plane.cable_drag_share + plane.induced_drag * found.lift**2
    )
    swing = plane.mass * GRAVITY * math.sin(lean)
    assert np.max(found.thrust - drag) == pytest.approx(swing, rel=0.01)
    assert np.min(found.thrust - drag) == pytest.approx(-swing, rel=0.01)


def test_the_least_power_is_that_of_the_closed_form():
    """Beside a dense grid of C/f0 and xi at cables of 60 m, with the same margins."""
    given = task(**STRAIGHT)
    program = FormationProgram(given, CO_ROTATING, phases=4)
    lower = np.array([0.05, 0, 0, 0, 0.05, 60.0, 1.0])
    upper = np.array([2.0, 0, 0, 0, 3.0, 60.0, 1.0])
    best = np.inf
    for start in ([0.5, 0.5], [1.5, 0.3], [1.0, 0.8]):
        begin = np.array([start[0], 0, 0, 0, start[1], 60.0, 1.0])
        found = program.solve(begin, lower, upper, np.zeros(7), power_weight=0.005)
        rows, _, power, _ = program.rows(found)
        if rows.min() > 1 - 1e-3:
            best = min(best, power)

    outward, rate = np.meshgrid(np.linspace(0.05, 2, 500), np.linspace(0.05, 3, 1500))
    plane = given.aircraft
    lift, bank, thrust, speed, apart = closed_form(plane, outward, rate, 60.0)
    least, most = thrust_limits(plane, speed.ravel())
    least, most = least.reshape(speed.shape), most.reshape(speed.shape)
    kept = lift / plane.max_lift <= 0.8
    kept &= speed / stall_speed(plane) >= 1.25
    kept &= np.abs(bank) <= math.radians(50) - 0.1
    kept &= (most - thrust) / (most - least) >= 0.1
    kept &= (thrust - least) / (most - least) >= 0.1
    kept &= apart >= 8.0
    expected = np.min((thrust * speed / plane.efficiency)[kept])
    assert best == pytest.approx(expected, rel=0.01)
