"""The wind, its gusts against MIL-F-8785C, and loads that are held in it."""

import numpy as np
import pytest
from helpers import model, outputs

from drake_nonstop import ScenarioError
from drake_nonstop.blocks.wind import GustyWind, GustyWindConfig, SteadyWind, SteadyWindConfig
from drake_nonstop.mechanics.wind import GUST_STEP, gust_samples, turbulence_at


def shown(block, times, name):
    """A signal of a block at times, (k, size)."""
    return np.array([outputs(block, time=time)[name] for time in times])


def test_a_steady_wind_rises_linearly_and_is_the_same_everywhere():
    velocity = np.array([3.0, -1.0, 0.5])
    for rise_time, times, shares in (
        (4, [0, 10, 11, 12, 14, 15], [0, 0, 0.25, 0.5, 1, 1]),
        (0, [9.99, 10], [0, 1]),
    ):
        config = SteadyWindConfig(velocity=velocity, start_time=10, rise_time=rise_time)
        for name, count in (("wind", 4), ("load_wind", 1), ("mean_wind", 1)):
            found = shown(SteadyWind(model(), config), times, name)
            np.testing.assert_array_equal(found, np.outer(shares, np.tile(velocity, count)))


@pytest.mark.slow
def test_spectra_of_gusts_are_drydens():
    """MIL-F-8785C, 3.7.2.1: from a twentieth of a wave in the time constant to 10 Hz.

    Those of u, and of v and w, one-sided over Hz; 64 waves left gaps.
    """
    times, count = np.array([3.0, 2.0, 1.5]), 1 << 13
    samples = gust_samples([[5, i] for i in range(60)], times, count)
    window = np.hanning(count)[:, None, None]
    power = (np.abs(np.fft.rfft(samples * window, axis=0)) ** 2).mean(axis=1)
    power *= 2 * GUST_STEP / (window**2).sum()
    frequencies = np.fft.rfftfreq(count, GUST_STEP)
    for low, high in ((0.03, 0.1), (0.1, 0.3), (0.3, 1), (1, 2.9), (2.9, 3.1), (3.1, 10)):
        band = (low <= frequencies) & (frequencies < high)
        for k, time in enumerate(times):
            square = (2 * np.pi * frequencies[band] * time) ** 2
            u, v = 4 / (1 + square), 2 * (1 + 3 * square) / (1 + square) ** 2
            expected = time * (u if k == 0 else v).mean()
            assert power[band, k].mean() == pytest.approx(expected, rel=0.12), (low, k)


@pytest.mark.parametrize(
    ("feet", "lengths", "ratio"), [(1000, [1000.0] * 3, 1.0), (100, [505.2, 505.2, 100], 1.716)]
)
def test_lengths_and_deviations_of_gusts_are_the_standards(feet, lengths, ratio):
    """By hand from MIL-F-8785C."""
    found = turbulence_at(feet * 0.3048)
    np.testing.assert_allclose(found[0], np.array(lengths) * 0.3048, rtol=1e-3)
    assert found[1] == pytest.approx(ratio, rel=1e-3)


def test_gusts_have_their_deviations_and_axes_over_seeds():
    """u is along the mean wind; carriers and load have gusts of their own."""
    fields = {"velocity": [0.0, 3.0, 0.0], "gust": 0.5, "load_gust": 0.4, "airspeed": 40.0}
    lag, draws, own = 2.5, [], model()  # s
    for seed in range(300):
        block = GustyWind(own, GustyWindConfig(**fields, seed=seed))
        rows = block.precomputed_inputs(["wind", "load_wind"], np.array([0.0, lag]))
        draws.append(np.hstack(rows))
    found, later = np.moveaxis(draws, 1, 0)  # (300, 15) each
    vertical = 0.5 / turbulence_at(100.0)[1], 0.4 / turbulence_at(20.0)[1]
    deviations = np.array([*np.tile([0.5, 0.5, vertical[0]], 4), 0.4, 0.4, vertical[1]])
    np.testing.assert_allclose(found.std(axis=0), deviations, rtol=0.15)
    np.testing.assert_allclose(np.corrcoef(found.T), np.eye(15), atol=0.22)
    correlated = ((found * later).mean(axis=0) / deviations**2)[:12].reshape(4, 3).mean(axis=0)
    s = lag * 40.0 / turbulence_at(100.0)[0][[1, 0, 2]]
    expected = np.exp(-s) * (1 - np.array([0.5, 0, 0.5]) * s)
    np.testing.assert_allclose(correlated, expected, atol=0.1)


def test_gusts_repeat_to_the_bit_whatever_the_number_of_carriers_and_the_order_of_times():
    def gusts(times, n=4, seed=7):
        return shown(GustyWind(model(n), GustyWindConfig(seed=seed)), times, "wind")

    times = [0.0, 3.7, 1.2]
    found = gusts(times)
    np.testing.assert_array_equal(gusts(times[::-1])[::-1], found)
    np.testing.assert_array_equal(gusts(times, n=3), found[:, :9])
    assert np.abs(gusts(times, seed=8) - found).max() > 0.1
    with pytest.raises(ScenarioError, match=r"^wind = GustyWind at t = 20000 s: "):
        gusts([2e4])
