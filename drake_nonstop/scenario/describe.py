"""What can stand in a scenario, for people and for editors, from the declarations of its fields.

The blocks are those of `BOXES`, a block's parameters the fields of the dataclass beside it, their
units and meanings the comments on these, and the ports those of a block that is built with the
default scenario's model.
"""

import dataclasses
import inspect
import math
import textwrap
import types
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from drake_nonstop.diagrams.nonstop import BOXES, SIGNALS
from drake_nonstop.loop.box import config_class
from drake_nonstop.mechanics.signal_layouts import Layout
from drake_nonstop.mechanics.signals import HELD
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.model.system import Model
from drake_nonstop.scenario.choices import CHOICES, PATTERN, PATTERNS, block_name, tag_of
from drake_nonstop.scenario.distributions import is_entry
from drake_nonstop.scenario.fields import Tree, fields_of, item_of, parts_of, write
from drake_nonstop.scenario.overrides import BASE, to_tree
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.scenario.yaml_text import dump_plain
from drake_nonstop.systems import wiring
from drake_nonstop.systems.documentation import field_comments, meanings
from drake_nonstop.validation import ScenarioError, members_of, require_known

_COMMENT_COLUMN = 44  # where comments begin
_LINE_WIDTH = 100  # characters; a comment for which there is no room stands above its field
_HEADING = """\
# {name} with every field; lines that you delete have their defaults.
# Vectors are in the world frame W, or where a comment says so in the load's frame L.
# `drake-nonstop schema --help` tells how an editor completes and checks this file.
"""
_JSON_TYPES = {float: "number", int: "integer", bool: "boolean", str: "string"}
_JSON_TYPES |= {types.NoneType: "null"}
Schema = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A field of a config: its type, its default as in YAML, and its unit and meaning."""

    name: str
    type: str
    default: str
    meaning: str


@dataclass(frozen=True, kw_only=True)
class Port:
    """A port and its size: a number, for n carriers "3n", for m coordinates "2m"."""

    name: str
    size: str
    is_optional: bool = False  # an output need not be there, an input need not be connected
    layout: Layout | None = None  # of a signal of the figure; None: it is not known, or no vector


@dataclass(frozen=True, kw_only=True)
class Choice:
    """A block that a box can be, or a pattern, which has no ports.

    `unbuildable` says why the ports are not known: the defaults do not make a block.
    """

    name: str
    summary: str
    parameters: tuple[Parameter, ...]
    inputs: tuple[Port, ...] = ()
    outputs: tuple[Port, ...] = ()
    unbuildable: str = ""


@dataclass(frozen=True, kw_only=True)
class Box:
    """A box of the figure, the signals that it has to make and its choices, the default first."""

    name: str
    signals: tuple[Port, ...]
    choices: tuple[Choice, ...]


def box_names() -> list[str]:
    """The names that `describe` takes: the figure's boxes, in its order, and the pattern."""
    return [*BOXES, PATTERN]


def describe(name: str) -> Box:
    """A box of the figure, or the pattern, with all that can be chosen for it.

    Raises:
        ScenarioError: there is no such box.
    """
    require_known(name, box_names(), "box", name)
    if name == PATTERN:
        choices = tuple(_choice(config, config, None) for config in PATTERNS)
        return Box(name=name, signals=(), choices=choices)
    scenario = Scenario()
    # For blocks of aircraft; it changes no port of the others.
    system = dataclasses.replace(scenario.system, aircraft=AircraftParameters(model="rascal_110"))
    model = Model(system, scenario.pattern, scenario.control_period)
    return Box(
        name=name,
        signals=tuple(_port(signal, None) for signal in BOXES[name].signals),
        choices=tuple(_choice(config_class(b), b, model) for b in BOXES[name].variants),
    )


def parameters(config: type) -> tuple[Parameter, ...]:
    """The fields of a config class, in order."""
    about, default = meanings(config), config()
    return tuple(
        Parameter(
            name=name,
            type=kind.__name__ if type(kind) is type else str(kind),
            default="" if parts_of(kind) and value else dump_plain(write(value, kind)),
            meaning=about.get(name, ""),
        )
        for name, kind in fields_of(config).items()
        for value in [getattr(default, name)]
    )


def _choice(config: type, block: type, model: Model | None) -> Choice:
    """A block and its config, with its ports if there is a model to build it with."""
    ports: dict[str, Any] = {}
    if model is not None:
        try:
            built = block(model)
        except ScenarioError as error:
            ports["unbuildable"] = str(error)
        else:
            optional = wiring.optional_inputs(built)
            read = wiring.input_sizes(built).items()
            ports["inputs"] = tuple(_port(*port, port[0] in optional) for port in read)
            ports["outputs"] = tuple(_port(*port) for port in wiring.output_sizes(built).items())
    summary = (inspect.getdoc(block) or "").partition("\n")[0]
    name = block_name(config)
    return Choice(name=name, summary=summary, parameters=parameters(config), **ports)


def _port(name: str, size: int | None, is_optional: bool | None = None) -> Port:
    """The port of that name: its size by the contract, or else as it is for the default n."""
    layout = SIGNALS.get(name.removeprefix(HELD))
    if is_optional is None:
        is_optional = any(name in box.optional for box in BOXES.values())
    text = "abstract" if size is None else str(size)
    text = text if layout is None else layout.size
    return Port(name=name, size=text, is_optional=is_optional, layout=layout)


def commented_scenario(scenario: Scenario, name: str) -> str:
    """The scenario as YAML under another name; `parse_scenario` reads it.

    Each field stands in a line of its own with a comment, and each box with its other blocks.
    """
    about = meanings(Scenario)
    lines = [f"{name}:"]
    for key, value in to_tree(scenario).items():
        if not isinstance(value, dict) or is_entry(value):
            lines += _field(1, key, value, about.get(key, ""))
            continue
        config, tag, comment = (
            type(getattr(scenario, key)),
            value.pop("_tag", ""),
            about.get(key, ""),
        )
        if tag:
            others = [block_name(other) for other in CHOICES[key] if other is not config]
            comment = f"or {', '.join(others)}" if others else ""
        head = " ".join(filter(None, [f"  {key}:", tag, "" if value else "{}"]))
        lines += ["", *_wrapped(1, comment), head, *commented_fields(2, value, config)]
    return _HEADING.format(name=scenario.name) + "\n".join(lines) + "\n"


def commented_fields(depth: int, fields: Tree, config: type) -> list[str]:
    """Lines of YAML for fields of a dataclass, each with its unit and meaning."""
    about = field_comments(config)
    lines = []
    for key, value in fields.items():
        meaning, heading = about.get(key, ("", ""))
        lines += [*_wrapped(depth, heading), ""] if heading else []
        lines += _field(depth, key, value, meaning)
    return lines


def _field(depth: int, key: str, value: Any, comment: str) -> list[str]:
    """A field with its comment."""
    text = f"{'  ' * depth}{key}: {dump_plain(value)}"
    beside = f"{text:{_COMMENT_COLUMN}}  # {comment}"
    if not comment or len(beside) <= _LINE_WIDTH:
        return [beside if comment else text]
    return [*_wrapped(depth, comment), text]


def _wrapped(depth: int, comment: str) -> list[str]:
    """A comment in lines of its own."""
    start = f"{'  ' * depth}# "
    return [start + line for line in textwrap.wrap(comment, _LINE_WIDTH - len(start))]


def scenario_schema(scenarios: Iterable[Scenario] = ()) -> Schema:
    """JSON Schema of a file with one scenario under its name, by which editors complete fields.

    JSON Schema knows no YAML tags: a box has the fields of all blocks that it can be, each with the
    names of those. Boxes may be the blocks of one's own that `scenarios` have, too.
    """
    scenario = _object(Scenario, _choices(scenarios))
    del scenario["properties"]["name"]
    about = "a scenario's name or file, whose fields count where this one has none"
    scenario["properties"][BASE] = {"type": "string", "description": about}
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "drake_nonstop scenario",
        "type": "object",
        "minProperties": 1,
        "maxProperties": 1,
        "additionalProperties": scenario,
    }


def custom_tags(scenarios: Iterable[Scenario] = ()) -> list[str]:
    """The tags of blocks, as the setting `yaml.customTags` of YAML's language server takes them."""
    configs = {config for choices in _choices(scenarios).values() for config in choices}
    configs |= {*parts_of(item_of(fields_of(Scenario)["obstacles"]))}
    return sorted(f"{tag_of(config)} mapping" for config in configs)


def _choices(scenarios: Iterable[Scenario]) -> dict[str, tuple[type, ...]]:
    """`CHOICES` with the configs of scenarios' own blocks."""
    found = {name: dict.fromkeys(configs) for name, configs in CHOICES.items()}
    for scenario in scenarios:
        for name, configs in found.items():
            configs[type(getattr(scenario, name))] = None
    return {name: tuple(configs) for name, configs in found.items()}


def _object(config: type, choices: dict[str, tuple[type, ...]] | None = None) -> Schema:
    """The schema of a dataclass, some of whose fields are boxes with choices."""
    about = meanings(config) if dataclasses.is_dataclass(config) else {}
    default, properties = config(), {}
    for name, kind in fields_of(config).items():
        boxes = (choices or {}).get(name)
        properties[name] = _box(boxes) if boxes else _of(kind)
        if about.get(name):
            properties[name].setdefault("description", about[name])
        value = getattr(default, name)
        if isinstance(value, tuple(_JSON_TYPES)) and value not in (None, math.inf):
            properties[name]["default"] = value
    return {"type": "object", "properties": properties, "additionalProperties": False}


def _box(configs: Sequence[type]) -> Schema:
    """A part with the fields of all classes that it can be."""
    properties: dict[str, Schema] = {}
    for config in configs:
        for key, found in _object(config)["properties"].items():
            known = properties.setdefault(key, {"anyOf": []})
            about = f"{block_name(config)}: {found.pop('description', '')}".removesuffix(": ")
            known["description"] = "; ".join(filter(None, [known.get("description"), about]))
            found.pop("default", None)
            known["anyOf"] += [found] if found not in known["anyOf"] else []
    part = {"type": "object", "properties": properties, "additionalProperties": False}
    tags = ", ".join(map(tag_of, configs))
    return {"anyOf": [part, {"type": "null"}], "description": f"one of {tags}"}


def _of(kind: Any) -> Schema:
    """The schema of a field's type."""
    members = members_of(kind)
    options: list[Schema] = [{"type": _JSON_TYPES[m]} for m in members if m in _JSON_TYPES]
    if (item := item_of(kind)) is not None:
        options.append({"type": "array", "items": _of(item)})
    if len(parts := parts_of(kind)) == 1:
        options.append(_object(parts[0]))
    elif parts:
        options.append(_box(parts))
    if {float, int} & {*members} or item is float:
        options.append({"type": "object"})  # a distribution, a tag with a mapping
    return {"anyOf": options} if options else {}
