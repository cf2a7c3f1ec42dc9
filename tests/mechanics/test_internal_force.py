import numpy as np
from helpers import difference, over_shapes
from numpy.polynomial import Polynomial

from drake_nonstop.mechanics.internal_force import (
    hamiltonian_cycle,
    harmonics,
    internal_force,
    orbit_axes,
)
from drake_nonstop.mechanics.signals import PlannedParameters


@over_shapes
def test_each_column_is_a_pair_of_opposite_unit_forces_that_spread_two_neighbours(attachments, rng):
    n = len(attachments)
    columns = hamiltonian_cycle(attachments).T.reshape(n, n, 3)
    for k, column in enumerate(columns):
        edge = attachments[k] - attachments[(k + 1) % n]
        np.testing.assert_allclose(column[k], edge / np.linalg.norm(edge), rtol=0, atol=1e-15)
        np.testing.assert_array_equal(column[(k + 1) % n], -column[k])
        assert np.count_nonzero(np.any(column, axis=1)) == 2


def plan(time):
    """`PlannedParameters` (8,) of polynomials of the phase and of the amplitude."""
    theta, A = Polynomial([0.2, 1.7, 0.3, -0.2, 0.1]), Polynomial([0.9, -0.2, 0.1, 0.05, -0.03])
    a, b = ([p(time), *(p.deriv(k)(time) for k in (1, 2, 3))] for p in (theta, A))
    return np.array([a[0], a[1], b[0], a[2], b[1], a[3], b[2], b[3]])


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
