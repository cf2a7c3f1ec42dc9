"""Whatever is given, a scenario is made of it, or one sentence says what to give instead."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drake_nonstop import (
    Scenario,
    ScenarioError,
    ablate,
    dump_scenario,
    load_scenario,
    make_nonstop,
    read_grid,
    simulate,
)
from drake_nonstop.diagrams.nonstop import BOXES, replaced
from drake_nonstop.loop.box import config_class
from drake_nonstop.scenario.yaml_text import parse_plain

# Values of YAML in one line, each in a scalar's place.

# Values of Python in a field's place.


# Numbers at the ends of what a float can be, and of what a scenario may hold.


@pytest.mark.parametrize(
    "content",
    [
        b"\xff\xfea\x00:\x00",  # UTF-16
        b"a: \xe9\n",
        b"a\x00: {}\n",
        b"",
        b"# nothing\n",
        b"---\n---\n",
        b"a: {}\n---\nb: {}\n",
        b"!Foo quintic: {}\n",
        b"!Foo {quintic: {}}\n",
        b"quintic: !Foo {}\n",
        b"{quintic: {system: !Foo {load_mass: 1}}}\n",
        b"a: " + b"[" * 100_000,
        b"a: " + b"{a: " * 100_000,
        b"\n".join(b" " * k + b"a:" for k in range(2000)),
        b"a: &x0 [1, 1]\n"
        + b"\n".join(b"x%d: &x%d [*x%d, *x%d]" % (k, k, k - 1, k - 1) for k in range(1, 64)),
        b"a: {description: " + b"x" * 17_000_000 + b"}",
        b"? [1]\n: 2\n",
        b"a: {? {b: c} : 1}\n",
        b"a: {system: {load_mass: 010}}\n",
        b"a: {based_on: a.yaml}\n",
        b"a: {based_on: /dev/zero}\n",
        b"a: {based_on: " + b"x" * 300 + b".yaml}\n",
        b"a: {based_on: b.yaml}\n",
    ],
    ids=lambda content: repr(content[:30]),
)
def test_files_that_are_none_of_a_scenario(content, tmp_path):
    path = tmp_path / "a.yaml"
    path.write_bytes(content)
    for read in (load_scenario, read_grid):
        with pytest.raises(ScenarioError):
            read(path)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *(("10", 10), ("+1", 1), ("-0", 0), ("1e3", 1000.0), ("1.", 1.0), (".5", 0.5)),
        *(("true", True), ("null", None), ("~", None), (".inf", math.inf), ("-.Inf", -math.inf)),
        *(("010", "010"), ("0x10", "0x10"), ("1_000", "1_000"), ("yes", "yes"), ("1:30", "1:30")),
        *(("2024-01-01", "2024-01-01"), ("'5'", "5"), ("=", "=")),
    ],
)
def test_scalars_are_those_of_yaml_1_2(text, value):
    read = parse_plain(text, "text")
    assert read == value
    assert type(read) is type(value)


@pytest.mark.parametrize(
    ("setting", "remedy"),
    [
        ("system.load_mass=010", "give a finite number in plain digits"),
        ("system.load_mass='010'", "give a finite number in plain digits"),
        ("system.load_mass='10'", "give the number without quotes"),
        ("system.cable_stiffness=inf", "or .inf"),
        ("system.load_mass=1e400", "below 1e308"),
        ("optimization_layer.wind=yes", "give true or false"),
        ("engine=fast", "give one of auto, diagram, compiled"),
        ("description=5", "give a text, in quotes"),
        ("phase='!PaperPhase {}'", "give it without quotes, or the name alone"),
        ("system=!Foo {}", "there is no !Foo"),
        ("simulation_duration=1e8", "give at most"),
    ],
)
def test_the_remedy_is_the_right_one(setting, remedy):
    with pytest.raises(ScenarioError, match=remedy):
        load_scenario("quintic", [setting])


def test_what_is_assigned_is_checked_before_a_run():
    scenario = load_scenario("quintic")
    for value in (math.inf, math.nan, -1, 0, None, "5", [5], np.array([5.0]), 10**400, True):
        scenario.simulation_duration = value
        for action in (make_nonstop, simulate, dump_scenario):
            with pytest.raises(ScenarioError, match=r"^simulation_duration = .*: give"):
                action(scenario)
    for scenario in (None, "quintic", {}, Scenario):
        for action in (simulate, dump_scenario):
            with pytest.raises(ScenarioError, match=r"scenario = .*: give a Scenario"):
                action(scenario)


def test_a_file_named_in_python_is_not_ignored():
    scenario = load_scenario("quintic")
    scenario.system.load_file = "load.sdf"
    with pytest.raises(ScenarioError, match=r"system.load_file = load.sdf: it is read"):
        make_nonstop(scenario)


def test_numpy_in_a_field_is_python_in_the_scenario():
    scenario = load_scenario("quintic")
    scenario.system.attachments = np.array(scenario.system.attachments)
    scenario.system.load_mass = np.float32(1.0)
    scenario.pattern.phases = tuple(scenario.pattern.phases)
    scenario.simulation_duration = np.int64(15)
    assert dump_scenario(scenario) == dump_scenario(load_scenario("quintic"))
    scenario.system.attachments[0][0] = np.float64(0.75)  # in place
    assert dump_scenario(scenario) == dump_scenario(load_scenario("quintic"))
    make_nonstop(scenario)


@pytest.mark.parametrize("box", BOXES)
def test_a_swap_in_python_is_that_of_the_command_line(box):
    for name in ("quintic", "real_scale_spread"):
        scenario = load_scenario(name)
        for block in BOXES[box].variants:
            swapped = load_scenario(name, [f"{box}={block.__name__}"])
            for replacement in (block, config_class(block)):
                after, others = replaced(scenario, {box: replacement})
                assert not others
                assert getattr(after, box) == getattr(swapped, box)


class _Uniterable:
    def __iter__(self):
        return 3


@pytest.mark.parametrize("value", [np.array("x"), np.array(None), _Uniterable(), 3, b"x", "a=1"])
@pytest.mark.parametrize("what", ["overrides", "variants", "a variant", "inputs"])
def test_what_is_no_list_is_one_sentence(tmp_path, value, what):
    scenario = Scenario(simulation_duration=0.02)
    calls: dict[str, Callable[[], Any]] = {
        "overrides": lambda: load_scenario("quintic", value),
        "variants": lambda: ablate(scenario, value, tmp_path),
        "a variant": lambda: ablate(scenario, {"a": value}, tmp_path),
        "inputs": lambda: make_nonstop(scenario, inputs=value),
    }
    with pytest.raises(ScenarioError, match=r"(?s)^(overrides|variants?( a)?|inputs) = .*: give "):
        calls[what]()


def test_an_empty_array_of_overrides_is_no_override():
    assert load_scenario("quintic", np.array([])) == load_scenario("quintic")
    heavier = load_scenario("quintic", np.array(["system.load_mass=1.2"]))
    assert heavier.system.load_mass == 1.2
