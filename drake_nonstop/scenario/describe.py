"""What can stand in a scenario, for people and for editors, from the declarations of its fields.

The blocks are those of `BOXES`, a block's parameters the fields of the dataclass beside it, their
units and meanings the comments on these, and the ports those of a block that is built with the
default scenario's model.
"""

import dataclasses
import inspect
import textwrap
import types
from collections.abc import Iterable
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
from drake_nonstop.validation import members_of, require_known

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
    """A block that a box can be, or a pattern, which has no ports."""

    name: str
    summary: str
    parameters: tuple[Parameter, ...]
    inputs: tuple[Port, ...] = ()
    outputs: tuple[Port, ...] = ()


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
    ports: dict[str, tuple[Port, ...]] = {}
    if model is not None:
        built = block(model)
        optional, read = wiring.optional_inputs(built), wiring.input_sizes(built)
        ports["inputs"] = tuple(_port(*port, port[0] in optional) for port in read.items())
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

    JSON Schema knows no YAML tags: a box has the fields of one of the blocks that it can be, the
    blocks of one's own that `scenarios` have among them.
    """
    scenario = _object(Scenario)
    fields = scenario["properties"]
    del fields["name"]
    about = "a scenario's name or file, whose fields count where this one has none"
    fields[BASE] = {"type": "string", "description": about}
    for box, configs in _choices(scenarios).items():
        fields[box] = {"anyOf": [{"type": "null"}, *map(_object, configs)]}
        fields[box]["description"] = f"one of {', '.join(map(tag_of, configs))}"
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


def _choices(scenarios: Iterable[Scenario]) -> dict[str, list[type]]:
    """`CHOICES` with the configs of scenarios' own blocks."""
    own = {box: [type(getattr(scenario, box)) for scenario in scenarios] for box in CHOICES}
    return {box: [*dict.fromkeys((*configs, *own[box]))] for box, configs in CHOICES.items()}


def _object(config: type) -> Schema:
    """The schema of a dataclass."""
    about = meanings(config)
    properties = {name: _of(kind) for name, kind in fields_of(config).items()}
    for name in properties:
        properties[name] |= {"description": about[name]} if about.get(name) else {}
    return {"type": "object", "properties": properties, "additionalProperties": False}


def _of(kind: Any) -> Schema:
    """The schema of a field's type."""
    members, item = members_of(kind), item_of(kind)
    options: list[Schema] = [{"type": _JSON_TYPES[m]} for m in members if m in _JSON_TYPES]
    options += map(_object, parts_of(kind))
    if item is not None:
        options.append({"type": "array", "items": _of(item)})
    if {float, int} & {*members, item}:
        options.append({"type": "object"})  # a distribution, a tag with a mapping
    return {"anyOf": options} if options else {}
