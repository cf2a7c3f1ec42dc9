"""Rotations against Drake, SciPy and NumPy."""

import numpy as np
import pytest
from helpers import difference, rotation
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RollPitchYaw
from scipy.spatial.transform import Rotation

from drake_nonstop.mechanics.rotation import (
    angular_velocity_of,
    quaternion_product,
    roll_pitch_yaw_to_quaternion,
    rotation_matrix,
    rotation_vector,
)
from drake_nonstop.mechanics.taylor import Taylor


def test_rotation_matrix_and_quaternion_product_are_drakes_row_by_row(rng):
    for quaternion in rng.normal(size=(20, 4)):
        expected = rotation(quaternion)
        np.testing.assert_allclose(rotation_matrix(quaternion), expected, rtol=0, atol=1e-14)
    a, b = rng.normal(size=(2, 20, 4))
    a, b = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (a, b))
    pairs = zip(a, b, strict=True)
    expected = [Quaternion(wxyz=p).multiply(Quaternion(wxyz=q)).wxyz() for p, q in pairs]
    np.testing.assert_allclose(quaternion_product(a, b), expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(quaternion_product(a[0], b[0]), expected[0], rtol=0, atol=1e-15)


def test_rotation_vector_is_scipys_whatever_norm_and_sign(rng):
    quaternions = rng.normal(size=(50, 4))
    expected = Rotation.from_quat(quaternions[:, [1, 2, 3, 0]]).as_rotvec()
    for scale in (1.0, -1.0, 0.2):
        vectors = rotation_vector(scale * quaternions)
        np.testing.assert_allclose(vectors, expected, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(rotation_vector(np.array([-1.0, 0, 0, 0])), 0)
    small = rotation_vector(np.array([1.0, 1e-9, -2e-9, 0]))
    np.testing.assert_allclose(small, [2e-9, -4e-9, 0], rtol=1e-15)


def test_roll_pitch_yaw_to_quaternion_is_drakes_and_does_not_flip_over_a_full_turn(rng):
    for angles in [*rng.uniform(-1.5, 1.5, (20, 3)), np.zeros(3), np.array([3.0, 0.1, -3.0])]:
        quaternion = roll_pitch_yaw_to_quaternion(angles)
        assert np.linalg.norm(quaternion) == pytest.approx(1, abs=1e-15)
        expected = RollPitchYaw(angles).ToRotationMatrix().matrix()
        np.testing.assert_allclose(rotation_matrix(quaternion), expected, rtol=0, atol=1e-14)
    yaws = np.linspace(-3, 3, 601)
    turned = np.array([roll_pitch_yaw_to_quaternion(np.array([0.2, 0.1, yaw])) for yaw in yaws])
    assert np.max(np.linalg.norm(np.diff(turned, axis=0), axis=1)) < 0.006


def test_angular_acceleration_is_the_inverse_of_drakes_and_the_jerk_its_difference(rng):
    for angles, rate, acceleration, jerk in rng.uniform(-1.2, 1.2, (20, 4, 3)):

        def motion(t, a=angles, b=rate, c=acceleration, d=jerk):
            now = a + b * t + c * t**2 / 2 + d * t**3 / 6, b + c * t + d * t**2 / 2
            return angular_velocity_of(Taylor.of_rates(*now, c + d * t, d)).rates

        _, found, its_rate = motion(0.0)
        back = RollPitchYaw(angles).CalcRpyDDtFromRpyDtAndAngularAccelInParent(rate, found)
        np.testing.assert_allclose(back, acceleration, rtol=0, atol=1e-12)
        expected = difference(lambda t, motion=motion: motion(t)[1], 0.0)
        np.testing.assert_allclose(its_rate, expected, rtol=0, atol=1e-6)
