"""What the comments on a dataclass say of its fields: units and meanings."""

import ast
import contextlib
import dataclasses
import functools
import inspect
import io
import textwrap
import tokenize


def meanings(config: type) -> dict[str, str]:
    """The comments on the fields of a config class, by name: units and meanings."""
    found: dict[str, str] = {}
    for base in reversed(config.__mro__):
        if dataclasses.is_dataclass(base):
            with contextlib.suppress(OSError, TypeError):  # a class that no source file has
                found |= _field_comments(base)
    return found


def headings(config: type) -> dict[str, str]:
    """By name of a field: the comment that heads it and those below, apart by an empty line."""
    found: dict[str, str] = {}
    for base in reversed(config.__mro__):
        if dataclasses.is_dataclass(base):
            with contextlib.suppress(OSError, TypeError):
                found |= _field_comments(base, apart=True)
    return found


@functools.cache  # Python parses a whole module for the source of each class in it
def _field_comments(config: type, *, apart: bool = False) -> dict[str, str]:
    """By the name of each field that a class body itself has: the comments on its lines.

    They are followed by those in lines of their own right above it; or there are only those which
    stand `apart`, above an empty line, of the fields that have them.
    """
    source = textwrap.dedent(inspect.getsource(config))
    lines = source.splitlines()
    comments = {
        token.start[0]: token.string.removeprefix("#").strip()
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }
    (definition,) = ast.parse(source).body
    assert isinstance(definition, ast.ClassDef)
    result = {}
    for statement in definition.body:
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
            above: list[int] = []
            line = statement.lineno - 1
            if apart and lines[line - 1].strip():
                continue
            line -= apart
            while line in comments and lines[line - 1].lstrip().startswith("#"):
                above.insert(0, line)
                line -= 1
            if apart:
                if above:
                    result[statement.target.id] = " ".join(comments[line] for line in above)
                continue
            within = range(statement.lineno, (statement.end_lineno or statement.lineno) + 1)
            found = [
                " ".join(comments[line] for line in group if line in comments)
                for group in (within, above)
            ]
            result[statement.target.id] = "; ".join(text for text in found if text)
    return result
