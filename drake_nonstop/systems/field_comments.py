"""What the comments on a dataclass say of its fields: units and meanings."""

import ast
import contextlib
import dataclasses
import functools
import inspect
import io
import textwrap
import tokenize
from typing import NamedTuple


class FieldComments(NamedTuple):
    """What is said of a field: its meaning, and the comment that heads it and those below."""

    meaning: str
    heading: str


def meanings(config: type) -> dict[str, str]:
    """The comments on the fields of a config class, by name: units and meanings."""
    return {name: found.meaning for name, found in field_comments(config).items()}


def field_comments(config: type) -> dict[str, FieldComments]:
    """The comments on the fields of a config class, by name."""
    found: dict[str, FieldComments] = {}
    for base in reversed(config.__mro__):
        if dataclasses.is_dataclass(base):
            with contextlib.suppress(OSError, TypeError):  # a class that no source file has
                found |= _own_comments(base)
    return found


@functools.cache  # Python parses a whole module for the source of each class in it
def _own_comments(config: type) -> dict[str, FieldComments]:
    """Those of the fields that a class body itself has.

    A meaning is the comments on the field's lines, then those in lines of their own right above it;
    a heading those above an empty line.
    """
    source = textwrap.dedent(inspect.getsource(config))
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
            is_apart = not lines[start - 2].strip()
            heading, own = (above(start - 2), "") if is_apart else ("", above(start - 1))
            meaning = "; ".join(filter(None, (within, own)))
            result[statement.target.id] = FieldComments(meaning, heading)
    return result
