"""What is drawn for distributions in a scenario's fields."""

import dataclasses

import numpy as np
import pytest
from pydrake.common import RandomGenerator
from pydrake.common.schema import Gaussian, Sample, Uniform, UniformDiscrete

from drake_nonstop import ScenarioError, dump_scenario, load_scenario

FIELDS = (
    "system.load_mass=!Uniform {min: 0.7, max: 1.3}",
    "load_disturbance=!DisturbanceForce {torque: [0, !Gaussian {mean: -1, stddev: 0.5}, 0], "
    "seed: !Uniform {min: 0, max: 10}, gust_force: !UniformDiscrete {values: [0.1, 0.2, 0.6]}}",
    "system.aircraft={model: rascal_110, mass: !Uniform {min: 5, max: 7}}",
)


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("line", FIELDS)


@pytest.mark.parametrize("seed", range(3, 8))
def test_they_are_drawn_in_the_order_of_the_fields(scenario, seed):
    """By Drake's own functions, called by hand."""
    generator = RandomGenerator(seed)
    sampled = dataclasses.replace(scenario, random_seed=seed).sampled()
    assert sampled.system.load_mass == Sample(Uniform(min=0.7, max=1.3), generator)
    assert sampled.system.aircraft.mass == Sample(Uniform(min=5, max=7), generator)
    wind = sampled.load_disturbance
    assert wind.torque[1] == Sample(Gaussian(mean=-1, stddev=0.5), generator)
    assert wind.gust_force == Sample(UniformDiscrete(values=[0.1, 0.2, 0.6]), generator)
    assert wind.seed == np.floor(Sample(Uniform(min=0, max=10), generator))
    assert isinstance(wind.seed, int)


def test_a_generator_gives_each_scenario_its_seed(scenario):
    generator, same = RandomGenerator(5), RandomGenerator(5)
    for _ in range(3):
        sampled = scenario.sampled(generator)
        seed = same()
        assert sampled.random_seed == seed
        by_itself = dataclasses.replace(scenario, random_seed=seed).sampled()
        assert dump_scenario(sampled) == dump_scenario(by_itself)
    with pytest.raises(ScenarioError, match="generator = 3: give a pydrake"):
        scenario.sampled(3)


def test_what_holds_no_distribution_stays(scenario):
    assert isinstance(scenario.system.load_mass, Uniform)  # nothing was drawn into it
    plain = load_scenario("line")
    assert plain.sampled() is plain
    sampled = scenario.sampled()
    assert sampled.sampled() is sampled
    assert "!Uniform" not in dump_scenario(sampled)
