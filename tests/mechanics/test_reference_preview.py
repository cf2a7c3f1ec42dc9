import numpy as np
import pytest
from helpers import Motion, rates_by_differences

from drake_nonstop.mechanics.reference_preview import continued_reference, stretched


def continued(time):
    return continued_reference(Motion(3).reference(0.4), time)


def in_another_time(time):
    s = time + 0.1 * time**2 + 0.05 * time**3
    rates = [1 + 0.2 * time + 0.15 * time**2, 0.2 + 0.3 * time, 0.3]
    return stretched(Motion(3).reference(s), np.array(rates))


@pytest.mark.parametrize("way", [continued, in_another_time])
@pytest.mark.parametrize("time", [-0.1, 0.0, 0.2, 1.0, 4.0])
def test_its_rates_are_differences_of_what_they_are_the_rates_of(way, time):
    expected = rates_by_differences(way, time)[:15]
    np.testing.assert_allclose(way(time)[7:], expected, rtol=0, atol=1e-7)
