"""Scenario texts with something wrong: types, names, tags, nesting, spellings, encodings."""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from adversary.api import attempt_call
from adversary.values import (
    BLOCKS,
    SPELLINGS,
    block_with_a_field,
    drawn_value,
    near_value,
    paths,
    resolved,
    scenario_name,
)
from adversary.verdicts import ACCEPTED, MISREAD, REFUSED, Case, Verdict
from drake_nonstop.scenario.loading import SCENARIOS, dump_scenario, load_scenario, parse_scenario
from drake_nonstop.scenario.overrides import changed, to_tree

_ANY, _REFUSED = "any", "refused"
# A text, or bytes, and what has to become of it: _ANY, _REFUSED, or a path with its number.
_Mutated = tuple[str | bytes, Any]
_Mutation = Callable[[np.random.Generator, str], _Mutated]


def _whole(rng: np.random.Generator) -> str:
    """The text of a shipped scenario, as it is or resolved."""
    name = scenario_name(rng)
    if rng.random() < 0.3:
        return (SCENARIOS / f"{name}.yaml").read_text()
    return dump_scenario(load_scenario(name))


def _at_a_path(rng: np.random.Generator, place: str, value: str) -> str:
    """A scenario that says only this."""
    first, *rest = place.split(".")
    tree = resolved("quintic")[first]
    tag = tree["_tag"] + " " if isinstance(tree, dict) and "_tag" in tree else ""
    if not rest:
        return f"mine:\n  based_on: quintic\n  {first}: {value}\n"
    base = "aircraft_rest" if rest[0] == "aircraft" else "quintic"
    keys = "".join(f"\n{'  ' * (k + 2)}{key}:" for k, key in enumerate(rest))
    return f"mine:\n  based_on: {base}\n  {first}: {tag}{keys} {value}\n"


def _path(rng: np.random.Generator) -> tuple[str, Any]:
    found = list(paths(resolved("quintic")))
    return found[rng.integers(len(found))]


def _value(rng: np.random.Generator, text: str) -> _Mutated:
    return _at_a_path(rng, _path(rng)[0], drawn_value(rng)), _ANY


def _near(rng: np.random.Generator, text: str) -> _Mutated:
    path, value = _path(rng)
    return _at_a_path(rng, path, near_value(rng, value)), _ANY


def _spelling(rng: np.random.Generator, text: str) -> _Mutated:
    numbers = [p for p, v in paths(resolved("quintic")) if isinstance(v, float) and "." in p]
    path, spelling = str(rng.choice(numbers)), str(rng.choice(list(SPELLINGS)))
    meant = SPELLINGS[spelling]
    if spelling in ("null", "~") and (path.startswith("simulated.") or ".aircraft." in path):
        return _at_a_path(rng, path, spelling), _ANY  # these may be left out
    return _at_a_path(rng, path, spelling), _REFUSED if meant is None else (path, meant)


def _field(rng: np.random.Generator, text: str) -> _Mutated:
    """A field of any block, in any scenario."""
    box, block = block_with_a_field(rng)
    return f"mine:\n  based_on: {scenario_name(rng)}\n  {box}: {block}\n", _ANY


def _in_list(rng: np.random.Generator, text: str) -> _Mutated:
    """A spelling among the numbers of a list."""
    spelling = str(rng.choice([s for s in SPELLINGS if "," not in s]))
    meant = SPELLINGS[spelling]
    text = _at_a_path(rng, "load_trajectory.displacement", f"[0.5, {spelling}, 0.5]")
    path = "load_trajectory.displacement.1"
    return text, _REFUSED if meant is None else (path, meant)


def _renamed(rng: np.random.Generator, text: str) -> _Mutated:
    """A key with a slip of the pen."""
    keys = list(re.finditer(r"\b([a-z]\w{3,})(?=: )", text))
    if not keys:
        return text + "  durration: 3\n", _REFUSED
    key = keys[rng.integers(len(keys))]
    slip = [key[0][::-1], key[0] + "s", key[0][:-1], key[0].upper(), key[0].replace("_", "-") + "_"]
    return text[: key.start()] + str(rng.choice(slip)) + text[key.end() :], _REFUSED


def _twice(rng: np.random.Generator, text: str) -> _Mutated:
    lines = text.splitlines()
    plain = [k for k, line in enumerate(lines) if re.match(r" +\w+: [^{\[!]*$", line)]
    if not plain:
        return text, _ANY
    k = int(rng.choice(plain))
    return "\n".join([*lines[: k + 1], *lines[k:]]), _REFUSED


def _unknown(rng: np.random.Generator, text: str) -> _Mutated:
    name = str(
        rng.choice(
            [
                "name",
                "gain",
                "_tag",
                "system.load_mass",
                "''",
                "1",
                "null",
                "true",
                "? [a]",
                "<<",
                "__class__",
                "self",
                "x" * 400,
                "é",
                "!!int 3",
                "*a",
            ]
        )
    )
    return f"mine:\n  based_on: line\n  {name}: {drawn_value(rng)}\n", _REFUSED


def _part_unknown(rng: np.random.Generator, text: str) -> _Mutated:
    part = str(rng.choice([*BLOCKS, "system", "simulated", "simulator_config"]))
    name = str(rng.choice(["gain", "_tag", "load_masss", "null", "1", "__init__", "x" * 400]))
    return f"mine:\n  {part}:\n    {name}: {drawn_value(rng)}\n", _REFUSED


def _tag(rng: np.random.Generator, text: str) -> _Mutated:
    """A block in a box that it does not fit, or a tag that is none."""
    box = str(rng.choice(list(BLOCKS)))
    others = [b for name, blocks in BLOCKS.items() if name != box for b in blocks]
    made_up = [
        "Foo",
        "",
        "!Cables",
        "os.system",
        "a..b",
        ".",
        "x" * 300,
        "Scenario",
        "é",
        "%20",
        f"{BLOCKS[box][0]}Config",
        BLOCKS[box][0].lower(),
        f"{BLOCKS[box][0]} x",
    ]
    block = str(rng.choice(others if rng.random() < 0.5 else made_up))
    content = str(rng.choice(["{}", "", "[]", "5", "{a: 1}", "text", "null", "''"]))
    return f"mine:\n  {box}: !{block} {content}\n", _REFUSED


def _top(rng: np.random.Generator, text: str) -> _Mutated:
    """What is not one scenario."""
    return str(
        rng.choice(
            [
                "",
                " ",
                "\n",
                "# nothing",
                "---",
                "...",
                "null",
                "5",
                "text",
                "[]",
                "[a: 1]",
                "{}",
                "a",
                "a:",
                "a: 5",
                "a: []",
                "a: text",
                "a: {}\nb: {}",
                "--- {a: {}}\n--- {b: {}}",
                "!Tag {a: {}}",
                "!Tag\na: {simulation_duration: 1}",
                "a: !Tag {simulation_duration: 1}",
                "!!map {a: {}}",
                "!!set {a}",
                "? [a]\n: {}",
                "1: {}",
                "true: {}",
                "null: {}",
                "'': {}",
                "..: {}",
                "a/b: {}",
                "-a: {}",
                ".a: {}",
                "é: {}",
                f"{'a' * 300}: {{}}",
                f"{'a' * 5000}: {{}}",
                "a b: {}",
                "'a\\n': {}",
                '"a\\nb": {}',
                "~: {}",
                "con: {}",
                "a: &a {system: *a}",
                "a: &a\n  system: {load_mass: *a}",
                "&x a: {simulation_duration: 1}",
                "a: {<<: {simulation_duration: 1}}",
                "%YAML 9.9\n---\na: {}",
                "%TAG ! x\n---\na: {}",
                "a: {simulation_duration: 1",
                "a: |\n  text",
                "a:\n\tduration: 1",
                "{{}: 1}",
                "? \n: ",
                "- - - a",
                "a: !!python/none",
                "a: {simulation_duration: !!float 3}",
                "a: {description: !!binary aGk=}",
                "a: {description: >\n}",
                "2024-01-01: {}",
                "1.5: {}",
                "a.b: {}",
                "a-b: {simulation_duration: 0.5}",
            ]
        )
    ), _ANY


def _nested(rng: np.random.Generator, text: str) -> _Mutated:
    depth = int(rng.choice([3, 10, 19, 21, 50, 300, 1000, 3000, 20_000, 200_000]))
    opening, closing = (("[", "]"), ("{a: ", "}"), ("[[", "]]"), ("!A {a: ", "}"))[rng.integers(4)]
    path = str(
        rng.choice(
            ["simulation_duration", "system.load_inertia", "pattern.phases", "scene.trail_time"]
        )
    )
    if rng.random() < 0.2:
        return opening * depth + closing * depth, _REFUSED
    if rng.random() < 0.2:  # by indentation
        depth = min(depth, 3000)
        return "\n".join(" " * k + f"a{k}:" for k in range(depth)), _REFUSED
    closing = closing if rng.random() < 0.8 else ""
    return _at_a_path(rng, path, f"{opening * depth}1{closing * depth}"), _REFUSED


def _aliases(rng: np.random.Generator, text: str) -> _Mutated:
    """A few lines that stand for very much, or for themselves."""
    levels, width = int(rng.integers(3, 40)), int(rng.integers(2, 12))
    form = rng.integers(4)
    if form == 0:
        bomb = [f"    - &a{k} [{', '.join([f'*a{k - 1}'] * width)}]" for k in range(1, levels)]
        return "\n".join(["mine:", "  pattern:", "    - &a0 [1]", *bomb]), _REFUSED
    if form == 1:
        bomb = [f"  a{k}: &a{k} {{b: *a{k - 1}, c: *a{k - 1}}}" for k in range(1, levels)]
        return "\n".join(["mine:", "  a0: &a0 {b: 1}", *bomb]), _REFUSED
    if form == 2:
        bomb = ", ".join(f"&a{k} [{', '.join([f'*a{k - 1}'] * width)}]" for k in range(1, levels))
        return _at_a_path(rng, "system.attachments", f"[&a0 [1, 1, 1], {bomb}]"), _REFUSED
    return (
        f"mine: &m\n  simulation_duration: 1\n  {rng.choice(['system', 'scene', 'a'])}: *m\n",
        _REFUSED,
    )


def _large(rng: np.random.Generator, text: str) -> _Mutated:
    count = int(rng.choice([100, 3000, 30_000, 300_000]))
    form = rng.integers(5)
    if form == 0:
        return _at_a_path(rng, "load_trajectory.displacement", f"[{'1, ' * count}1]"), _REFUSED
    if form == 1:
        return "mine:\n" + "".join(f"  a{k}: {k}\n" for k in range(count)), _REFUSED
    if form == 2:
        return f"mine: {{description: {'x' * count}, simulation_duration: 1}}", _ANY
    if form == 3:
        count = min(max(count, 1000), 30_000)
        points = ", ".join(f"[{math.cos(k):.3f}, {math.sin(k):.3f}, 0]" for k in range(count))
        return _at_a_path(rng, "system.attachments", f"[{points}]"), _ANY
    return "#" + "x" * count + "\n" * count + "mine: {simulation_duration: 1}", _ANY


def _damaged(rng: np.random.Generator, text: str) -> _Mutated:
    """Cut off, or with some characters replaced, left out or put in."""
    if rng.random() < 0.4:
        return text[: rng.integers(len(text))], _ANY
    characters = list(text)
    for _ in range(int(rng.integers(1, 6))):
        k, new = (
            int(rng.integers(len(characters))),
            str(rng.choice(list("{}[]:,!&*#|>%@`'\"\t\0-?é "))),
        )
        characters[k : k + int(rng.integers(0, 3))] = [new] * int(rng.integers(0, 3))
    return "".join(characters), _ANY


def _encoded(rng: np.random.Generator, text: str) -> _Mutated:
    text = text.replace("description: ", "description: é ", 1)
    form = rng.integers(9)
    if form < 5:
        encoding = ["utf-8-sig", "utf-16", "utf-32", "latin-1", "utf-16-le"][form]
        return text.encode(encoding), _ANY
    if form == 5:
        return text.replace("\n", "\r\n").encode(), _ANY
    if form == 6:
        return text.replace("\n", "\r").encode(), _ANY
    if form == 7:
        return rng.bytes(int(rng.integers(1, 5000))), _REFUSED
    data = bytearray(text.encode())
    for _ in range(3):
        data[rng.integers(len(data))] = rng.integers(256)
    return bytes(data), _ANY


def _base(rng: np.random.Generator, text: str) -> _Mutated:
    base = str(
        rng.choice(
            [
                "line.yaml",
                "mine.yaml",
                "./mine.yaml",
                "../here/mine.yaml",
                "no_such",
                "no_such.yaml",
                "5",
                "[line]",
                "{line: 1}",
                "null",
                "''",
                "'.yaml'",
                ".",
                "/",
                "/dev/zero",
                "/dev/stdin",
                "true",
                "!line",
                "quintic.yml",
                "x" * 300 + ".yaml",
                "x" * 300,
                "'a\\0.yaml'",
                '"a\\0b.yaml"',
                "~",
                "/proc/self/mem.yaml",
                "Line",
                "line ",
                "é",
                "/dev/zero/a.yaml",
                ".yaml",
                "a/../mine.yaml",
            ]
        )
    )
    return f"mine:\n  based_on: {base}\n  simulation_duration: 1\n".encode(), _ANY


_MUTATIONS: dict[_Mutation, float] = {
    _value: 3,
    _near: 3,
    _field: 2,
    _spelling: 2,
    _in_list: 1,
    _renamed: 1,
    _twice: 0.5,
    _unknown: 0.7,
    _part_unknown: 0.7,
    _tag: 1.2,
    _top: 1.5,
    _nested: 1,
    _aliases: 1,
    _large: 0.6,
    _damaged: 2.5,
    _encoded: 1,
    _base: 1,
}


def draw(rng: np.random.Generator) -> Case:
    weights = np.array(list(_MUTATIONS.values()))
    mutation = list(_MUTATIONS)[rng.choice(len(weights), p=weights / weights.sum())]
    text, expected = mutation(rng, _whole(rng))
    is_file = isinstance(text, bytes) or rng.random() < 0.3
    trusts = bool(rng.random() < 0.2)
    shown = text if len(text) < 3000 else text[:600] + type(text)().join([text[:0], text[-300:]])
    return Case(
        text=f"{mutation.__name__[1:]}, {'load' if is_file else 'parse'}_scenario: {shown!r}",
        attempt=lambda folder: _attempt(folder, text, expected, is_file, trusts),
        limit=10,
    )


def _attempt(
    folder: Path, text: str | bytes, expected: Any, is_file: bool, trusts: bool
) -> Verdict:
    if is_file:
        data = text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
        (folder / "mine.yaml").write_bytes(data)
    scenario, verdict = attempt_call(
        lambda: (
            load_scenario("mine.yaml", trust=trusts)
            if is_file
            else parse_scenario(text, trust=trusts)
        )  # type: ignore[arg-type]
    )
    if verdict.ending != ACCEPTED or scenario is None:
        return verdict
    if isinstance(expected, tuple):
        path, meant = expected
        found: Any = to_tree(scenario)
        for key in path.split("."):
            found = found[int(key) if key.isdigit() else key]
        if found != meant:
            verdict.add(MISREAD, f"{path} is {found}, not {meant}")
    written, again = attempt_call(lambda: _written_again(scenario))
    if again.ending != ACCEPTED or written[0] != written[1]:
        verdict.add(MISREAD, f"what is written does not read back: {again.message}")
    _, flown = attempt_call(lambda: _fly(scenario))
    verdict.merge(flown)
    if expected == _REFUSED and flown.ending != REFUSED:
        verdict.add(MISREAD, "accepted")
    return verdict


def _written_again(scenario: Any) -> tuple[str, str]:
    text = dump_scenario(scenario)
    return text, dump_scenario(parse_scenario(text, trust=True))


def _fly(scenario: Any) -> Any:
    from drake_nonstop import simulate

    return simulate(changed(scenario, ["simulation_duration=0.02"], trust=True))
