"""Changes of a scenario by the runs of a study: fields by overrides, blocks by their makers."""

import functools
import hashlib
import itertools
import pickle
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from drake_nonstop.diagrams.nonstop import BOXES, make_nonstop, replaced
from drake_nonstop.loop.assembly import EXTRA
from drake_nonstop.run.preparation import LoopMaker
from drake_nonstop.scenario.overrides import changed, require_override
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.validation import require

# An override "path=value", or what to put in the places of boxes, as `make_nonstop` takes it.
Change = str | Mapping[str, Any]


def checked_changes(changes: Any, where: str) -> list[Change]:
    """The changes, a list or a single mapping, as a list; errors call them `where`.

    Raises:
        ScenarioError: they are anything else, name no box, or cannot be sent to a process.
    """
    changes = [changes] if isinstance(changes, Mapping) else changes
    remedy = 'give a list of path=value, and of replacements such as {"phase": PaperPhase}'
    is_list = isinstance(changes, Sequence) and not isinstance(changes, str)
    require(is_list, where, changes, remedy)
    for change in changes:
        if not isinstance(change, Mapping):
            require_override(change, where)
            continue
        for box, entry in change.items():
            require(box in BOXES or box == EXTRA, where, box, f"give one of {', '.join(BOXES)}")
            require_sendable(entry, f"{where}, {box}")
    return [*changes]


def require_sendable(entry: Any, where: str) -> None:
    """Raises ScenarioError for what processes cannot be sent."""
    remedy = (
        "processes cannot import it; give a class, a config or a function of those at the top "
        "level of a module"
    )
    try:
        data = pickle.dumps(entry)
    except Exception:  # whatever a user's object may raise
        require(False, where, label(entry), remedy)
    is_in_file = hasattr(sys.modules["__main__"], "__file__") or b"__main__" not in data
    require(is_in_file, where, label(entry), "processes cannot import it; save it in a .py file")


def varied(
    scenario: Scenario, changes: Iterable[Change], *, trust: bool
) -> tuple[Scenario, dict[str, Any]]:
    """The scenario with changes, one after the other, and the replacements that are no configs."""
    others: dict[str, Any] = {}
    paths = []
    for is_override, group in itertools.groupby(changes, lambda change: isinstance(change, str)):
        if is_override:
            overrides = [change for change in group if isinstance(change, str)]
            scenario = changed(scenario, overrides, trust=trust)
            paths += [override.partition("=")[0] for override in overrides]
            continue
        for change in group:
            assert not isinstance(change, str)
            scenario, more = replaced(scenario, change)
            others = {name: entry for name, entry in others.items() if name not in change} | more
    for path in paths:
        box = path.split(".")[0]
        remedy = f"leave it out: {box} is made by {label(others.get(box))}, which takes no fields"
        require(box not in others, "override", path, remedy)
    return scenario, others


def is_block(path: str, value: Any) -> bool:
    """Whether a value of a path is what makes a block, and not what YAML may hold."""
    is_plain = value is None or isinstance(value, (str, bool, int, float, list, dict))
    return path in BOXES and not is_plain


def label(entry: Any) -> str:
    """Name of a block's maker in tables: a class's or function's import path."""
    if isinstance(entry, functools.partial):
        given = [
            *map(repr, entry.args),
            *(f"{key}={value!r}" for key, value in entry.keywords.items()),
        ]
        return f"{label(entry.func)}({', '.join(given)})"
    if isinstance(entry, Mapping):
        return "{" + ", ".join(f"{name}: {label(value)}" for name, value in entry.items()) + "}"
    if entry is None or not hasattr(entry, "__qualname__"):
        return str(entry)
    is_ours = entry.__module__.startswith(BOXES["phase"].variants[0].__module__.split(".")[0])
    return entry.__qualname__ if is_ours else f"{entry.__module__}.{entry.__qualname__}"


def labels(changes: Iterable[Change]) -> list[str]:
    """The changes as texts "path=value"."""
    found: list[str] = []
    for change in changes:
        if isinstance(change, str):
            found.append(change)
        else:
            found += [f"{box}={label(entry)}" for box, entry in change.items()]
    return found


def identity(changes: Iterable[Change], make_loop: LoopMaker = make_nonstop) -> str:
    """A text that differs where changes do; it names the modules of the user's own."""
    changes = [*changes]
    entries = [change for change in changes if not isinstance(change, str)]
    own = [*entries, make_loop] if make_loop is not make_nonstop else entries
    names = labels(changes) + ([label(make_loop)] if make_loop is not make_nonstop else [])
    return "\n".join([*names, *(hashlib.sha256(pickle.dumps(entry)).hexdigest() for entry in own)])
