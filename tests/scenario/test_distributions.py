"""Drake's distributions in a scenario's fields, and what is drawn for them."""

import copy
import dataclasses
import pickle
import re

import numpy as np
import pytest
from pydrake.common import RandomGenerator
from pydrake.common.schema import (
    Deterministic,
    Gaussian,
    GaussianVectorX,
    Sample,
    Uniform,
    UniformDiscrete,
    UniformVector,
)
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed

from drake_nonstop import (
    DisturbanceForceConfig,
    RunLimits,
    Scenario,
    ScenarioError,
    dump_scenario,
    load_scenario,
    parse_scenario,
)
from drake_nonstop.scenario.describe import commented_scenario
from drake_nonstop.scenario.overrides import changed

FIELDS = (
    "system.load_mass=!Uniform {min: 0.7, max: 1.3}",
    "load_disturbance=!DisturbanceForce {force: "
    "!GaussianVector {mean: [1, 2, 3], stddev: [0.1, 0.2, 0.3]}, "
    "torque: [0, !Gaussian {mean: -1, stddev: 0.5}, 0], seed: !Uniform {min: 0, max: 10}, "
    "gust_force: !UniformDiscrete {values: [0.1, 0.2, 0.6]}}",
    "simulated.cable_length=!Deterministic {value: 0.81}",
)


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("line", FIELDS)


class TestDraws:
    def test_they_are_drawn_in_the_order_of_the_fields(self, scenario):
        """By Drake's own functions, called by hand."""
        generator = RandomGenerator(3)
        sampled = dataclasses.replace(scenario, random_seed=3).sampled()
        assert sampled.system.load_mass == Sample(Uniform(min=0.7, max=1.3), generator)
        Sample(Deterministic(value=0.81), generator)
        wind = sampled.load_disturbance
        assert wind.force == [
            Sample(Gaussian(mean=mean, stddev=mean / 10), generator) for mean in (1.0, 2.0, 3.0)
        ]
        assert wind.torque[1] == Sample(Gaussian(mean=-1, stddev=0.5), generator)
        discrete = UniformDiscrete(values=[0.1, 0.2, 0.6])
        assert wind.gust_force == Sample(discrete, generator)
        assert wind.seed == np.floor(Sample(Uniform(min=0, max=10), generator))
        assert isinstance(wind.seed, int)

    def test_a_generator_gives_each_scenario_its_seed(self, scenario):
        generator, same = RandomGenerator(5), RandomGenerator(5)
        for _ in range(3):
            sampled = scenario.sampled(generator)
            seed = same()
            assert sampled.random_seed == seed
            by_itself = dataclasses.replace(scenario, random_seed=seed).sampled()
            assert dump_scenario(sampled) == dump_scenario(by_itself)

    def test_what_holds_no_distribution_stays(self, scenario):
        assert isinstance(scenario.system.load_mass, Uniform)  # nothing was drawn into it
        plain = load_scenario("line")
        assert plain.sampled() is plain
        sampled = scenario.sampled()
        assert sampled.sampled() is sampled
        text = dump_scenario(sampled)
        assert not any(f"!{kind}" in text for kind in ("Uniform", "Gaussian", "Deterministic"))


class TestYaml:
    def test_a_scenario_with_distributions_reads_back(self, scenario):
        text = dump_scenario(scenario)
        assert "load_mass: !Uniform {min: 0.7, max: 1.3}" in text
        again = parse_scenario(text)
        assert dump_scenario(again) == text
        assert dump_scenario(again.sampled()) == dump_scenario(scenario.sampled())

    def test_a_scenario_that_it_is_based_on(self, tmp_path):
        (tmp_path / "base.yaml").write_text(
            "base: {based_on: line, system: {load_mass: !Uniform {min: 1, max: 2}}}"
        )
        (tmp_path / "mine.yaml").write_text("mine: {based_on: base.yaml, random_seed: 4}")
        mine = load_scenario(tmp_path / "mine.yaml")
        sample = Sample(Uniform(min=1, max=2), RandomGenerator(4))
        assert mine.sampled().system.load_mass == sample

    def test_overrides_change_a_distribution_and_take_it_away(self, scenario):
        wider = changed(scenario, ["system.load_mass.max=2"])
        assert "load_mass: !Uniform {min: 0.7, max: 2.0}" in dump_scenario(wider)
        assert changed(scenario, ["system.load_mass=2"]).system.load_mass == 2

    def test_a_scenario_with_all_fields_commented(self):
        scenario = load_scenario("line", [*FIELDS, "simulation_duration=!Uniform {min: 1, max: 2}"])
        scenario.name = "mine"
        text = commented_scenario(scenario, "mine")
        assert dump_scenario(parse_scenario(text)) == dump_scenario(scenario)


class TestPython:
    def test_objects_of_pydrake(self):
        scenario = Scenario()
        scenario.simulation_duration = Uniform(min=1, max=2)
        scenario.limits = RunLimits(speed=UniformDiscrete(values=[50, 60]))
        scenario.system.attachments[0][2] = Gaussian(mean=0, stddev=0.01)
        scenario.load_disturbance = DisturbanceForceConfig(
            force=GaussianVectorX(mean=[1, 2, 3], stddev=[0.1]),
            torque=UniformVector[3](min=[1, 2, 3], max=[2, 3, 4]),
        )
        sampled = scenario.sampled()
        assert 1 < sampled.simulation_duration < 2
        assert sampled.limits.speed in (50, 60)
        assert 0 < abs(sampled.system.attachments[0][2]) < 0.1
        assert np.all(np.floor(sampled.load_disturbance.torque) == [1, 2, 3])
        again = parse_scenario(dump_scenario(scenario))
        assert dump_scenario(again.sampled()) == dump_scenario(sampled)

    def test_pickles_copies_and_equality(self):
        scenario = Scenario()
        scenario.system.load_mass = Uniform(min=1, max=2)
        scenario.load_disturbance = DisturbanceForceConfig(
            force=GaussianVectorX(mean=[1, 2, 3], stddev=[0.1]),
            torque=UniformVector[3](min=[1, 2, 3], max=[2, 3, 4]),
        )
        for again in (pickle.loads(pickle.dumps(scenario)), copy.deepcopy(scenario)):
            assert again == scenario
            assert again.sampled() == scenario.sampled()
            again.system.load_mass = Uniform(min=1, max=3)
            assert again != scenario

    def test_typed_yaml_is_for_numbers(self, scenario):
        sampled = scenario.sampled()
        assert yaml_load_typed(schema=Scenario, data=yaml_dump_typed(sampled)) == sampled

    def test_what_is_no_generator(self, scenario):
        with pytest.raises(ScenarioError, match="generator = 3: give a pydrake"):
            scenario.sampled(3)


WIND = (
    "load_disturbance=!DisturbanceForce {force: !GaussianVector {mean: [1, 2, 3], stddev: [0.1]}}"
)


class TestBadInput:
    @pytest.mark.parametrize(
        ("overrides", "words"),
        [
            (["system.load_mass=!Uniform {min: 2, max: 1}"], "min = 2.0: give at most max"),
            (
                ["system.load_mass=!Gaussian {mean: 1, stddev: -0.1}"],
                "system.load_mass.stddev = -0.1: give a standard deviation from 0 on",
            ),
            (["system.load_mass=!Gaussian {mean: 1}"], "{mean: 1}: give mean and stddev"),
            (["system.load_mass=!Gaussian {mean: .inf, stddev: 1}"], "give finite numbers"),
            (["system.load_mass=!Gaussian {mean: a, stddev: 1}"], "mean = a: give a number"),
            (["system.load_mass=!UniformDiscrete {values: []}"], "give at least one number"),
            (
                ["system.load_mass=!Uniform {low: 1, high: 2}"],
                "there is no low; there are min",
            ),
            (["system.load_mass=!Normal {mean: 1}"], "give a number, or a distribution: !Det"),
            (["system.load_mass=!UniformVector {min: [1], max: [2]}"], "give a number, or a"),
            ([WIND, "load_disturbance.force.stddev=[1, 2]"], "as many numbers as mean has, 3, or"),
            ([WIND, "load_disturbance.force=!Uniform {min: 0, max: 1}"], "give a list in [ ]"),
            (
                [WIND, "load_disturbance.force=!UniformVector {min: [0], max: [1, 2]}"],
                "force.min = [0.0]: give as many numbers as max has, 2",
            ),
            ([WIND, "load_disturbance.seed=!Gaussian {mean: 1, stddev: 1}"], "give whole numbers"),
            ([WIND, "load_disturbance.seed=!Deterministic {value: 0.5}"], "give whole numbers"),
            (["engine=!Uniform {min: 0, max: 1}"], "a number or a list of numbers only"),
            (["optimization_layer.wind=!Uniform {min: 0, max: 1}"], "a list of numbers only"),
            (["description=!Uniform {min: 0, max: 1}"], "a number or a list of numbers only"),
            (["phase=!Uniform {min: 0, max: 1}"], "a number or a list of numbers only"),
            (["system=!Uniform {min: 0, max: 1}"], "a number or a list of numbers only"),
            (["random_seed=!Uniform {min: 0, max: 1}"], "give the whole number to draw with"),
            (
                ["random_seed=4294967296"],
                "give a whole number from 0 to 4294967295",
            ),
            (["simulator_config.accuracy=!Uniform {min: 0, max: 1}"], "give a plain float"),
        ],
    )
    def test_one_clear_sentence(self, overrides, words):
        with pytest.raises(ScenarioError, match=re.escape(words)) as raised:
            load_scenario("line", overrides)
        assert "\n" not in str(raised.value)

    def test_nan_in_python(self):
        scenario = Scenario()
        scenario.system.load_mass = Uniform(min=0, max=np.nan)
        with pytest.raises(ScenarioError, match=r"load_mass.max = .nan: give finite numbers"):
            scenario.sampled()

    def test_what_is_drawn_is_checked(self):
        scenario = load_scenario("line", ["control_period=!Gaussian {mean: 0.01, stddev: 1e6}"])
        with pytest.raises(ScenarioError, match=r"control_period = -?[0-9.]+: give 0 for"):
            scenario.sampled()
