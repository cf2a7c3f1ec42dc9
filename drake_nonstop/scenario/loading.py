"""Scenarios from YAML and to it.

A scenario file has one key, the scenario's name, and below it the fields of `Scenario`. A box of
the figure is chosen by its tag, `phase: !PaperPhase {}`: block X is configured by the dataclass
XConfig, whose fields stand below the tag. Fields left out have their defaults. A tag with dots is
the import path of a block of the user's own (`choices`). With `based_on: NAME` the fields left
out are those of another scenario, also those of a box without a tag.
"""

import copy
import functools
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import yaml

from drake_nonstop import diagrams
from drake_nonstop.scenario.choices import make_importable
from drake_nonstop.scenario.fields import Walk, fields_of
from drake_nonstop.scenario.overrides import BASE, changed, resolved, to_tree
from drake_nonstop.scenario.schema import Scenario, check, check_name
from drake_nonstop.scenario.yaml_text import TreeDumper, parse_plain
from drake_nonstop.validation import (
    listed,
    read_text,
    require,
    require_known,
    require_type,
)

SCENARIOS = diagrams.FOLDER / "scenarios"


def scenario_names() -> list[str]:
    """The names of the scenarios that come with the package, sorted."""
    return sorted(path.stem for path in SCENARIOS.glob("*.yaml"))


def load_scenario(
    name_or_file: str | Path, overrides: Iterable[str] = (), *, trust: bool = False
) -> Scenario:
    """The scenario of that name, or the one in a YAML file.

    Args:
        name_or_file: one of `scenario_names()`, or the path of a `.yaml` file.
        overrides: changes "path=value", such as "system.load_mass=1.2". A value is YAML, and
            means the same as in a file: a mapping changes the fields that it has, and a tagged
            one ("phase=!PaperPhase {}") begins with its block's defaults. The name of another
            block ("phase=PaperPhase") takes over the parameters that both blocks have (of a
            trajectory: those that differ from the defaults).
        trust: whether blocks of the user's own may be imported, which runs their code. Python also
            looks for them in the current folder and in the scenario's.

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
    """The scenario in YAML text; error messages call the text `source`.

    The current folder has the file that it is based on; `trust` is as in `load_scenario`.

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
    known, own = [*scenario_names(), "a .yaml file"], f"{name_or_file}.yaml"
    is_own = str(name_or_file) not in known and os.path.isfile((folder or Path()) / own)
    require(not is_own, field, name_or_file, f"give the whole name of the file, {own}")
    require_known(str(name_or_file), known, field, name_or_file)
    return SCENARIOS / f"{name_or_file}.yaml"


def _parsed(text: str, source: str, folder: Path, trust: bool, trail: Sequence[Path]) -> Scenario:
    """The scenario in a text from that folder, which the files of the trail are based on."""
    scenario = resolved(_read(text, source, folder, trust, trail))
    check(scenario)
    return scenario


def _read(text: str, source: str, folder: Path, trust: bool, trail: Sequence[Path]) -> Scenario:
    """The scenario in a text, without the files that it names and without checks."""
    if trust and folder.absolute() != SCENARIOS:
        make_importable(str(folder.absolute()))
    tree = parse_plain(text, source)
    is_one = isinstance(tree, dict) and len(tree) == 1 and "_tag" not in tree
    remedy = "give one key, the scenario's name, with its fields below it"
    require(is_one, source, "a file without exactly one scenario", remedy)
    ((name, content),) = tree.items()
    check_name(name)
    content = {} if content is None else content
    remedy = "give the scenario's fields below its name"
    require(isinstance(content, dict) and "_tag" not in content, name, content, remedy)
    known = [BASE, *(field for field in fields_of(Scenario) if field != "name")]
    for key, value in content.items():
        require_known(key, known, key, value)
    scenario = Scenario()
    if BASE in content:
        scenario = _base(content.pop(BASE), folder, trust, trail)
        scenario.description = ""  # that of another task
    Walk(trusted=trust).read("", Scenario, content, scenario)
    scenario.name = name
    return scenario


def _base(base: Any, folder: Path, trust: bool, trail: Sequence[Path]) -> Scenario:
    """The scenario of that name, or in a file from that folder, likewise."""
    require(isinstance(base, str), BASE, base, "give a scenario's name, or a .yaml file")
    path = _path(base, BASE, folder)
    text = read_text(path, BASE)
    is_new = not any(path.samefile(other) for other in trail)
    require(is_new, BASE, base, "it is based on this scenario itself; give another one")
    return _read(text, str(path), path.parent, trust, [*trail, path])
