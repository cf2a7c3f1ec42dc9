"""A scenario as a YAML file to start from: every field, with its unit and meaning."""

import textwrap
from typing import Any

from drake_nonstop.scenario.distributions import is_entry
from drake_nonstop.scenario.schema import CHOICES, Scenario
from drake_nonstop.scenario.tree import Tree, block_name, to_tree
from drake_nonstop.scenario.yaml_text import dump_plain
from drake_nonstop.systems.documentation import field_comments, meanings

_COMMENT_COLUMN = 44  # where comments begin
_LINE_WIDTH = 100  # characters; a comment for which there is no room stands above its field
_HEADING = """\
# {name} with every field; lines that you delete have their defaults.
# Vectors are in the world frame W, or where a comment says so in the load's frame L.
# `drake-nonstop schema --help` tells how an editor completes and checks this file.
"""


def commented_scenario(scenario: Scenario, name: str) -> str:
    """The scenario as YAML under another name; `parse_scenario` reads it.

    Each field stands in a line of its own with a comment, and each box with its other blocks.
    """
    about = meanings(Scenario)
    lines = [f"{name}:"]
    for key, value in to_tree(scenario).items():
        config = getattr(scenario, key)
        if not isinstance(value, dict) or is_entry(value):
            lines += _field(1, key, value, about.get(key, ""))
            continue
        tag, comment = value.pop("_tag", ""), about.get(key, "")
        if tag:
            others = [block_name(other) for other in CHOICES[key] if other is not type(config)]
            comment = f"or {', '.join(others)}" if others else ""
        head = " ".join(filter(None, [f"  {key}:", tag, "" if value else "{}"]))
        lines += ["", *_wrapped(1, comment), head, *commented_fields(2, value, type(config))]
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
