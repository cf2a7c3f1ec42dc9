"""The disturbance of the load: constant from its start on, and its gust's statistics."""

import numpy as np
from helpers import model, outputs

from drake_nonstop.blocks.load_disturbance import DisturbanceForce, DisturbanceForceConfig


def wrenches(times, **fields):
    block = DisturbanceForce(model(), DisturbanceForceConfig(**fields))
    return np.array([outputs(block, time=time)["disturbance_wrench"] for time in times])


def test_force_is_constant_but_for_its_gust():
    found = wrenches([0.4, 0.6], force=[1, 2, 3], torque=[4, 5, 6], start_time=0.5)
    np.testing.assert_array_equal(found, [np.zeros(6), [4, 5, 6, 1, 2, 3]])


def test_a_gust_has_its_deviation_and_correlation_time():
    fields, times = {"gust_force": 0.5, "gust_time": 0.4}, np.arange(0, 400, 0.05)
    forces = wrenches(times, **fields, seed=3)[:, 3:]
    np.testing.assert_allclose(forces.std(axis=0), 0.5, rtol=0.1)
    assert np.abs(forces.mean(axis=0)).max() < 0.05
    lag = round(0.4 / 0.05)
    correlation = (forces[lag:] * forces[:-lag]).mean(axis=0) / forces.var(axis=0)
    np.testing.assert_allclose(correlation, np.exp(-1), atol=0.15)
    assert np.abs(np.corrcoef(forces.T) - np.eye(3)).max() < 0.1
    assert np.abs(forces[:9] - wrenches(times[:9], **fields, seed=4)[:, 3:]).max() > 0.01
