"""A scenario as nested dicts, as they stand in a YAML file, and back.

A dict that is a box's entry has the name of the block under "_tag": "!PaperPhase".
"""

import copy
import dataclasses
import types
import typing
from typing import Any

from pydrake.common.yaml import yaml_dump, yaml_load_typed
from pydrake.systems.analysis import SimulatorConfig

from drake_nonstop.loop.box import import_path
from drake_nonstop.model.load_file import read_load
from drake_nonstop.model.system import SystemParameters, require_few
from drake_nonstop.scenario import distributions
from drake_nonstop.scenario.own_blocks import import_config, is_import_path
from drake_nonstop.scenario.run_limits import RunLimits
from drake_nonstop.scenario.schema import (
    CHOICES,
    Scenario,
    check,
    check_name,
    require_current,
    require_current_block,
)
from drake_nonstop.validation import (
    ScenarioError,
    fields_of,
    one_line,
    optional_part,
    plain_value,
    require,
    require_known,
    require_type,
)

BASE = "based_on"  # a key of files, which `loading` replaces by what it stands for

Tree = dict[str, Any]
Trusted = bool | set[str]  # tags of blocks of the user's own that may be imported; True: all


def to_tree(scenario: Scenario) -> Tree:
    """Nested dicts with every field, each box with its block's name under "_tag".

    Raises:
        ScenarioError: see `check`.
    """
    check(scenario)
    scenario = copy.copy(scenario)
    _resolve_configs(scenario)
    tree = _plain(scenario, Scenario)
    for name, choices in CHOICES.items():
        config = type(getattr(scenario, name))
        tag = block_name(config) if config in choices else import_path(config)
        tree[name] = {**tree[name], "_tag": f"!{tag}"}
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
    check_name(name)
    tree = dict(tree)
    scenario = Scenario()
    if defaults is not None:
        scenario = copy.deepcopy(defaults)
        for key in tree.keys() & vars(scenario).keys():
            setattr(scenario, key, getattr(Scenario(), key))
    for key, value in tree.items():
        require_current(key, f"{name}.{key}", value)
    _check_fields(name, tree, Scenario, BASE)
    require("name" not in tree, f"{name}.name", tree.get("name"), "leave it to the file's one key")
    own = {}
    for field_name, options in CHOICES.items():
        if field_name in tree:
            config_class, fields = _checked_entry(field_name, tree.pop(field_name), trusted)
            if config_class not in options:
                own[field_name] = _loaded(field_name, config_class, fields, config_class())
            else:
                tag = {"_tag": f"!{config_class.__name__}"} if len(options) > 1 else {}
                tree[field_name] = tag | fields
    for field_name, schema in (
        ("system", SystemParameters),
        ("simulated", SystemParameters),
        ("limits", RunLimits),
        ("simulator_config", SimulatorConfig),
    ):
        if field_name in tree:
            tree[field_name] = {} if tree[field_name] is None else tree[field_name]
            _check_fields(field_name, tree[field_name], schema)
            points = tree[field_name].get("attachments")
            if isinstance(points, list):  # of which many take long to load
                require_few(f"{field_name}.attachments", len(points))
    scenario = _loaded(name, Scenario, tree, scenario)
    scenario.name = name
    for field_name, config in own.items():
        setattr(scenario, field_name, config)
    _read_files(scenario)
    check(scenario)
    return scenario


def _plain(value: Any, kind: Any) -> Any:
    """A value of a field of that type as it stands in YAML."""
    if distributions.is_distribution(value):
        return distributions.to_entry(value)
    if dataclasses.is_dataclass(value) or isinstance(value, SimulatorConfig):
        fields = [(f, getattr(value, f.name)) for f in fields_of(type(value))]
        return {f.name: _plain(part, f.type) for f, part in fields if part is not None}
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        kind = typing.get_args(kind)[0]  # of a field that may be None
    if isinstance(value, list):
        item_kind = typing.get_args(kind)[0] if typing.get_args(kind) else Any
        return [_plain(item, item_kind) for item in value]
    is_number = kind is float and not isinstance(value, str)
    return float(value) if is_number else plain_value(value, "value")


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
    require_current_block(name, block, tag)
    matching = [option for option in options if block_name(option) == block]
    require(matching, name, tag, f"give one of !{', !'.join(map(block_name, options))}")
    return matching[0]


def _read_files(scenario: Scenario) -> None:
    """Puts what files say in the place of the files' names."""
    for owner in ("system", "simulated"):
        system = getattr(scenario, owner)
        if system.load_file:
            fields = read_load(system.load_file, system.attachment_frames or [])
            fields |= {"load_file": "", "attachment_frames": []}
            setattr(scenario, owner, dataclasses.replace(system, **fields))
    _resolve_configs(scenario)


def _resolve_configs(scenario: Scenario) -> None:
    """Puts what files say in the place of the files' names, in the boxes' configs."""
    for name in CHOICES:
        config = getattr(scenario, name)
        if hasattr(config, "resolved"):
            setattr(scenario, name, config.resolved())


def _checked_entry(name: str, entry: Any, trusted: Trusted) -> tuple[type, Tree]:
    """The config class of a box's entry, and its fields, which the class has."""
    entry = {} if entry is None else entry
    default = block_name(CHOICES[name][0])
    remedy = f"name a block by its tag, without quotes, such as !{default} {{}}"
    require(isinstance(entry, dict), name, entry, remedy)
    fields = dict(entry)
    config_class = config_class_of(name, fields.pop("_tag", f"!{default}"), trusted)
    _check_block_fields(name, fields, config_class)
    _check_fields(name, fields, config_class)
    return config_class, fields


def _check_block_fields(name: str, fields: Tree, config_class: type) -> None:
    """Raises ScenarioError for the first key that is a field of other blocks of the box alone."""
    of_others = {key: value for key, value in fields.items() if not _has_field(config_class, key)}
    for key, value in of_others.items():
        others = [block_name(choice) for choice in CHOICES[name] if _has_field(choice, key)]
        remedy = f"{block_name(config_class)} has none; make {name} one of {', '.join(others)}"
        require(not others, f"{name}.{key}", value, remedy)


def _has_field(config_class: type, key: str) -> bool:
    return any(field.name == key for field in fields_of(config_class))


def _loaded(name: str, schema: type, fields: Tree, defaults: Any) -> Any:
    """The dataclass of these fields, the others as in the defaults."""
    data = yaml_dump(distributions.with_stand_ins(fields))
    try:
        config = yaml_load_typed(schema=schema, data=data, defaults=defaults)
        distributions.restore(config, fields)
        return config
    except Exception as error:  # what a user's own dataclass does not take
        remedy = f"give its fields values of their types ({one_line(error)})"
        raise ScenarioError(f"{name} = {block_name(schema)}: {remedy}") from error


def _check_fields(name: str, tree: Any, schema: Any, *other_keys: str) -> None:
    """Raises ScenarioError for the first key that is no field, or value not of its type.

    `other_keys` are named among those that there are.
    """
    require(isinstance(tree, dict), name, tree, "give a mapping of fields to values")
    require("_tag" not in tree, name, tree.get("_tag"), "take the tag away; it is no block")
    kinds = {field.name: field.type for field in fields_of(schema)}
    for key, value in tree.items():
        require_known(key, [*kinds, *other_keys], f"{name}.{key}", value)
        if key in kinds:
            path = f"{name}.{key}"
            if schema is SimulatorConfig:
                remedy = "give what is no distribution; Drake's SimulatorConfig takes none"
                is_plain = not distributions.is_entry(value)
                require(is_plain, path, "a distribution", remedy)
            require_type(path, distributions.with_means(path, value, kinds[key]), kinds[key])
            part = optional_part(kinds[key])
            if part is not None and value is not None:
                _check_fields(path, value, part)
