"""Changes "path=value" to a scenario: read from files, checked, combined, applied."""

import copy
import dataclasses
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from drake_nonstop.blocks.load_trajectory import SampledTrajectoryConfig
from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.loop.box import kept_parameters
from drake_nonstop.scenario.choices import CHOICES, config_of, tag_of
from drake_nonstop.scenario.fields import Tree, Walk, fields_of, write
from drake_nonstop.scenario.schema import Scenario, check
from drake_nonstop.scenario.yaml_text import dump_plain, parse_plain
from drake_nonstop.validation import listed, number_text, read_text, require, require_type

BASE = "based_on"  # a key of files, the name of the scenario that has the fields left out


def to_tree(scenario: Scenario) -> Tree:
    """Nested dicts with every field of a scenario but its name, as in a YAML file.

    Raises:
        ScenarioError: see `check`.
    """
    check(scenario)
    tree = write(resolved(copy.copy(scenario)), Scenario)
    del tree["name"]
    return tree


def resolved(scenario: Scenario) -> Scenario:
    """The scenario with what stands in the files that it names in their place: load, trajectory."""
    for owner in ("system", "simulated"):
        system: Any = getattr(scenario, owner)
        if getattr(system, "load_file", ""):
            from drake_nonstop.model.load_file import read_load  # with much of Drake

            read = read_load(system.load_file, system.attachment_frames or [])
            read |= {"load_file": "", "attachment_frames": []}
            setattr(scenario, owner, dataclasses.replace(system, **read))
    if isinstance(scenario.load_trajectory, SampledTrajectoryConfig):
        scenario.load_trajectory = scenario.load_trajectory.resolved()
    return scenario


def changed(scenario: Scenario, overrides: Iterable[str], *, trust: bool = False) -> Scenario:
    """A copy of the scenario with changes "path=value", see `load_scenario`.

    Blocks of the user's own that the scenario has already are trusted.

    Raises:
        ScenarioError: a path or value cannot be used.
    """
    require_type("trust", trust, bool)
    remedy = 'give a list of texts, such as ["simulation_duration=5"]'
    texts = listed("overrides", overrides, remedy)
    check(scenario)
    scenario = copy.deepcopy(scenario)
    walk = Walk(trusted=trust or {tag_of(type(getattr(scenario, name))) for name in CHOICES})
    for override in texts:
        path, value = parse_override(override)
        if path in CHOICES and isinstance(value, str):
            value = _swapped(path, value, scenario, walk)
        top, *keys = path.split(".")
        known = [name for name in fields_of(Scenario) if name != "name"]
        if not keys and top not in known:
            parts = [part for part in known if part != "simulated"]
            homes = [f"{part}.{top}" for part in parts if hasattr(getattr(scenario, part), top)]
            require(not homes, "--set", path, f"there is none; did you mean {' or '.join(homes)}?")
        for key in reversed(keys):
            value = {key: value}
        walk.read("", Scenario, {top: value}, scenario)
    check(resolved(scenario))
    return scenario


def read_mapping(path: Path, option: str, known: tuple[str, ...], remedy: str) -> dict[str, Any]:
    """The mapping in a YAML file, whose keys are among the known ones.

    `option` is what gave the path, and `remedy` what a file of this kind must hold.

    Raises:
        ScenarioError: the file cannot be read, or holds anything else; `description` is no text.
    """
    source = path.name
    content = parse_plain(read_text(path, option), source)
    require(isinstance(content, dict) and "_tag" not in content, source, content, remedy)
    for key in content:
        require(key in known, f"{source}.{key}", content[key], remedy)
    description = content.get("description", "")
    require(isinstance(description, str), f"{source}.description", description, "give a text")
    return content


def require_override(override: Any, where: str) -> None:
    """Raises ScenarioError for what is no "path=value"."""
    is_override = isinstance(override, str) and not override.startswith("=") and "=" in override
    remedy = "give path=value, such as phase=PaperPhase, in quotes where it has a colon"
    require(is_override, where, override, remedy)


def parse_override(override: str) -> tuple[str, Any]:
    """The path and the value of a change "path=value"; raises ScenarioError."""
    require_override(override, "--set")
    path, _, text = override.partition("=")
    require("_tag" not in path.split("."), "--set", path, "choose a block by its name, phase=X")
    require(text.strip(), f"--set {path}", "nothing", "give a value after the =")
    return path, parse_plain(text, f"--set {path}", path)


def require_choices(values: Any, where: str) -> None:
    """Raises ScenarioError for what is no list of different values."""
    require(isinstance(values, list) and values, where, values, "give a list of values in [ ]")
    for value in values:
        is_quoted = isinstance(value, str) and number_text(value)
        require(not is_quoted, where, f"'{value}'", "give the number without quotes")
    for text, count in Counter(dump_plain(value, where) for value in values).items():
        require(count == 1, where, text, "give each value once")


def as_override(path: str, value: Any) -> str:
    """The override that gives the path the value, which is as `parse_plain` makes it."""
    return f"{path}={dump_plain(value, path)}"


def _swapped(box: str, name: str, scenario: Scenario, walk: Walk) -> Tree:
    """The box's entry with another block, which keeps parameters that both blocks have."""
    present = getattr(scenario, box)
    remedy = "give it without quotes, or the name alone"
    require(not name.startswith("!"), box, f"'{name}'", remedy)
    new = config_of(box, f"!{name}", CHOICES[box], walk.trusted)
    keeps_defaults = box not in BOXES or BOXES[box].swap_keeps_defaults
    return kept_parameters(vars(present), type(present), new, keeps_defaults) | {"_tag": f"!{name}"}
