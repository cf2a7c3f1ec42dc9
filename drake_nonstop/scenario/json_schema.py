"""A JSON Schema of scenario files, by which editors complete fields and mark what is wrong.

JSON Schema knows no YAML tags: a box has the fields of all blocks that it can be, each with the
names of those. What a field means and its unit are its description.
"""

import dataclasses
import math
import types
import typing
from collections.abc import Iterable, Sequence
from typing import Any

from pydrake.systems.analysis import SimulatorConfig

from drake_nonstop.loop.box import import_path
from drake_nonstop.scenario.loading import scenario_names
from drake_nonstop.scenario.obstacles import Obstacle
from drake_nonstop.scenario.schema import CHOICES, Scenario
from drake_nonstop.scenario.tree import block_name
from drake_nonstop.systems.documentation import meanings
from drake_nonstop.validation import parts_of

_PLAIN = {float: "number", int: "integer", bool: "boolean", str: "string"}
_DISTRIBUTION = {"type": "object"}  # a tag with a mapping, in the place of a number

Schema = dict[str, Any]


def scenario_schema(scenarios: Iterable[Scenario] = ()) -> Schema:
    """The schema of a file with one scenario under its name.

    Boxes may be the blocks of one's own that `scenarios` have, too.
    """
    choices = _choices(scenarios)
    scenario = _object(Scenario)
    scenario["properties"]["based_on"] = {
        "type": "string",
        "description": "a scenario's name or file, whose fields count where this one has none",
        "examples": scenario_names(),
    }
    for name, configs in choices.items():
        scenario["properties"][name] = _box(configs)
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
    configs |= {*typing.get_args(Obstacle)}
    return sorted(f"!{_tag(config)} mapping" for config in configs)


def _tag(config: type) -> str:
    """The name by which scenarios have a block: that of one's own has its module before it."""
    is_known = any(config in choices for choices in (*CHOICES.values(), typing.get_args(Obstacle)))
    return block_name(config) if is_known else import_path(config)


def _choices(scenarios: Iterable[Scenario]) -> dict[str, tuple[type, ...]]:
    """`CHOICES` with the configs of scenarios' own blocks."""
    found = dict(CHOICES)
    for scenario in scenarios:
        for name in CHOICES:
            config = type(getattr(scenario, name))
            if dataclasses.is_dataclass(config) and config not in found[name]:
                found[name] = (*found[name], config)
    return found


def _box(configs: Sequence[type]) -> Schema:
    """A box, or the pattern, with the fields of all that it can be."""
    properties: dict[str, Schema] = {}
    for config in configs:
        block = block_name(config)
        for key, found in _object(config)["properties"].items():
            known = properties.setdefault(key, {"anyOf": []})
            alternative = {k: v for k, v in found.items() if k not in ("description", "default")}
            if alternative not in known["anyOf"]:
                known["anyOf"].append(alternative)
            about = f"{block}: {found.get('description', '')}".removesuffix(": ")
            known["description"] = "; ".join(filter(None, [known.get("description"), about]))
    blocks = ", ".join(f"!{_tag(config)}" for config in configs)
    return {
        "anyOf": [
            {"type": "object", "properties": properties, "additionalProperties": False},
            {"type": "null"},
        ],
        "description": f"one of {blocks}",
    }


def _object(config: type) -> Schema:
    """The schema of a dataclass."""
    about, kinds = meanings(config), typing.get_type_hints(config)
    properties = {}
    for field in dataclasses.fields(config):
        if field.name.startswith("_"):
            continue
        properties[field.name] = _of(kinds[field.name])
        if about.get(field.name):
            properties[field.name]["description"] = about[field.name]
        if isinstance(field.default, (bool, int, str, float)) and field.default != math.inf:
            properties[field.name]["default"] = field.default
    return {"type": "object", "properties": properties, "additionalProperties": False}


def _of(kind: Any) -> Schema:
    """The schema of a field's type."""
    if kind in (float, int):
        return {"anyOf": [{"type": _PLAIN[kind]}, _DISTRIBUTION]}
    if kind in _PLAIN:
        return {"type": _PLAIN[kind]}
    if dataclasses.is_dataclass(kind):
        return _object(typing.cast(type, kind))
    if kind is SimulatorConfig:
        default = SimulatorConfig()
        values = {field.name: getattr(default, field.name) for field in default.__fields__}
        properties = {name: {"type": _PLAIN[type(value)]} for name, value in values.items()}
        return {"type": "object", "properties": properties, "additionalProperties": False}
    if kind is type(None):
        return {"type": "null"}
    arguments = typing.get_args(kind)
    if typing.get_origin(kind) is list:
        return {"anyOf": [{"type": "array", "items": _of(arguments[0])}, _DISTRIBUTION]}
    if parts := parts_of(kind):
        return _box(parts)
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        return {"anyOf": [_of(argument) for argument in arguments]}
    return {}  # mappings
