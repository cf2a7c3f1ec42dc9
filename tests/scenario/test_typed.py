"""A scenario through typed YAML, pickle and copies, and when two of them are equal."""

import copy
import dataclasses
import pickle
import random
import sys

import numpy as np
import pytest
from helpers import nightly_beyond
from plausible_scenarios import draw
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed

from drake_nonstop import (
    Scenario,
    ScenarioError,
    dump_scenario,
    load_scenario,
    make_nonstop,
    parse_scenario,
    scenario_names,
)
from drake_nonstop.scenario.schema import CHOICES
from drake_nonstop.validation import fields_of

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


@pytest.mark.parametrize("seed", nightly_beyond(3, "studies", range(8)))
def test_a_drawn_scenario_comes_back(seed):
    name, overrides = draw(seed)
    scenario = load_scenario(name, overrides)
    scenario.description = random.Random(seed).choice(TEXTS)
    scenario.limits.speed = float("inf")
    scenario.simulated.attachments = (2 * np.array(scenario.system.attachments)).tolist()
    comes_back(scenario)


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
        for field in fields_of(type(part)):
            if field.name in dict(parts(scenario)):
                continue
            changed = copy.deepcopy(scenario)
            target = getattr(changed, path) if path else changed
            setattr(target, field.name, other(getattr(part, field.name)))
            assert changed != scenario, (path, field.name)
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


OWN = """
from dataclasses import dataclass, field
import numpy as np
from drake_nonstop.blocks.carrier_controller import CarrierPid, CarrierPidConfig

@dataclass(kw_only=True)
class MineConfig(CarrierPidConfig):
    level: float = 2.0

class Mine(CarrierPid):
    pass

@dataclass
class ArrayConfig:
    gains: np.ndarray = field(default_factory=lambda: np.ones(3))
    level: float = 2.0

class Array(CarrierPid):
    pass
"""


@pytest.mark.parametrize("block", ["Mine", "Array"])
def test_a_block_of_the_users_own_is_pickled_but_not_written_for_another(
    block, tmp_path, monkeypatch
):
    (tmp_path / "own_typed_block.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    text = f"a: {{carrier_controller: !own_typed_block.{block} {{}}}}"
    try:
        scenario = parse_scenario(text, trust=True)
        config = scenario.carrier_controller
        remedy = rf"^carrier_controller = own_typed_block\.{block}: write it with dump_scenario"
        with pytest.raises(ScenarioError, match=remedy):
            yaml_dump_typed(scenario)
        assert parse_scenario(dump_scenario(scenario), trust=True) == scenario
        for level in (3.0, np.nan):
            config.level = level
            assert pickle.loads(pickle.dumps(scenario)) == scenario == copy.deepcopy(scenario)
        assert scenario != parse_scenario(text, trust=True)
        if block == "Array":
            again = copy.deepcopy(scenario)
            again.carrier_controller.gains[1] = 2.0
            assert again != scenario
    finally:
        sys.modules.pop("own_typed_block", None)


def test_what_typed_yaml_gives_is_checked_where_it_is_used():
    scenario = yaml_load_typed(schema=Scenario, data="system: {load_mass: -1.0}")
    with pytest.raises(ScenarioError, match=r"system\.load_mass = -1\.0: give"):
        make_nonstop(scenario)
    with pytest.raises(RuntimeError, match="duration"):
        yaml_load_typed(schema=Scenario, data="duration: 5.0")
