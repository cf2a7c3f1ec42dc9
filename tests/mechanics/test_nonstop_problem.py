import numpy as np
import pytest
from helpers import Motion, rotation

from drake_nonstop.mechanics.nonstop import (
    advanced_reference,
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


def test_a_reference_ahead_is_that_of_a_true_motion_to_second_order():
    motion = Motion(43)
    now = motion.reference(0.5)
    rotation_errors, position_errors = [], []
    for time in (0.04, 0.02, 0.01):
        ahead, true = advanced_reference(now, time), motion.state(0.5 + time)
        rotation_errors.append(np.linalg.norm(rotation(ahead[:4]) - rotation(true[:4])))
        position_errors.append(np.linalg.norm(ahead[4:7] - true[4:7]))
        np.testing.assert_allclose(ahead[7:13], now[7:13] + time * now[13:19], rtol=1e-14)
    for errors in (rotation_errors, position_errors):
        np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 8, rtol=0.1)
    np.testing.assert_array_equal(advanced_reference(now, 0.0), now)


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
