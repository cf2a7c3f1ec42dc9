"""What can stand in a scenario, for people and for editors, from the declarations of its fields.

The blocks are those of `BOXES`, their ports what the class `reads` and `makes`, their parameters
the fields of the dataclass beside it, and units and meanings the comments on these.
"""

import inspect
import textwrap
import types
from collections.abc import Iterable
from typing import Any, NamedTuple

from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.diagrams.nonstop import SIGNALS as OF_FIGURE
from drake_nonstop.loop.box import config_class
from drake_nonstop.mechanics.signals import HELD, SIGNALS
from drake_nonstop.scenario.choices import CHOICES, PATTERN, block_name, tag_of
from drake_nonstop.scenario.distributions import is_entry
from drake_nonstop.scenario.fields import Tree, fields_of, item_of, parts_of, takes_fields, write
from drake_nonstop.scenario.overrides import BASE, to_tree
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.scenario.yaml_text import dump_plain
from drake_nonstop.systems.documentation import meanings
from drake_nonstop.validation import members_of, require_known

_COMMENT_COLUMN = 44  # where comments begin
_LINE_WIDTH = 100  # characters; a comment for which there is no room stands above its field
_HEADING = """\
# {name} with every field; lines that you delete have their defaults.
# Vectors are in the world frame W, or where a comment says so in the load's frame L.
"""
_JSON_TYPES = {float: "number", int: "integer", bool: "boolean", str: "string"}
_JSON_TYPES |= {types.NoneType: "null"}
Schema = dict[str, Any]


class Parameter(NamedTuple):
    """A field of a config: its type, its default as in YAML, and its unit and meaning."""

    name: str
    type: str
    default: str
    meaning: str


class Choice(NamedTuple):
    """A block that a box can be, or a pattern, which has no ports."""

    name: str
    summary: str
    parameters: tuple[Parameter, ...]
    reads: str = ""  # its ports with their sizes, for n carriers and m coordinates
    makes: str = ""


def choices_of(name: str) -> list[Choice]:
    """All that can be chosen for a box of the figure, or for the pattern, the default first.

    Raises:
        ScenarioError: there is no such box.
    """
    require_known(name, [*BOXES, PATTERN], "box", name)
    if name == PATTERN:
        return [
            Choice(block_name(config), _summary(config), parameters(config))
            for config in CHOICES[PATTERN]
        ]
    return [
        Choice(
            block.__name__,
            _summary(block),
            parameters(config_class(block)),
            _ports(block, block.reads),
            _ports(block, block.makes),
        )
        for block in BOXES[name].variants
    ]


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


def size_of(signal: str) -> str:
    """The size of a signal of the figure, such as "3n"."""
    layout = OF_FIGURE.get(signal)
    return "abstract" if layout is None else layout.size


def _summary(kind: type) -> str:
    return (inspect.getdoc(kind) or "").partition("\n")[0]


def _ports(block: Any, names: Iterable[str]) -> str:
    layouts = SIGNALS | block.signal_layouts
    told = []
    for name in names:
        layout = layouts.get(name.removeprefix(HELD))
        about = ["abstract" if layout is None else layout.size]
        about += ["optional"] if name in block.optional_inputs else []
        about += [f"where {block.where[name]}"] if name in block.where else []
        told.append(f"{name} ({', '.join(about)})")
    return ", ".join(told)


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
        config, tag = type(getattr(scenario, key)), value.pop("_tag", "")
        others = [block_name(other) for other in CHOICES.get(key, ()) if other is not config]
        comment = f"or {', '.join(others)}" if others else about.get(key, "")
        head = " ".join(filter(None, [f"  {key}:", tag, "" if value else "{}"]))
        lines += ["", *_wrapped(1, comment), head, *commented_fields(2, value, config)]
    return _HEADING.format(name=scenario.name) + "\n".join(lines) + "\n"


def commented_fields(depth: int, fields: Tree, config: type) -> list[str]:
    """Lines of YAML for fields of a dataclass, each with its unit and meaning."""
    about = meanings(config)
    return [
        line
        for key, value in fields.items()
        for line in _field(depth, key, value, about.get(key, ""))
    ]


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


def scenario_schema() -> Schema:
    """JSON Schema of a file with one scenario under its name, by which editors complete fields.

    JSON Schema knows no YAML tags: a box has the fields of one of the blocks that it can be. The
    tags are under `yaml.customTags`, as the setting of YAML's language server takes them.
    """
    scenario = _object(Scenario)
    about = "a scenario's name or file, whose fields count where this one has none"
    scenario["properties"][BASE] = {"type": "string", "description": about}
    del scenario["properties"]["name"]
    obstacles = parts_of(item_of(fields_of(Scenario)["obstacles"]))
    tags = {tag_of(config) for configs in (*CHOICES.values(), obstacles) for config in configs}
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "drake_nonstop scenario",
        "type": "object",
        "minProperties": 1,
        "maxProperties": 1,
        "additionalProperties": scenario,
        "yaml.customTags": sorted(f"{tag} mapping" for tag in tags),
    }


def _object(config: type) -> Schema:
    """The schema of a dataclass."""
    about, properties = meanings(config), {}
    for name, kind in fields_of(config).items():
        configs = parts_of(kind)
        one_of = f"one of {', '.join(map(tag_of, configs))}" if len(configs) > 1 else ""
        properties[name] = _of(kind) | {"description": about.get(name) or one_of}
    return {"type": "object", "properties": properties, "additionalProperties": False}


def _of(kind: Any) -> Schema:
    """The schema of a field's type."""
    members, item, parts = members_of(kind), item_of(kind), parts_of(kind)
    options: list[Schema] = [{"type": _JSON_TYPES[m]} for m in members if m in _JSON_TYPES]
    options += [{"type": "null"}, *map(_object, parts)] if parts else []
    if item is not None:
        options.append({"type": "array", "items": _of(item)})
    if {float, int} & {*members} or takes_fields(kind):
        options.append({"type": "object"})  # also a distribution, a tag with a mapping
    return {"anyOf": options} if options else {}
