"""The wrench controllers: default, as printed in the paper, PD and tuned."""

import dataclasses

import numpy as np
import pytest
from helpers import Motion, fix, model, nightly_beyond, output, outputs
from pydrake.systems.analysis import Simulator

from drake_nonstop import compute_metrics, load_scenario, simulate
from drake_nonstop.blocks.wrench_controller import (
    PaperWrenchController,
    TunedWrenchController,
    TunedWrenchControllerConfig,
    WrenchController,
    WrenchControllerConfig,
    WrenchRate,
    WrenchRateConfig,
)
from drake_nonstop.loop.box import config_class
from drake_nonstop.mechanics.tuning import load_gains
from drake_nonstop.mechanics.wrench import tracking_error
from drake_nonstop.systems.compiled_flight import sample_times

GAINS = {
    "position_gain": 7.0,
    "velocity_gain": 3.0,
    "position_integral_gain": 1.1,
    "orientation_gain": 0.6,
    "angular_velocity_gain": 0.07,
    "orientation_integral_gain": 0.2,
    "feedforward": 0.5,
}


WIND = np.array([2.0, -1.0, 0.5])


def test_integrals_of_a_sampled_controller_step_once_a_period():
    block = WrenchController(model(4, 0.02))
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    state, reference = Motion(51).state(0.3), Motion(52).reference(0.3)
    signals = {"measured_load_state": state, "reference": reference, "wind_estimate": WIND}
    fix(block, context, **signals, sample_time=np.array([0.02]))
    simulator.Initialize()
    error = tracking_error(state, reference)[:6]
    for time, steps in ((0.0, 0), (0.01, 0), (0.03, 1), (0.05, 2)):
        simulator.AdvanceTo(time)
        integrals = context.get_discrete_state_vector().value()
        np.testing.assert_allclose(integrals, steps * 0.02 * error, rtol=0, atol=1e-15)


STILL_AIR = {"wind_estimate": np.zeros(3)}
SIGNALS = STILL_AIR | {
    "measured_load_state": Motion(3).state(0.3),
    "reference": Motion(4).reference(0.3),
}


INTEGRALS = np.array([0.1, -0.2, 0.3, 0.2, 0.1, -0.1])


@pytest.mark.parametrize("make", [WrenchController, PaperWrenchController])
def test_gains_that_are_auto_are_those_of_the_load_about_its_quickest_axis(rng, make):
    turned, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    inertia = turned @ np.diag([3.0, 2.0, 4.0]) @ turned.T
    body = model(
        load_mass=20.0, load_inertia=((inertia + inertia.T) / 2).tolist(), cable_length=30.0
    )
    config = config_class(make)
    names = {field.name for field in dataclasses.fields(config)} & {*GAINS}
    following = load_gains(20.0, 2.0, 30.0, 9.81)
    plain = config(**{name: following[name] for name in names & {*following}})
    mixed = config(position_gain=following["position_gain"])
    expected = outputs(make(body, plain), INTEGRALS, **SIGNALS)
    for block in (make(body), make(body, mixed)):
        assert block.gains["velocity_gain"] == following["velocity_gain"]
        for name, value in outputs(block, INTEGRALS, **SIGNALS).items():
            np.testing.assert_allclose(value, expected[name], rtol=1e-12, err_msg=name)


def test_tuned_gains_are_the_plain_ones_of_that_mass_and_inertia():
    body = model(load_mass=3.0, load_drag=0.5, load_inertia=(0.02 * np.eye(3)).tolist())
    tuned = TunedWrenchControllerConfig(
        position_frequency=2.0,
        position_damping=0.7,
        position_integral_rate=0.0,
        orientation_frequency=5.0,
        orientation_damping=0.6,
        orientation_integral_rate=0.3,
    )
    plain = WrenchControllerConfig(
        position_gain=3.0 * 4.0,
        velocity_gain=3.0 * 2 * 0.7 * 2.0 - 0.5,
        position_integral_gain=0.0,
        orientation_gain=0.02 * (25.0 + 6.0 * 0.3),
        angular_velocity_gain=0.02 * (6.0 + 0.3),
        orientation_integral_gain=0.02 * 25.0 * 0.3,
    )
    expected = outputs(WrenchController(body, plain), INTEGRALS, **SIGNALS)
    for name, value in outputs(TunedWrenchController(body, tuned), INTEGRALS, **SIGNALS).items():
        np.testing.assert_allclose(value, expected[name], rtol=1e-12, atol=1e-12, err_msg=name)


class OwnController(WrenchController):
    """The shipped controller's wrench, without the rate."""

    makes = ("wrench", "tracking_error")

    @staticmethod
    def equations(*signals, **numbers):
        rate, wrench, _, error = WrenchController.equations(*signals, **numbers)
        return rate, wrench, error


def test_a_filtered_difference_lags_and_is_the_rate_of_what_grows_steadily():
    block = WrenchRate(model(4, 0.01), WrenchRateConfig(time_constant=0.02))
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    fix(block, context, wrench=np.full(6, 3.0))
    simulator.Initialize()
    np.testing.assert_allclose(output(block, context, "wrench_rate"), 0, atol=1e-12)
    for k in range(1, 40):
        simulator.AdvanceTo(sample_times(k, 0.01))
        simulator.AdvancePendingEvents()
        fix(block, context, wrench=np.full(6, 3.0 + 0.2 * k * 0.01))
    np.testing.assert_allclose(output(block, context, "wrench_rate"), 0.2, rtol=1e-6)


@pytest.mark.parametrize("engine", nightly_beyond(1, "studies", ["compiled", "diagram"]))
def test_a_controller_of_ones_own_gets_the_rate_of_its_wrench(engine):
    """It is the shipped controller's exact one, but for the lag of the filter and of a sample."""
    changes = ["simulation_duration=3", "load_trajectory.move_time=3"]
    scenario = load_scenario("quintic", [*changes, "optimization_layer=ConstantParameters"])
    exact = simulate(scenario, engine=engine)
    own = simulate(scenario, engine=engine, wrench_controller=OwnController)
    expected = exact.signal("wrench_rate")
    lag = WrenchRateConfig().time_constant + scenario.control_period
    fastest = np.abs(np.diff(expected, axis=0)).max() / np.diff(exact.time[:2])[0]
    error = np.abs(own.signal("wrench_rate") - expected)[20:]
    assert np.abs(expected).max() > 5 * lag * fastest  # which a rate of zero would not pass
    assert error.max() < lag * fastest
    assert compute_metrics(own)["load"]["position_error_max_m"] < 1e-3
