import numpy as np
import pytest
from helpers import SHAPES, difference, over_shapes

from drake_nonstop.mechanics.grasp import grasp_matrix
from drake_nonstop.mechanics.internal_force import (
    even_phases,
    hamiltonian_cycle,
    harmonics,
    internal_force,
    orbit_axes,
)
from drake_nonstop.mechanics.signals import PlannedParameters


@over_shapes
def test_cycle_forces_have_no_net_wrench(attachments, rng):
    wrenches = grasp_matrix(attachments) @ hamiltonian_cycle(attachments)
    np.testing.assert_allclose(wrenches, 0, rtol=0, atol=1e-15)


@over_shapes
def test_cycle_has_a_column_per_cable_and_full_rank(attachments, rng):
    n = len(attachments)
    basis = hamiltonian_cycle(attachments)
    assert basis.shape == (3 * n, n)
    assert np.linalg.svd(basis, compute_uv=False)[-1] > 0.1  # sin of the sharpest corner


def test_cycle_of_three_spans_the_whole_null_space():
    for name in ("regular-3", "irregular-3", "spatial-3"):
        basis = hamiltonian_cycle(SHAPES[name])
        null_space = np.linalg.svd(grasp_matrix(SHAPES[name]))[2][6:]
        rest = null_space.T - basis @ np.linalg.lstsq(basis, null_space.T, rcond=None)[0]
        np.testing.assert_allclose(rest, 0, rtol=0, atol=1e-14)


@over_shapes
def test_each_column_is_a_pair_of_opposite_unit_forces_that_spread_two_neighbours(attachments, rng):
    n = len(attachments)
    columns = hamiltonian_cycle(attachments).T.reshape(n, n, 3)
    for k, column in enumerate(columns):
        edge = attachments[k] - attachments[(k + 1) % n]
        np.testing.assert_allclose(column[k], edge / np.linalg.norm(edge), rtol=0, atol=1e-15)
        np.testing.assert_array_equal(column[(k + 1) % n], -column[k])
        assert np.count_nonzero(np.any(column, axis=1)) == 2


@pytest.mark.parametrize("count", [1, 2, 3, 8])
def test_even_phases_divide_a_turn(count):
    phases = even_phases(count)
    assert phases[0] == 0
    np.testing.assert_allclose(np.diff([*phases, 2 * np.pi]), 2 * np.pi / count, rtol=1e-14)


def test_internal_force_of_a_square_after_a_quarter_turn():
    force, rate, *_ = internal_force(
        np.array([2.0, 1.5]), np.array([np.pi / 2]), phases=np.array([0, np.pi / 2, np.pi])
    )
    np.testing.assert_allclose(force, [0, -1.5, 0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(rate, [-3, 0, 3], rtol=0, atol=1e-15)


def test_internal_force_rate_is_its_difference_at_constant_frequency(rng):
    parameters, phases = np.array([1.7, 0.8]), rng.uniform(0, 6, 5)

    def force(time):
        return internal_force(parameters, parameters[:1] * time, phases=phases)

    for time in (0.0, 0.4, 2.5):
        value, rate, second, third = force(time)
        expected = difference(lambda t: force(t)[0], time)
        np.testing.assert_allclose(rate, expected, rtol=0, atol=1e-9)
        np.testing.assert_allclose(second, -(1.7**2) * value, rtol=1e-13)
        np.testing.assert_allclose(third, -(1.7**2) * rate, rtol=1e-13)


def plan(time):
    """`PlannedParameters` (8,) of a frequency and an amplitude that both swing."""
    size, rate = 1.3, 0.8
    angle = 0.2 + 1.7 * time + 0.5 * np.sin(size * time)
    angle_rates = [0.5 * size**k * np.sin(size * time + k * np.pi / 2) for k in (1, 2, 3)]
    sizes = [0.3 * rate**k * np.cos(rate * time + k * np.pi / 2) for k in range(4)]
    frequency, amplitude = 1.7 + angle_rates[0], 0.9 + sizes[0]
    rates = [angle_rates[1], sizes[1], angle_rates[2], sizes[2], sizes[3]]
    return np.array([angle, frequency, amplitude, *rates])


def test_planned_internal_force_has_the_differences_of_what_is_below_as_rates(rng):
    phases = rng.uniform(0, 6, 5)

    def force(time):
        series = PlannedParameters.view(plan(time)).series
        return harmonics(*series, phases=phases).rates

    for time in (0.0, 0.7, 2.5):
        expected = plan(time)[2] * np.cos(plan(time)[0] + phases)
        np.testing.assert_allclose(force(time)[0], expected, rtol=0, atol=1e-14)
        for order in (1, 2, 3):
            below = difference(lambda t, k=order: force(t)[k - 1], time)
            np.testing.assert_allclose(force(time)[order], below, rtol=1e-8, atol=1e-8)


def test_planned_internal_force_without_rates_is_that_of_constant_parameters(rng):
    phases = rng.uniform(0, 6, 5)
    parameters = np.array([1.7, 0.8])
    still = PlannedParameters.view(np.array([0.4, *parameters, 0, 0, 0, 0, 0]))
    force = harmonics(*still.series, phases=phases).rates
    known = internal_force(parameters, np.array([0.4]), phases=phases)
    np.testing.assert_array_equal(force, known)


@over_shapes
def test_forces_of_each_cable_run_on_the_ellipse_of_its_axes(attachments, rng):
    phases = rng.uniform(0, 2 * np.pi, len(attachments))
    basis = hamiltonian_cycle(attachments)
    p, q = orbit_axes(basis, phases)
    for angle in (0.0, 1.0, 4.0):
        force, *_ = internal_force(np.array([2.0, 1.0]), np.array([angle]), phases=phases)
        expected = (basis @ force).reshape(-1, 3)
        found = p * np.cos(angle) + q * np.sin(angle)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
