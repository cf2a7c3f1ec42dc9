"""Whatever is given, a scenario is made of it, or one sentence says what to give instead.

Inputs are drawn by seeds over all fields that there are; an input that fails is found again by its
seed, which the test's name has.
"""

import dataclasses
import math
import random
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop import (
    ConstantParameters,
    ConstantParametersConfig,
    Scenario,
    ScenarioError,
    SystemParameters,
    ablate,
    dump_scenario,
    load_scenario,
    make_nonstop,
    parse_scenario,
    read_grid,
    read_sweep,
    scenario_names,
    simulate,
)
from drake_nonstop.diagrams.nonstop import BOXES, replaced
from drake_nonstop.loop.box import config_class
from drake_nonstop.scenario.choices import CHOICES
from drake_nonstop.scenario.overrides import to_tree
from drake_nonstop.scenario.yaml_text import dump_plain, parse_plain
from drake_nonstop.validation import StrictFields

SEEDS = nightly_beyond(1, "adversary", range(3))
INPUTS = 60  # of each seed; a hundred times as many were tried

# Values of YAML in one line, each in a scalar's place.
TOKENS = [
    *("010", "0o10", "0x10", "0b1", "1_000", "1:30", "+1", "-0.0", "1.", ".5", "1e400", "-1e400"),
    *("1e300", "1e-300", "1e27", "1e9", "1e-9", "9" * 400, "9" * 5000, "-1", "0", "2", "3.7"),
    *(".inf", "-.inf", ".Inf", "inf", "Infinity", ".nan", "nan", ".NaN", "yes", "off", "true"),
    *("~", "null", "", "''", "'5'", "'010'", '"1e3"', "2024-01-01", "2024-01-01T00:00:00Z"),
    *("!!float 5", "!!int '5'", "!!python/object/apply:os.system ['true']", "!!binary aGk="),
    *("!", "!Foo", "!Foo {}", "!Foo [1]", "! 5", "!!map {}", "!<x> 5", "!PaperPhase {}"),
    *("'!PaperPhase {}'", "!PaperPhase 5", "PaperPhase", "!os.system {}", "!a..b {}", "..", "."),
    *("[]", "{}", "[[]]", "[1, 2, 3]", "[[1, 2], [3]]", "[a, b, c]", "[.nan, 0, 0]", "[~]"),
    *("{a: 1}", "{1: 2}", "{[1]: 2}", "{~: 1}", "{a: 1, a: 2}", "{<<: {a: 1}}", "{_tag: x}"),
    *("&a [*a]", "*a", "&a 5", "[&a 1, *a]", "&a {x: *a}", "<<", "=", "- 1", "? 1", "a: b: c"),
    *("[" * 5000, "{a: " * 5000, "[" * 30 + "]" * 30, "- " * 3000, "x" * 100_000, "'", '"\\ud800"'),
    *("\t1", "\x001", "\ufeff5", "\u2028", "\x1b[31m", "é", "\U0001f680", "\ud800", "|", "> a"),
    *("--- 1", "...", "%YAML 1.1", "# x", "5 # x", "@x", "`x`", "%x", "]", "}", ",", ":", "-", "?"),
]

# Values of Python in a field's place.
OBJECTS: list[Any] = [
    *(None, True, False, 0, -1, 1, 2, 10**12, 10**400, -(10**400), 1e300, 1e-300, -0.0, 1e9, 2.5),
    *(math.inf, -math.inf, math.nan, "", "5", "x", "nan", "\ud800", "a\nb", b"5", 1j, object()),
    *([], [1], [1, 2, 3], [[1, 2], [3]], [[]], [None], ["a"], [math.nan] * 3, (1, 2, 3), {1: 2}),
    *({}, {"_tag": "!PaperPhase"}, set(), range(3), iter([1]), lambda: 5, ConstantParameters),
    *(np.float64(2), np.float32(2), np.int64(2), np.bool_(True), np.nan, np.zeros(3), np.zeros(0)),
    *(np.zeros((4, 3)), np.eye(3), np.array("x"), np.array([None]), np.zeros((2,) * 25)[:0]),
    *(ConstantParametersConfig(), ConstantParametersConfig, SystemParameters(), Scenario()),
]
SELF: list[Any] = []
SELF.append(SELF)
OBJECTS.append(SELF)


def checked(action: Callable[[], Any], note: object) -> Any:
    """What the action returns, None where it ends with a sentence; all else is a failure."""
    start = time.process_time()
    try:
        result = action()
    except ScenarioError as error:
        result, message = None, str(error)
        assert message.isprintable(), note
        assert " = " in message, (note, message)
        assert ": " in message, (note, message)
        assert len(message) < 1500, (note, message)
    except BaseException as error:
        raise AssertionError(f"{note!r:.300}: {type(error).__name__}: {error}") from error
    assert time.process_time() - start < 2, note
    return result


def reads_back(scenario: Scenario | None, note: object) -> None:
    if scenario is not None:
        text = dump_scenario(scenario)
        assert dump_scenario(parse_scenario(text)) == text, note


def paths(tree: dict[str, Any], before: str = "") -> list[str]:
    found = []
    for key, value in tree.items():
        found += [before + key] if key != "_tag" else []
        found += paths(value, f"{before}{key}.") if isinstance(value, dict) else []
    return found


def all_configs() -> list[tuple[str, Any]]:
    """The names and configs of every field of a scenario that is a dataclass."""
    parts = [("", Scenario()), ("system", SystemParameters()), ("simulated", Scenario().simulated)]
    parts += [(name, config()) for name, choices in CHOICES.items() for config in choices]
    return parts


CONFIGS = all_configs()


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_any_override(seed):
    draw = random.Random(seed)
    names = scenario_names()
    trees = {name: paths(to_tree(load_scenario(name))) for name in names}
    for _ in range(INPUTS):
        name = draw.choice(names)
        path = draw.choice(trees[name])
        if draw.random() < 0.1:
            path = draw.choice([f"{path}.x", f"{path}.", f".{path}", path[1:], "", path + "\n"])
        override = f"{path}={draw.choice(TOKENS)}"
        made = checked(lambda: load_scenario(name, [override]), override)  # noqa: B023
        reads_back(made, override)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_any_text(seed):
    draw = random.Random(1000 + seed)
    texts = [dump_scenario(load_scenario(name)) for name in scenario_names()]
    for _ in range(INPUTS):
        text = mutated(draw.choice(texts), draw)
        reads_back(checked(lambda: parse_scenario(text), text), text)  # noqa: B023


def mutated(text: str, draw: random.Random) -> str:
    """The text of a scenario with one to three things changed."""
    for _ in range(draw.randint(1, 3)):
        lines = text.splitlines() or [""]
        at = draw.randrange(len(lines))
        where = draw.randrange(len(text) + 1)
        key, colon, _ = lines[at].partition(": ")
        kind = draw.randrange(9)
        if kind == 0:
            lines[at] = f"{key}{colon}{draw.choice(TOKENS)}"
        elif kind == 1:
            lines[at] = draw.choice(["  ", " ", "\t", "- ", "!Foo ", "&a ", "? "]) + lines[at]
        elif kind == 2:
            lines.insert(at, draw.choice(lines))
        elif kind == 3:
            del lines[at]
        elif kind == 4:
            lines.insert(at, draw.choice(TOKENS))
        elif kind == 5:
            lines[at] = lines[at].replace("0", draw.choice(TOKENS), 1)
        else:
            changed = {
                6: text[:where],
                7: text[:where] + draw.choice(TOKENS) + text[where:],
                8: text[:where] + text[where + draw.randint(1, 40) :],
            }[kind]
            lines = changed.split("\n")
        text = "\n".join(lines)
    return text


@pytest.mark.parametrize("seed", SEEDS)
def test_any_value_assigned_in_python(seed):
    draw = random.Random(2000 + seed)
    for _ in range(INPUTS):
        scenario = load_scenario("line")
        part, config = draw.choice(CONFIGS)
        field = draw.choice([f.name for f in dataclasses.fields(config)] or ["none"])
        value = draw.choice(OBJECTS)
        if draw.random() < 0.3:
            value = [value] * draw.randint(1, 4)

        def action(part=part, field=field, value=value, config=config, scenario=scenario):
            target = dataclasses.replace(config) if part else scenario
            setattr(target, field, value)
            if part:
                setattr(scenario, part, target)
            dump_scenario(scenario)
            return scenario

        note = (part, type(config).__name__, field, repr(value)[:200])
        reads_back(checked(action, note), note)


# Numbers at the ends of what a float can be, and of what a scenario may hold.


@pytest.mark.parametrize("seed", SEEDS)
def test_plain_values_read_back(seed):
    draw = random.Random(6000 + seed)
    for _ in range(INPUTS):
        token = draw.choice(TOKENS)
        value = draw.choice([token, [token], {"a": token}, np.float64(draw.random()), 1e300])
        text = checked(lambda: dump_plain(value), value)  # noqa: B023
        back = checked(lambda: parse_plain(text, "text"), text)  # noqa: B023
        assert back is None or back == value, (value, text)


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
    for read in (load_scenario, read_sweep, read_grid):
        assert checked(lambda: read(path), content[:100]) is None  # noqa: B023


@pytest.mark.parametrize(("part", "config"), CONFIGS, ids=lambda item: str(item)[:40])
def test_a_field_that_there_is_not_cannot_be_assigned(part, config):
    assert isinstance(config, StrictFields)
    names = [f.name for f in dataclasses.fields(config)]
    for name in names or ["gain"]:
        with pytest.raises(ScenarioError, match=f"there is no {name}x.*there are") as caught:
            setattr(config, f"{name}x", 5)
        assert not names or "did you mean" in str(caught.value)
    assert not hasattr(config, "x")


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
