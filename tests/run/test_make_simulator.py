"""A Simulator of a scenario with distributions, as Drake's Monte Carlo functions take it."""

import functools
import os

import numpy as np
import pytest
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import MonteCarloSimulation, RandomSimulation

from drake_nonstop import (
    ScenarioError,
    load_scenario,
    make_simulator,
    simulate,
)
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.studies.study import study
from drake_nonstop.studies.workers import SerialExecutor

DURATION = 0.2
_STEP = "simulator_config.max_step_size"
# 50 of them agree; the suite flies a few, since a loop is traced for each.
RUNS = int(os.environ.get("DRAKE_NONSTOP_RANDOM_RUNS", "2"))
DRAWN = (
    "optimization_layer=ConstantParameters",
    f"simulation_duration={DURATION}",
    "simulated.load_mass=!Gaussian {mean: 1, stddev: 0.1}",
    "load_disturbance=!DisturbanceForce {force: [!Gaussian {mean: 0, stddev: 0.2}, 0, 0], "
    "gust_force: !Uniform {min: 0, max: 0.3}, seed: !Uniform {min: 0, max: 1e9}}",
    "wrench_controller.position_gain=!Uniform {min: 4, max: 6}",
)


def position_error(system, context):
    """As the metric of that name."""
    load, reference = (
        system.GetOutputPort(name).Eval(context) for name in ("load_state", "reference")
    )
    return float(np.linalg.norm([load[4:7] - reference[4:7]], axis=1)[0])


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("quintic", [*DRAWN, "engine=diagram"])  # in the sweep as well


@pytest.mark.nightly("studies")
def test_monte_carlo_gives_what_a_study_gives_to_the_bit(scenario):
    generator = RandomGenerator(5)
    seeds = [generator() for _ in range(RUNS)]
    table = study(scenario, {}, seeds, executor=SerialExecutor()).table
    make = functools.partial(make_simulator, scenario)
    results = MonteCarloSimulation(make, position_error, DURATION, RUNS, RandomGenerator(5))
    outputs = [result.output for result in results]
    assert outputs == [*table["load.position_error_final_m"]]
    assert len(set(outputs)) == RUNS
    again = RandomSimulation(make, position_error, DURATION, results[1].generator_snapshot)
    assert again == outputs[1]


@pytest.mark.parametrize(
    "overrides",
    [
        ("control_period=0", f"{_STEP}=0.0023"),
        ("optimization_layer=RecedingHorizonOptimizer",),
    ],
)
def test_it_flies_as_simulate_does(scenario, overrides):
    """With the scenario's own random_seed, once the context was reset to its defaults."""
    scenario = changed(scenario, [*overrides, "random_seed=8"])
    simulator = make_simulator(scenario)
    system, context = simulator.get_system(), simulator.get_mutable_context()
    system.SetRandomContext(context, RandomGenerator(1))
    simulator.AdvanceTo(DURATION)
    run = simulate(scenario)
    assert run.scenario == scenario.sampled()
    for name in ("load_state", "carrier_state", "tensions", "wrench"):
        value = system.GetOutputPort(name).Eval(context)
        np.testing.assert_array_equal(value, run.signal(name)[-1])


def test_a_box_cannot_be_left_out():
    with pytest.raises(ScenarioError, match="replacement cables = None: give a block"):
        make_simulator(load_scenario("quintic"), cables=None)
