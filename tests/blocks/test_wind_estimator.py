"""What the controllers believe of the wind, and how far an observer's estimate is off."""

import numpy as np
import pytest
from helpers import fix, model, output
from pydrake.systems.analysis import Simulator

from drake_nonstop.blocks.wind_estimator import (
    LoadAnemometer,
    LoadAnemometerConfig,
    WindObserver,
    WindObserverConfig,
)

PERIOD = 0.05  # s
BOTH = pytest.mark.parametrize(
    ("kind", "config"), [(WindObserver, WindObserverConfig), (LoadAnemometer, LoadAnemometerConfig)]
)
# m/s, of three carriers at the start and later, and at the load.
WINDS = np.array([[[1.0, 2, 0], [1, 0, 0.5], [0, 1, 0]], [[3.0, 0, 0], [0, 1, 0], [0, 0, -1]]])
AT_LOAD = np.array([[0.2, -0.3, 0.4], [0.5, 1.0, -2.0]])


def begun(block, winds, at_load):
    """A simulator that has begun in these winds, and what then sets others."""
    simulator = Simulator(block)

    def blow(winds, at_load):
        inputs = {"wind": np.ravel(winds), "load_wind": at_load}
        given = {name: value for name, value in inputs.items() if name in block.reads}
        fix(block, simulator.get_mutable_context(), **given)

    blow(winds, at_load)
    simulator.Initialize()
    return simulator, blow


@BOTH
def test_from_the_winds_at_the_start_on_each_estimate_follows_by_its_time_constant(kind, config):
    """w + (1 − exp(−t/T)) (w′ − w) of the mean, or the load's wind, and T_i of each carrier's."""
    noises = {name: 0.0 for name in vars(config()) if name.endswith("noise")}
    block = kind(model(3, PERIOD), config(time_constant=4.0, carrier_time_constant=1.0, **noises))
    simulator, blow = begun(block, WINDS[0], AT_LOAD[0])
    of_all = AT_LOAD if kind is LoadAnemometer else WINDS.mean(axis=1)
    for time, allowed in ((0.0, 1e-12), (2.0, 0.04)):
        simulator.AdvanceTo(time)
        context, passed = simulator.get_context(), 1 - np.exp(-time / np.array([4.0, 1.0]))
        expected = of_all[0] + passed[0] * (of_all[1] - of_all[0])
        np.testing.assert_allclose(output(block, context, "wind_estimate"), expected, atol=allowed)
        gusts = output(block, context, "carrier_gust_estimate").reshape(3, 3)
        own = WINDS[0] + passed[1] * (WINDS[1] - WINDS[0])
        np.testing.assert_allclose(gusts, own - expected, atol=allowed)
        blow(WINDS[1], AT_LOAD[1])


@pytest.mark.slow
@BOTH
def test_noise_passes_with_the_time_constant(kind, config):
    """White noise ν held for samples of h leaves ν² h/(2 T), for h much below T (Lyapunov)."""
    noises = {name: 0.5 for name in vars(config()) if name.endswith("noise")}
    block = kind(model(4, PERIOD), config(time_constant=1.0, seed=4, **noises))
    simulator, _ = begun(block, np.ones(12), np.ones(3))
    found = []
    for time in np.arange(5.0, 205.0, 1.0):
        simulator.AdvanceTo(time)
        found.append(output(block, simulator.get_context(), "wind_estimate"))
    assert np.mean(found) == pytest.approx(1.0, abs=0.04)
    expected = 0.5 * np.sqrt(PERIOD / 2) / (2 if kind is WindObserver else 1)  # of four sensors
    assert np.std(found) == pytest.approx(expected, rel=0.15)
