import numpy as np
import pytest

from drake_nonstop.mechanics.carrier import carrier_acceleration, carrier_jerk
from drake_nonstop.mechanics.signals import LOAD_REFERENCE_SIZE
from drake_nonstop.mechanics.tethered_loop import Orbit, bending


@pytest.mark.parametrize("seed", range(3))
def test_accelerations_and_jerks_depend_on_forces_and_rates_as_differences_tell(seed):
    f, rate, second_rate, third_rate = np.random.default_rng(seed).normal(size=(4, 2, 3))
    rest = np.zeros(LOAD_REFERENCE_SIZE)
    rest[0] = 1.0
    cables = {"attachments": np.zeros((2, 3)), "rest_length": 0.7, "compliance": 0.0}
    found = bending(Orbit(f, rate, second_rate, third_rate, f), 0.7)

    def motion(change):
        moved = f + change[:3], rate + change[3:], second_rate
        return np.stack(
            [
                carrier_acceleration(rest, *moved, **cables),
                carrier_jerk(rest, *moved, third_rate, **cables),
            ]
        )

    for place, step in enumerate(1e-6 * np.eye(6)):
        expected = (motion(step) - motion(-step)) / 2e-6
        for own, by_difference in zip(found, expected, strict=True):
            np.testing.assert_allclose(own[:, :, place], by_difference, rtol=1e-5, atol=1e-6)
