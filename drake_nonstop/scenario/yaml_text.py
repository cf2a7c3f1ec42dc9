"""YAML read as strictly as scenarios need it, and written so that it reads back the same."""

import contextlib
from typing import Any

import yaml

from drake_nonstop.validation import ScenarioError, require


def parse_plain(text: str, source: str) -> Any:
    """YAML text as dicts, lists and scalars, read as strictly as a scenario.

    A dict that has a tag holds it under "_tag"; `source` as in `parse_scenario`.

    Raises:
        ScenarioError: the text is no YAML, or ambiguous.
    """
    node = compose(text, source)
    return None if node is None else to_plain(node, source)


def dump_plain(value: Any) -> str:
    """What `parse_plain` makes of YAML, as YAML in one line: the value of an override."""
    text = yaml.dump(
        value, Dumper=TreeDumper, sort_keys=False, default_flow_style=True, width=float("inf")
    )
    return text.removesuffix("...\n").strip()


# The parser in C, ten times as fast, where PyYAML was built with it.
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class TreeDumper(yaml.SafeDumper):
    """Writes "_tag" in a dict as the tag of its mapping."""

    def represent_tree(self, data: dict[str, Any]) -> yaml.Node:
        """A dict as a mapping, tagged where it holds a "_tag"."""
        fields = {key: value for key, value in data.items() if key != "_tag"}
        return self.represent_mapping(data.get("_tag", "tag:yaml.org,2002:map"), fields)


TreeDumper.add_representer(dict, TreeDumper.represent_tree)


def compose(text: str, source: str) -> yaml.Node | None:
    """The text as a tree of YAML nodes."""
    with contextlib.suppress(yaml.YAMLError):  # the parser in Python tells errors more exactly
        return yaml.compose(text, Loader=_Loader)
    try:
        return yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = mark.line + 1 if mark else 1
        problem = " ".join(str(getattr(error, "problem", None) or "unreadable").split())
        raise ScenarioError(f"{source} = line {line}, {problem}: give valid YAML") from None


def to_plain(node: yaml.Node | None, path: str) -> Any:
    """A YAML node as dicts, lists and scalars, without what YAML silently reads in another way."""
    assert node is not None
    require(path.count(".") < 20, path[:60], "an alias of itself", "write the value out")
    if isinstance(node, yaml.MappingNode):
        result: dict[str, Any] = {}
        if not node.tag.startswith("tag:"):
            result["_tag"] = node.tag
        for key_node, value_node in node.value:
            require(
                isinstance(key_node, yaml.ScalarNode), path, "a key in brackets", "give text keys"
            )
            key = str(key_node.value)
            field_path = f"{path}.{key}"
            require(
                key not in result,
                field_path,
                f"given twice, again in line {key_node.start_mark.line + 1}",
                "give it once",
            )
            result[key] = to_plain(value_node, field_path)
        return result
    if isinstance(node, yaml.SequenceNode):
        return [to_plain(item, f"{path}[{i}]") for i, item in enumerate(node.value)]
    if not node.tag.startswith("tag:"):
        require(node.value == "", path, f"{node.tag} {node.value}", "give its fields in {}")
        return {"_tag": node.tag}  # a tag without {}
    assert isinstance(node, yaml.ScalarNode)
    quoted = node.style in ("'", '"')
    require(
        not (quoted and _is_number_text(node.value)),
        path,
        f"'{node.value}'",
        "give the number without quotes",
    )
    loader = yaml.SafeLoader("")
    try:
        value = loader.construct_object(node)
    except (ValueError, yaml.YAMLError):
        raise ScenarioError(f"{path} = {node.tag} {node.value}: give a plain value") from None
    is_sexagesimal = ":" in node.value and not isinstance(value, str)  # YAML 1.1: 1:30 is 90
    require(not is_sexagesimal, path, node.value, "give a number in plain digits")
    if isinstance(value, str) and not quoted and _is_number_text(value):
        value = float(value)  # YAML 1.1 takes 1e-3 for a string
    require(value == value, path, node.value, "give a finite number")
    return value


def _is_number_text(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
