"""Recipes and environments fly every shipped scenario as `simulate` does."""

import functools

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator

from drake_nonstop import (
    load_scenario,
    make_gym_env,
    make_gym_vec_env,
    make_nonstop,
    simulate,
    with_largest_step,
)
from drake_nonstop.mechanics.signals import SIGNAL_PERIOD
from drake_nonstop.scenario.loading import scenario_names

NAMES = scenario_names()
FIRST = "aircraft_rest_cables"  # whose step has to be shorter than its scenario's
CASES = [FIRST, *(name for name in NAMES if name != FIRST)]
# Its layer makes a turn rate: an environment's actions are a frequency and an amplitude.
WITHOUT_PARAMETERS = {"aircraft_co_rotating_rising_wind"}


def short(name, *overrides):
    """The scenario for a second, with steps that need not end for the sake of a run's signals."""
    step = min(load_scenario(name).simulator_config.max_step_size, SIGNAL_PERIOD)
    return load_scenario(
        name, ["simulation_duration=1", f"simulator_config.max_step_size={step}", *overrides]
    )


@pytest.mark.parametrize("name", nightly_beyond(1, "studies", CASES))
def test_the_recipe_of_the_readme_flies_as_simulate_does(name):
    scenario = short(name)
    diagram = make_nonstop(scenario)
    simulator = Simulator(diagram)
    context = simulator.get_context()
    config = with_largest_step(scenario.simulator_config, diagram, context)
    ApplySimulatorConfig(config, simulator)
    simulator.AdvanceTo(1.0)
    run = simulate(scenario)
    for signal in ("load_state", "carrier_state"):
        flown = diagram.GetOutputPort(signal).Eval(context)
        np.testing.assert_allclose(flown, run.signal(signal)[-1], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "is_vector"), nightly_beyond(2, "studies", [(n, v) for n in CASES for v in (0, 1)])
)
def test_an_environment_flies_as_simulate_does(name, is_vector):
    scenario = short(name)
    if name in WITHOUT_PARAMETERS:
        pytest.skip("its layer makes no frequency and no amplitude")
    action = np.array(
        [scenario.optimization_layer.frequency, scenario.optimization_layer.amplitude]
    )
    values = dict(zip(("frequency", "amplitude"), action.tolist(), strict=True))
    constant = short(name, f"optimization_layer=!ConstantParameters {values}")
    make = functools.partial(make_gym_vec_env, n=1) if is_vector else make_gym_env
    env = make(scenario, time_step=0.1)
    env.reset()
    for step in range(10):
        observation, _, terminated, truncated, info = env.step(
            action[None] if is_vector else action
        )
        assert (bool(terminated), bool(truncated)) == (False, step == 9)
    last = info["final_obs"][0] if is_vector else observation
    run = simulate(constant)
    flown = np.concatenate(
        [run.signal(s)[-1] for s in ("load_state", "reference", "carrier_state")]
    )
    np.testing.assert_allclose(last, flown, rtol=1e-6, atol=1e-6)
