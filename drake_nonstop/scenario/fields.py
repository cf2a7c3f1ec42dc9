"""The one walk over the fields of a scenario: read, checked, drawn and written.

A field is declared once, in its dataclass: its type, its default, its range (see
`validation.checked`), and its unit and meaning, a comment. Types are made of numbers, texts, truth
values, None, lists, and dataclasses, of which a union is told by a tag. A scenario as nested dicts,
as they stand in a YAML file, is a tree; a dict of a tagged dataclass has its tag under "_tag".
"""

import contextlib
import copy
import dataclasses
import functools
import math
import operator
import types
import typing
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from drake_nonstop.scenario.choices import (
    CHOICES,
    Trusted,
    block_name,
    config_of,
    require_config,
    tag_of,
)
from drake_nonstop.scenario.distributions import (
    ends,
    from_entry,
    is_distribution,
    is_entry,
    to_entry,
)
from drake_nonstop.scenario.yaml_text import dump_plain
from drake_nonstop.systems.documentation import meanings
from drake_nonstop.validation import (
    ScenarioError,
    members_of,
    plain_value,
    require,
    require_known,
    require_ranges,
    require_type,
    warn_user,
)

Tree = dict[str, Any]
# Called with the path, the distribution and the type of the field; returns what takes its place.
Change = Callable[[str, Any, Any], Any]

_SCALARS = (float, int, bool, str)


@functools.cache
def fields_of(config: Any) -> dict[str, Any]:
    """The types of the fields of a dataclass, or of one of Drake's, by name."""
    if dataclasses.is_dataclass(config):
        hints = typing.get_type_hints(config)
        return {field.name: hints[field.name] for field in dataclasses.fields(config)}
    return {field.name: field.type for field in config.__fields__}


@functools.cache
def parts_of(kind: Any) -> tuple[type, ...]:
    """The dataclasses that a value of a type can be."""
    members = members_of(kind)
    return tuple(m for m in members if dataclasses.is_dataclass(m) or hasattr(m, "__fields__"))


@functools.cache
def item_of(kind: Any) -> Any:
    """The type of the items of a field of lists; None where it holds none."""
    lists = [member for member in members_of(kind) if typing.get_origin(member) is list]
    return typing.get_args(lists[0])[0] if lists else None


def takes_fields(kind: Any) -> bool:
    """Whether a field may hold a tree, of paths of fields to their values."""
    return any(typing.get_origin(member) is dict for member in members_of(kind))


def kept(path: str, distribution: Any, kind: Any) -> Any:
    """The distribution itself, from which a number for the field can be drawn."""
    ends(path, distribution, kind)
    return distribution


@dataclass(frozen=True, kw_only=True)
class Walk:
    """Reads a tree, or goes through what Python has made, and checks it.

    Attributes:
        trusted: tags of blocks of the user's own that may be imported.
        change: what is put in the place of a distribution.
        reads_trees: whether mappings stand for dataclasses; if not, objects alone are gone through.
    """

    trusted: Trusted = False
    change: Change = kept
    reads_trees: bool = True

    def read(self, path: str, kind: Any, given: Any, present: Any = None) -> Any:
        """The value of a field of that type that a tree stands for.

        A mapping changes what is present, and a tagged one begins with its block's own defaults.

        Args:
            path: the field's name in error messages.
            kind: its type.
            given: a tree, or the value itself, which is not changed.
            present: the field's value, which may be changed.

        Raises:
            ScenarioError: a key is no field, a value is not of its type, a value that Python has
                made is out of its range, or a block is not trusted.
        """
        members = members_of(kind)
        if given is None and types.NoneType in members:
            return None
        parts, item = parts_of(kind), item_of(kind)
        if self.reads_trees and isinstance(given, dict):
            if is_distribution(present) and "_tag" not in given:
                given = to_entry(present) | given
            if is_entry(given) or ("_tag" in given and {float, int} & {*members}):
                given = from_entry(path, given)
        if is_distribution(given):
            return self.change(path, given, kind)
        if parts:
            return self._part(path, parts, given, present)
        if isinstance(given, list) and item is not None:
            read = [self.read(f"{path}[{i}]", item, value) for i, value in enumerate(given)]
            return given if all(map(operator.is_, read, given)) else read
        if isinstance(given, dict) and takes_fields(kind):
            return given
        scalars = [member for member in members if member in _SCALARS]
        if scalars:
            is_text = isinstance(given, str) and str in scalars
            return require_type(path, given, str if is_text else scalars[0])
        require(item is None, path, given, "give a list in [ ]")
        if np.ndarray in members:
            return np.asarray(given, dtype=float)
        return given  # a type that only blocks of the user's own have

    def _part(self, path: str, parts: tuple[type, ...], given: Any, present: Any) -> Any:
        """A dataclass: what a mapping makes of the one present, or an object gone through."""
        is_tree = self.reads_trees and (given is None or isinstance(given, dict))
        if is_tree:
            tree = given or {}
            config = self._config(path, parts, tree, present)
            values = {key: value for key, value in tree.items() if key != "_tag"}
        else:
            if path in CHOICES:
                require_config(path, given)
            names = " or ".join(part.__name__ for part in parts)
            remedy = f"give it as {names}, or in YAML as a mapping of fields to values"
            require(path in CHOICES or isinstance(given, parts), path, given, remedy)
            config = copy.copy(given)
            values = {key: getattr(given, key, None) for key in fields_of(given.__class__)}
        kinds = fields_of(config.__class__)
        for key, value in values.items():
            field = f"{path}.{key}".removeprefix(".")
            if key not in kinds:
                owners = [c for c in CHOICES.get(path, ()) if key in fields_of(c)]
                names = ", ".join(map(block_name, owners))
                remedy = f"{block_name(type(config))} has none; make {path} one of {names}"
                require(not owners, field, value, remedy)
            require_known(key, kinds, field, value)
            present = getattr(config, key, None)
            try:
                read = self.read(field, kinds[key], value, present)
                if read is not present:
                    setattr(config, key, read)
            except ScenarioError:
                raise
            except Exception as error:  # what Drake's class, or a user's own, does not take
                kind = getattr(kinds[key], "__name__", kinds[key])
                require(False, field, value, f"give a plain {kind} ({type(error).__name__})")
        # A block checks its config by itself, with the model.
        if not self.reads_trees and dataclasses.is_dataclass(given) and path not in CHOICES:
            require_ranges(path, config)
        return config

    def _config(self, path: str, parts: tuple[type, ...], tree: Tree, present: Any) -> Any:
        """What a mapping changes: the present object, or one with its class's own defaults."""
        if "_tag" in tree:
            return config_of(path, tree["_tag"], parts, self.trusted)()
        is_plain = path in CHOICES or len(parts) == 1
        tags = ", ".join(f"!{block_name(part)}" for part in parts)
        require(is_plain, path, dump_plain(tree, path), f"give one of {tags}")
        # Another model of an aircraft begins with its own figures.
        return parts[0]() if present is None or "model" in tree else present


def write(value: Any, kind: Any, path: str = "") -> Any:
    """A value of a field of that type as it stands in YAML."""
    if is_distribution(value):
        return to_entry(value)
    if parts_of(value.__class__):
        is_tagged = path in CHOICES or len(parts_of(kind)) > 1
        tag = {"_tag": tag_of(type(value))} if is_tagged else {}
        fields = {
            key: write(getattr(value, key), field, f"{path}.{key}".removeprefix("."))
            for key, field in fields_of(value.__class__).items()
            if getattr(value, key) is not None
        }
        return fields | tag
    if isinstance(value, list):
        return [write(item, item_of(kind)) for item in value]
    if isinstance(value, dict):
        return {key: write(each, None) for key, each in value.items()}
    is_number = float in members_of(kind) and isinstance(value, int)
    return float(value) if is_number else plain_value(value, path)


def warn_of_angles(part: Any, owner: str = "") -> None:
    """Warns of each angle beyond a turn: of a field, also in parts, whose comment begins "rad"."""
    about = meanings(type(part))
    for field in dataclasses.fields(part):
        value, path = getattr(part, field.name), f"{owner}{field.name}"
        if dataclasses.is_dataclass(value):
            warn_of_angles(value, f"{path}.")
        elif about.get(field.name, "").split(",")[0].strip() == "rad":
            with contextlib.suppress(TypeError, ValueError):  # rows of all lengths
                angles = np.asarray(value, dtype=float)
                if np.any(np.abs(angles[np.isfinite(angles)]) > 2 * math.pi):
                    hint = "an angle beyond 2π, it is in rad: degrees given?"
                    warn_user(f"{path} = {angles.tolist()}: {hint}")
