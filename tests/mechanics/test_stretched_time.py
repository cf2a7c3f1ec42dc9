import numpy as np
import pytest
from helpers import Motion, difference, rotation

from drake_nonstop.mechanics.reference_preview import stretched, stretched_higher_rates
from drake_nonstop.mechanics.signals import LoadReference


def own_time(t):
    """s, ṡ, s̈, s⃛, s⁗ of a time that passes at 0.3 to 1.3."""
    return np.array(
        [
            0.8 * t + 0.25 * np.sin(2 * t),
            0.8 + 0.5 * np.cos(2 * t),
            -np.sin(2 * t),
            -2 * np.cos(2 * t),
            4 * np.sin(2 * t),
        ]
    )


def in_time(t):
    s, *rates = own_time(t)
    return LoadReference.view(stretched(Motion(7).reference(s), np.array(rates)))


@pytest.mark.parametrize("time", [-0.4, 0.3, 1.1])
def test_rates_are_the_differences_of_what_they_are_the_rates_of(time):
    now = in_time(time)
    S = difference(lambda t: rotation(in_time(t).quaternion), time) @ rotation(now.quaternion).T
    expected = {
        "angular_velocity": np.array([S[2, 1], S[0, 2], S[1, 0]]),
        "velocity": difference(lambda t: in_time(t).position, time),
        "angular_acceleration": difference(lambda t: in_time(t).angular_velocity, time),
        "acceleration": difference(lambda t: in_time(t).velocity, time),
        "jerk": difference(lambda t: in_time(t).acceleration, time),
    }
    for name, rate in expected.items():
        np.testing.assert_allclose(getattr(now, name), rate, rtol=0, atol=1e-7, err_msg=name)


def jerks(reference):
    """[ω̇, jerk] (6,), whose rates are the higher ones."""
    at = LoadReference.view(reference)
    return np.concatenate([at.angular_acceleration, at.jerk])


@pytest.mark.parametrize("time", [-0.4, 0.3, 1.1])
def test_higher_rates_are_the_differences_of_the_accelerations_and_of_the_jerk(time):
    s, *rates = own_time(time)
    motion = Motion(7).reference
    higher = difference(lambda s: jerks(motion(s)), s)
    expected = difference(lambda t: jerks(np.concatenate(in_time(t))), time)
    found = stretched_higher_rates(motion(s), higher, np.array(rates))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


def test_at_the_rate_1_nothing_changes_to_the_bit():
    references = np.array([Motion(1).reference(t) for t in (0.0, 0.5)])
    higher = np.arange(12.0).reshape(2, 6)
    rates = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    np.testing.assert_array_equal(stretched(references, rates), references)
    found = stretched_higher_rates(references, higher, rates)
    np.testing.assert_array_equal(found, higher)
