"""A scenario as nested dicts, as they stand in a YAML file, and back.

A dict that is a box's entry has the name of the block under "_tag": "!PaperPhase".
"""

import copy
import dataclasses
import types
import typing
from collections.abc import Collection
from typing import Any

from pydrake.common.yaml import yaml_dump, yaml_load_typed
from pydrake.systems.analysis import SimulatorConfig

from drake_nonstop.blocks.load_trajectory import SampledTrajectoryConfig
from drake_nonstop.loop.box import import_path
from drake_nonstop.model.system import SystemParameters, require_few
from drake_nonstop.scenario import distributions
from drake_nonstop.scenario.own_blocks import import_config
from drake_nonstop.scenario.schema import (
    CHOICES,
    Scenario,
    check,
    check_name,
)
from drake_nonstop.scenario.yaml_text import dump_plain
from drake_nonstop.validation import (
    ScenarioError,
    fields_of,
    of_given,
    one_line,
    optional_part,
    parts_of,
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
    _read_trajectory(scenario)
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
    require("name" not in tree, f"{name}.name", tree.get("name"), "leave it to the file's one key")
    scenario, schema = Scenario() if defaults is None else copy.deepcopy(defaults), Scenario()
    fields = {**tree}
    for key, part in vars(schema).items():
        if key not in tree:
            continue
        setattr(scenario, key, part)
        if distributions.is_entry(tree[key]):
            continue  # refused with the other fields
        if key in CHOICES:
            config_class, given = _checked_entry(key, fields.pop(key), trusted)
            setattr(scenario, key, filled(key, given, config_class()))
        elif key in ("system", "simulated", "limits", "simulator_config"):
            given = fields.pop(key)
            points = given.get("attachments") if isinstance(given, dict) else None
            if isinstance(points, list):  # of which many take long to load
                require_few(f"{key}.attachments", len(points))
            kinds = SystemParameters if key == "simulated" else type(part)
            filled(key, {} if given is None else given, part, kinds)
    filled(name, fields, scenario, other_keys=[BASE])
    scenario.name = name
    for owner in ("system", "simulated"):
        system = getattr(scenario, owner)
        if system.load_file:
            from drake_nonstop.model.load_file import read_load  # with much of Drake

            read = read_load(system.load_file, system.attachment_frames or [])
            read |= {"load_file": "", "attachment_frames": []}
            setattr(scenario, owner, dataclasses.replace(system, **read))
    _read_trajectory(scenario)
    check(scenario)
    return scenario


def _read_trajectory(scenario: Scenario) -> None:
    """Puts the samples of the load's trajectory in the place of the name of their file."""
    if isinstance(scenario.load_trajectory, SampledTrajectoryConfig):
        scenario.load_trajectory = scenario.load_trajectory.resolved()


def filled(
    path: str, tree: Any, config: Any, schema: Any = None, other_keys: Collection[str] = ()
) -> Any:
    """A dataclass with the values of a tree in its fields, which it is given.

    Args:
        path: its name in error messages.
        tree: a mapping of fields to values.
        config: the dataclass.
        schema: the class that has the fields' types; None: that of `config`.
        other_keys: named among the fields that there are.

    Raises:
        ScenarioError: a key is no field, or a value not of its type.
    """
    require(isinstance(tree, dict), path, tree, "give a mapping of fields to values")
    require("_tag" not in tree, path, tree.get("_tag"), "take the tag away; it is no block")
    kinds = {field.name: field.type for field in fields_of(schema or type(config))}
    for key, value in tree.items():
        field = f"{path}.{key}"
        require_known(key, [*kinds, *other_keys], field, value)
        is_plain = not (isinstance(config, SimulatorConfig) and distributions.is_entry(value))
        remedy = "give what is no distribution; Drake's SimulatorConfig takes none"
        require(is_plain, field, "a distribution", remedy)
        try:
            setattr(config, key, _typed(field, value, kinds[key], getattr(config, key)))
        except ScenarioError:
            raise
        except Exception as error:  # what a user's own dataclass does not take
            remedy = f"give its fields values of their types ({one_line(error)})"
            raise ScenarioError(f"{path} = {block_name(type(config))}: {remedy}") from error
    return config


def _typed(path: str, tree: Any, kind: Any, default: Any) -> Any:
    """The value of a field of that type that a tree stands for."""
    is_tagged = isinstance(tree, dict) and "_tag" in tree
    if distributions.is_entry(tree) or (is_tagged and of_given(kind) in (int, float)):
        distribution = distributions.from_entry(path, tree)
        require_type(path, distributions.mean(path, distribution, kind), kind)
        return distribution
    if parts := parts_of(kind):
        tags = {f"!{block_name(part)}": part for part in parts}
        fields = {**tree} if isinstance(tree, dict) else {}
        tag = fields.pop("_tag", None)
        require(tag in tags, path, dump_plain(tree, path), f"give one of {', '.join(tags)}")
        return filled(path, fields, tags[tag]())
    part: Any = kind if dataclasses.is_dataclass(kind) else optional_part(kind)
    if part is not None:
        return None if tree is None else filled(path, tree, part() if default is None else default)
    item = distributions.item_kind(kind)
    is_list = isinstance(tree, list) and typing.get_origin(of_given(kind, tree)) is list
    if is_list and (_is_plain(kind) or parts_of(item)):
        return [_typed(f"{path}[{i}]", value, item, None) for i, value in enumerate(tree)]
    require_type(path, tree, kind)
    if _is_plain(kind):
        return _plain(tree, kind)
    # What only blocks of the user's own have: arrays, mappings, parts.
    holder = dataclasses.make_dataclass("Holder", [("value", kind, None)])
    data = yaml_dump({"value": tree})
    return yaml_load_typed(schema=holder, data=data, defaults=holder(default)).value


def _is_plain(kind: Any) -> bool:
    """Whether a type is made of numbers, texts, truth values, None and lists."""
    parts = typing.get_args(kind)
    is_leaf = kind in (float, int, bool, str, types.NoneType)
    is_made = typing.get_origin(kind) in (list, typing.Union, types.UnionType)
    return is_leaf or (is_made and all(map(_is_plain, parts)))


def _plain(value: Any, kind: Any) -> Any:
    """A value of a field of that type as it stands in YAML."""
    if distributions.is_distribution(value):
        return distributions.to_entry(value)
    if dataclasses.is_dataclass(value) or isinstance(value, SimulatorConfig):
        fields = [(f, getattr(value, f.name)) for f in fields_of(type(value))]
        plain = {f.name: _plain(part, f.type) for f, part in fields if part is not None}
        return plain | ({"_tag": f"!{block_name(type(value))}"} if parts_of(kind) else {})
    if isinstance(value, list):
        return [_plain(item, distributions.item_kind(kind)) for item in value]
    is_number = of_given(kind) is float and isinstance(value, int)
    return float(value) if is_number else plain_value(value, "value")


def block_name(config_class: type) -> str:
    """The block's name in a scenario: X of XConfig."""
    return config_class.__name__.removesuffix("Config")


def config_class_of(name: str, tag: str, trusted: Trusted) -> type:
    """The config class that a tag in the field of that name stands for.

    Raises:
        ScenarioError: there is none, or it is not trusted.
    """
    options = CHOICES[name]
    block = tag.removeprefix("!")
    if "." in block and name != "scene":  # the import path of a block of the user's own
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


def _checked_entry(name: str, entry: Any, trusted: Trusted) -> tuple[type, Tree]:
    """The config class of a box's entry, and its fields, none of other blocks of the box alone."""
    entry = {} if entry is None else entry
    default = block_name(CHOICES[name][0])
    remedy = f"name a block by its tag, without quotes, such as !{default} {{}}"
    require(isinstance(entry, dict), name, entry, remedy)
    fields = dict(entry)
    config_class = config_class_of(name, fields.pop("_tag", f"!{default}"), trusted)
    own = {field.name for field in fields_of(config_class)}
    for key in (key for key in fields if key not in own):
        others = [
            choice for choice in CHOICES[name] if any(f.name == key for f in fields_of(choice))
        ]
        names = ", ".join(map(block_name, others))
        remedy = f"{block_name(config_class)} has none; make {name} one of {names}"
        require(not others, f"{name}.{key}", fields[key], remedy)
    return config_class, fields
