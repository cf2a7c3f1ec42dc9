import numpy as np
import pytest
from helpers import Motion, difference, rotation

from drake_nonstop.mechanics.reference_preview import continued_reference
from drake_nonstop.mechanics.signals import LoadReference


def reference_of(seed):
    return Motion(seed).reference(0.4)


@pytest.mark.parametrize("time", [-0.1, 0.0, 0.2, 1.0, 4.0])
def test_its_rates_are_differences_of_what_they_are_the_rates_of(time):
    now = reference_of(3)

    def at(t):
        return LoadReference.view(continued_reference(now, t))

    R = rotation(at(time).quaternion)
    S = difference(lambda t: rotation(at(t).quaternion), time) @ R.T
    parts = at(time)
    expected = {
        "angular_velocity": np.array([S[2, 1], S[0, 2], S[1, 0]]),
        "velocity": difference(lambda t: at(t).position, time),
        "angular_acceleration": difference(lambda t: at(t).angular_velocity, time),
        "acceleration": difference(lambda t: at(t).velocity, time),
        "jerk": difference(lambda t: at(t).acceleration, time),
    }
    for name, rate in expected.items():
        np.testing.assert_allclose(getattr(parts, name), rate, rtol=0, atol=1e-8, err_msg=name)
