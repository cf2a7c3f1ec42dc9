"""Blocks of the user's own, named in a scenario by their import path.

The tag `!my_blocks.MyOptimizer {gain: 3.0}` stands for the class MyOptimizer of the module
my_blocks, made with the model and a config of the dataclass MyOptimizerConfig beside it.
"""

import dataclasses
import difflib
import importlib
import os
import sys
from pathlib import Path

from pydrake.common.yaml import yaml_dump_typed

from drake_nonstop.validation import ScenarioError, one_line, require


def make_importable(folder: str) -> None:
    """Adds a folder to those that modules are imported from, as the last."""
    if folder not in sys.path:
        sys.path.append(folder)


def import_config(field: str, path: str) -> type:
    """Returns the config class of the block or cable pattern at an import path.

    `field` is the scenario's field that has the tag, for messages.

    Raises:
        ScenarioError: the module cannot be imported, or holds no such block and config.
    """
    module_name, _, name = path.rpartition(".")
    folder = Path.cwd()
    try:
        module = importlib.import_module(module_name)
    except (Exception, SystemExit) as error:  # whatever a user's module may raise
        raise ScenarioError(
            f"{field} = !{path}: the module {module_name} cannot be imported ({one_line(error)}); "
            "correct it, or put it into the current folder, the scenario's or PYTHONPATH"
        ) from error
    finally:
        os.chdir(folder)  # the module may have left it: results would go elsewhere
    config = getattr(module, f"{name}Config", None)
    if config is None and not hasattr(module, name):
        own = [key.removesuffix("Config") for key in vars(module) if key.endswith("Config")]
        close = difflib.get_close_matches(name, filter(None, own), n=1)
        remedy = f"did you mean {close[0]}?" if close else f"give it the block and a {name}Config"
        require(False, field, f"!{path}", f"{module_name} has no {name}; {remedy}")
    require(
        isinstance(config, type) and dataclasses.is_dataclass(config),
        field,
        f"!{path}",
        f"give {module_name} a dataclass {name}Config with the parameters",
    )
    assert isinstance(config, type)
    remedy = f"give every field of {name}Config a type such as float or list[float] and a default"
    try:
        yaml_dump_typed(config())
    except (Exception, SystemExit) as error:  # whatever a user's dataclass may raise
        raise ScenarioError(f"{field} = !{path}: {remedy} ({one_line(error)})") from error
    return config
