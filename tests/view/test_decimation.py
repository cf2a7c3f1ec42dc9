"""The samples that are drawn of a long curve."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_nonstop.view.figure_style import extreme_samples


@settings(max_examples=50, deadline=None)
@given(
    count=st.integers(0, 3000),
    columns=st.integers(0, 5),
    spare=st.integers(0, 300),
    seed=st.integers(0, 2**32 - 1),
)
def test_few_samples_have_the_ends_and_all_extremes(count, columns, spare, seed):
    shape = (count, columns) if columns else (count,)
    values = np.random.default_rng(seed).normal(size=shape)
    most = 2 + 4 * max(columns, 1) + spare
    chosen = extreme_samples(values, most)
    assert len(chosen) <= most
    assert np.all(np.diff(chosen) > 0)
    if count <= most:
        assert len(chosen) == count
        return
    assert (chosen[0], chosen[-1]) == (0, count - 1)
    np.testing.assert_array_equal(values[chosen].min(axis=0), values.min(axis=0))
    np.testing.assert_array_equal(values[chosen].max(axis=0), values.max(axis=0))


def test_a_gap_is_still_seen():
    values = np.sin(np.arange(10_000.0))
    values[4321] = np.nan
    assert 4321 in extreme_samples(values, 100)
