import numpy as np
import pytest
from helpers import Motion, difference, rotation, spatial
from pydrake.common.eigen_geometry import Quaternion

from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.mechanics.grasp import cable_forces_and_rates, grasp_matrix
from drake_nonstop.mechanics.internal_force import hamiltonian_cycle
from drake_nonstop.mechanics.nonstop import (
    advance,
    carrier_velocities,
    change_cost,
    phase_of,
    speed_terms,
    turned_speed_terms,
)

ATTACHMENTS = spatial(4)
BASIS = hamiltonian_cycle(ATTACHMENTS)
PHASES = np.array([0.1, 1.7, 3.3, 4.5])
GRASP = {
    "pseudo_inverse": np.linalg.pinv(grasp_matrix(ATTACHMENTS)),
    "basis": BASIS,
    "offset": BASIS @ np.array([0.2, -0.1, 0.3, 0.05]),
}
CABLES = {"attachments": ATTACHMENTS, "rest_length": 0.8, "compliance": 1 / 500}
PREVIOUS, PARAMETERS = np.array([2.0, 1.2]), np.array([2.3, 1.5])
PHASE = np.array([0.7, 3.0])  # θ and ∂θ/∂ξ = t
WRENCHES = (
    np.array([0.1, -0.2, 0.05, 0.5, -0.3, 9.0]),
    np.array([0.2, 0.1, -0.3, 1.0, 0.5, -0.7]),
    np.array([0.5, -0.6, 0.4, -2.0, 1.0, 3.0]),
)


def predicted(time, state, motion, wrenches=WRENCHES, phase=PHASE):
    return carrier_velocities(
        PARAMETERS,
        PREVIOUS,
        phase,
        state,
        motion,
        *wrenches,
        time=time,
        phases=PHASES,
        **GRASP,
        **CABLES,
    )


def internal(theta):
    """[λ; λ̇] of PARAMETERS, written out."""
    frequency, amplitude = PARAMETERS
    return np.concatenate(
        [amplitude * np.cos(theta + PHASES), -amplitude * frequency * np.sin(theta + PHASES)]
    )


def test_accumulated_phase_does_not_jump_and_the_printed_one_does():
    assert phase_of(PARAMETERS, PREVIOUS, np.array([0.7, 0.0])) == pytest.approx(0.7, abs=0)
    # θ = ξ t: 2.0 · 3 s becomes 2.3 · 3 s
    assert phase_of(PARAMETERS, PREVIOUS, np.array([6.0, 3.0])) == pytest.approx(6.9, rel=1e-15)


def test_velocities_of_now_are_the_carrier_generators():
    state, reference = Motion(40).state(0.2), Motion(41).reference(0.2)
    forces = cable_forces_and_rates(state, *WRENCHES[:2], internal(0.7 + 0.3 * 3.0), **GRASP)
    _, expected = carrier_motion(reference, *forces, **CABLES)
    velocities = predicted(0.0, state, reference)
    np.testing.assert_allclose(velocities, expected, rtol=0, atol=1e-14)


def test_velocities_ahead_are_the_rates_of_positions_ahead():
    motion, desired = Motion(40), Motion(41)

    def positions(time):
        wrench = WRENCHES[0] + time * WRENCHES[1] + time**2 / 2 * WRENCHES[2]
        theta = 0.7 + 0.3 * 3.0 + PARAMETERS[0] * time
        forces = cable_forces_and_rates(
            motion.state(time), wrench, np.zeros(6), internal(theta), **GRASP
        )
        return carrier_motion(desired.state(time), *forces, **CABLES)[0]

    for time in (0.0, 0.05, 0.4):
        velocities = predicted(time, motion.state(time), desired.state(time))
        np.testing.assert_allclose(velocities, difference(positions, time), rtol=0, atol=1e-9)


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


def test_turned_speed_terms_are_the_terms_of_the_turned_phase():
    state, reference = Motion(40).state(0.2), Motion(41).reference(0.2)

    def terms(angle):
        return speed_terms(
            np.array([angle]),
            state,
            reference,
            *WRENCHES,
            time=0.01,
            phases=PHASES,
            attachments=ATTACHMENTS,
            **GRASP,
        )

    turns = np.array([0.0, 0.9, 4.0])
    now, later = np.stack(terms(0.7)), np.stack(terms(0.7 + np.pi / 2))
    turned = turned_speed_terms(now, later, turns)
    expected = [np.concatenate(rows) for rows in zip(*(terms(0.7 + t) for t in turns), strict=True)]
    for found, true in zip(turned, expected, strict=True):
        np.testing.assert_allclose(found, true, rtol=0, atol=1e-14)


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
        expected += 0.5 * (1.5 * np.cos(theta + phi) - 1.2 * np.cos(0.7 + phi)) ** 2
        expected += 0.25 * (1.5 * 2.3 * np.sin(theta + phi) - 1.2 * 2.0 * np.sin(0.7 + phi)) ** 2
    assert cost.shape == (1,)
    assert cost[0] == pytest.approx(expected, rel=1e-14)


def test_no_change_costs_nothing():
    weights = {"internal_force_weight": 1.0, "internal_force_rate_weight": 1.0}
    assert change_cost(PREVIOUS, PREVIOUS, PHASE, phases=PHASES, **weights)[0] == 0
