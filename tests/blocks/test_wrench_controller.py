"""The wrench controllers: integrals, gains that follow from the load, and one of one's own."""

import dataclasses

import numpy as np
import pytest
from helpers import Motion, model, nightly_beyond, outputs

from drake_nonstop import compute_metrics, load_scenario, simulate
from drake_nonstop.blocks.wrench_controller import (
    PaperWrenchController,
    PaperWrenchControllerConfig,
    TunedWrenchController,
    TunedWrenchControllerConfig,
    WrenchController,
    WrenchControllerConfig,
)
from drake_nonstop.mechanics.tuning import load_gains

SIGNALS = {
    "measured_load_state": Motion(3).state(0.3),
    "reference": Motion(4).reference(0.3),
    "wind_estimate": np.array([2.0, -1.0, 0.5]),
}
INTEGRALS = np.array([0.1, -0.2, 0.3, 0.2, 0.1, -0.1])


def same(one, other, integrals=INTEGRALS):
    expected = outputs(other, integrals, **SIGNALS)
    for name, value in outputs(one, integrals, **SIGNALS).items():
        np.testing.assert_allclose(value, expected[name], rtol=1e-12, atol=1e-12, err_msg=name)


@pytest.mark.parametrize(
    ("make", "config"),
    [
        (WrenchController, WrenchControllerConfig),
        (PaperWrenchController, PaperWrenchControllerConfig),
    ],
)
def test_gains_that_are_auto_are_those_of_the_load_about_its_quickest_axis(rng, make, config):
    turned, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    inertia = turned @ np.diag([3.0, 2.0, 4.0]) @ turned.T
    inertia = ((inertia + inertia.T) / 2).tolist()
    body = model(load_mass=20.0, load_inertia=inertia, cable_length=30.0)
    following = load_gains(20.0, 2.0, 30.0, 9.81)
    names = {field.name for field in dataclasses.fields(config)}
    plain = make(body, config(**{name: following[name] for name in names & {*following}}))
    for block in (make(body), make(body, config(position_gain=following["position_gain"]))):
        assert block.gains["velocity_gain"] == following["velocity_gain"]
        same(block, plain, ())


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
    same(TunedWrenchController(body, tuned), WrenchController(body, plain))


class OwnController(WrenchController):
    """The shipped controller's wrench, without the rate."""

    makes = ("wrench", "tracking_error")

    @staticmethod
    def equations(*signals, **numbers):
        rate, wrench, _, error = WrenchController.equations(*signals, **numbers)
        return rate, wrench, error


@pytest.mark.parametrize("engine", nightly_beyond(1, "studies", ["compiled", "diagram"]))
def test_a_controller_of_ones_own_gets_the_rate_of_its_wrench(engine):
    """It is the shipped controller's exact one, but for the lag of the filter and of a sample."""
    changes = ["simulation_duration=3", "load_trajectory.move_time=3"]
    scenario = load_scenario("quintic", [*changes, "optimization_layer=ConstantParameters"])
    exact = simulate(scenario, engine=engine)
    own = simulate(scenario, engine=engine, wrench_controller=OwnController)
    expected = exact.signal("wrench_rate")
    lag = 0.05 + scenario.control_period  # of the filter, and of a sample, s
    fastest = np.abs(np.diff(expected, axis=0)).max() / np.diff(exact.time[:2])[0]
    error = np.abs(own.signal("wrench_rate") - expected)[20:]
    assert np.abs(expected).max() > 5 * lag * fastest  # which a rate of zero would not pass
    assert error.max() < lag * fastest
    assert compute_metrics(own)["load"]["position_error_max_m"] < 1e-3
