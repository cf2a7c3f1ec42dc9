"""The program that designs formations, beside closed forms."""

import math

import numpy as np
import pytest

from drake_nonstop import AircraftParameters, Model, SystemParameters, read_request
from drake_nonstop.mechanics.aircraft import stall_speed, thrust_limits
from drake_nonstop.model.pattern import HamiltonianCycleConfig
from drake_nonstop.planning.formation_program import FormationProgram
from drake_nonstop.studies.formation_search import design_task

GRAVITY, MASS, N, RADIUS, LENGTH = 9.81, 10.0, 4, 1.5, 60.0
KINDS = LEANING, CO_ROTATING = "leaning", "co_rotating"
# Without lift at no angle, and with an angle of attack of none: T acts along the path.
STRAIGHT = {"lift_at_zero_angle": 0.0, "lift_slope": 1e9}
# On the way of the load in a wind, with all limits of aircraft.
MOVING = ["wind=[2, 0, 0]", "speed=1", "cable_safety=0"]
EVERY = ["max_lift_share=0.6", "max_bank=0.9", "max_climb=0.9", "max_thrust_share=0.6"]
VALUES = np.array([0.3, 0.15, 0.2, 0.1, 0.6, 150.0, 0.5])
PLANE = Model(
    SystemParameters(
        aircraft=AircraftParameters(model="rascal_110", **STRAIGHT), cable_length=LENGTH
    ),
    HamiltonianCycleConfig(),
).aircraft


def program(kind, *changes, phases=3, turns=2):
    task = design_task(read_request(None, list(changes)), N)
    return FormationProgram(task, kind, turns, phases=phases)


def at_rest(kind, **options):
    """That of a load at rest on thin, stiff cables of 60 m."""
    straight = [f"aircraft.{name}={value:g}" for name, value in STRAIGHT.items()]
    own = ["speed=0", "cable_stiffness=1e7", "separation=8", "bank=0.8", "climb=0.5"]
    return program(kind, *straight, *own, f"cable_length=[{LENGTH}, {LENGTH}]", **options)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("asked", [[], EVERY], ids=["own", "asked"])
def test_gradients_are_central_differences(kind, asked):
    made = program(kind, *MOVING, *asked)
    _, gradients, _, power_gradient = made.rows(VALUES)
    for i in range(len(VALUES) - 1):
        step = 1e-5 * max(1.0, VALUES[i])
        ends = [made.rows(VALUES + sign * step * np.eye(7)[i]) for sign in (1, -1)]
        expected = (ends[0][0] - ends[1][0]) / (2 * step)
        np.testing.assert_allclose(gradients[:, i], expected, rtol=1e-4, atol=1e-5)
        expected = (ends[0][2] - ends[1][2]) / (2 * step)
        assert power_gradient[i] == pytest.approx(expected, rel=1e-4, abs=1e-3)


def closed_form(plane, outward, rate):
    """Level circles that turn with the load: C_L, bank, thrust, airspeed, distance."""
    share, ratio = MASS * GRAVITY / N, MASS / (N * plane.mass)
    half_cone = np.arctan(outward)
    radius = RADIUS + LENGTH * np.sin(half_cone)
    speed = rate * radius
    bank = np.arctan((speed**2 / (GRAVITY * radius) - ratio * np.tan(half_cone)) / (1 + ratio))
    pressure = plane.air_density / 2 * speed**2 * plane.wing_area
    held = plane.mass * GRAVITY + share
    lift = held / (pressure * np.cos(bank))
    parasitic = plane.zero_lift_drag + 1.1 * 0.001 * LENGTH / (4 * plane.wing_area)
    thrust = pressure * parasitic + plane.induced_drag * pressure * lift**2
    return lift, bank, thrust, speed, 2 * radius * math.sin(math.pi / N)


def test_leaning_circles_are_those_of_the_closed_form():
    """A = f0 tan(theta)/cos(psi), C = f0 tan(psi): a constant speed, T = D +- W sin(psi)."""
    lean, half_cone, rate = 0.3, 0.2, 0.9
    size = math.tan(half_cone) / math.cos(lean)
    values = [math.tan(lean), size * math.cos(lean), size, size * math.sin(lean), rate, LENGTH, 0]
    found = at_rest(LEANING).extremes(np.array(values), 64)
    speed = rate * LENGTH * math.sin(half_cone)
    assert found["airspeed_m_s"] == pytest.approx([speed, speed], rel=1e-6)
    assert found["climb"][1] == pytest.approx(math.sin(lean), rel=1e-6)
    pressure = PLANE.air_density / 2 * speed**2 * PLANE.wing_area
    lift = np.array(found["lift"]) * PLANE.max_lift
    drag = PLANE.zero_lift_drag + PLANE.cable_drag_share + PLANE.induced_drag * lift**2
    swing = PLANE.mass * GRAVITY * math.sin(lean)
    assert np.ptp(found["thrust_N"]) == pytest.approx(2 * swing, rel=0.02)
    assert np.mean(found["thrust_N"]) == pytest.approx(pressure * np.mean(drag), rel=0.05)


def test_the_least_power_is_that_of_the_closed_form():
    """Beside a dense grid of C/f0 and xi at cables of 60 m, with the same margins."""
    made = at_rest(CO_ROTATING, phases=4, turns=0)
    lift, bank, thrust, speed, apart = closed_form(PLANE, 1.2, 0.4)
    x = np.array([1.2, 0, 0, 0, 0.4, LENGTH, 0.0])
    found = made.extremes(x, 5)
    values = {"lift": lift / PLANE.max_lift, "airspeed_m_s": speed, "thrust_N": thrust, "share": 1}
    for name, value in values.items():
        assert found[name] == pytest.approx([value, value], rel=1e-5)
    assert np.abs(found["bank"]) == pytest.approx([abs(bank)] * 2, rel=1e-5)
    assert made.separation(x) == pytest.approx(apart, rel=1e-5)

    lower = np.array([0.05, 0, 0, 0, 0.05, LENGTH, 1.0])
    upper = np.array([2.0, 0, 0, 0, 3.0, LENGTH, 1.0])
    best = np.inf
    for start in ([0.5, 0.5], [1.5, 0.3], [1.0, 0.8]):
        begin = np.array([start[0], 0, 0, 0, start[1], LENGTH, 1.0])
        solved = made.solve(begin, lower, upper, np.zeros(7), power_weight=0.005)
        rows, _, power, _ = made.rows(solved)
        if rows.min() > 1 - 1e-3:
            best = min(best, power)

    outward, rate = np.meshgrid(np.linspace(0.05, 2, 500), np.linspace(0.05, 3, 1500))
    lift, bank, thrust, speed, apart = closed_form(PLANE, outward, rate)
    least, most = (end.reshape(speed.shape) for end in thrust_limits(PLANE, speed.ravel()))
    kept = lift / PLANE.max_lift <= 0.8
    kept &= speed / stall_speed(PLANE) >= 1.25
    kept &= np.abs(bank) <= 0.8
    kept &= (most - thrust) / (most - least) >= 0.1
    kept &= (thrust - least) / (most - least) >= 0.1
    kept &= apart >= 8.0
    expected = np.min((thrust * speed / PLANE.efficiency)[kept])
    assert best == pytest.approx(expected, rel=0.01)
