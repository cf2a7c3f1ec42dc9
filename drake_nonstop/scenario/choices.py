"""The configs of the blocks that a scenario's boxes can be: the package's, and the user's own.

Block X is configured by the dataclass XConfig beside it. The tag `!X` stands for one of the
package's, and `!my_blocks.X` for one of the user's own, at its import path.
"""

import dataclasses
import importlib
import sys
from collections.abc import Sequence
from typing import Any

from pydrake.systems.framework import System

from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.loop.box import block_of, import_path
from drake_nonstop.model.pattern import (
    CarouselConfig,
    ConstantSpreadConfig,
    EllipticCarouselConfig,
    HamiltonianCycleConfig,
    SpreadCarouselConfig,
)
from drake_nonstop.validation import ScenarioError, one_line, require, require_known

Trusted = bool | set[str]  # tags of blocks of the user's own that may be imported; True: all

PATTERN = "pattern"  # the field that is chosen like a box's block, and belongs to several
PATTERNS: tuple[type, ...] = (
    HamiltonianCycleConfig,
    CarouselConfig,
    SpreadCarouselConfig,
    EllipticCarouselConfig,
    ConstantSpreadConfig,
)

# The configs that each tagged field may hold, the default first.
CHOICES: dict[str, tuple[type, ...]] = {
    **{name: box.configs for name, box in BOXES.items()},
    PATTERN: PATTERNS,
}
_ALL_CONFIGS = {config for configs in CHOICES.values() for config in configs}


def block_name(config: type) -> str:
    """The block's name in a scenario: X of XConfig."""
    return config.__name__.removesuffix("Config")


def tag_of(config: type) -> str:
    """The tag of a config: that of a block of the user's own has its module before it."""
    is_own = config.__module__.partition(".")[0] != __name__.partition(".")[0]
    return f"!{import_path(config) if is_own else block_name(config)}"


def config_of(path: str, tag: str, configs: Sequence[type], trusted: Trusted) -> type:
    """The config, of those that the field at a path can hold, that a tag stands for.

    Raises:
        ScenarioError: there is none, or it is not trusted.
    """
    if "." in tag and path in CHOICES:
        remedy = (
            "this scenario runs code of its own, from the module that the tag names; where you "
            "trust that code, give --trust (in Python: trust=True)"
        )
        require(trusted is True or (trusted and tag in trusted), path, tag, remedy)
        return _imported(path, tag.removeprefix("!"))
    known = {f"!{block_name(config)}": config for config in configs}
    require_known(tag, known, path, tag)
    return known[tag]


def require_config(name: str, config: Any) -> None:
    """Raises ScenarioError for what is no config of a block that the box of the name can be."""
    kind, block = type(config), block_name(CHOICES[name][0])
    remedy = f"name a block by its tag, such as !{block} {{}}, in Python by its {block}Config()"
    require(dataclasses.is_dataclass(kind), name, config, remedy)
    if kind in CHOICES[name]:
        return
    is_own = kind not in _ALL_CONFIGS and (name in BOXES or hasattr(config, "make"))
    remedy = f"give one of {', '.join(map(block_name, CHOICES[name]))}"
    require(is_own, name, block_name(kind), remedy)
    if name in BOXES:
        own, path = block_of(kind), import_path(kind)
        is_block = isinstance(own, type) and issubclass(own, System)
        remedy = f"give {kind.__module__} a LeafSystem or Diagram of the name {block_name(kind)}"
        require(is_block, name, path, remedy)
        for needed, meaning in BOXES[name].config_fields.items():
            remedy = f"give {kind.__name__} a field {needed} ({meaning})"
            require(hasattr(config, needed), name, path, remedy)


def make_importable(folder: str) -> None:
    """Adds a folder to those that modules are imported from, as the last."""
    if folder not in sys.path:
        sys.path.append(folder)


def _imported(field: str, path: str) -> type:
    """The config class of a block, or of a pattern, at an import path.

    Raises:
        ScenarioError: the module cannot be imported, or holds no such config with defaults.
    """
    module_name, _, name = path.rpartition(".")
    try:
        module = importlib.import_module(module_name)
        known = [key for key in vars(module) if key.endswith("Config")]
        require_known(f"{name}Config", known, field, f"!{path}")
        config: type = getattr(module, f"{name}Config")
        config()
    except ScenarioError:
        raise
    except (Exception, SystemExit) as error:  # whatever a user's module may raise
        remedy = (
            f"{name}Config of the module {module_name} cannot be had ({one_line(error)}): put the "
            "module into the current folder, the scenario's or PYTHONPATH, and give every field a "
            "default"
        )
        raise ScenarioError(f"{field} = !{path}: {remedy}") from error
    is_config = dataclasses.is_dataclass(config)
    require(is_config, field, f"!{path}", f"make {name}Config a dataclass with the parameters")
    return config
