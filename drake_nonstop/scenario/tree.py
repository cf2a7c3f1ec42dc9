"""A scenario as nested dicts, as they stand in a YAML file, and back.

A dict that is a box's entry has the name of the block under "_tag": "!PaperPhase".
"""

import copy
import dataclasses
import difflib
import re
import typing
from collections.abc import Collection
from typing import Any

from pydrake.common.yaml import yaml_dump, yaml_dump_typed, yaml_load_typed
from pydrake.systems.analysis import SimulatorConfig

from drake_nonstop.diagrams.box import import_path
from drake_nonstop.model.load_file import read_load
from drake_nonstop.model.system import SystemParameters
from drake_nonstop.scenario.own_blocks import import_config, is_import_path
from drake_nonstop.scenario.run_limits import RunLimits
from drake_nonstop.scenario.schema import CHOICES, Scenario, check
from drake_nonstop.scenario.yaml_text import parse_plain
from drake_nonstop.validation import require

BASE = "based_on"  # a key of files, which `loading` replaces by what it stands for

# What earlier versions had as fields, and what has taken their place.
_MOVED = {
    "safe_carrier_distance": "give limits.carrier_distance instead, a share of the reach: of the "
    "farthest attachment's distance from the load's centre plus a cable's length",
    "safe_cable_distance": "give limits.cable_distance instead, a share of the distance between "
    "the two cables' attachments",
}

Tree = dict[str, Any]
Trusted = bool | set[str]  # tags of blocks of the user's own that may be imported; True: all


def to_tree(scenario: Scenario) -> Tree:
    """Nested dicts with every field, each box with its block's name under "_tag"."""
    configs = {name: getattr(scenario, name) for name in CHOICES}
    replaced = {}  # blocks of the user's own, which the schema does not know, by the defaults
    for name, choices in CHOICES.items():
        require(
            type(configs[name]) in choices or _is_own(configs[name]),
            name,
            block_name(type(configs[name])),
            f"give one of {', '.join(map(block_name, choices))}",
        )
        if type(configs[name]) not in choices:
            replaced[name] = choices[0]()
    known = dataclasses.replace(scenario, **replaced)
    tree = _plain_fields(known, Scenario)
    for name, config in configs.items():
        fields, tag = tree[name], block_name(type(config))
        if name in replaced:
            fields = _plain_fields(config, type(config))
            tag = import_path(type(config))
        tree[name] = {**(fields or {}), "_tag": f"!{tag}"}
    del tree["name"]
    return tree


def from_tree(
    name: str, tree: Tree, trusted: Trusted, defaults: Scenario | None = None
) -> Scenario:
    """The scenario of that name from nested dicts such as `to_tree` makes, some left out.

    Fields that are left out are those of `defaults`, which is not changed, or the schema's; what a
    field leaves out is the schema's in both cases.

    Raises:
        ScenarioError: a key or value cannot be used, or a block is not trusted.
    """
    require(
        re.fullmatch(r"[A-Za-z0-9][\w.-]*", name),
        "scenario",
        name,
        "name it with letters, digits, _, - and . only: its results' folder is named after it",
    )
    tree = dict(tree)
    scenario = Scenario()
    if defaults is not None:
        scenario = copy.deepcopy(defaults)
        for key in tree.keys() & vars(scenario).keys():
            setattr(scenario, key, getattr(Scenario(), key))
    for field_name, remedy in _MOVED.items():
        require(field_name not in tree, f"{name}.{field_name}", tree.get(field_name), remedy)
    _check_fields(name, tree, Scenario, BASE)
    require("name" not in tree, f"{name}.name", tree.get("name"), "leave it to the file's one key")
    own = {}
    for field_name, options in CHOICES.items():
        if field_name in tree:
            config_class, fields = _checked_entry(field_name, tree.pop(field_name), trusted)
            if config_class not in options:
                own[field_name] = _loaded(config_class, fields)
            else:
                tag = {"_tag": f"!{config_class.__name__}"} if len(options) > 1 else {}
                tree[field_name] = tag | fields
    for field_name, schema in (
        ("system", SystemParameters),
        ("simulated", SystemParameters),
        ("limits", RunLimits),
        ("simulator", SimulatorConfig),
    ):
        if field_name in tree:
            tree[field_name] = {} if tree[field_name] is None else tree[field_name]
            _check_fields(field_name, tree[field_name], schema)
    scenario = yaml_load_typed(schema=Scenario, data=yaml_dump(tree), defaults=scenario)
    scenario.name = name
    for field_name, config in own.items():
        setattr(scenario, field_name, config)
    _read_files(scenario)
    check(scenario)
    return scenario


def _plain_fields(config: Any, schema: type) -> Tree:
    """The fields of a dataclass as they stand in YAML."""
    return parse_plain(yaml_dump_typed(config, schema=schema), schema.__name__) or {}


def block_name(config_class: type) -> str:
    """The block's name in a scenario: X of XConfig."""
    return config_class.__name__.removesuffix("Config")


def own_tags(tree: Tree) -> set[str]:
    """The tags in a tree, those of blocks of the user's own among them."""
    entries = [entry for entry in tree.values() if isinstance(entry, dict)]
    return {entry["_tag"] for entry in entries if "_tag" in entry}


def config_class_of(name: str, tag: str, trusted: Trusted) -> type:
    """The config class that a tag in the field of that name stands for.

    Raises:
        ScenarioError: there is none, or it is not trusted.
    """
    options = CHOICES[name]
    block = tag.removeprefix("!")
    if is_import_path(block) and name != "scene":
        require(
            trusted is True or (trusted and tag in trusted),
            name,
            tag,
            "this scenario runs code of its own, from the module that the tag names; where you "
            "trust that code, give --trust (in Python: trust=True)",
        )
        return import_config(name, block)
    matching = [option for option in options if block_name(option) == block]
    require(matching, name, tag, f"give one of !{', !'.join(map(block_name, options))}")
    return matching[0]


def require_known(
    key: Any, valid: Collection[str], field: str, value: Any, called: str = ""
) -> None:
    """Raises ScenarioError for a key that is not among the valid ones; `called` is its full name.

    Only then is a close one looked for, which takes longer than all else.
    """
    if key in valid:
        return
    name = called or key
    close = difflib.get_close_matches(str(name), valid, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    there = f"there is no {name}; {hint}there are {', '.join(valid) or 'no fields'}"
    require(False, field, value, there)


def _is_own(config: Any) -> bool:
    """Whether a config is that of a block of the user's own."""
    known = {option for options in CHOICES.values() for option in options}
    return dataclasses.is_dataclass(config) and type(config) not in known


def _read_files(scenario: Scenario) -> None:
    """Puts what files say in the place of the files' names."""
    for owner in ("system", "simulated"):
        system = getattr(scenario, owner)
        if system.load_file:
            fields = read_load(system.load_file, system.attachment_frames or [])
            fields |= {"load_file": "", "attachment_frames": []}
            setattr(scenario, owner, dataclasses.replace(system, **fields))
    for name in CHOICES:
        config = getattr(scenario, name)
        if hasattr(config, "resolved"):
            setattr(scenario, name, config.resolved())


def _checked_entry(name: str, entry: Any, trusted: Trusted) -> tuple[type, Tree]:
    """The config class of a box's entry, and its fields, which the class has."""
    entry = {} if entry is None else entry
    default = block_name(CHOICES[name][0])
    require(
        isinstance(entry, dict), name, entry, f"name a block by its tag, such as !{default} {{}}"
    )
    fields = dict(entry)
    config_class = config_class_of(name, fields.pop("_tag", f"!{default}"), trusted)
    _check_fields(name, fields, config_class)
    return config_class, fields


def _loaded(config_class: type, fields: Tree) -> Any:
    """A config of the user's own from its fields."""
    return yaml_load_typed(schema=config_class, data=yaml_dump(fields), defaults=config_class())


def _check_fields(name: str, tree: Any, schema: Any, *other_keys: str) -> None:
    """Raises ScenarioError for the first key that is no field, or value not of its type.

    `other_keys` are named among those that there are.
    """
    require(isinstance(tree, dict), name, tree, "give a mapping of fields to values")
    fields = dataclasses.fields(schema) if dataclasses.is_dataclass(schema) else schema.__fields__
    types = {f.name: f.type for f in fields}
    for key, value in tree.items():
        require_known(key, [*types, *other_keys], f"{name}.{key}", value)
        _check_type(f"{name}.{key}", value, types[key])


def _check_type(path: str, value: Any, annotation: Any) -> None:
    """Raises ScenarioError for a scalar or list that is not what the annotation says."""
    if typing.get_origin(annotation) is list:
        require(isinstance(value, list), path, value, "give a list in [ ]")
        for i, item in enumerate(value):
            _check_type(f"{path}[{i}]", item, typing.get_args(annotation)[0])
    elif annotation in _KINDS:
        accepted, kind = _KINDS[annotation]
        require(type(value) in accepted, path, value, f"give {kind}")


_KINDS: dict[type, tuple[tuple[type, ...], str]] = {
    float: ((int, float), "a number"),
    int: ((int,), "a whole number"),
    str: ((str,), "a text"),
    bool: ((bool,), "true or false"),
}
