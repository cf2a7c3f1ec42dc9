"""A scenario comes back as it was, by every way in which it can be written or copied."""

import copy
import dataclasses
import pickle
from pathlib import Path

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed

from drake_nonstop import (
    Scenario,
    ScenarioError,
    changed,
    dump_scenario,
    load_scenario,
    make_nonstop,
    parse_scenario,
    scenario_names,
)
from drake_nonstop.cli.main import main
from drake_nonstop.scenario.choices import CHOICES

DRAWN = (
    "system.load_mass=!Uniform {min: 0.7, max: 1.3}",
    "system.cable_length=[0.8, !Uniform {min: 0.8, max: 0.9}, 1, 1.4]",
    "load_disturbance=!DisturbanceForce {torque: [0, !Gaussian {mean: -1, stddev: 0.5}, 0]}",
    "limits.slack_time=!UniformDiscrete {values: [50, 60]}",
    "obstacles=[!Box {name: tower}, !Sphere {position: [1, !Uniform {min: 0, max: 1}, 3]}, "
    "!Ground {height: -1e9}]",
)
AIRCRAFT = "x: {system: {aircraft: {model: rascal_110, mass: !Uniform {min: 6, max: 7}}}}"


def with_blocks(k):
    """A scenario of the k-th block of each box, or of the last one."""
    return Scenario(**{name: each[min(k, len(each) - 1)]() for name, each in CHOICES.items()})


MADE = {
    "distributions": lambda: load_scenario("line", DRAWN),
    "aircraft": lambda: parse_scenario(AIRCRAFT),
    **{f"blocks {k}": (lambda k=k: with_blocks(k)) for k in range(max(map(len, CHOICES.values())))},
    **{name: (lambda name=name: load_scenario(name)) for name in scenario_names()},
}


def by_comments(scenario):
    """The copy, in the current folder, that has the unit and meaning of each field."""
    Path("another.yaml").unlink(missing_ok=True)
    Path("old.yaml").write_text(dump_scenario(scenario))
    assert main(["new", "another", "--from", "old.yaml"]) == 0
    again = load_scenario("another.yaml")
    assert again.name == "another"
    return dataclasses.replace(again, name=scenario.name)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The current folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def by_typed_yaml(scenario):
    return yaml_load_typed(schema=Scenario, data=yaml_dump_typed(scenario))


WAYS = (
    lambda scenario: parse_scenario(dump_scenario(scenario)),
    lambda scenario: pickle.loads(pickle.dumps(scenario)),
    copy.deepcopy,
    copy.copy,
    by_comments,
)


@pytest.mark.parametrize("name", nightly_beyond(12, "examples", MADE))
def test_a_scenario_comes_back(name):
    scenario = MADE[name]()
    plain = scenario.sampled()
    ways = [*WAYS, *([by_typed_yaml] if scenario is plain else [])]
    for way in ways:
        again = way(scenario)
        assert again is not scenario
        assert again == scenario
        assert dump_scenario(again) == dump_scenario(scenario)
        assert again.sampled() == plain


OTHERS = [
    *("system.load_mass=1.5", "simulated.load_mass=1.5", "pattern.phases=[0, 1, 0, 1.5]"),
    *("system.aircraft={model: rascal_110}", "load_trajectory.move_time=8", "errors=light"),
    *("load_feedback=NoisyFeedback", "optimization_layer.speed_bound=0.5", "engine=diagram"),
    *("simulation_duration=3", "control_period=0.02", "limits.slack_time=3", "random_seed=1"),
    *("simulator_config.max_step_size=0.001", "scene.wing_span=1", "obstacles=[!Ground {}]"),
    *("reference_governor={}", "description=another"),
]


def test_scenarios_are_equal_only_if_all_their_fields_are():
    scenario = load_scenario("quintic")
    others = [changed(scenario, [override]) for override in OTHERS]
    assert all(other != scenario for other in others)
    assert len({dump_scenario(other) for other in others}) == len(OTHERS)
    assert scenario == load_scenario("quintic")
    assert scenario not in ("quintic", scenario.system)


def test_a_copy_shares_no_part():
    scenario = load_scenario("quintic")
    for again in (copy.deepcopy(scenario), pickle.loads(pickle.dumps(scenario))):
        again.system.attachments[0][0] = 3.0
        again.simulator_config.max_step_size = 0.001
        again.scene.wing_span = 0.5
        assert scenario == load_scenario("quintic") != again


def test_numpy_in_a_field_is_python_in_the_scenario():
    scenario = load_scenario("quintic")
    scenario.system.attachments = np.array(scenario.system.attachments)
    scenario.system.load_mass = np.float32(1.0)
    scenario.pattern.phases = tuple(scenario.pattern.phases)
    scenario.simulation_duration = np.int64(15)
    scenario.system.attachments[0][0] = np.float64(0.75)  # in place
    assert dump_scenario(scenario) == dump_scenario(load_scenario("quintic"))
    make_nonstop(scenario)


def test_a_trajectory_from_a_file_is_in_the_resolved_scenario(folder):
    path = folder / "way.csv"
    path.write_text("t,x,y,z\n0,0,0,1\n4,0.25,0,1\n9,1,0,1e-1\n")
    setting = f"load_trajectory=!SampledTrajectory {{file: '{path}'}}"
    scenario = load_scenario("quintic", [setting, "optimization_layer=ConstantParameters"])
    path.unlink()
    assert scenario.load_trajectory.file == ""
    assert scenario.load_trajectory.samples == [[0, 0, 0, 1], [4, 0.25, 0, 1], [9, 1, 0, 0.1]]
    assert parse_scenario(dump_scenario(scenario)) == scenario
    with pytest.raises(ScenarioError, match=r"load_trajectory\.file = .*way\.csv: give"):
        load_scenario("quintic", [setting])
