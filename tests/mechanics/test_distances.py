"""Distances of segments by bounded least squares, and over time by many instants."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from drake_nonstop.mechanics.distances import nearest_over_time, segment_distances


def test_the_distance_of_segments_is_a_bounded_least_square(rng):
    ends = rng.normal(size=(4, 100, 3)) * rng.choice([0.1, 1, 5], (4, 100, 1))
    ends[3, :9] = ends[2, :9] + rng.normal(size=(9, 1)) * (ends[1] - ends[0])[:9]  # parallel ones
    ends[1, 5:9] = ends[0, 5:9]  # and without a length
    found = segment_distances(*ends)
    for k, (a, b, c, d) in enumerate(ends.swapaxes(0, 1)):
        least = lsq_linear(np.column_stack([b - a, c - d]), c - a, (0, 1))
        assert abs(found[k] - np.sqrt(2 * least.cost)) < 1e-6


@pytest.mark.parametrize("last", [0, 1, 9, 100])
def test_the_nearest_over_time_is_that_of_many_instants_between_steps(last, rng):
    """Pairs of three segments, the first of which stands still; some are inside of each other."""
    times, fine = np.arange(last + 1), np.arange(0, last + 0.001, 1 / 64)
    rates, phases, middles = rng.uniform(0.05, 0.6, 18), rng.uniform(0, 6, 18), rng.normal(size=18)
    moved = middles + np.sin(np.outer(times, rates) + phases) * np.repeat([0, 1, 2], 6)
    pairs = np.array([[0, 1], [1, 2], [0, 2]])

    def signed(ends):
        return segment_distances(*ends.reshape(-1, 4, 3).swapaxes(0, 1)) - 0.3

    def of_pairs(at):
        columns = [np.interp(at, times, column) for column in moved.T]
        segments = np.stack(columns, axis=1).reshape(-1, 3, 2, 3)
        return np.stack([signed(segments[:, pair]) for pair in pairs], axis=1)

    found, every = nearest_over_time(signed, moved.reshape(-1, 3, 2, 3), pairs), of_pairs(fine)
    np.testing.assert_allclose(found.distances, every.min(axis=0), atol=5e-3)
    assert np.all(found.distances <= every.min(axis=0) + 1e-12)
    np.testing.assert_allclose(np.diag(of_pairs(found.steps)), found.distances, atol=1e-12)
    is_inside = of_pairs(times) < 0
    expected = np.where(is_inside.any(axis=0), is_inside.argmax(axis=0), np.inf)
    np.testing.assert_array_equal(found.inside, expected)
