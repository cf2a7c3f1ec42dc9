import numpy as np
import pytest

from drake_nonstop.optimization.amplitude_intervals import allowed_intervals

LOW, HIGH = 0.01, 8.0


def drawn_margins(seed):
    """The least of some curves by the logarithm of A, each allowed in an interval or outside it."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform(np.log(LOW), np.log(HIGH), (3, 1))
    widths, heights = rng.uniform(0.1, 3, (2, 3, 1))
    signs = rng.choice([-1, 1], (3, 1))

    def margins(amplitudes):
        bumps = 2 * np.exp(-(((np.log(amplitudes) - centres) / widths) ** 2)) - 1
        return np.min(signs * heights * bumps, axis=0)

    return margins


def test_intervals_hold_what_is_allowed_and_nothing_else():
    for seed in range(60):
        assert_intervals_are_right(seed)


def assert_intervals_are_right(seed):
    margins = drawn_margins(seed)
    intervals = allowed_intervals(margins, LOW, HIGH, 1.2)
    amplitudes = np.geomspace(LOW, HIGH, 20001)
    is_inside = np.zeros(len(amplitudes), bool)
    for low, high in intervals:
        assert LOW <= low <= high <= HIGH
        assert np.all(margins(np.array([low, high])) >= 0)
        is_inside |= (amplitudes >= low) & (amplitudes <= high)
    np.testing.assert_array_equal(is_inside, margins(amplitudes) >= 0, err_msg=str(seed))


def test_all_or_nothing_may_be_allowed():
    assert allowed_intervals(np.ones_like, LOW, HIGH, 1.2) == [(LOW, HIGH)]
    assert allowed_intervals(lambda a: -a, LOW, HIGH, 1.2) == []


@pytest.mark.parametrize("sign", [1, -1])
def test_a_narrow_interval_between_two_samples_is_found(sign):
    def margins(amplitudes):
        return sign * (1e-2 - np.abs(np.log(amplitudes / 0.777)))

    ends = [end for interval in allowed_intervals(margins, LOW, HIGH, 1.2) for end in interval]
    narrow = [0.777 * np.exp(-1e-2), 0.777 * np.exp(1e-2)]
    expected = narrow if sign > 0 else [LOW, *narrow, HIGH]
    np.testing.assert_allclose(ends, expected, rtol=1e-7)
