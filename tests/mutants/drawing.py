"""Draws faults at random, by operators of cosmic-ray (PyPI), and appends them to the file.

What is drawn has to be read: a change may be none that a user could observe.
"""

import ast
import random
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mutants.faults import DRAWN, ROOT, Fault, FaultError, as_yaml, read_faults

_LEFT_OUT = {"cli", "view"}
_BINARY = "Add_Sub Sub_Add Mul_Div Div_Mul Pow_Mul FloorDiv_Div BitOr_BitAnd BitAnd_BitOr"
_COMPARISON = "Lt_LtE Lt_Gt LtE_Lt LtE_Gt Gt_GtE Gt_Lt GtE_Gt GtE_Lt Eq_NotEq NotEq_Eq Is_IsNot"
_OTHERS = "TrueWithFalse FalseWithTrue AndWithOr OrWithAnd BreakWithContinue"
# Those whose changes are plausible mistakes in numerical code.
_OPERATORS = [
    *(f"ReplaceBinaryOperator_{name}" for name in _BINARY.split()),
    *(f"ReplaceComparisonOperator_{name}" for name in _COMPARISON.split()),
    *(f"ReplaceUnaryOperator_Delete_{name}" for name in ("USub", "Not")),
    *(f"Replace{name}" for name in _OTHERS.split()),
    "NumberReplacer",
]


def append(path: Path, seed: int, count: int) -> int:
    """Appends so many faults to a file of faults; returns an exit code."""
    try:
        import cosmic_ray.plugins  # noqa: F401
    except ImportError:
        print("cosmic-ray is not installed: pip install cosmic-ray", file=sys.stderr)
        return 2
    known = {(fault.file, fault.line) for fault in read_faults(path)}
    drawn: list[Fault] = []
    for fault in _drawn(random.Random(seed)):
        if len(drawn) == count:
            break
        if (fault.file, fault.line) not in known:
            known.add((fault.file, fault.line))
            drawn.append(fault)
    with path.open("a", encoding="utf-8") as file:
        file.write(f"\n# Drawn with the seed {seed}\n" + "".join(map(as_yaml, drawn)))
    return 0


def _drawn(draw: random.Random) -> Iterator[Fault]:
    """Faults without end; a file is as likely as it has statements, a place as others in it."""
    found = [p for part in ("drake_nonstop", "diagrams") for p in (ROOT / part).rglob("*.py")]
    names = sorted(path.relative_to(ROOT) for path in found)
    texts = {n: (ROOT / n).read_text(encoding="utf-8") for n in names if not _LEFT_OUT & {*n.parts}}
    sizes = [sum(isinstance(n, ast.stmt) for n in ast.walk(ast.parse(t))) for t in texts.values()]
    while True:
        ((name, text),) = draw.choices([*texts.items()], sizes)
        places = _places(text)
        fault = _made(name.as_posix(), text, *draw.choice(draw.choice(places))) if places else None
        if fault is not None:
            yield fault


def _places(text: str) -> list[list[tuple[str, int]]]:
    """For each place that may be changed the operators, and its number among those of each."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.plugins import get_operator

    nodes, places = [*ast_nodes(get_ast(text))], defaultdict(list)
    for name in _OPERATORS:
        operator = get_operator(f"core/{name}")()
        found = [(node, place) for node in nodes for place in operator.mutation_positions(node)]
        for number, (node, (begin, _)) in enumerate(found):
            if _is_code(node):
                places[begin].append((name, number))
    return [places[begin] for begin in sorted(places)]


def _is_code(node: Any) -> bool:
    """Whether a node of parso is in a function's body, and no type, message or decorator."""
    is_inside = False
    while (parent := node.parent) is not None:
        is_type = parent.type == "annassign" and parent.children[1] is node
        if is_type or parent.type in ("decorator", "fstring", "raise_stmt"):
            return False
        if parent.type == "funcdef":
            is_inside = True
            if node is not parent.children[-1] or parent.name.value == "__repr__":
                return False
        node = parent
    return is_inside


def _made(file: str, text: str, operator: str, number: int) -> Fault | None:
    """The fault; None: it is none of a single line that is found once, or does not compile."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    changed = mutate_code(text, get_operator(f"core/{operator}")(), number) or text
    pairs = zip(text.split("\n"), changed.split("\n"), strict=False)
    different = [[line.lstrip(" ") for line in pair] for pair in pairs if pair[0] != pair[1]]
    if len(different) != 1:
        return None
    kind = operator.removeprefix("Replace").replace("Operator", "")
    fault = Fault(file, *different[0], kind, DRAWN)
    try:
        compile(fault.made_in(text), file, "exec")
    except (FaultError, SyntaxError):
        return None
    return fault
