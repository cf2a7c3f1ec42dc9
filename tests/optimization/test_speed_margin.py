"""Shares of a speed margin, against closed forms."""

import numpy as np
import pytest

from drake_nonstop.optimization.speed_margin import SpeedMargin, grid_dip


def test_between_two_instants_a_parabola_dips_by_an_eighth_of_its_second_rate():
    """‖v‖ = 1 + 3 t², at its vertex: from ±Δ/2 it falls by 3 Δ²/4."""
    spacing = 0.02
    level = np.array([1.0, 0.0, 0.0]).reshape(1, 1, 1, 3)
    motion = [level, 0 * level, 6 * level]
    assert grid_dip(motion, np.ones((1, 1, 1)), spacing) == pytest.approx(3 * spacing**2 / 4)


def test_a_turning_velocity_of_constant_speed_does_not_dip():
    rate = 3.0
    v, a = np.array([1.0, 0, 0]), np.array([0, rate, 0])
    parts = (part.reshape(1, 1, 1, 3) for part in (v, a, -(rate**2) * v))
    assert grid_dip(parts, np.ones((1, 1, 1)), 0.1) == pytest.approx(0)


def test_a_margin_is_the_sum_of_its_shares():
    shares = {name: 2.0**-i for i, name in enumerate(SpeedMargin.__dataclass_fields__)}
    assert SpeedMargin(**shares).total == 2 - 2.0 ** (1 - len(shares))
