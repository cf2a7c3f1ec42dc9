import numpy as np
import pytest
from helpers import Motion, difference, rotation, spatial
from pydrake.common.eigen_geometry import Quaternion

from drake_nonstop.mechanics.carrier import carrier_motion
from drake_nonstop.mechanics.grasp import cable_forces_and_rates, grasp_matrix
from drake_nonstop.mechanics.internal_force import hamiltonian_cycle, orbit_axes
from drake_nonstop.mechanics.nonstop import (
    advance,
    change_cost,
    nearest_squares,
    orbit_positions,
    phase_of,
    polynomial_values,
    quadratic_change_cost,
    speed_polynomials,
    speed_squares,
)
from drake_nonstop.mechanics.planned_orbit import flight_terms, orbit_directions
from drake_nonstop.mechanics.rotation import rotation_matrix

ATTACHMENTS = spatial(4)
BASIS = hamiltonian_cycle(ATTACHMENTS)
PHASES = np.array([0.1, 1.7, 3.3, 4.5])
GRASP = {
    "pseudo_inverse": np.linalg.pinv(grasp_matrix(ATTACHMENTS)),
    "basis": BASIS,
    "offset": BASIS @ np.array([0.2, -0.1, 0.3, 0.05]),
}
STRETCH = {"rest_length": 0.8, "compliance": 1 / 500}
CABLES = {"attachments": ATTACHMENTS, **STRETCH}
PREVIOUS, PARAMETERS = np.array([2.0, 1.2]), np.array([2.3, 1.5])
PHASE = np.array([0.7, 3.0])  # θ and ∂θ/∂ξ = t
WRENCHES = (
    np.array([0.1, -0.2, 0.05, 0.5, -0.3, 9.0]),
    np.array([0.2, 0.1, -0.3, 1.0, 0.5, -0.7]),
    np.array([0.5, -0.6, 0.4, -2.0, 1.0, 3.0]),
)


AXES = orbit_axes(BASIS, PHASES)


def terms_ahead(time, state, reference):
    wrench, rate, second_rate = WRENCHES
    return flight_terms(
        state,
        reference,
        wrench + time * (rate + time / 2 * second_rate),
        rate + time * second_rate,
        second_rate,
        attachments=ATTACHMENTS,
        **{name: GRASP[name] for name in ("pseudo_inverse", "offset")},
    )


def predicted(time, state, reference, theta):
    """The squared speeds (4,) and tensions of PARAMETERS at a phase, `time` ahead."""
    terms = terms_ahead(time, state, reference).of_speeds
    u, along, _ = orbit_directions(AXES, np.array([theta]))
    polynomials = speed_polynomials(terms, u[0], along[0])
    frequency, amplitude = PARAMETERS
    values = polynomial_values(polynomials, amplitude)
    c, b, a, tension_squares = speed_squares(values, **STRETCH)
    s = amplitude * frequency
    return c + s * (2 * b + s * a), tension_squares


def internal(theta):
    """[λ; λ̇] of PARAMETERS, written out."""
    frequency, amplitude = PARAMETERS
    return np.concatenate(
        [amplitude * np.cos(theta + PHASES), -amplitude * frequency * np.sin(theta + PHASES)]
    )


def test_accumulated_phase_does_not_jump_and_that_of_the_paper_does():
    assert phase_of(PARAMETERS, PREVIOUS, np.array([0.7, 0.0])) == pytest.approx(0.7, abs=0)
    # θ = ξ t: 2.0 · 3 s becomes 2.3 · 3 s
    assert phase_of(PARAMETERS, PREVIOUS, np.array([6.0, 3.0])) == pytest.approx(6.9, rel=1e-15)


def test_speeds_and_tensions_of_now_are_the_carrier_generators():
    state, reference = Motion(40).state(0.2), Motion(41).reference(0.2)
    for theta in (0.0, 1.6, 4.0):
        forces = cable_forces_and_rates(state, *WRENCHES[:2], internal(theta), **GRASP)
        _, velocities = carrier_motion(reference, *forces, **CABLES)
        squares, tension_squares = predicted(0.0, state, reference, theta)
        np.testing.assert_allclose(squares, (velocities**2).sum(axis=1), rtol=1e-12)
        np.testing.assert_allclose(tension_squares, (forces[0] ** 2).sum(axis=1), rtol=1e-12)


def test_speeds_ahead_are_the_rates_of_positions_ahead():
    motion, desired = Motion(40), Motion(41)

    def positions(time):
        wrench = WRENCHES[0] + time * WRENCHES[1] + time**2 / 2 * WRENCHES[2]
        theta = 0.7 + PARAMETERS[0] * time
        forces = cable_forces_and_rates(
            motion.state(time), wrench, np.zeros(6), internal(theta), **GRASP
        )
        return carrier_motion(desired.state(time), *forces, **CABLES)[0]

    for time in (0.0, 0.05, 0.4):
        theta = 0.7 + PARAMETERS[0] * time
        squares, _ = predicted(time, motion.state(time), desired.reference(time), theta)
        expected = (difference(positions, time) ** 2).sum(axis=1)
        np.testing.assert_allclose(squares, expected, rtol=0, atol=1e-9)


def test_separations_are_those_of_the_orbits_between_the_turns_too():
    state, reference = Motion(40).state(0.2), Motion(41).reference(0.2)
    forces = terms_ahead(0.0, state, reference).forces
    levers = ATTACHMENTS @ (rotation_matrix(state[:4]).T @ rotation_matrix(reference[:4])).T
    pairs = np.array([(i, j) for i in range(4) for j in range(i)]).T
    count = 36
    phases = 2 * np.pi * np.arange(count)[:, None] / count
    cosine, sine, (p, q) = np.cos(phases), np.sin(phases), (axes.T[:, None] for axes in AXES)
    for amplitude in (0.4, 1.5):
        positions, rates = orbit_positions(
            amplitude,
            forces.T[:, None],
            levers.T[:, None],
            cosine * p + sine * q,
            cosine * q - sine * p,
            **STRETCH,
        )
        assert positions.shape == rates.shape == (3, count, 4)
        gaps, gap_rates = (a[:, :, pairs[0]] - a[:, :, pairs[1]] for a in (positions, rates))
        squares = nearest_squares(gaps, gap_rates, np.pi / count)
        nearest = np.full(6, np.inf)
        for theta in np.linspace(0, 2 * np.pi, 1000):
            internal_forces = np.concatenate([amplitude * np.cos(theta + PHASES), np.zeros(4)])
            cables = cable_forces_and_rates(state, *WRENCHES[:2], internal_forces, **GRASP)
            positions, _ = carrier_motion(reference, *cables, **CABLES)
            gaps = positions[pairs[0]] - positions[pairs[1]]
            nearest = np.minimum(nearest, np.linalg.norm(gaps, axis=1))
        # Within half a step either orbit leaves its tangent by 0.4 % of its radius.
        np.testing.assert_allclose(np.sqrt(squares.min(axis=0)), nearest, rtol=0, atol=5e-3)


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
        anchor_weight=2.0,
        nominal=np.array([2.1, 0.9]),
    )
    expected = 0.3**2 + 0.3**2 + 2.0 * (0.2**2 + 0.6**2)
    theta = 0.7 + 0.3 * slope
    for phi in PHASES:
        expected += 0.5 * (1.5 * np.cos(theta + phi) - 1.2 * np.cos(0.7 + phi)) ** 2
        expected += 0.25 * (1.5 * 2.3 * np.sin(theta + phi) - 1.2 * 2.0 * np.sin(0.7 + phi)) ** 2
    assert cost.shape == (1,)
    assert cost[0] == pytest.approx(expected, rel=1e-14)


def test_no_change_costs_nothing():
    weights = {
        "internal_force_weight": 1.0,
        "internal_force_rate_weight": 1.0,
        "anchor_weight": 1.0,
        "nominal": PREVIOUS,
    }
    assert change_cost(PREVIOUS, PREVIOUS, PHASE, phases=PHASES, **weights)[0] == 0


def weighted(seed):
    """Weights, ξ⁻ and A⁻, and their nominal values, drawn at random."""
    rng = np.random.default_rng(seed)
    weights = {
        "internal_force_weight": rng.uniform(0, 3),
        "internal_force_rate_weight": rng.uniform(0, 3),
        "anchor_weight": rng.choice([0.0, 0.7]),
        "nominal": rng.uniform([1, 0.5], [3, 2]),
    }
    return rng, rng.uniform([0.5, 0.3], [4, 3]), weights


@pytest.mark.parametrize("seed", range(8))
def test_quadratic_cost_is_the_general_one_for_a_phase_that_does_not_jump(seed):
    rng, previous, weights = weighted(seed)
    theta = rng.uniform(0, 2 * np.pi)
    quadratic = quadratic_change_cost(previous, theta + PHASES, **weights)
    for frequency, amplitude in rng.uniform([0.5, 0.3], [4, 3], (20, 2)):
        x = np.array([frequency, amplitude])
        general = change_cost(x, previous, np.array([theta, 0.0]), phases=PHASES, **weights)[0]
        found = quadratic.value(frequency, amplitude, frequency * amplitude)
        assert found == pytest.approx(general, rel=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_no_s_is_cheaper_than_the_cheapest(seed):
    rng, previous, weights = weighted(seed)
    quadratic = quadratic_change_cost(previous, rng.uniform(0, 6) + PHASES, **weights)
    for amplitude in rng.uniform(0.3, 3, 10):
        s = quadratic.cheapest_s(amplitude)
        least = quadratic.value(s / amplitude, amplitude, s)
        for other in s + np.array([-0.1, -1e-3, 1e-3, 0.1]):
            assert quadratic.value(other / amplitude, amplitude, other) > least
