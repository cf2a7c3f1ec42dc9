"""What a block's docstring says of its ports and parameters: all of it from its declarations."""

import functools
import inspect
import re
import sys
from collections.abc import Iterable
from typing import Any, TypeVar, cast

from drake_nonstop.mechanics.signal_layouts import HELD, SIGNALS
from drake_nonstop.systems.field_comments import meanings
from drake_nonstop.validation import ScenarioError

_Kind = TypeVar("_Kind", bound=type)


def config_class(block: type) -> Any:
    """The dataclass of a block's parameters, XConfig in the module of X; None: it has none."""
    return getattr(sys.modules.get(block.__module__), f"{block.__name__}Config", None)


def own_config_class(block: type) -> Any:
    """Likewise; of a class without one, that of the nearest class above it."""
    found = next(filter(None, map(config_class, block.__mro__)), None)
    name, where = f"{block.__name__}Config", block.__module__
    remedy = f"without a config: give {where} a dataclass {name}"
    if found is None:
        raise ScenarioError(f"{block.__name__} = {remedy}")
    return found


def documented(block: _Kind) -> _Kind:
    """A block's class, whose docstring goes on with what it reads and makes, and its parameters.

    It is told by the class's attributes `reads` and `makes`, names of signals, `where`, which says
    of some of them when there is such a port, and the dataclass of its parameters.
    """
    text, kind = vars(block).get("__doc__"), cast(Any, block)
    if text is None and _declared_names(kind):
        text = ""  # not the docstring of the class above, which has other ports
    if isinstance(text, str):
        block.__doc__ = _Docstring(text)  # type: ignore[assignment]
    return block


def _declared_names(kind: Any) -> list[str]:
    return [*getattr(kind, "reads", ()), *getattr(kind, "makes", ())]


class _Docstring:
    """A docstring that is put together when it is asked for."""

    def __init__(self, text: str):
        self._text = text

    def __get__(self, block: Any, kind: type) -> str:
        return _docstring(kind, self._text)


@functools.cache
def _docstring(kind: type, text: str) -> str:
    """With the generated part in front of the sections."""
    said, declared = inspect.cleandoc(text), _declared(kind)
    if not declared:
        return said
    section = re.search(r"^(Args|Attributes|Raises):$", said, re.MULTILINE)
    head, tail = (said[: section.start()], said[section.start() :]) if section else (said, "")
    return f"{head.rstrip()}\n\n{declared}\n\n{tail}".strip()


def _declared(kind: Any) -> str:
    """Drake's directive, and lists of the ports and the parameters."""
    if not _declared_names(kind):
        return ""
    reads, makes = getattr(kind, "reads", ()), getattr(kind, "makes", ())
    parts = [_directive(kind, reads, makes)]
    parts += [_list(f"{word}:", _ports(kind, names)) for word, names in _words(reads, makes)]
    config = config_class(kind)
    if config and (fields := meanings(config)):
        head = f"Parameters, the fields of `{config.__name__}`:"
        parts.append(_list(head, (f"`{name}`: {said}" for name, said in fields.items())))
    return "\n\n".join(parts)


def _words(reads: Iterable[str], makes: Iterable[str]) -> list[tuple[str, Iterable[str]]]:
    return [pair for pair in (("Reads", reads), ("Makes", makes)) if pair[1]]


def _directive(kind: Any, reads: Iterable[str], makes: Iterable[str]) -> str:
    lines = [".. pydrake_system::", "", f"    name: {kind.__name__}"]
    for word, names in (("input", reads), ("output", makes)):
        if names:
            lines += [f"    {word}_ports:", *(f"    - {_where(kind, name)}" for name in names)]
    return "\n".join(lines)


def _where(kind: Any, name: str) -> str:
    where = getattr(kind, "where", {}).get(name, "")
    return f"{name} (where {where})" if where else name


def _ports(kind: Any, names: Iterable[str]) -> Iterable[str]:
    layouts = SIGNALS | getattr(kind, "signal_layouts", {})
    for name in names:
        layout = layouts.get(name.removeprefix(HELD))
        size, about = ("abstract", "") if layout is None else (layout.size, str(layout))
        said = f": {about}" if about else ""
        when = [f"where {where}"] if (where := getattr(kind, "where", {}).get(name)) else []
        when += ["may be left unconnected"] if name in getattr(kind, "optional_inputs", ()) else []
        yield f"`{name}` ({', '.join([size, *when])}){said}"


def _list(head: str, items: Iterable[str]) -> str:
    return "\n".join([head, "", *(f"- {item}" for item in items)])
