"""Settings "path=value" in files of the user's: read, checked and combined."""

import itertools
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from drake_nonstop.scenario.loading import dump_plain, parse_plain
from drake_nonstop.validation import ScenarioError, require


def read_mapping(path: Path, option: str, known: tuple[str, ...], remedy: str) -> dict[str, Any]:
    """The mapping in a YAML file, whose keys are among the known ones.

    `option` is what gave the path, and `remedy` what a file of this kind must hold.

    Raises:
        ScenarioError: the file cannot be read, or holds anything else; `description` is no text.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{option} = {path}: give a file that can be read ({error})") from None
    source = path.name
    content = parse_plain(text, source)
    require(isinstance(content, dict), source, content, remedy)
    for key in content:
        require(key in known, f"{source}.{key}", content[key], remedy)
    description = content.get("description", "")
    require(isinstance(description, str), f"{source}.description", description, "give a text")
    return content


def require_setting(setting: Any, where: str) -> None:
    """Raises ScenarioError for what is no "path=value"."""
    is_setting = isinstance(setting, str) and not setting.startswith("=") and "=" in setting
    remedy = "give path=value, such as phase=PaperPhase, in quotes where it has a colon"
    require(is_setting, where, setting, remedy)


def require_choices(values: Any, where: str) -> None:
    """Raises ScenarioError for what is no list of different values."""
    require(isinstance(values, list) and values, where, values, "give a list of values in [ ]")
    for text, count in Counter(dump_plain(value) for value in values).items():
        require(count == 1, where, text, "give each value once")


def combinations(grid: Mapping[str, list[Any]]) -> Iterator[dict[str, Any]]:
    """Every combination of the values of the paths, the last path's changing first."""
    for values in itertools.product(*grid.values()):
        yield dict(zip(grid, values, strict=True))


def as_setting(path: str, value: Any) -> str:
    """The setting that gives the path the value, which is as `parse_plain` makes it."""
    return f"{path}={dump_plain(value)}"
