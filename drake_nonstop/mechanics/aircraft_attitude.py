"""The attitude of an aircraft in coordinated flight, as that of a rigid body.

Body axes are x forward, y to the right, z downwards. An aircraft without sideslip that flies
through the air along x_a, with the angle of attack α and its lift along l, has

    x_b = cos α x_a + sin α l,   z_b = sin α x_a − cos α l,   y_b = z_b × x_b.

Floats only.
"""

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.aircraft import air_frame
from drake_nonstop.mechanics.rotation import cross

_UP = np.array([0.0, 0.0, 1.0])
_NORTH_EAST_DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def body_attitude(air_velocity: NDArray, angle: float, bank: float) -> NDArray:
    """R_WB (3, 3) of flight through the air without sideslip.

    Args:
        air_velocity: v − w (3,), m/s, in W, not vertical.
        angle: α, rad.
        bank: μ, rad, positive to the right.
    """
    frame = air_frame(air_velocity)
    lift = frame.lift_direction(np.array(bank))
    forward = np.cos(angle) * frame.forward + np.sin(angle) * lift
    down = np.sin(angle) * frame.forward - np.cos(angle) * lift
    return np.stack([forward, cross(down, forward), down], axis=1)


def turn_rate(air_velocity: NDArray, acceleration: NDArray) -> NDArray:
    """Angular velocity ω (3,), rad/s, in W, of `air_frame` in a steady wind.

    With the rate of the direction x of flight, ẋ = (v̇ − (v̇·x) x)/V, it is the sum of a turn
    about the vertical and a pitching about the right y: ω = −ẋ·y/√(1 − x₃²) e₃ + ẋ·z′ y.

    Args:
        air_velocity: V_a = v − w (3,), m/s, in W, not vertical.
        acceleration: v̇ (3,), m/s², in W.
    """
    frame = air_frame(air_velocity)
    rate = acceleration / frame.airspeed
    level = np.sqrt(1 - frame.forward[2] ** 2)
    return -(rate @ frame.right) / level * _UP + (rate @ frame.up) * frame.right


def north_east_down(vectors: NDArray) -> NDArray:
    """Vectors (..., 3) in W, whose axes are east, north and up, in north, east and down; or back.

    Of a matrix (3, 3) of columns in W, give and take the transposed.
    """
    return vectors @ _NORTH_EAST_DOWN
