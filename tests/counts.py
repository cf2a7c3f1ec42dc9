"""Lines of each room, and private names that tests import: `python tests/counts.py`.

A name is public where the reference has it (`import drake_nonstop`, the equations, blocks and what
else scenarios can name, with their parameters), where a page, an example or a notebook imports it,
and that of the command itself. Tests of `mechanics` and `systems` import what they like. The
command ends with 1 where a limit is missed; `--names` lists the private names.
"""

import ast
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]

import drake_nonstop  # noqa: E402
from drake_nonstop.diagrams.nonstop import BOXES  # noqa: E402
from drake_nonstop.scenario.choices import CHOICES  # noqa: E402

TESTS, PACKAGE = ROOT / "tests", ROOT / "drake_nonstop"
OPEN = ("mechanics", "systems")  # rooms whose tests may import private names
LIMITS = {
    "lines of tests": 20_000,
    "lines of tests per line of the package": 0.6,
    "private names that tests import": 60,
}


def room_of(path: Path, folder: Path) -> str:
    """The room of a file of that folder; "root" for one in none."""
    parts = path.relative_to(folder).parts
    return parts[0] if len(parts) > 1 else "root"


def lines_of_rooms(folder: Path) -> dict[str, int]:
    """Lines of Python and C of each room of a folder, without what is linked from elsewhere."""
    found: dict[str, int] = {}
    for path in sorted(folder.resolve().rglob("*")):
        if path.suffix in (".py", ".c") and "__pycache__" not in path.parts:
            lines = path.read_text(encoding="utf-8").count("\n")
            found[room_of(path, folder)] = found.get(room_of(path, folder), 0) + lines
    return found


def imported(code: str) -> Iterator[tuple[str, str]]:
    """The modules and names of the package that a piece of code imports."""
    for node in ast.walk(ast.parse(code)):
        module = getattr(node, "module", None) or ""
        if isinstance(node, ast.ImportFrom) and module.split(".")[0] == "drake_nonstop":
            yield from ((module, alias.name) for alias in node.names)


def public_names() -> set[str]:
    """The names that the reference has, and those that pages, examples and notebooks import."""
    names = {*drake_nonstop.__all__, "main"}
    names |= {block.__name__ for box in BOXES.values() for block in box.variants}
    names |= {config.__name__ for configs in CHOICES.values() for config in configs}
    codes = [path.read_text(encoding="utf-8") for path in (ROOT / "examples").rglob("*.py")]
    for page in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")):
        codes += re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    for path in (ROOT / "docs").rglob("*.ipynb"):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        found = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
        codes += [re.sub(r"(?m)^[%!].*", "", text) for text in found]
    return names | {name for code in codes for _, name in imported(code)}


def private_names() -> dict[str, set[str]]:
    """The private names that the tests of each room import."""
    public, found = public_names(), dict[str, set[str]]()
    for path in sorted(TESTS.rglob("*.py")):
        room = room_of(path, TESTS)
        for module, name in imported(path.read_text(encoding="utf-8")) if room not in OPEN else ():
            if name not in public and not module.startswith("drake_nonstop.mechanics."):
                found.setdefault(room, set()).add(f"{module.removeprefix('drake_nonstop.')}.{name}")
    return found


def main() -> int:
    """Prints the table; 1 where a limit is missed."""
    package = lines_of_rooms(PACKAGE) | {"diagrams": lines_of_rooms(ROOT / "diagrams")["root"]}
    tests, private = lines_of_rooms(TESTS), private_names()
    print(f"{'room':12}{'package':>9}{'tests':>9}{'private names':>15}")
    for room in sorted({*package, *tests}):
        row = package.get(room, 0), tests.get(room, 0), len(private.get(room, ()))
        print(f"{room:12}{row[0]:9}{row[1]:9}{row[2]:15}")
    if "--names" in sys.argv:
        print(*(f"\n{room}: {', '.join(sorted(names))}" for room, names in private.items()))
    lines = sum(package.values()), sum(tests.values())
    values = lines[1], lines[1] / lines[0], len(set().union(*private.values()))
    print(f"{'all':12}{lines[0]:9}{lines[1]:9}{values[2]:15}")
    rows = zip(LIMITS.items(), values, strict=True)
    missed = [f"{what} = {v:.4g}: keep to {limit}" for (what, limit), v in rows if v > limit]
    print("\n".join(missed))
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main())
