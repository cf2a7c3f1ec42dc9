import numpy as np
import pytest

from drake_nonstop.mechanics.carrier import carrier_acceleration
from drake_nonstop.mechanics.signals import LOAD_REFERENCE_SIZE
from drake_nonstop.mechanics.tethered_loop import _bending


@pytest.mark.parametrize("seed", range(3))
def test_accelerations_depend_on_forces_and_rates_as_differences_tell(seed):
    f, rate, second_rate = np.random.default_rng(seed).normal(size=(3, 1, 3))
    rest = np.zeros(LOAD_REFERENCE_SIZE)
    rest[0] = 1.0

    def acceleration(f, rate):
        cables = {"attachments": np.zeros((1, 3)), "rest_length": 1.0, "compliance": 0.0}
        return carrier_acceleration(rest, f, rate, second_rate, **cables)[0]

    steps = 1e-6 * np.eye(3)
    of_f, of_rate = _bending(f[0], rate[0], second_rate[0])
    for step, by_f, by_rate in zip(steps, of_f.T, of_rate.T, strict=True):
        change = acceleration(f + step, rate) - acceleration(f - step, rate)
        np.testing.assert_allclose(by_f, change / 2e-6, rtol=1e-5, atol=1e-7)
        change = acceleration(f, rate + step) - acceleration(f, rate - step)
        np.testing.assert_allclose(by_rate, change / 2e-6, rtol=1e-5, atol=1e-7)
