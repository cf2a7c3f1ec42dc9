"""The wind, what it does to the load, and what the controllers believe of it."""

import numpy as np
import pytest
from helpers import model, output

from drake_nonstop import load_scenario, make_nonstop
from drake_nonstop.blocks.wind import (
    GustyWind,
    GustyWindConfig,
    SteadyWind,
    SteadyWindConfig,
)
from drake_nonstop.mechanics.wind import GUST_STEP, gust_samples, turbulence_at
from drake_nonstop.systems import wiring
from drake_nonstop.validation import ScenarioError

SIGNALS = ("wind", "load_wind", "mean_wind")
CONSTANT = "optimization_layer=!ConstantParameters {}"


def signals(block, times):
    """The block's signals at times, (k, size) each, by their names."""
    context = block.CreateDefaultContext()
    found = {name: [] for name in SIGNALS}
    for time in times:
        context.SetTime(time)
        for name in SIGNALS:
            found[name].append(output(block, context, name))
    return {name: np.array(values) for name, values in found.items()}


def gusts(times, n=4, **fields):
    """The wind (k, 3n) at n carriers."""
    block = GustyWind(model(n), GustyWindConfig(**fields))
    return signals(block, times)["wind"]


def test_a_steady_wind_rises_linearly_and_is_the_same_everywhere():
    velocity = np.array([3.0, -1.0, 0.5])
    config = SteadyWindConfig(velocity=velocity, start_time=10, rise_time=4)
    found = signals(SteadyWind(model(), config), [0, 10, 11, 12, 14, 15])
    shares = np.array([0, 0, 0.25, 0.5, 1, 1])[:, None]
    np.testing.assert_array_equal(found["wind"], shares * np.tile(velocity, 4))
    for name in ("load_wind", "mean_wind"):
        np.testing.assert_array_equal(found[name], shares * velocity)
    at_once = SteadyWindConfig(velocity=velocity, start_time=10)
    found = signals(SteadyWind(model(), at_once), [9.99, 10])
    np.testing.assert_array_equal(found["load_wind"], [np.zeros(3), velocity])


def dryden_spectrum(k, x):
    """Of u (0), v and w, over σ² τ, one-sided over Hz, at x = ωτ; MIL-F-8785C, 3.7.2.1."""
    return 4 / (1 + x**2) if k == 0 else 2 * (1 + 3 * x**2) / (1 + x**2) ** 2


class TestGusts:
    @pytest.mark.slow
    def test_spectra_are_drydens(self):
        """From a twentieth of a wave in the time constant to 10 Hz, where 64 waves left gaps."""
        times, count = np.array([3.0, 2.0, 1.5]), 1 << 13
        samples = gust_samples([[5, i] for i in range(60)], times, count)
        window = np.hanning(count)[:, None, None]
        power = (np.abs(np.fft.rfft(samples * window, axis=0)) ** 2).mean(axis=1)
        power *= 2 * GUST_STEP / (window**2).sum()
        frequencies = np.fft.rfftfreq(count, GUST_STEP)
        for low, high in ((0.03, 0.1), (0.1, 0.3), (0.3, 1), (1, 2.9), (2.9, 3.1), (3.1, 10)):
            band = (low <= frequencies) & (frequencies < high)
            for k, time in enumerate(times):
                expected = time * dryden_spectrum(k, 2 * np.pi * frequencies[band] * time)
                assert power[band, k].mean() == pytest.approx(expected.mean(), rel=0.12), (low, k)

    def test_variances_and_correlations_are_stationary_from_the_start(self):
        """E x(t) x(t + s): exp(−s/τ) of u, (1 − s/2τ) exp(−s/τ) of v and w, and 0 of two noises."""
        times = np.array([3.0, 0.5, 300.0])
        samples = gust_samples([[1, i] for i in range(4000)], times, 65)
        lags = GUST_STEP * np.arange(65)[:, None] / times
        expected = np.exp(-lags) * (1 - np.array([0, 0.5, 0.5]) * lags)
        found = np.einsum("tki,ki->ti", samples, samples[0]) / len(samples[0])
        np.testing.assert_allclose(found, expected, atol=0.07)
        np.testing.assert_allclose(samples.var(axis=1), 1, atol=0.08)
        between = np.corrcoef(samples[-1, ::2].T, samples[-1, 1::2].T)
        np.testing.assert_allclose(between, np.eye(6), atol=0.08)

    def test_lengths_and_deviations_are_the_standards(self):
        """At 100 and 1000 ft: by hand from MIL-F-8785C; at 1000 ft all lengths are 1000 ft."""
        lengths, ratio = turbulence_at(1000 * 0.3048)
        np.testing.assert_allclose(lengths, 304.8, rtol=1e-9)
        assert ratio == pytest.approx(1.0, rel=1e-9)
        lengths, ratio = turbulence_at(100 * 0.3048)
        np.testing.assert_allclose(lengths, np.array([505.2, 505.2, 100]) * 0.3048, rtol=1e-3)
        assert ratio == pytest.approx(1.716, rel=1e-3)

    def test_deviations_and_axes_over_seeds(self):
        """u is along the mean wind; carriers and load have gusts of their own."""
        fields = {
            "velocity": [0.0, 3.0, 0.0],
            "gust": 0.5,
            "load_gust": 0.4,
            "airspeed": 40.0,
        }
        lag = 2.5  # s
        draws, own = [], model()
        for seed in range(300):
            block = GustyWind(own, GustyWindConfig(**fields, seed=seed))
            draws.append(np.hstack(block.precomputed_inputs(SIGNALS[:2], np.array([0.0, lag]))))
        found, later = np.moveaxis(draws, 1, 0)  # (300, 15) each
        vertical = 0.5 / turbulence_at(100.0)[1], 0.4 / turbulence_at(20.0)[1]
        deviations = np.array([*np.tile([0.5, 0.5, vertical[0]], 4), 0.4, 0.4, vertical[1]])
        np.testing.assert_allclose(found.std(axis=0), deviations, rtol=0.15)
        np.testing.assert_allclose(np.corrcoef(found.T), np.eye(15), atol=0.22)
        correlated = ((found * later).mean(axis=0) / deviations**2)[:12].reshape(4, 3).mean(axis=0)
        s = lag * 40.0 / turbulence_at(100.0)[0][[1, 0, 2]]
        expected = np.exp(-s) * (1 - np.array([0.5, 0, 0.5]) * s)
        np.testing.assert_allclose(correlated, expected, atol=0.1)

    def test_a_flight_that_is_too_long_for_its_gusts_is_refused(self):
        with pytest.raises(ScenarioError, match=r"^wind = GustyWind at t = 20000 s: "):
            gusts([2e4])

    def test_repeat_to_the_bit_whatever_the_number_of_carriers_and_the_order_of_times(self):
        times = [0.0, 3.7, 1.2]
        found = gusts(times, seed=7)
        np.testing.assert_array_equal(gusts(times[::-1], seed=7)[::-1], found)
        np.testing.assert_array_equal(gusts(times, n=3, seed=7), found[:, :9])
        assert np.abs(gusts(times, seed=8) - found).max() > 0.1


def start_offset(*settings):
    """How far from its reference the load starts at rest (3,), m."""
    nonstop = make_nonstop(load_scenario("quintic", [CONSTANT, *settings]))
    context = nonstop.CreateDefaultContext()
    load, reference = (output(nonstop, context, name) for name in ("load_state", "reference"))
    return load[4:7] - reference[4:7]


def test_controllers_that_know_the_wind_hold_the_load_where_it_should_be():
    windy = "wind=!SteadyWind {velocity: [2, 0, 0]}"
    np.testing.assert_allclose(start_offset(windy), 0, atol=1e-7)
    drift = start_offset(windy, "wind_estimator=NoWind")
    assert drift[0] > 0.01
    assert np.abs(drift[1:]).max() < 0.2 * drift[0]


def test_sampled_controllers_hold_an_estimate_that_changes():
    wire = "{}.{}wind_estimate -> wrench_controller.wind_estimate"
    direct, held = ("wind_estimator", ""), ("sample_and_hold", "held_")
    for block, estimator, source in (
        ("StillAir", "KnownWind", direct),
        ("SteadyWind", "KnownWind", direct),
        ("!SteadyWind {rise_time: 1}", "KnownWind", held),
        ("GustyWind", "KnownWind", held),
        ("GustyWind", "NoWind", direct),
        ("GustyWind", "WindObserver", direct),
    ):
        settings = [CONSTANT, f"wind={block}", f"wind_estimator={estimator}"]
        scenario = load_scenario("quintic", settings)
        nonstop = make_nonstop(scenario, at_equilibrium=False)
        assert wire.format(*source) in wiring.connections(nonstop)
