"""The wind, what it does to the load, and what the controllers believe of it."""

import warnings

import numpy as np
import pytest
from helpers import fix, model, output
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem

from drake_nonstop import ScenarioWarning, load_scenario, make_nonstop, simulate
from drake_nonstop.blocks.load_plant import LoadPlant, MultibodyLoadPlant
from drake_nonstop.blocks.wind import (
    GustyWind,
    GustyWindConfig,
    SteadyWind,
    SteadyWindConfig,
    StillAir,
    WindProfile,
    WindProfileConfig,
)
from drake_nonstop.mechanics.wind import random_waves
from drake_nonstop.systems import wiring
from drake_nonstop.validation import ScenarioError

SIGNALS = ("wind", "load_wind", "wind_estimate")
CONSTANT = "optimization_layer=!ConstantParameters {}"


def signals(block, times, load_height=0.0, carrier_heights=(0.0, 0.0, 0.0, 0.0)):
    """The block's signals at times, (k, size) each, by their names."""
    context = block.CreateDefaultContext()
    if block.num_input_ports() > 0:
        carriers = np.zeros((2, len(carrier_heights), 3))
        carriers[0, :, 2] = carrier_heights
        load = np.eye(13)[0]
        load[6] = load_height
        fix(block, context, carrier_state=carriers.ravel(), load_state=load)
    found = {name: [] for name in SIGNALS}
    for time in times:
        context.SetTime(time)
        for name in SIGNALS:
            found[name].append(output(block, context, name))
    return {name: np.array(values) for name, values in found.items()}


def gusts(times, n=4, **fields):
    """The wind (k, 3n) at n carriers."""
    block = GustyWind(model(n), GustyWindConfig(**fields))
    return signals(block, times, carrier_heights=np.zeros(n))["wind"]


def test_still_air_does_not_move():
    for name, values in signals(StillAir(model()), [0.0, 1.0]).items():
        np.testing.assert_array_equal(values, 0, err_msg=name)


def test_a_steady_wind_rises_linearly_and_is_the_same_everywhere():
    velocity = np.array([3.0, -1.0, 0.5])
    config = SteadyWindConfig(velocity=velocity, start_time=10, rise_time=4)
    found = signals(SteadyWind(model(), config), [0, 10, 11, 12, 14, 15])
    shares = np.array([0, 0, 0.25, 0.5, 1, 1])[:, None]
    np.testing.assert_array_equal(found["wind"], shares * np.tile(velocity, 4))
    for name in ("load_wind", "wind_estimate"):
        np.testing.assert_array_equal(found[name], shares * velocity)
    at_once = SteadyWindConfig(velocity=velocity, start_time=10)
    found = signals(SteadyWind(model(), at_once), [9.99, 10])
    np.testing.assert_array_equal(found["load_wind"], [np.zeros(3), velocity])


@pytest.mark.parametrize("block", [SteadyWind, WindProfile, GustyWind])
def test_what_is_believed_may_differ_from_the_mean_wind_at_the_load(block):
    config = {
        SteadyWind: SteadyWindConfig,
        WindProfile: WindProfileConfig,
        GustyWind: GustyWindConfig,
    }[block](velocity=[5.0, 0, 0])
    true = signals(block(model(), config), [1.0], load_height=10)
    np.testing.assert_allclose(true["wind_estimate"], [[5.0, 0, 0]])
    config.believed = [0.0, 1.0, 0.0]
    found = signals(block(model(), config), [1.0], load_height=10)
    np.testing.assert_array_equal(found["wind_estimate"], [[0, 1, 0]])
    np.testing.assert_array_equal(found["load_wind"], true["load_wind"])


def test_a_profile_follows_the_power_law():
    config = WindProfileConfig(
        velocity=[4.0, 3.0, 0.0], exponent=0.2, reference_height=20, ground_height=5
    )
    heights = np.array([25.0, 125.0, 6.0, -3.0])
    found = signals(WindProfile(model(), config), [0.0], 15.0, heights)
    winds = found["wind"].reshape(4, 3)
    np.testing.assert_allclose(winds[:, 0] / 4, winds[:, 1] / 3, rtol=1e-14)
    # ln w is linear in ln h; at 1 m above the ground and below it w is the same.
    speeds = np.exp(np.log(5) + 0.2 * np.log(np.array([20, 120, 1, 1]) / 20))
    np.testing.assert_allclose(np.linalg.norm(winds, axis=1), speeds, rtol=1e-13)
    speed = np.exp(np.log(5) + 0.2 * np.log(10 / 20))
    for name in ("load_wind", "wind_estimate"):
        np.testing.assert_allclose(np.linalg.norm(found[name]), speed, rtol=1e-13)


class TestGusts:
    @pytest.mark.nightly("studies")
    def test_deviation_correlation_and_independence_over_seeds(self):
        """Against E x_i(t) x_j(t + s) = δ_ij σ² exp(−|s|/τ)."""
        tau, lags = 50 / 15, np.array([0.0, 0.3, 1.0, 2.0])
        starts = np.arange(30) * 20 * tau
        times = (starts[:, None] + lags * tau).ravel()
        draws = np.concatenate(
            [gusts(times, gust=0.5, seed=seed).reshape(30, 4, 12) for seed in range(60)]
        )
        deviations = np.tile([0.5, 0.5, 0.3], 4)
        scaled = draws / deviations  # (draws, lags, noises)
        np.testing.assert_allclose(draws.std(axis=(0, 1)), deviations, rtol=0.05)
        np.testing.assert_allclose(scaled.mean(axis=(0, 1)), 0, atol=0.08)
        products = np.einsum("kli,kj->lij", scaled, scaled[:, 0]) / len(scaled)
        own = np.diagonal(products, axis1=1, axis2=2)  # (lags, noises)
        np.testing.assert_allclose(own.mean(axis=1), np.exp(-lags), atol=0.03)
        np.testing.assert_allclose(own, np.exp(-lags)[:, None] * np.ones(12), atol=0.11)
        others = products[:, ~np.eye(12, dtype=bool)]
        np.testing.assert_allclose(others, 0, atol=0.11)

    def test_spectrum_of_each_draw(self):
        """Against the power below ω of the first-order spectrum, in proportion to arctan ωτ."""
        tau, count = 3.0, 64
        waves = random_waves(np.random.default_rng(5), 50, tau, count=count, highest=100.0)
        for x in (0.1, 0.3, 1.0, 3.0, 10.0, 50.0):
            share = (waves.frequencies * tau < x).mean(axis=1)
            np.testing.assert_allclose(share, np.arctan(x) / np.arctan(100), atol=1 / count)

    def test_repeat_to_the_bit_whatever_the_number_of_carriers_and_the_order_of_times(self):
        times = [0.0, 3.7, 1.2]
        found = gusts(times, seed=7)
        np.testing.assert_array_equal(gusts(times[::-1], seed=7)[::-1], found)
        np.testing.assert_array_equal(gusts(times, n=3, seed=7), found[:, :9])
        assert np.abs(gusts(times, seed=8) - found).max() > 0.1

    def test_repeat_to_the_bit_whatever_the_steps_are(self):
        settings = [CONSTANT, "simulation_duration=0.1", "wind=!GustyWind {seed: 3}"]
        runs = [
            simulate(load_scenario("quintic", [*settings, f"simulator_config.max_step_size={h}"]))
            for h in (0.005, 0.002)
        ]
        name = next(name for name in runs[0].signals if name.split(".")[-1] == "wind")
        np.testing.assert_array_equal(*(run.signals[name] for run in runs))

    def test_a_load_has_gusts_of_its_own_where_it_is_given_some(self):
        times = 50.0 * np.arange(400)
        fields = {"velocity": [2.0, 0, 0], "seed": 1}
        calm = signals(GustyWind(model(), GustyWindConfig(**fields)), times[:3])
        np.testing.assert_array_equal(calm["load_wind"], [[2, 0, 0]] * 3)
        found = signals(GustyWind(model(), GustyWindConfig(**fields, load_gust=0.4)), times)
        np.testing.assert_allclose(found["load_wind"].std(axis=0), [0.4, 0.4, 0.24], rtol=0.15)
        np.testing.assert_array_equal(found["wind_estimate"], [[2, 0, 0]] * 400)
        both = np.hstack([found["wind"], found["load_wind"]])
        assert np.abs(np.corrcoef(both.T) - np.eye(15)).max() < 0.25


@pytest.mark.parametrize("plant", [LoadPlant, MultibodyLoadPlant])
def test_a_falling_load_approaches_its_terminal_velocity_in_wind(plant):
    block = plant(model(load_drag=0.7))
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    wind = np.array([3.0, -2.0, 1.0])
    fix(block, context, cable_forces=np.zeros(12), disturbance_wrench=np.zeros(6), load_wind=wind)
    block.SetLoadState(context, np.eye(13)[0])
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    simulator.AdvanceTo(3.0)
    terminal = wind - np.array([0, 0, 9.81 / 0.7])  # m = 1 kg
    expected = terminal * (1 - np.exp(-0.7 * 3.0))
    np.testing.assert_allclose(output(block, context, "load_state")[10:], expected, atol=1e-6)


def start_offset(*settings):
    """How far from its reference the load starts at rest (3,), m."""
    nonstop = make_nonstop(load_scenario("quintic", [CONSTANT, *settings]))
    context = nonstop.CreateDefaultContext()
    load, reference = (output(nonstop, context, name) for name in ("load_state", "reference"))
    return load[4:7] - reference[4:7]


def test_controllers_that_know_the_wind_hold_the_load_where_it_should_be():
    windy = "wind=!SteadyWind {velocity: [2, 0, 0]%s}"
    np.testing.assert_allclose(start_offset(windy % ""), 0, atol=1e-7)
    drift = start_offset(windy % ", believed: [0, 0, 0]")
    assert drift[0] > 0.01
    assert np.abs(drift[1:]).max() < 0.2 * drift[0]


def test_sampled_controllers_hold_an_estimate_that_changes():
    wire = "{}.{}wind_estimate -> wrench_controller.wind_estimate"
    for block, source in (
        ("StillAir", ("wind", "")),
        ("SteadyWind", ("wind", "")),
        ("!SteadyWind {rise_time: 1}", ("sample_and_hold", "held_")),
        ("WindProfile", ("sample_and_hold", "held_")),
    ):
        scenario = load_scenario("quintic", [CONSTANT, f"wind={block}"])
        nonstop = make_nonstop(scenario, at_equilibrium=False)
        assert wire.format(*source) in wiring.connections(nonstop)


class DeafLoadPlant(LeafSystem):
    """A load that stays where it is, and reads no wind."""

    def __init__(self, model):
        super().__init__()
        self.DeclareVectorInputPort("cable_forces", 3 * model.n)
        state = self.DeclareDiscreteState(np.eye(13)[0])
        self.DeclareStateOutputPort("load_state", state)


def test_a_load_that_does_not_read_the_wind_is_told():
    scenario = load_scenario("quintic", [CONSTANT])
    with warnings.catch_warnings():
        warnings.simplefilter("error", ScenarioWarning)
        make_nonstop(scenario, load_plant=DeafLoadPlant, at_equilibrium=False)
    said = r"^load_plant = DeafLoadPlant: no wind acts on the load, since this block does not read"
    with pytest.warns(ScenarioWarning, match=said) as caught:
        make_nonstop(
            scenario, load_plant=DeafLoadPlant, wind=SteadyWindConfig(), at_equilibrium=False
        )
    assert len(caught) == 1


@pytest.mark.parametrize(
    ("config", "field"),
    [
        (SteadyWindConfig(velocity=[1.0, 2.0]), "velocity"),
        (SteadyWindConfig(velocity=[80.0, 80.0, 0.0]), "velocity"),
        (SteadyWindConfig(believed=[np.nan, 0.0, 0.0]), "believed"),
        (SteadyWindConfig(rise_time=-1.0), "rise_time"),
        (WindProfileConfig(exponent=-0.1), "exponent"),
        (WindProfileConfig(exponent=1.5), "exponent"),
        (WindProfileConfig(reference_height=0.5), "reference_height"),
        (WindProfileConfig(ground_height=np.inf), "ground_height"),
        (GustyWindConfig(gust=-1.0), "gust"),
        (GustyWindConfig(load_gust=200.0), "load_gust"),
        (GustyWindConfig(vertical_share=3.0), "vertical_share"),
        (GustyWindConfig(airspeed=0.0), "airspeed"),
        (GustyWindConfig(gust_length=0.1), "gust_length"),
        (GustyWindConfig(seed=0.5), "seed"),
    ],
)
def test_bad_wind(config, field):
    block = {SteadyWindConfig: SteadyWind, WindProfileConfig: WindProfile}.get(
        type(config), GustyWind
    )
    with pytest.raises(ScenarioError, match=f"^wind\\.{field} = "):
        block(model(), config)
