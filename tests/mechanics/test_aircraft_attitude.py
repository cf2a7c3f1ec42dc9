"""Attitude and angular velocity of coordinated flight, held against differences and pydrake."""

import numpy as np
import pytest
from pydrake.math import RollPitchYaw

from drake_nonstop.mechanics.aircraft import (
    air_frame,
    body_attitude,
    north_east_down,
    turn_rate,
)


@pytest.fixture(params=range(4))
def drawn(request):
    rng = np.random.default_rng(request.param)
    velocity = rng.uniform([-15, -15, -4], [15, 15, 4])
    return velocity, rng.uniform(-4, 4, 3), *rng.uniform(-0.6, 0.6, 2)


def test_air_and_lift_are_where_angle_of_attack_and_bank_say(drawn):
    velocity, _, angle, bank = drawn
    R_WB = body_attitude(velocity, angle, bank)
    np.testing.assert_allclose(R_WB.T @ R_WB, np.eye(3), atol=1e-12)
    assert np.linalg.det(R_WB) == pytest.approx(1)
    speed = np.linalg.norm(velocity)
    of_air = speed * np.array([np.cos(angle), 0, np.sin(angle)])
    np.testing.assert_allclose(R_WB.T @ velocity, of_air, atol=1e-9)
    lift = R_WB @ [np.sin(angle), 0, -np.cos(angle)]
    np.testing.assert_allclose(lift, air_frame(velocity).lift_direction(np.array(bank)), atol=1e-9)


def test_turn_rate_is_that_of_differences(drawn):
    velocity, acceleration, angle, bank = drawn
    step = 1e-6
    later, earlier = (
        body_attitude(velocity + s * acceleration, angle, bank) for s in (step, -step)
    )
    skew = (later - earlier) / (2 * step) @ body_attitude(velocity, angle, bank).T
    rate = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    np.testing.assert_allclose(turn_rate(velocity, acceleration), rate, atol=1e-6)


def test_an_aircraft_to_the_north_has_no_angles():
    level = body_attitude(np.array([0.0, 15.0, 0.0]), 0.0, 0.0)
    np.testing.assert_allclose(north_east_down(level.T).T, np.eye(3), atol=1e-9)
    banked = body_attitude(np.array([15.0, 0.0, 0.0]), 0.1, 0.0)  # to the east
    angles = RollPitchYaw(np.asarray(north_east_down(banked.T).T)).vector()
    np.testing.assert_allclose(angles, [0, 0.1, np.pi / 2], atol=1e-9)
