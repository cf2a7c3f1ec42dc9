"""YAML read as strictly as scenarios need it, and written so that it reads back the same.

Scalars are those of YAML 1.2: null, true, false and decimal numbers; all else is a text. A number
with a zero in front, which YAML 1.1 takes for octal digits, is a text as well, and no number.
"""

from collections.abc import Iterator
from typing import Any

import yaml

from drake_nonstop.validation import ScenarioError, number_text, one_line, plain_value, require

_MAX_DEPTH = 20  # of lists and mappings in one another


def parse_plain(text: str, source: str, path: str | None = None) -> Any:
    """YAML text as dicts, lists and scalars, read as strictly as a scenario.

    A dict that has a tag holds it under "_tag"; `source` as in `parse_scenario`. `path` is what
    error messages call the value, if not the source.

    Raises:
        ScenarioError: the text is no YAML, ambiguous, or nested too deep.
    """
    require(isinstance(text, str), source, text, "give a text")
    try:
        return _Reader(text, source).document(source if path is None else path)
    except yaml.YAMLError as error:
        mark, problem = (getattr(error, name, None) for name in ("problem_mark", "problem"))
        line = f"line {mark.line + 1}, " if mark else ""
        remedy = "give valid YAML" + (", with spaces in place of tabs" if "\t" in text else "")
        require(False, source, f"{line}{problem or 'unreadable'}", remedy)
    except UnicodeEncodeError:
        require(False, source, text, "give a text that is valid Unicode")


def dump_plain(value: Any, field: str = "value") -> str:
    """A value as YAML in one line, which `parse_plain` reads: the value of an override.

    `field` is its name in error messages.

    Raises:
        ScenarioError: the value is not made of numbers, texts, lists and dicts.
    """
    try:
        text = yaml.dump(
            plain_value(value, field),
            Dumper=TreeDumper,
            sort_keys=False,
            default_flow_style=True,
            width=float("inf"),
        )
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        remedy = f"give numbers, texts, lists and mappings ({one_line(error)[:100]})"
        raise ScenarioError(f"{field} = <{type(value).__name__}>: {remedy}") from None
    return text.removesuffix("...\n").strip()


class TreeDumper(yaml.SafeDumper):
    """Writes "_tag" in a dict as the tag of its mapping."""

    def represent_tree(self, data: dict[str, Any]) -> yaml.Node:
        """A dict as a mapping, tagged where it holds a "_tag"."""
        fields = {key: value for key, value in data.items() if key != "_tag"}
        return self.represent_mapping(data.get("_tag", "tag:yaml.org,2002:map"), fields)

    def represent_text(self, data: str) -> yaml.Node:
        """A text, in quotes where it would be read as anything else."""
        is_text = isinstance(_scalar(data), str)
        return self.represent_scalar("tag:yaml.org,2002:str", data, style=None if is_text else "'")


TreeDumper.add_representer(dict, TreeDumper.represent_tree)
TreeDumper.add_representer(str, TreeDumper.represent_text)

# The parser in C, ten times as fast, where PyYAML was built with it.
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Reader:
    """Makes plain values of the parser's events.

    The parser keeps its own stack; a composer of nodes would run out of Python's, or of the
    process's, on text that is nested too deep.
    """

    def __init__(self, text: str, source: str):
        self._events: Iterator[Any] = yaml.parse(text, Loader=_Loader)
        self._source = source

    def document(self, path: str) -> Any:
        """The value of the text's only document, None where there is none."""
        next(self._events)  # the stream's start
        if isinstance(next(self._events), yaml.StreamEndEvent):
            return None
        value = self._value(next(self._events), path, 0)
        next(self._events)  # the document's end
        is_end = isinstance(next(self._events), yaml.StreamEndEvent)
        require(is_end, self._source, "several documents", "give one, without --- after it")
        return value

    def _value(self, event: Any, path: str, depth: int) -> Any:
        require(event.anchor is None, path, f"the anchor {event.anchor}", "write the value out")
        if isinstance(event, yaml.ScalarEvent):
            return _plain_scalar(event, path)
        remedy = f"give at most {_MAX_DEPTH} levels of lists and mappings"
        require(depth < _MAX_DEPTH, path, "nested too deep", remedy)
        if isinstance(event, yaml.MappingStartEvent):
            return self._mapping(event, path, depth)
        require(event.tag is None, path, event.tag, "take the tag in front of the list away")
        values: list[Any] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            values.append(self._value(event, f"{path}[{len(values)}]", depth + 1))
        return values

    def _mapping(self, start: Any, path: str, depth: int) -> dict[str, Any]:
        values: dict[str, Any] = {} if start.tag is None else _tagged(start.tag, path)
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            line = event.start_mark.line + 1
            is_text = isinstance(event, yaml.ScalarEvent) and event.tag is None
            require(is_text, path, f"a key that is no text, in line {line}", "give text keys")
            key, field = event.value, f"{path}.{event.value}"
            require(key not in ("<<", "_tag"), field, "no name of a field", "write the fields out")
            again = f"given twice, again in line {line}"
            require(key not in values, field, again, "give it once")
            values[key] = self._value(next(self._events), field, depth + 1)
        return values


def _plain_scalar(event: Any, path: str) -> Any:
    """Value of a scalar in YAML: a tag without {} is a mapping without fields."""
    if event.tag is not None:
        is_empty = event.value == "" and not event.style
        require(is_empty, path, f"{event.tag} {event.value}", "give its fields in {}")
        return _tagged(event.tag, path)
    if event.style:
        return event.value
    value = _scalar(event.value)
    is_finite = value not in (float("inf"), float("-inf")) or "inf" in event.value.lower()
    require(is_finite, path, event.value, "give a number below 1e308, or .inf for no limit")
    return value


def _scalar(text: str) -> Any:
    """Value of a text without quotes."""
    if text in ("", "~", "null", "Null", "NULL"):
        return None
    if text in ("true", "True", "TRUE", "false", "False", "FALSE"):
        return text.lower() == "true"
    if not number_text(text):
        return text
    is_whole = text.lstrip("+-").isdigit() and len(text) < 300
    return int(text) if is_whole else float(text.lower().replace(".inf", "inf"))


def _tagged(tag: str, path: str) -> dict[str, Any]:
    """A mapping with a tag, which has to be that of a block."""
    is_local = tag.startswith("!") and len(tag) > 1
    remedy = "take the tag away; only a block has one, such as !PaperPhase"
    require(is_local, path, tag.replace("tag:yaml.org,2002:", "!!"), remedy)
    return {"_tag": tag}
