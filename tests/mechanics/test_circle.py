import numpy as np
import pytest
from helpers import difference

from drake_nonstop.mechanics.rotation import circular_motion


def angle(time):
    """An angle and its four derivatives, (5,)."""
    return np.array(
        [
            0.3 + np.sin(time) + 0.2 * time**3,
            np.cos(time) + 0.6 * time**2,
            -np.sin(time) + 1.2 * time,
            -np.cos(time) + 1.2,
            np.sin(time),
        ]
    )


def test_the_point_is_on_the_circle_at_its_angle():
    for theta in np.linspace(-7, 7, 15):
        point = circular_motion(np.array([theta, 0.3, 0.2, 0.1, 0.4]), 1.7)[0]
        assert complex(*point) == pytest.approx(1.7 * np.exp(1j * theta), rel=1e-15)


def test_each_row_is_the_rate_of_the_one_above():
    for time in np.linspace(-1, 1, 7):
        motion = circular_motion(angle(time), 1.7)
        for order in range(4):
            rate = difference(lambda t, row=order: circular_motion(angle(t), 1.7)[row], time)
            np.testing.assert_allclose(motion[order + 1], rate, rtol=0, atol=1e-9)


def test_at_constant_speed_the_acceleration_points_to_the_centre():
    motion = circular_motion(np.array([0.4, 3.0, 0, 0, 0]), 0.5)
    position, velocity, acceleration, jerk, snap = motion
    np.testing.assert_allclose(acceleration, -9 * position, rtol=1e-15)
    np.testing.assert_allclose(jerk, -9 * velocity, rtol=1e-15)
    np.testing.assert_allclose(snap, 81 * position, rtol=1e-15)
