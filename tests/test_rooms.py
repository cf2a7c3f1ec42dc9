"""What the rooms of the package know of each other's classes."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import drake_nonstop

PACKAGE = Path(drake_nonstop.__file__).parent


def names_in(*nodes: ast.AST) -> set[str]:
    return {each.id for node in nodes for each in ast.walk(node) if isinstance(each, ast.Name)}


def classes_asked_for(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Lines with `isinstance`, `type(...) is` and the like, and what they name of the package."""
    imported = {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("drake_nonstop")
        for alias in node.names
    }
    for node in ast.walk(tree):
        asked: set[str] = set()
        if isinstance(node, ast.Call) and names_in(node.func) & {"isinstance", "issubclass"}:
            asked = names_in(*node.args[1:])
        elif isinstance(node, ast.Compare) and "type" in names_in(node.left):
            asked = names_in(*node.comparators)
        elif isinstance(node, ast.MatchClass):
            asked = names_in(node.cls)
        yield from ((node.lineno, name) for name in asked & imported)


@pytest.mark.parametrize("room", ["analysis", "loop", "planning"])
def test_no_class_of_the_package_is_asked_for_outside_its_module(room):
    """What is asked of blocks, configs and limits is declared by their classes."""
    modules = sorted((PACKAGE / room).glob("*.py"))
    assert modules
    found = [
        f"{room}/{path.name}:{line} {name}"
        for path in modules
        for line, name in classes_asked_for(ast.parse(path.read_text(encoding="utf-8")))
    ]
    assert found == []


def test_each_way_to_ask_for_a_class_is_found():
    asks = "from drake_nonstop.blocks import wind\nfrom drake_nonstop.model.system import Model\n"
    asks += "isinstance(a, (int, wind.StillAir))\ntype(a) is Model\n"
    asks += "match a:\n    case Model(): pass\nisinstance(a, int)\nwind.VARIANTS == a"
    assert [line for line, _ in classes_asked_for(ast.parse(asks))] == [3, 4, 6]
