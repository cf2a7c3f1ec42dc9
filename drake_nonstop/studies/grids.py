"""Grids: variants of a scenario by name, from files."""

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drake_nonstop import diagrams
from drake_nonstop.scenario.overrides import (
    as_override,
    combinations,
    read_mapping,
    require_choices,
    require_override,
)
from drake_nonstop.validation import require

GRIDS = diagrams.FOLDER / "grids"
_MAX_VARIANTS = 10_000


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Variants by their names, each a list of overrides "path=value"."""

    name: str
    description: str
    variants: dict[str, list[str]]


def grid_names() -> list[str]:
    """The names of the grids that come with the package, sorted."""
    return sorted(path.stem for path in GRIDS.glob("*.yaml"))


def read_grid(name_or_file: str | Path) -> Grid:
    """The grid of that name, or the one in a YAML file.

    A file may have a `description`, and has either `variants`, a mapping from a variant's name
    to a list of overrides "path=value", or `grid`, a mapping from a path to a list of values:
    then every combination of values is a variant, named by them.

    Raises:
        ScenarioError: there is no such grid or file, or its content cannot be used.
    """
    is_path = isinstance(name_or_file, (str, Path))
    require(is_path, "--grid", name_or_file, "give a grid's name, or a .yaml file")
    path = Path(name_or_file)
    if path.suffix not in (".yaml", ".yml"):
        names = grid_names()
        require(
            str(name_or_file) in names,
            "--grid",
            name_or_file,
            f"give a .yaml file or one of {', '.join(names)}",
        )
        path = GRIDS / f"{name_or_file}.yaml"
    known = ("description", "variants", "grid")
    remedy = "give variants or grid, and a description if needed"
    content, source = read_mapping(path, "--grid", known, remedy), path.name
    given = [key for key in known[1:] if key in content]
    require(len(given) == 1, source, " and ".join(given) or "neither", "give variants or grid")
    entries = content[given[0]]
    require(
        isinstance(entries, dict) and entries and "_tag" not in entries,
        f"{source}.{given[0]}",
        entries,
        "give a mapping from the variants' names to lists of path=value"
        if given[0] == "variants"
        else "give a mapping from paths to lists of values",
    )
    if given[0] == "variants":
        variants = _listed(entries, f"{source}.variants")
    else:
        variants = _combined(entries, f"{source}.grid")
    return Grid(name=path.stem, description=content.get("description", ""), variants=variants)


def _listed(entries: Mapping[str, Any], source: str) -> dict[str, list[str]]:
    """The variants that a file lists, by their names."""
    for name, overrides in entries.items():
        require(name.strip(), source, "a variant without a name", "name it")
        where = f"{source}.{name}"
        require(
            isinstance(overrides, list) and overrides, where, overrides, "give a list of path=value"
        )
        for override in overrides:
            require_override(override, where)
    return {" ".join(name.split()): overrides for name, overrides in entries.items()}


def _combined(entries: Mapping[str, Any], source: str) -> dict[str, list[str]]:
    """A variant for every combination of the values, named by them."""
    for path, values in entries.items():
        require_choices(values, f"{source}.{path}")
    count = math.prod(map(len, entries.values()))
    require(count <= _MAX_VARIANTS, source, f"{count} variants", f"give at most {_MAX_VARIANTS}")
    variants = ([as_override(*item) for item in c.items()] for c in combinations(entries))
    return {name_overrides(overrides): overrides for overrides in variants}


def name_overrides(overrides: Sequence[str]) -> str:
    """A variant's name: its blocks, and its other values with their fields."""
    paths = [override.partition("=")[0] for override in overrides]
    last = Counter(path.split(".")[-1] for path in paths)
    labels = []
    for path, override in zip(paths, overrides, strict=True):
        value = " ".join(override.partition("=")[2].split())
        block = value.removeprefix("!").removesuffix("{}").strip()
        if "." not in path and re.match(r"[A-Za-z_]", block):
            labels.append(block)
        else:
            name = path.split(".")[-1]
            labels.append(f"{name if last[name] == 1 else path}={value}")
    return ", ".join(labels)
