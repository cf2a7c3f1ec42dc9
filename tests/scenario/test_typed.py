"""A scenario through typed YAML, pickle and copies, and when two of them are equal."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed

from drake_nonstop import (
    Scenario,
    dump_scenario,
    load_scenario,
    scenario_names,
)
from drake_nonstop.scenario.choices import CHOICES
from drake_nonstop.scenario.fields import fields_of

TEXTS = ["", "12", "yes", "null", "1e3", "a: {b: c}", "# no", "two\nlines\n", "ξ, °", "  x ", "'\""]


def comes_back(scenario):
    """Asserts that a scenario is the same again by every way, also as `dump_scenario` tells."""
    for again in (
        yaml_load_typed(schema=Scenario, data=yaml_dump_typed(scenario)),
        yaml_load_typed(
            schema=Scenario,
            data=yaml_dump_typed(scenario, child_name="it", defaults=Scenario()),
            child_name="it",
            defaults=Scenario(),
        ),
        pickle.loads(pickle.dumps(scenario)),
        copy.deepcopy(scenario),
        copy.copy(scenario),
    ):
        assert again is not scenario
        assert again == scenario
        assert dump_scenario(again) == dump_scenario(scenario)


NAMES = dict.fromkeys(["quintic", "aircraft_transfer_gusty", *scenario_names()])


@pytest.mark.parametrize("name", nightly_beyond(4, "examples", NAMES))
def test_a_shipped_scenario_comes_back(name):
    comes_back(load_scenario(name))


def test_every_block_of_a_box_comes_back_as_itself():
    """Drake writes a config for the first class of the box's that it is an instance of."""
    for k in range(max(map(len, CHOICES.values()))):
        scenario = Scenario()
        for name, configs in CHOICES.items():
            setattr(scenario, name, configs[min(k, len(configs) - 1)]())
        again = yaml_load_typed(schema=Scenario, data=yaml_dump_typed(scenario))
        for name in CHOICES:
            assert type(getattr(again, name)) is type(getattr(scenario, name)), name
        assert again == scenario
        assert pickle.loads(pickle.dumps(scenario)) == scenario


def parts(scenario):
    """The scenario and all in it that has fields, with their names."""
    for path in ("", *(f.name for f in dataclasses.fields(Scenario))):
        part = getattr(scenario, path) if path else scenario
        if path == "" or dataclasses.is_dataclass(part) or hasattr(part, "__fields__"):
            yield path, part


def other(value):
    """Another value of the same type."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, (int, float)):
        return value + 1 if np.isfinite(value) else 1
    if isinstance(value, list):
        return [*value[:-1], other(value[-1])] if value else [1.0]
    return "another" if isinstance(value, str) else 1.0


def test_scenarios_are_equal_only_if_all_their_fields_are():
    scenario = load_scenario("quintic")
    count = 0
    for path, part in parts(scenario):
        for name in fields_of(type(part)):
            if name in dict(parts(scenario)):
                continue
            changed = copy.deepcopy(scenario)
            target = getattr(changed, path) if path else changed
            setattr(target, name, other(getattr(part, name)))
            assert changed != scenario, (path, name)
            assert pickle.loads(pickle.dumps(changed)) == changed
            count += 1
    assert count > 80
    for name, configs in CHOICES.items():
        for config in configs[1:]:
            changed = copy.deepcopy(scenario)
            setattr(changed, name, config())
            assert (changed == scenario) == (config() == getattr(scenario, name)), name
    assert scenario == load_scenario("quintic")
    assert scenario != "quintic"
    assert scenario != scenario.system


def test_a_copy_shares_no_part_with_the_scenario_it_was_made_of():
    scenario = load_scenario("quintic")
    for again in (copy.deepcopy(scenario), pickle.loads(pickle.dumps(scenario))):
        again.system.attachments[0][0] = 3.0
        again.simulator_config.max_step_size = 0.001
        again.scene.carrier_colours.append("#000000")
        assert scenario == load_scenario("quintic") != again
