"""The disturbances of the load."""

import numpy as np
from helpers import model, output

from drake_nonstop.blocks.load_disturbance import (
    DisturbanceForce,
    DisturbanceForceConfig,
)


def wrenches(config, times):
    block = DisturbanceForce(model(), config)
    context = block.CreateDefaultContext()
    results = []
    for time in times:
        context.SetTime(time)
        results.append(output(block, context, "disturbance_wrench").copy())
    return np.array(results)


def test_force_is_constant_but_for_its_gust():
    config = DisturbanceForceConfig(force=[1, 2, 3], torque=[4, 5, 6], start_time=0.5)
    before, after = wrenches(config, [0.4, 0.6])
    np.testing.assert_array_equal(before, 0)
    np.testing.assert_array_equal(after, [4, 5, 6, 1, 2, 3])


def test_a_gust_has_its_deviation_and_correlation_time():
    config = DisturbanceForceConfig(gust_force=0.5, gust_time=0.4, seed=3)
    times = np.arange(0, 400, 0.05)
    forces = wrenches(config, times)[:, 3:]
    np.testing.assert_allclose(forces.std(axis=0), 0.5, rtol=0.1)
    assert np.abs(forces.mean(axis=0)).max() < 0.05
    lag = round(0.4 / 0.05)
    correlation = (forces[lag:] * forces[:-lag]).mean(axis=0) / forces.var(axis=0)
    np.testing.assert_allclose(correlation, np.exp(-1), atol=0.15)
    assert np.abs(np.corrcoef(forces.T) - np.eye(3)).max() < 0.1
    np.testing.assert_array_equal(forces[:9], wrenches(config, times[:9])[:, 3:])
    config.seed = 4
    assert np.abs(forces[:9] - wrenches(config, times[:9])[:, 3:]).max() > 0.01
