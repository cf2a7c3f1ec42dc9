"""Bad and extreme values, as YAML texts, and the paths of scenarios that they are put at."""

import copy
import functools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from drake_nonstop.model.aircraft import AircraftParameters, aircraft_names, values_of
from drake_nonstop.scenario.choices import CHOICES, block_name
from drake_nonstop.scenario.fields import fields_of
from drake_nonstop.scenario.loading import load_scenario, scenario_names
from drake_nonstop.scenario.overrides import to_tree

# Spellings of numbers and what a reader takes them for; None: it has to be refused.
SPELLINGS: dict[str, float | None] = {
    "010": 10.0,
    "-010": -10.0,
    "0x1F": 31.0,
    "0b101": 5.0,
    "0o17": 15.0,
    "1_000": 1000.0,
    "1_0.5": 10.5,
    "_1": None,
    "1__0": 10.0,
    "1e3": 1000.0,
    "1E+3": 1000.0,
    "1e-3": 1e-3,
    "1.e3": 1000.0,
    ".5": 0.5,
    "5.": 5.0,
    "+5": 5.0,
    "--5": None,
    "1:30": None,
    "1:30.5": None,
    "1,5": None,
    "1 000": None,
    "1'000": None,
    "1.2.3": None,
    "12 kg": None,
    "1/3": None,
    "50%": None,
    "３": 3.0,  # a full-width digit
    "٣": 3.0,  # an Arabic one
    "½": None,
    "∞": None,
    "1e400": None,
    "-1e400": None,
    ".nan": None,
    ".NaN": None,
    "nan": None,
    "NaN": None,
    "!!float nan": None,
    "1e": None,
    "e5": None,
    "yes": None,
    "on": None,
    "y": None,
    "null": None,
    "~": None,
    "None": None,
    "'1.0'": None,
    '"2"': None,
    "2024-01-01": None,
    "1d": None,
    "1f": None,
    "1j": None,
    "!!str 5": None,
    "!!int 5.5": None,
    "!!bool 1": None,
}

NUMBERS = (
    *("0", "-0.0", "-1", "1", "2", "0.5", "1e-300", "-1e-300", "5e-324", "1e-12", "1e-9", "1e-6"),
    *("1e-3", "1e3", "1e6", "1e9", "1e12", "1e15", "1e30", "-1e30", "1e150", "1e300", "-1e300"),
    *(".inf", "-.inf", "9007199254740993", f"1{'0' * 30}", f"1{'0' * 400}", f"-1{'0' * 5000}"),
    *("100", "1000", "10000", "4294967296", "-2147483649", "18446744073709551616"),
)

OTHERS = (
    *("true", "false", "''", "' '", "text", "a.b", "a b", "é", "🛩", "'\\'", '"\\0"', '"\\u202e"'),
    *("[]", "[[]]", "[[[]]]", "[1]", "[1, 2]", "[1, 2, 3]", "[2, 1]", "[0, 0]", "[0, 0, 0]"),
    *("[1, 2, 3, 4]", "[[1, 2, 3]]", "[[1], [2], [3]]", "[a, b, c]", "[true, false, true]"),
    *(
        "[.nan, 0, 0]",
        "[.inf, 0, 0]",
        "[1e30, 0, 0]",
        "[1e300, 1e300, 1e300]",
        "[null]",
        "[1, [2]]",
    ),
    *("[[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "[[0, 0, 0], [0, 0, 0], [0, 0, 0]]", "[1, 2"),
    *("[[1, 0], [0, 1]]", "[[1, 0, 0], [0, 1], [0, 0, 1]]", "[-1, -1, -1]", "[1e-300, 1e-300]"),
    *("{}", "{a: 1}", "{_tag: x}", "{_tag: '!PaperPhase'}", "{: }", "{1: 2}", "{[1]: 2}", "}{"),
    *("!Foo {}", "!Foo", "!PaperPhase", "!PaperPhase {}", "!PaperPhase {gain: 1}", "!", "!! x"),
    *("!Scenario {}", "!<tag:x,2000:y> {}", "!os.system {}", "!os.path.Join {a: 1}", "!a.b.c.D {}"),
    *("!!python/object/apply:os.system [ls]", "!!python/name:os.system", "!!set {a, b}"),
    *(
        "!!binary aGVsbG8=",
        "!!binary '*'",
        "!!timestamp 2001-12-14",
        "!!omap [a: 1]",
        "!!map {a: 1}",
    ),
    *("!!seq [1]", "!!null ''", "&a 5", "*a", "&a [*a]", "&a {b: *a}", "<<", "{<<: {a: 1}}", "? a"),
    *(
        "@",
        "`",
        "%",
        "# nothing",
        "- a",
        "a: b",
        "a: b: c",
        "|\n  text",
        ">",
        "'",
        '"',
        "\t",
        "\x07",
    ),
    *("/dev/zero", "/dev/full", "/", ".", "..", "~", "/nonexistent/file.csv", "no_such.yaml"),
    *(
        "NaN",
        "inf",
        "search",
        "runge_kutta2",
        "implicit_euler",
        "red",
        "'#12'",
        "'#gggggg'",
        "'#fff'",
    ),
    *("x" * 300, "x" * 100_000, f"[{'1, ' * 2000}1]", "[" * 50 + "]" * 50, "[" * 5000 + "]" * 5000),
    *("{a: " * 40 + "1" + "}" * 40, "[[1, 2, 3]," + " [1, 2, 3]," * 300 + "]"),
)


def drawn_value(rng: np.random.Generator) -> str:
    """A value as YAML."""
    kind = rng.random()
    if kind < 0.35:
        return str(rng.choice(NUMBERS))
    if kind < 0.5:
        return str(rng.choice(list(SPELLINGS)))
    if kind < 0.6:
        return repr(float(rng.normal() * 10.0 ** rng.uniform(-12, 12)))
    if kind < 0.65:
        return str([float(x) for x in rng.normal(size=rng.integers(1, 5)).round(2)])
    return OTHERS[rng.integers(len(OTHERS))]


def near_value(rng: np.random.Generator, value: Any) -> str:
    """A value of the same type and shape, as YAML, with something extreme in it."""
    extreme = [0.0, -1.0, 1e-12, 1e-6, 1e-3, 1e3, 1e6, 1e12, 1e30, 1e200, math.inf, -1e-3, 0.1, 10]
    if isinstance(value, bool):
        return str(not value).lower()
    if isinstance(value, (int, float)):
        if rng.random() < 0.5 and value == value and abs(value) < math.inf:
            number = value * float(10.0 ** rng.uniform(-3, 3)) * rng.choice([1, 1, 1, -1])
            return str(int(number)) if isinstance(value, int) else repr(float(number))
        number = float(rng.choice(extreme))
        number = ".inf" if number == math.inf else number
        return str(int(number)) if isinstance(value, int) and number != ".inf" else str(number)
    if isinstance(value, str):
        return str(rng.choice(["", value.upper(), value[:-1], value + "x", value * 2]) or "''")
    if isinstance(value, list) and value:
        items = [near_value(rng, item) if rng.random() < 0.5 else _as_yaml(item) for item in value]
        if rng.random() < 0.3:
            items.pop(rng.integers(len(items)))
        if rng.random() < 0.2:
            items += items[:1]
        return f"[{', '.join(items)}]"
    return drawn_value(rng)


def _as_yaml(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_as_yaml, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and math.isinf(value):
        return ".inf" if value > 0 else "-.inf"
    return repr(value)


@functools.cache
def resolved(name: str) -> dict[str, Any]:
    """The tree of a shipped scenario, with every field, those that it leaves out too."""
    scenario = load_scenario(name)
    tree, model = to_tree(scenario), aircraft_names()[0]
    aircraft = {"model": model, **values_of(AircraftParameters(model=model))}
    tree["system"]["aircraft"] = aircraft | tree["system"].get("aircraft", {})
    tree["simulated"] = copy.deepcopy(tree["system"]) | tree["simulated"]
    for box in CHOICES:
        names = [*fields_of(type(getattr(scenario, box)))]
        tree[box] = dict.fromkeys(names) | tree[box]
    return tree


def block_with_a_field(rng: np.random.Generator) -> tuple[str, str]:
    """A box, and as YAML one of its blocks with a bad or extreme value of a field."""
    found = [(box, config) for box, configs in CHOICES.items() for config in configs]
    box, config = found[rng.integers(len(found))]
    names = [*fields_of(config)]
    if not names:
        return box, f"!{block_name(config)} {drawn_value(rng)}"
    name = str(rng.choice(names))
    near = near_value(rng, getattr(config(), name))
    value = near if rng.random() < 0.6 else drawn_value(rng)
    return box, f"!{block_name(config)} {{{name}: {value}}}"


def paths(tree: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Every path of a tree, and what is there: parts and leaves."""
    for key, value in tree.items():
        if key != "_tag":
            yield key, value
            if isinstance(value, dict):
                yield from ((f"{key}.{path}", leaf) for path, leaf in paths(value))


def scenario_name(rng: np.random.Generator) -> str:
    return str(rng.choice(scenario_names()))


BLOCKS = {name: [block_name(choice) for choice in CHOICES[name]] for name in CHOICES}
