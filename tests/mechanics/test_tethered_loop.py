import numpy as np
import pytest

from drake_nonstop.mechanics.carrier import cable_vectors
from drake_nonstop.mechanics.tethered_loop import Orbit, bending


@pytest.mark.parametrize("seed", range(3))
def test_accelerations_and_jerks_depend_on_forces_and_rates_as_differences_tell(seed):
    f, rate, second_rate, third_rate = np.random.default_rng(seed).normal(size=(4, 2, 3))
    found = bending(Orbit(f, rate, second_rate, third_rate, f), 0.7)

    def motion(change):
        moved = f + change[:3], rate + change[3:], second_rate, third_rate
        return cable_vectors(moved, rest_length=0.7, compliance=0.0)[2:]

    for place, step in enumerate(1e-6 * np.eye(6)):
        expected = (np.array(motion(step)) - motion(-step)) / 2e-6
        for own, by_difference in zip(found, expected, strict=True):
            np.testing.assert_allclose(own[:, :, place], by_difference, rtol=1e-5, atol=1e-6)
