import copy
import math

import numpy as np
import pytest
from helpers import Motion, difference, rotation

from drake_nonstop.mechanics.reference_preview import ReferencePreview, continued_reference
from drake_nonstop.mechanics.signals import LoadReference


def reference_of(seed):
    return Motion(seed).reference(0.4)


@pytest.mark.parametrize("seed", range(3))
def test_a_continued_reference_begins_as_the_present_one(seed):
    now = reference_of(seed)
    np.testing.assert_allclose(continued_reference(now, 0.0), now, rtol=0, atol=1e-14)


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


def test_velocity_and_turn_rate_stay():
    now = LoadReference.view(reference_of(4))
    late = LoadReference.view(continued_reference(reference_of(4), [20.0, 25.0]))
    np.testing.assert_allclose(late.velocity, [now.velocity] * 2, atol=1e-12)
    np.testing.assert_allclose(late.acceleration, 0, atol=1e-12)
    np.testing.assert_allclose(late.position[1] - late.position[0], 5 * now.velocity, atol=1e-12)
    rates = np.linalg.norm(late.angular_velocity, axis=1)
    np.testing.assert_allclose(rates, np.linalg.norm(now.angular_velocity), rtol=1e-12)
    np.testing.assert_allclose(late.angular_velocity[0], late.angular_velocity[1], atol=1e-12)


def test_a_reference_at_rest_stays():
    rest = np.concatenate([np.eye(4)[0], [1.0, 2.0, 3.0], np.zeros(15)])
    np.testing.assert_array_equal(continued_reference(rest, np.linspace(0, 9, 5)), [rest] * 5)


def test_references_at_many_instants_are_those_at_each():
    preview = ReferencePreview(Motion(5).reference, end_time=3.0)
    assert math.isinf(ReferencePreview(Motion(5).reference).end_time)
    times = [0.1, 2.0]
    np.testing.assert_array_equal(preview.at(times), [preview(time) for time in times])
    assert preview.at([]).shape == (0, 22)
    assert copy.deepcopy(preview) is preview
