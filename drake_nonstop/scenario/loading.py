"""Scenarios from YAML and to it.

A scenario file has one key, the scenario's name, and below it the fields of `Scenario`. A box of
the figure is chosen by its tag, `phase: !PaperPhase {}`: block X is configured by the dataclass
XConfig, whose fields stand below the tag. Fields left out have their defaults. A tag with dots is
the import path of a block of the user's own (`own_blocks`). With `based_on: NAME` the fields left
out are those of another scenario.
"""

import copy
import difflib
import functools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import yaml

from drake_nonstop import diagrams
from drake_nonstop.scenario.overrides import changed
from drake_nonstop.scenario.own_blocks import make_importable
from drake_nonstop.scenario.schema import CHOICES, Scenario
from drake_nonstop.scenario.tree import BASE, Tree, block_name, from_tree, to_tree
from drake_nonstop.scenario.yaml_text import TreeDumper, parse_plain
from drake_nonstop.validation import listed, read_text, require, require_file, require_type

SCENARIOS = diagrams.FOLDER / "scenarios"
_MAX_BASES = 20


def scenario_names() -> list[str]:
    """The names of the scenarios that come with the package, sorted."""
    return sorted(path.stem for path in SCENARIOS.glob("*.yaml"))


def load_scenario(
    name_or_file: str | Path, overrides: Iterable[str] = (), *, trust: bool = False
) -> Scenario:
    """The scenario of that name, or the one in a YAML file.

    Args:
        name_or_file: one of `scenario_names()`, or the path of a `.yaml` file.
        overrides: changes "path=value", such as "system.load_mass=1.2". A path names a
            field of the resolved scenario; a value is YAML. A box takes a tagged value
            ("phase=!PaperPhase {}"), or the name of another block ("phase=PaperPhase"),
            which takes over the parameters that both have (a trajectory: those not default).
        trust: whether blocks of the user's own may be imported, which runs their code; they
            are looked for in the current folder and the scenario's, too.

    Raises:
        ScenarioError: there is no such scenario or file, or its content cannot be used;
            the message names the field, the value and the remedy.
    """
    require_type("trust", trust, bool)
    is_path = isinstance(name_or_file, (str, Path))
    require(is_path, "scenario", name_or_file, "give a scenario's name, or a .yaml file")
    remedy = 'give a list of texts, such as ["simulation_duration=5"]'
    texts = listed("overrides", overrides, remedy)
    path = _path(name_or_file, "scenario")
    if trust:
        make_importable(str(Path.cwd()))
    if path.parent == SCENARIOS and path.exists():
        scenario = copy.deepcopy(_shipped(path))
    else:
        scenario = _parsed(read_text(path, "scenario"), str(path), path.parent, trust, [path])
    return changed(scenario, texts, trust=trust) if texts else scenario


@functools.cache
def _shipped(path: Path) -> Scenario:
    """A scenario that comes with the package; its file does not change."""
    return _parsed(read_text(path, "scenario"), str(path), path.parent, False, [path])


def parse_scenario(text: str, source: str = "scenario", *, trust: bool = False) -> Scenario:
    """The scenario in YAML text; `source` is what error messages call the text.

    A file that it is based on is looked for in the current folder; `trust` as in `load_scenario`.

    Raises:
        ScenarioError: see `load_scenario`.
    """
    require_type("trust", trust, bool)
    return _parsed(text, source, Path(), trust, [])


def dump_scenario(scenario: Scenario) -> str:
    """The scenario as YAML with every field and tag written out; `parse_scenario` reads it.

    Raises:
        ScenarioError: a field cannot be used.
    """
    tree = to_tree(scenario)
    return yaml.dump(
        {scenario.name: tree},
        Dumper=TreeDumper,
        sort_keys=False,  # the boxes stand in the figure's order
        default_flow_style=None,
        width=96,
    )


def _path(name_or_file: str | Path, field: str, folder: Path | None = None) -> Path:
    """The file of a shipped scenario's name, or a file, in that folder unless absolute."""
    path = Path(name_or_file)
    if path.suffix in (".yaml", ".yml"):
        return path if folder is None else folder / path
    names = scenario_names()
    close = difflib.get_close_matches(str(name_or_file), names, n=1)
    hint = f"; did you mean {close[0]}?" if close else ""
    remedy = f"give a .yaml file or one of {', '.join(names)}{hint}"
    require(str(name_or_file) in names, field, name_or_file, remedy)
    return SCENARIOS / f"{name_or_file}.yaml"


def _parsed(text: str, source: str, folder: Path, trust: bool, trail: Sequence[Path]) -> Scenario:
    """The scenario in a text from that folder, which the files of the trail are based on."""
    if trust and folder.absolute() != SCENARIOS:
        make_importable(str(folder.absolute()))
    name, tree = _tree(text, source, folder, trust, trail)
    return from_tree(name, tree, trust)


def _tree(
    text: str, source: str, folder: Path, trust: bool, trail: Sequence[Path]
) -> tuple[str, Tree]:
    """The name of the scenario in a text, and its fields with those of what it is based on."""
    tree = parse_plain(text, source)
    require(
        isinstance(tree, dict) and len(tree) == 1 and "_tag" not in tree,
        source,
        "a file without exactly one scenario",
        "give one key, the scenario's name, with its fields below it",
    )
    ((name, content),) = tree.items()
    content = {} if content is None else content
    require(isinstance(content, dict), name, content, "give the scenario's fields below its name")
    if BASE not in content:
        return name, content
    field, base = f"{name}.{BASE}", content.pop(BASE)
    require(isinstance(base, str), field, base, "give a scenario's name, or a .yaml file")
    path = _path(base, field, folder)
    require_file(path, field, "give a file that can be read")
    is_new = not any(path.samefile(other) for other in trail)
    require(is_new, field, base, "it is based on this scenario itself; give another one")
    require(len(trail) < _MAX_BASES, field, base, f"give at most {_MAX_BASES} bases in a row")
    if trust and path.parent != SCENARIOS:
        make_importable(str(path.parent.absolute()))
    _, inherited = _tree(read_text(path, field), str(path), path.parent, trust, [*trail, path])
    inherited.pop("description", None)  # that of another task
    return name, _merged(inherited, content)


def _merged(base: Tree, content: Tree) -> Tree:
    """The fields of a base with those of a scenario in their place.

    Parts such as `system` are merged field by field, boxes too where the block is the same:
    another block begins with its own defaults, and another model of an aircraft with its figures.
    """
    merged = dict(base)
    for name, value in content.items():
        inherited: Any = base.get(name)
        if isinstance(inherited, dict) and value is None:
            continue  # a part without any fields
        if isinstance(value, dict) and isinstance(inherited, dict):
            default = f"!{block_name(CHOICES[name][0])}" if name in CHOICES else None
            tag = inherited.get("_tag", default)
            if value.get("_tag", tag) == tag:
                value = inherited | {k: _part(inherited.get(k), v) for k, v in value.items()}
        merged[name] = value
    return merged


def _part(base: Any, content: Any) -> Any:
    """A field of a part; of one that has fields itself, such as an aircraft, with the base's."""
    are_parts = all(isinstance(part, dict) and "_tag" not in part for part in (base, content))
    return base | content if are_parts and "model" not in content else content
