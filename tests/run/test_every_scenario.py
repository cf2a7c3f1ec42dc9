"""Recipes and environments fly every shipped scenario as `simulate` does."""

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator

from drake_nonstop import (
    load_scenario,
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
