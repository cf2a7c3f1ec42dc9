"""YAML read as strictly as scenarios need it, and written so that it reads back the same.

Scalars are those of YAML 1.2: null, true, false and decimal numbers; all else is a text. A number
with a zero in front, which YAML 1.1 takes for octal digits, is a text as well, and no number.
"""

import contextlib
import copy
from collections.abc import Iterator
from typing import Any

import numpy as np
import yaml

from drake_nonstop.validation import ScenarioError, number_text, one_line, require

_MAX_DEPTH = 20  # of lists and mappings in one another
_MAX_VALUES = 200_000  # those of an alias each time that it stands there
_SHORT = 10_000  # characters that the parser in Python reads in no time


def parse_plain(text: str, source: str, path: str | None = None) -> Any:
    """YAML text as dicts, lists and scalars, read as strictly as a scenario.

    A dict that has a tag holds it under "_tag"; `source` as in `parse_scenario`. `path` is what
    error messages call the value, if not the source.

    Raises:
        ScenarioError: the text is no YAML, ambiguous, nested too deep or too long.
    """
    require(isinstance(text, str), source, text, "give a text")
    path = source if path is None else path
    with contextlib.suppress(yaml.YAMLError):
        return _Reader(text, _Loader, source).document(path)
    # The parser in Python tells errors more exactly.
    loader = _Loader if len(text) > _SHORT else yaml.SafeLoader
    try:
        return _Reader(text, loader, source).document(path)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        if isinstance(error, yaml.reader.ReaderError):
            line = text.count("\n", 0, error.position) + 1
            problem = f"a character that YAML does not allow, {error.character!a}"
        else:
            line = mark.line + 1 if mark else 1
            problem = str(getattr(error, "problem", None) or "unreadable")
        require(False, source, f"line {line}, {problem}", "give valid YAML")


def dump_plain(value: Any, field: str = "value") -> str:
    """A value as YAML in one line, which `parse_plain` reads: the value of an override.

    `field` is its name in error messages.

    Raises:
        ScenarioError: the value is not made of numbers, texts, lists and dicts.
    """
    try:
        text = yaml.dump(
            value, Dumper=TreeDumper, sort_keys=False, default_flow_style=True, width=float("inf")
        )
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        remedy = f"give numbers, texts, lists and mappings ({one_line(error)[:100]})"
        raise ScenarioError(f"{field} = <{type(value).__name__}>: {remedy}") from None
    return text.removesuffix("...\n").strip()


# The parser in C, ten times as fast, where PyYAML was built with it.
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class TreeDumper(yaml.SafeDumper):
    """Writes "_tag" in a dict as the tag of its mapping, and NumPy's values as Python's."""

    def represent_tree(self, data: dict[str, Any]) -> yaml.Node:
        """A dict as a mapping, tagged where it holds a "_tag"."""
        fields = {key: value for key, value in data.items() if key != "_tag"}
        return self.represent_mapping(data.get("_tag", "tag:yaml.org,2002:map"), fields)

    def represent_text(self, data: str) -> yaml.Node:
        """A text, in quotes where it would be read as anything else."""
        is_text = isinstance(_scalar(data), str)
        return self.represent_scalar("tag:yaml.org,2002:str", data, style=None if is_text else "'")

    def represent_array(self, data: np.ndarray | np.generic) -> yaml.Node:
        """NumPy's value as Python's."""
        return self.represent_data(data.tolist())

    def ignore_aliases(self, data: Any) -> bool:
        """No anchors and aliases: what stands there twice is written out."""
        return True


TreeDumper.add_representer(dict, TreeDumper.represent_tree)
TreeDumper.add_representer(str, TreeDumper.represent_text)
TreeDumper.add_multi_representer(np.ndarray, TreeDumper.represent_array)
TreeDumper.add_multi_representer(np.generic, TreeDumper.represent_array)  # type: ignore[type-abstract]


class _Reader:
    """Makes plain values of the parser's events, of which a bounded number is read.

    The parser keeps its own stack; a composer of nodes would run out of Python's, or of the
    process's, on text that is nested too deep.
    """

    def __init__(self, text: str, loader: Any, source: str):
        encoded = text.encode("utf-8", errors="replace")
        require(encoded.decode() == text, source, text, "give a text that is valid Unicode")
        self._events: Iterator[Any] = yaml.parse(text, Loader=loader)
        self._source = source
        self._count = 0
        self._anchored: dict[str, tuple[Any, int]] = {}  # values, and how many each holds

    def document(self, path: str) -> Any:
        """The value of the text's only document, None where there is none."""
        next(self._events)  # the stream's start
        event = next(self._events)
        if isinstance(event, yaml.StreamEndEvent):
            return None
        value = self._value(next(self._events), path, 0)
        next(self._events)  # the document's end
        is_end = isinstance(next(self._events), yaml.StreamEndEvent)
        require(is_end, self._source, "several documents", "give one, without --- after it")
        return value

    def _value(self, event: Any, path: str, depth: int) -> Any:
        before = self._count
        self._count_up(1)
        if isinstance(event, yaml.AliasEvent):
            anchor = str(event.anchor)
            remedy = "an alias of itself or of nothing; write the value out"
            require(anchor in self._anchored, path, f"*{anchor}", remedy)
            value, size = self._anchored[anchor]
            self._count_up(size)
            return copy.deepcopy(value)
        if isinstance(event, yaml.ScalarEvent):
            value = _plain_scalar(event, path)
        else:
            remedy = f"give at most {_MAX_DEPTH} levels of lists and mappings"
            require(depth < _MAX_DEPTH, path, "nested too deep", remedy)
            is_mapping = isinstance(event, yaml.MappingStartEvent)
            value = (self._mapping if is_mapping else self._list)(event, path, depth)
        if event.anchor is not None:
            self._anchored[event.anchor] = value, self._count - before
        return value

    def _count_up(self, size: int) -> None:
        self._count += size
        remedy = f"give at most {_MAX_VALUES}, aliases written out"
        require(self._count <= _MAX_VALUES, self._source, "too many values", remedy)

    def _list(self, start: Any, path: str, depth: int) -> list[Any]:
        require(start.tag is None, path, start.tag, "take the tag in front of the list away")
        values: list[Any] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            values.append(self._value(event, f"{path}[{len(values)}]", depth + 1))
        return values

    def _mapping(self, start: Any, path: str, depth: int) -> dict[str, Any]:
        values: dict[str, Any] = {}
        if start.tag is not None:
            _require_tag(start.tag, path)
            values["_tag"] = start.tag
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            line = event.start_mark.line + 1
            is_text = isinstance(event, yaml.ScalarEvent) and event.tag is None
            require(is_text, path, f"a key that is no text, in line {line}", "give text keys")
            key = event.value
            self._count_up(1)
            field = f"{path}.{key}"
            is_merge = key == "<<" and not event.style
            require(not is_merge, field, "a merge key", "write the fields out")
            require(key != "_tag", field, "a name of this package's own", "write the tag itself")
            again = f"given twice, again in line {line}"
            require(key not in values, field, again, "give it once")
            values[key] = self._value(next(self._events), field, depth + 1)
        return values


def _plain_scalar(event: Any, path: str) -> Any:
    """Value of a scalar in YAML: a tag without {} is a mapping without fields."""
    if event.tag is not None:
        _require_tag(event.tag, path)
        is_empty = event.value == "" and not event.style
        require(is_empty, path, f"{event.tag} {event.value}", "give its fields in {}")
        return {"_tag": event.tag}
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


def _require_tag(tag: str, path: str) -> None:
    """Raises ScenarioError for a tag that is no block's."""
    is_local = tag.startswith("!") and len(tag) > 1
    remedy = "take the tag away; only a block has one, such as !PaperPhase"
    require(is_local, path, tag.replace("tag:yaml.org,2002:", "!!"), remedy)
