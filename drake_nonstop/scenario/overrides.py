"""Changes "path=value" to a scenario: read from files, checked, combined, applied."""

import copy
import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.loop.box import kept_parameters
from drake_nonstop.scenario.schema import CHOICES, Scenario
from drake_nonstop.scenario.tree import (
    BASE,
    Tree,
    Trusted,
    config_class_of,
    from_tree,
    to_tree,
)
from drake_nonstop.scenario.yaml_text import dump_plain, parse_plain
from drake_nonstop.validation import (
    listed,
    number_text,
    read_text,
    require,
    require_known,
    require_type,
)

# Parts that are not in the tree where they are none.
_LEFT_OUT = ("system.aircraft", "simulated.aircraft", "reference_governor")


def changed(scenario: Scenario, overrides: Iterable[str], *, trust: bool = False) -> Scenario:
    """A copy of the scenario with changes "path=value", see `load_scenario`.

    Blocks of the user's own that the scenario has already are trusted.

    Raises:
        ScenarioError: a path or value cannot be used.
    """
    require_type("trust", trust, bool)
    remedy = 'give a list of texts, such as ["simulation_duration=5"]'
    texts = listed("overrides", overrides, remedy)
    tree = to_tree(scenario)
    before = copy.deepcopy(tree)
    entries = [entry for entry in tree.values() if isinstance(entry, dict)]
    trusted = True if trust else {entry["_tag"] for entry in entries if "_tag" in entry}
    for override in texts:
        _apply(tree, override, trusted)
    # By their texts, since True equals 1.
    parts = {name: part for name, part in tree.items() if repr(part) != repr(before.get(name))}
    return from_tree(scenario.name, parts, trusted, scenario)


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


def combinations(grid: Mapping[str, list[Any]]) -> Iterator[dict[str, Any]]:
    """Every combination of the values of the paths, the last path's changing first."""
    for values in itertools.product(*grid.values()):
        yield dict(zip(grid, values, strict=True))


def as_override(path: str, value: Any) -> str:
    """The override that gives the path the value, which is as `parse_plain` makes it."""
    return f"{path}={dump_plain(value, path)}"


def _apply(tree: Tree, override: str, trusted: Trusted) -> None:
    """Changes the resolved tree by one "path=value"."""
    path, value = parse_override(override)
    *parents, last = path.split(".")
    require(path != BASE, "--set", override, "run that scenario itself, or name it in a file")
    require("_tag" not in path.split("."), "--set", path, "choose a block by its name, phase=X")
    if not parents and path not in tree:
        homes = [
            f"{part}.{path}" for part, of in tree.items() if isinstance(of, dict) and path in of
        ]
        require(not homes, "--set", path, f"there is none; did you mean {' or '.join(homes)}?")
    branch: Any = tree
    for i, key in enumerate(parents):
        parts = [part for part in branch if part != "_tag"]
        at = ".".join(parents[: i + 1])
        if at in _LEFT_OUT:
            branch.setdefault(key, {})
            parts.append(key)
        require_known(key, parts, "--set", path, called=at)
        require(isinstance(branch[key], dict), "--set", path, f"{at} has no parts; set it whole")
        branch = branch[key]
    if path in CHOICES and isinstance(value, str):
        name = value.removeprefix("!").partition("{")[0].strip()
        remedy = f"give it without quotes, or the name alone: {name}"
        require(not value.startswith("!"), path, f"'{value}'", remedy)
        # Parameters that both blocks have stay as they were.
        old, new = (config_class_of(path, t, trusted) for t in (tree[path]["_tag"], f"!{value}"))
        keeps_defaults = path not in BOXES or BOXES[path].swap_keeps_defaults
        kept = kept_parameters(tree[path], old, new, keeps_defaults)
        value = {**kept, "_tag": f"!{value}"}
    branch[last] = value
