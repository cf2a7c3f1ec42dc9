"""Linear maps from sample to sample, against products and closed forms."""

from functools import reduce

import numpy as np
import pytest

from drake_nonstop.analysis.sampled_maps import interpolated, largest_growth, map_of_turn


def test_the_map_of_a_turn_is_the_product_of_maps_between_the_phases(rng):
    count, samples = 15, 150
    constant = np.eye(3)
    cosine, sine = rng.standard_normal((2, 3, 3)) / samples

    def steps(turns):
        angles = 2 * np.pi * np.arange(turns)[:, None, None] / turns
        return constant + np.cos(3 * angles) * cosine + np.sin(7 * angles) * sine

    expected = reduce(lambda turn, step: step @ turn, steps(samples))
    np.testing.assert_allclose(map_of_turn(steps(count), samples), expected, atol=1e-12)


def test_the_largest_growth_is_that_from_the_worst_sample_to_the_worst():
    maps = np.stack([np.diag([factor, 1.0]) for factor in (0.5, 0.5, 3.0, 2.0, 0.5)])
    assert largest_growth(maps, np.ones(1), spacing=1) == pytest.approx((6, 2, 4))
    assert largest_growth(maps, np.ones(1), spacing=3) == pytest.approx((2, 3, 4))
    assert largest_growth(maps[:2], np.ones(1), spacing=1) == (1, 0, 0)


def test_growth_of_several_states_is_the_largest_singular_value():
    rng = np.random.default_rng(3)
    maps, scale = rng.normal(size=(5, 4, 4)), np.array([2.0, 0.5])
    whole = np.linalg.multi_dot(maps[::-1])[:2, :2]
    sizes = np.linalg.svd(scale[:, None] * whole / scale, compute_uv=False)
    found = largest_growth(maps, scale, spacing=5)
    assert found.times >= sizes.max()
    if found.last == 5:
        assert found.times == pytest.approx(sizes.max())


def test_growth_beyond_all_bounds_is_followed_no_further():
    found = largest_growth((10.0 * np.eye(1) for _ in range(1000)), np.ones(1), spacing=7)
    assert (found.first, found.last) == (0, 12)


@pytest.mark.parametrize("count", [8, 9])
def test_a_function_of_the_phase_is_interpolated_between_even_phases(count):
    def function(turns):
        angles = 2 * np.pi * np.asarray(turns)[:, None, None]
        return 1 + np.cos(angles) - 2 * np.sin(3 * angles) * np.ones((1, 1, 2))

    between = np.array([0.0, 0.13, 0.77])
    found = interpolated(function(np.arange(count) / count), between)
    np.testing.assert_allclose(found, function(between), atol=1e-12)
