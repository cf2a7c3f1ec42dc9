"""Faults of one line: chosen ones, of faults.yaml, and others that operators of cosmic-ray draw."""

import random
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator

ROOT = Path(__file__).parents[2]
CHOSEN = Path(__file__).parent / "faults.yaml"
EXPLAINED = Path(__file__).parent / "explained.yaml"
DRAWN_OF = ("mechanics", "planning", "blocks", "loop", "systems", "run")
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


class Fault(NamedTuple):
    """A line of a file, and what it becomes; both without leading blanks."""

    file: str  # from the checkout's root
    number: int  # of the line, from 1 on
    line: str
    becomes: str
    is_drawn: bool = False

    @property
    def key(self) -> tuple[str, str, str]:
        """The fault, wherever in its file it is."""
        return self.file, self.line, self.becomes

    def made_in(self, text: str) -> str:
        """The file's text with the fault."""
        lines, k = text.split("\n"), self.number - 1
        lines[k] = lines[k].replace(self.line, self.becomes)
        return "\n".join(lines)


def chosen_faults() -> tuple[list[Fault], list[str]]:
    """The faults of the file, and what is not found exactly once in its file any more."""
    found, gone = [], []
    for file, faults in yaml.safe_load(CHOSEN.read_text(encoding="utf-8")).items():
        text = (ROOT / file).read_text(encoding="utf-8") if (ROOT / file).exists() else ""
        lines = [line.strip() for line in text.split("\n")]
        for line, becomes in faults.items():
            if lines.count(line) == 1:
                found.append(Fault(file, lines.index(line) + 1, line, becomes))
            else:
                gone.append(f"{file}: {line!r} is there {lines.count(line)} times, not once")
    return found, gone


def explanations() -> dict[tuple[str, str, str], str]:
    """Why faults survive, by their `key`: what they change cannot be seen, or is not promised."""
    return {
        (file, line, becomes): why
        for file, lines in yaml.safe_load(EXPLAINED.read_text(encoding="utf-8")).items()
        for line, faults in lines.items()
        for becomes, why in faults.items()
    }


def drawn_faults(seed: int, count: int) -> list[Fault]:
    """So many faults, each at another line; a place in the code is as likely as any other.

    Whether a place is drawn depends on its file's name and its line: others may change.
    """
    places = []
    for room in DRAWN_OF:
        for path in sorted((ROOT / "drake_nonstop" / room).glob("*.py")):
            text = path.read_text(encoding="utf-8")
            lines, file = text.split("\n"), path.relative_to(ROOT).as_posix()
            for (number, column), operators in _places(text):
                line = lines[number - 1]
                draw = random.Random(f"{seed} {file} {line.strip()} {column - len(line)}")
                places.append((draw.random(), file, draw.choice(operators)))
    found: dict[tuple[str, int], Fault] = {}
    for _, file, change in sorted(places):
        if len(found) == count:
            break
        fault = _made(ROOT / file, *change)
        if fault is not None:
            found.setdefault((fault.file, fault.number), fault)
    return [*found.values()]


def _places(text: str) -> Iterator[tuple[tuple[int, int], list[tuple[str, int]]]]:
    """Each place that may be changed: the operators, and its number among those of each."""
    nodes, places = [*ast_nodes(get_ast(text))], defaultdict(list)
    for name in _OPERATORS:
        operator = get_operator(f"core/{name}")()
        found = [(node, place) for node in nodes for place in operator.mutation_positions(node)]
        for number, (node, (begin, _)) in enumerate(found):
            if _is_code(node):
                places[begin].append((name, number))
    yield from places.items()


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


def _made(path: Path, operator: str, number: int) -> Fault | None:
    """The fault; None: it is none of a single line, or does not compile."""
    text = path.read_text(encoding="utf-8")
    changed = mutate_code(text, get_operator(f"core/{operator}")(), number) or text
    pairs = enumerate(zip(text.split("\n"), changed.split("\n"), strict=False), start=1)
    different = [(k, old.strip(), new.strip()) for k, (old, new) in pairs if old != new]
    if len(different) != 1:
        return None
    try:
        compile(changed, path.name, "exec")
    except SyntaxError:
        return None
    return Fault(path.relative_to(ROOT).as_posix(), *different[0], is_drawn=True)
