"""What the controllers believe of the wind, and how far an observer's estimate is off."""

import numpy as np
import pytest
import scipy.linalg
from helpers import fix, model, output
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from drake_nonstop import connect_by_name, load_scenario, simulate_many
from drake_nonstop.blocks.wind import GustyWind, GustyWindConfig, SteadyWind, SteadyWindConfig
from drake_nonstop.blocks.wind_estimator import (
    AssumedWind,
    AssumedWindConfig,
    LoadAnemometer,
    LoadAnemometerConfig,
    NoWind,
    WindObserver,
    WindObserverConfig,
)
from drake_nonstop.validation import ScenarioError

PERIOD = 0.05  # s
QUIET = {"airspeed_noise": 0.0}


def observed(wind, times, speed=15.0, **fields):
    """Estimates (k, 3) and variances (k,) of four carriers that circle in a block's wind."""
    builder = DiagramBuilder()
    own = model(4, PERIOD)
    angles = np.pi / 2 * np.arange(4)
    velocities = speed * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1)
    blocks = {"wind": wind(own), "observer": WindObserver(own, WindObserverConfig(**fields))}
    sizes = {"carrier_state": 24, "load_state": 13}
    read = {k for k in sizes if any(each.HasInputPort(k) for each in blocks.values())}
    connect_by_name(builder, blocks, inputs={k: sizes[k] for k in read})
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    given = {"carrier_state": np.append(np.zeros(12), velocities), "load_state": np.eye(13)[0]}
    fix(diagram, context, **{k: v for k, v in given.items() if diagram.HasInputPort(k)})
    found = []
    for time in times:
        simulator.AdvanceTo(time)
        estimate, variance = (
            output(diagram, context, f"wind_{name}").copy() for name in ("estimate", "variance")
        )
        found.append(np.append(estimate, variance))
    return np.array(found)[:, :3], np.array(found)[:, 3]


def rising(own):
    return SteadyWind(own, SteadyWindConfig(velocity=[3.0, -1.0, 0.5], start_time=1.0))


def test_an_estimate_follows_a_jump_of_the_wind_by_its_time_constant():
    estimates, _ = observed(rising, [0.5, 1.0, 3.0, 9.0], time_constant=2.0, **QUIET)
    shares = np.array([0, 0, 1 - np.exp(-1), 1 - np.exp(-4)])[:, None]
    np.testing.assert_allclose(estimates, shares * [3.0, -1.0, 0.5], atol=0.03)


def test_each_carriers_wind_is_followed_beside_the_mean():
    """Of gusts (1 − exp(−t/T_i)) and of their mean (1 − exp(−t/T)), from calm air on."""
    block = WindObserver(
        model(3, PERIOD), WindObserverConfig(time_constant=4.0, carrier_time_constant=1.0, **QUIET)
    )
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    fix(block, context, wind=np.zeros(9), carrier_state=np.zeros(18))
    simulator.Initialize()
    winds = np.array([[3.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0]])
    fix(block, context, wind=winds.ravel())
    simulator.AdvanceTo(2.0)
    mean = (1 - np.exp(-2 / 4)) * winds.mean(axis=0)
    np.testing.assert_allclose(output(block, context, "wind_estimate"), mean, atol=0.02)
    gusts = output(block, context, "carrier_gust_estimate").reshape(3, 3)
    np.testing.assert_allclose(gusts, (1 - np.exp(-2)) * winds - mean, atol=0.03)


def test_an_anemometer_tells_the_wind_at_the_load_and_that_of_each_carrier_beyond_it():
    """(1 − exp(−t/T)) of the load's wind, (1 − exp(−t/T_i)) of each carrier's."""
    fields = {"time_constant": 2.0, "carrier_time_constant": 1.0, "noise": 0.0, **QUIET}
    block = LoadAnemometer(model(3, PERIOD), LoadAnemometerConfig(**fields))
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    fix(block, context, load_wind=np.zeros(3), wind=np.zeros(9), carrier_state=np.zeros(18))
    simulator.Initialize()
    winds, at_load = np.array([[3.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0]]), np.array([0.5, 1.0, -2.0])
    fix(block, context, wind=winds.ravel(), load_wind=at_load)
    simulator.AdvanceTo(2.0)
    expected = (1 - np.exp(-2 / 2)) * at_load
    np.testing.assert_allclose(output(block, context, "wind_estimate"), expected, atol=0.02)
    gusts = output(block, context, "carrier_gust_estimate").reshape(3, 3)
    np.testing.assert_allclose(gusts, (1 - np.exp(-2)) * winds - expected, atol=0.04)


def test_noise_of_an_anemometer_passes_with_its_time_constant():
    """White noise ν held for samples of h leaves ν² h/(2 T), for h much below T (Lyapunov)."""
    fields = {"time_constant": 1.0, "noise": 0.5, "airspeed_noise": 0.0, "seed": 4}
    block = LoadAnemometer(model(4, PERIOD), LoadAnemometerConfig(**fields))
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    fix(block, context, load_wind=np.ones(3), wind=np.ones(12), carrier_state=np.zeros(24))
    simulator.Initialize()
    found = []
    for time in np.arange(5.0, 605.0, 1.0):
        simulator.AdvanceTo(time)
        found.append(output(block, context, "wind_estimate").copy())
    assert np.mean(found) == pytest.approx(1.0, abs=0.02)
    expected = 0.5 * np.sqrt(PERIOD / 2)
    assert np.std(found) == pytest.approx(expected, rel=0.1)


def test_errors_of_instruments_average_out_over_a_turn_but_in_the_wind_itself():
    """(1 + ε) R_z(ψ) turns and stretches the mean airspeed, −w, alone."""
    fields = {"heading_error": 0.1, "airspeed_error": 0.05, **QUIET}
    estimates, _ = observed(rising, [10.0], time_constant=0.5, **fields)
    c, s = np.cos(0.1), np.sin(0.1)
    turned = 1.05 * np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ [3.0, -1.0, 0.5]
    np.testing.assert_allclose(estimates[-1], turned, atol=1e-5)


def test_the_variance_is_that_of_the_error_of_the_filter():
    """Against the Lyapunov equation of [the mean wind's error, the mean gust], over time."""
    T, tau, n, q, gust, common, noise = 4.0, 7.0, 4, 0.1, 0.6, 0.3, 0.5
    fields = {"time_constant": T, "gust": gust, "gust_time": tau, "coherence": common}
    times = np.array([0.0, 0.5, 2.0, 5.0, 20.0])
    _, found = observed(rising, times, drift=q, airspeed_noise=noise, **fields)
    spread = gust**2 * (common + (1 - common) / n)
    rates = np.array([[-1 / T, 1 / T], [0, -1 / tau]])
    driven = np.diag([q**2 + noise**2 / n * PERIOD / T**2, 2 * spread / tau])
    steady = scipy.linalg.solve_continuous_lyapunov(rates, -driven)
    at_start = spread * np.ones((2, 2)) + np.diag([noise**2 / n, 0])
    for time, variance in zip(times, found, strict=True):
        moved = scipy.linalg.expm(rates * time)
        expected = steady + moved @ (at_start - steady) @ moved.T
        assert variance == pytest.approx(expected[0, 0], rel=0.01), time
    formula = spread * tau / (tau + T) + q**2 * T / 2 + noise**2 / n * PERIOD / (2 * T)
    assert steady[0, 0] == pytest.approx(formula, rel=1e-12)


def test_a_kalman_filter_that_measures_without_noise_gains_a_seventh():
    """With default values; y = w + g, of which ẏ + y/τ = w/τ + white noise of q and s."""
    c = WindObserverConfig()
    q, tau, spread = c.drift**2, c.gust_time, c.gust**2 / 4
    s = 2 * spread / tau
    kalman = scipy.linalg.solve_continuous_are(
        np.zeros((1, 1)), np.array([[1 / tau]]), np.array([[q]]), np.array([[q + s]]), s=[[q]]
    )
    assert kalman[0, 0] == pytest.approx(tau * (np.sqrt(q * (q + s)) - q), rel=1e-9)
    assert np.sqrt(kalman[0, 0]) == pytest.approx(0.201, abs=1e-3)
    ours = spread * tau / (tau + c.time_constant) + q * c.time_constant / 2
    assert np.sqrt(ours) == pytest.approx(0.236, abs=1e-3)
    assert np.sqrt(q / (q + s)) == pytest.approx(0.48, abs=5e-3)  # its gain at high frequencies


def test_in_gusts_of_half_a_metre_a_second_the_estimate_is_good_to_three_decimetres():
    def gusty(own):
        return GustyWind(own, GustyWindConfig(velocity=[2.0, 0, 0], gust=0.5, airspeed=40.0))

    estimates, variances = observed(gusty, np.arange(0.0, 30.0, 0.5))
    rms = np.sqrt(((estimates - [2.0, 0, 0]) ** 2).mean(axis=0))
    assert (rms > 0.05).all()
    assert (rms < 0.3).all()
    assert rms.max() < 1.5 * np.sqrt(variances[-1])


def test_none_and_assumed_winds_are_what_they_say():
    for block, expected in (
        (NoWind(model()), [0, 0, 0]),
        (AssumedWind(model(), AssumedWindConfig(velocity=[1.0, 2.0, 3.0])), [1, 2, 3]),
    ):
        context = block.CreateDefaultContext()
        np.testing.assert_array_equal(output(block, context, "wind_estimate"), expected)
        np.testing.assert_array_equal(block.describe_wind_estimate(), expected)


def test_a_loop_starts_with_what_its_carriers_observe():
    """The estimate at t = 0 is the carriers' mean wind, and repeats to the bit."""
    overrides = ["wind_estimator=WindObserver", "simulation_duration=0.4"]
    scenario = load_scenario("aircraft_co_rotating_gusty", overrides)
    runs = simulate_many([scenario] * 2)
    estimate, wind = (runs[0].signal(name) for name in ("wind_estimate", "wind"))
    np.testing.assert_allclose(estimate[0], wind[0].reshape(4, 3).mean(axis=0), rtol=1e-12)
    np.testing.assert_array_equal(*(run.signal("wind_estimate") for run in runs))
    assert runs[0].engine.startswith("compiled")


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"time_constant": 0.0}, "time_constant"),
        ({"airspeed_error": -1.0}, "airspeed_error"),
        ({"heading_error": 4.0}, "heading_error"),
        ({"coherence": 1.1}, "coherence"),
        ({"seed": -1}, "seed"),
    ],
)
def test_bad_observer(fields, field):
    with pytest.raises(ScenarioError, match=f"^wind_estimator\\.{field} = "):
        WindObserver(model(), WindObserverConfig(**fields))
