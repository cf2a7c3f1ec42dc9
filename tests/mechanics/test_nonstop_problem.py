import numpy as np
import pytest
from helpers import Motion, rotation
from pydrake.common.eigen_geometry import Quaternion

from drake_nonstop.mechanics.nonstop import (
    advance,
    change_cost,
    phase_of,
)

PHASES = np.array([0.1, 1.7, 3.3, 4.5])
PREVIOUS, PARAMETERS = np.array([2.0, 1.2]), np.array([2.3, 1.5])
PHASE = np.array([0.7, 3.0])  # θ and ∂θ/∂ξ = t


def test_accumulated_phase_does_not_jump_and_that_of_the_paper_does():
    assert phase_of(PARAMETERS, PREVIOUS, np.array([0.7, 0.0])) == pytest.approx(0.7, abs=0)
    # θ = ξ t: 2.0 · 3 s becomes 2.3 · 3 s
    assert phase_of(PARAMETERS, PREVIOUS, np.array([6.0, 3.0])) == pytest.approx(6.9, rel=1e-15)


def exact(state, angular, translational, time, steps=64):
    """The state under constant accelerations, its rotation by exponentials (Magnus, 4th order)."""
    h = time / steps
    rotation_now = Quaternion(wxyz=state[:4])
    for i in range(steps):
        middle = state[7:10] + angular * (i + 0.5) * h
        # ω = middle + s α: the commutator term of the Magnus series is −h³/12 ω × α.
        turn = h * middle + h**3 / 12 * np.cross(angular, middle)
        angle = np.linalg.norm(turn)
        rotation_now = Quaternion(
            wxyz=[np.cos(angle / 2), *(np.sin(angle / 2) * turn / angle)]
        ).multiply(rotation_now)
    return np.concatenate(
        [
            rotation_now.wxyz(),
            state[4:7] + time * state[10:13] + time**2 / 2 * translational,
            state[7:10] + time * angular,
            state[10:13] + time * translational,
        ]
    )


def test_advance_is_exact_but_for_the_rotation_which_is_of_second_order():
    state = Motion(42).state(0.3)
    angular, translational = np.array([1.5, -0.7, 0.9]), np.array([0.4, 0.3, -0.8])
    errors = []
    for time in (0.02, 0.01, 0.005, 0.0025):
        ahead, expected = (f(state, angular, translational, time) for f in (advance, exact))
        np.testing.assert_allclose(ahead[4:], expected[4:], rtol=0, atol=1e-15)
        errors.append(np.linalg.norm(rotation(ahead[:4]) - rotation(expected[:4])))
    ratios = np.array(errors[:-1]) / errors[1:]
    # A local error of h³: halving the step divides it by 8 (by 4 were it of first order).
    np.testing.assert_allclose(ratios, 8, rtol=0.1)


def test_advance_along_a_true_motion_is_of_second_order():
    motion = Motion(43)
    now = motion.reference(0.5)
    rotation_errors, position_errors = [], []
    for time in (0.04, 0.02, 0.01):
        ahead = advance(now[:13], now[13:16], now[16:19], time)
        true = motion.state(0.5 + time)
        rotation_errors.append(np.linalg.norm(rotation(ahead[:4]) - rotation(true[:4])))
        position_errors.append(np.linalg.norm(ahead[4:7] - true[4:7]))
    for errors in (rotation_errors, position_errors):
        np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 8, rtol=0.1)


def test_advance_by_no_time_changes_nothing():
    state = Motion(42).state(0.3)
    np.testing.assert_array_equal(advance(state, np.ones(3), np.ones(3), 0.0), state)


@pytest.mark.parametrize("slope", [0.0, 3.0])
def test_change_cost_in_closed_form(slope):
    cost = change_cost(
        PARAMETERS,
        PREVIOUS,
        np.array([0.7, slope]),
        phases=PHASES,
        internal_force_weight=0.5,
        internal_force_rate_weight=0.25,
    )
    expected = 0.3**2 + 0.3**2
    theta = 0.7 + 0.3 * slope
    for phi in PHASES:
        before, after = 0.7 + phi, theta + phi
        expected += 0.5 * (1.5 * np.cos(after) - 1.2 * np.cos(before)) ** 2
        jump = 1.5 * 2.3 * np.sin(after) - 1.2 * 2.0 * np.sin(before)
        expected += 0.25 * jump**2
    assert cost.shape == (1,)
    assert cost[0] == pytest.approx(expected, rel=1e-14)


def test_no_change_costs_nothing():
    weights = {"internal_force_weight": 1.0, "internal_force_rate_weight": 1.0}
    assert change_cost(PREVIOUS, PREVIOUS, PHASE, phases=PHASES, **weights)[0] == 0
