"""Comments on a config's fields, and docstrings of a block's ports and parameters."""

import ast
import dataclasses
import functools
import inspect
import io
import linecache
import re
import sys
import textwrap
import tokenize
from collections.abc import Iterable
from typing import Any, TypeVar, cast

from drake_nonstop.mechanics.signals import HELD, SIGNALS
from drake_nonstop.validation import ScenarioError

_Kind = TypeVar("_Kind", bound=type)


def declared_by(block: Any, name: str, default: Any = None) -> Any:
    """An attribute of a block, or of its class; the default for one that does not declare it.

    A user's own block may be any System of Drake's.
    """
    return getattr(block, name, default)


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
    return [*kind.reads, *kind.makes]


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
    lines, lists = [".. pydrake_system::", "", f"    name: {kind.__name__}"], []
    for word, head, attribute in (("input", "Reads", "reads"), ("output", "Makes", "makes")):
        if names := getattr(kind, attribute):
            lines += [f"    {word}_ports:", *(f"    - {_where(kind, name)}" for name in names)]
            lists.append(_list(f"{head}:", (_port(kind, name) for name in names)))
    config = config_class(kind)
    if config and (fields := meanings(config)):
        head = f"Parameters, the fields of `{config.__name__}`:"
        lists.append(_list(head, (f"`{name}`: {said}" for name, said in fields.items())))
    return "\n\n".join(["\n".join(lines), *lists])


def _where(kind: Any, name: str) -> str:
    where = kind.where.get(name)
    return f"{name} (where {where})" if where else name


def _port(kind: Any, name: str) -> str:
    layout = (SIGNALS | kind.signal_layouts).get(name.removeprefix(HELD))
    size, about = ("abstract", "") if layout is None else (layout.size, str(layout))
    said = f": {about}" if about else ""
    when = [f"where {where}"] if (where := kind.where.get(name)) else []
    when += ["may be left unconnected"] if name in kind.optional_inputs else []
    return f"`{name}` ({', '.join([size, *when])}){said}"


def _list(head: str, items: Iterable[str]) -> str:
    return "\n".join([head, "", *(f"- {item}" for item in items)])


def meanings(config: type) -> dict[str, str]:
    """The comments on the fields of a config class, by name: units and meanings."""
    found: dict[str, str] = {}
    for base in reversed(config.__mro__):
        if dataclasses.is_dataclass(base):
            found |= _own_comments(base)
    return found


def _source_of(config: type) -> str:
    """The source of a class; `inspect` parses the whole module for each class in it."""
    file = getattr(sys.modules.get(config.__module__), "__file__", None)
    body = rf"^class {config.__qualname__}\b[^:]*:.*\n(?:(?:[ \t].*)?\n)+"
    found = re.findall(body, "".join(linecache.getlines(file)), re.MULTILINE) if file else []
    return found[0] if len(found) == 1 else textwrap.dedent(inspect.getsource(config))


@functools.cache
def _own_comments(config: type) -> dict[str, str]:
    """Comments on the fields that a class body itself has.

    They are those on the field's lines, then those in lines of their own right above it.
    """
    try:
        source = _source_of(config)
    except (OSError, TypeError):  # a class that no source file has
        return {}
    lines = source.splitlines()
    comments = {
        token.start[0]: token.string.removeprefix("#").strip()
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }

    def above(line: int) -> str:
        first = line
        while first in comments and lines[first - 1].lstrip().startswith("#"):
            first -= 1
        return " ".join(comments[k] for k in range(first + 1, line + 1))

    (definition,) = ast.parse(source).body
    assert isinstance(definition, ast.ClassDef)
    result = {}
    for statement in definition.body:
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
            start, end = statement.lineno, statement.end_lineno or statement.lineno
            within = " ".join(comments[k] for k in range(start, end + 1) if k in comments)
            result[statement.target.id] = "; ".join(filter(None, (within, above(start - 1))))
    return result
