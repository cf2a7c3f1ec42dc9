"""Strategies for bad and extreme values, and for the fields of scenarios that they are put at."""

import dataclasses
import math
import types
import typing
from collections.abc import Iterator
from typing import Any, NamedTuple

from hypothesis import strategies as st
from registries import CHOICES, block_name

from drake_nonstop import AircraftParameters, RunLimits, SceneConfig, SystemParameters

SHORT = "simulation_duration=0.02"

# Spellings of numbers and what is meant by them; None: it has to be refused, for YAML 1.1, YAML 1.2
# and Python read other numbers, or none.
SPELLINGS: dict[str, float | None] = {
    **dict.fromkeys(["1e3", "1E+3", "1.e3"], 1e3),
    **dict.fromkeys(["5.", "+5"], 5.0),
    **dict.fromkeys(["010", "-010", "0x1F", "0b101", "0o17", "1_000", "1_0.5", "_1", "1__0"]),
    **dict.fromkeys(["--5", "1:30", "1:30.5", "1,5", "1 000", "1'000", "1.2.3", "12 kg", "1/3"]),
    **dict.fromkeys(["50%", "３", "٣", "½", "∞", "1e400", "-1e400", ".nan", ".NaN", "nan", "NaN"]),
    **dict.fromkeys(["!!float nan", "1e", "e5", "yes", "on", "y", "null", "~", "None", "'1.0'"]),
    **dict.fromkeys(['"2"', "2024-01-01", "1d", "1f", "1j", "!!str 5", "!!int 5.5", "!!bool 1"]),
}
NUMBERS = st.one_of(
    st.sampled_from([0.0, -0.0, -1.0, 1.0, 2.0, 5e-324, 1e-300, 1e-12, 1e-6, 1e-3, 100.0, 1e4]),
    st.sampled_from([1e6, 1e9, 1e12, 1e30, -1e30, 1e150, 1e300, math.inf, -math.inf, math.nan]),
    st.sampled_from([9007199254740993, 10**30, 10**400, -(10**5000), 4294967296, -2147483649]),
    st.floats(allow_nan=False),
    st.integers(),
)
# What is no number at all, or YAML of some other kind.
OTHERS = st.sampled_from(
    [
        *("true", "false", "''", "' '", "text", "a.b", "é", "🛩", '"\\0"', '"\\u202e"', "'#12'"),
        *("[]", "[[]]", "[1]", "[1, 2]", "[1, 2, 3]", "[0, 0, 0]", "[1, 2, 3, 4]", "[[1, 2, 3]]"),
        *("[a, b, c]", "[.nan, 0, 0]", "[.inf, 0, 0]", "[1e30, 0, 0]", "[null]", "[1, [2]]"),
        *("[[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "[[0, 0, 0], [0, 0, 0], [0, 0, 0]]", "[1, 2", "}{"),
        *("[[1, 0, 0], [0, 1], [0, 0, 1]]", "[-1, -1, -1]", "[true, false, true]", "[2, 1]"),
        *("{}", "{a: 1}", "{_tag: x}", "{_tag: '!PaperPhase'}", "{: }", "{1: 2}", "{[1]: 2}"),
        *("!Foo {}", "!Foo", "!PaperPhase", "!PaperPhase {gain: 1}", "!", "!! x", "!Scenario {}"),
        *("!<tag:x,2000:y> {}", "!os.system {}", "!a.b.c.D {}", "!!python/name:os.system", "*a"),
        *("!!python/object/apply:os.system [ls]", "!!set {a, b}", "!!binary aGVsbG8=", "&a [*a]"),
        *("!!timestamp 2001-12-14", "!!omap [a: 1]", "&a {b: *a}", "<<", "{<<: {a: 1}}", "? a"),
        *("@", "`", "%", "# nothing", "- a", "a: b", "a: b: c", "|\n  text", ">", "'", '"', "\t"),
        *("/dev/zero", "/dev/full", "/", "..", "no_such.yaml", "x" * 300, "x" * 100_000, "\x07"),
        *("[" * 50 + "]" * 50, "[" * 5000 + "]" * 5000, "{a: " * 40 + "1" + "}" * 40),
        f"[{'1, ' * 2000}1]",
    ]
)


def as_yaml(value: Any) -> str:
    """A value of Python's in YAML."""
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(as_yaml, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if value != value else ".inf" if value > 0 else "-.inf"
    if isinstance(value, int) and value.bit_length() > 10_000:  # too many digits for `str`
        return f"{'-' * (value < 0)}1{'0' * 5000}"
    return "null" if value is None else str(value)


VALUES = st.one_of(
    NUMBERS.map(as_yaml),
    st.sampled_from([*SPELLINGS]),
    st.lists(st.floats(-10, 10), min_size=1, max_size=5).map(as_yaml),
    OTHERS,
)


class Field(NamedTuple):
    """A declared field: the change that gives it a value {}, its types, its default, a scenario."""

    form: str
    kinds: set[Any]
    default: Any
    scenario: str = "quintic"

    def change(self, value: str) -> str:
        """The change that gives it a value in YAML."""
        return self.form.replace("{}", value)


def _declared() -> Iterator[Field]:
    owners = {
        "limits.NAME={}": RunLimits(),
        "scene.NAME={}": SceneConfig(),
        "system.NAME={}": SystemParameters(),
        "simulated.NAME={}": SystemParameters(),
        "system.aircraft.NAME={}": AircraftParameters(model="rascal_110"),
    }
    for box, configs in CHOICES.items():
        owners |= {f"{box}=!{block_name(kind)} {{NAME: {{}}}}": kind() for kind in configs}
    for form, owner in owners.items():
        hints = typing.get_type_hints(type(owner))
        scenario = "aircraft_rest" if ".aircraft." in form else "quintic"
        for name in (field.name for field in dataclasses.fields(owner)):
            kind = hints[name]
            kinds = {*typing.get_args(kind)} if isinstance(kind, types.UnionType) else {kind}
            yield Field(form.replace("NAME", name), kinds, getattr(owner, name), scenario)
    for name, default in (("control_period", 0.01), ("random_seed", 0), ("engine", "auto")):
        yield Field(f"{name}={{}}", {type(default)}, default)
    yield Field("simulator_config.max_step_size={}", {float}, 0.1)


FIELDS = [*_declared()]


def near(default: Any) -> st.SearchStrategy[str]:
    """Values in YAML of the same type and shape, with something extreme in them."""
    if isinstance(default, bool):
        return st.just(as_yaml(not default))
    if isinstance(default, (int, float)):
        scaled = st.builds(lambda by: default * 10.0**by, st.floats(-3, 3))
        return st.one_of(scaled, scaled.map(lambda x: -x), NUMBERS).map(as_yaml)
    if isinstance(default, str):
        return st.sampled_from([default.upper(), default[:-1] or "''", f"{default}x", default * 2])
    if isinstance(default, list) and default:
        items = st.tuples(*(st.one_of(st.just(as_yaml(x)), near(x)) for x in default))
        lists = st.one_of(items, items.map(lambda i: i[1:]), items.map(lambda i: (*i, i[0])))
        return lists.map(lambda i: f"[{', '.join(i)}]")
    return VALUES


@st.composite
def changes(draw: st.DrawFn) -> tuple[str, str]:
    """A scenario's name, and a change of one of its fields."""
    field = draw(st.sampled_from(FIELDS))
    return field.scenario, field.change(draw(st.one_of(near(field.default), VALUES)))
