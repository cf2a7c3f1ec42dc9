import numpy as np
import pytest
from helpers import Motion, rates_by_differences

from drake_nonstop.mechanics.reference_preview import continued_reference


@pytest.mark.parametrize("time", [-0.1, 0.0, 0.2, 1.0, 4.0])
def test_its_rates_are_differences_of_what_they_are_the_rates_of(time):
    now = Motion(3).reference(0.4)
    expected = rates_by_differences(lambda t: continued_reference(now, t), time)[:15]
    found = continued_reference(now, time)[7:]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)
