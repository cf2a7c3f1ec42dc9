"""What type checkers know of the package: public names, and the fields of scenarios."""

import ast
import dataclasses
import importlib
import importlib.metadata
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import drake_nonstop
from drake_nonstop.diagrams.nonstop import BOXES, BoxFields

ROOT = Path(__file__).parents[1]


def test_the_public_names_have_every_block_and_its_config():
    for name, box in BOXES.items():
        for part in (*box.variants, *box.configs):
            public = getattr(drake_nonstop.public, part.__name__, None)
            assert public is part, f"write {part.__name__} into __all__ of blocks/{name}.py"
    assert len(set(drake_nonstop.__all__)) == len(drake_nonstop.__all__)


def test_every_public_name_is_written_out():
    """As an import by its own name, or in the `__all__` of a module of which all is imported."""
    tree = ast.parse(Path(drake_nonstop.public.__file__).read_text(encoding="utf-8"))
    written = {"__version__"}
    for node in tree.body:
        for alias in node.names if isinstance(node, ast.ImportFrom) else ():
            if alias.name == "*":
                written |= {*importlib.import_module(node.module).__all__}
            elif alias.asname == alias.name:
                written.add(alias.name)
    assert {*drake_nonstop.__all__} == written


def test_the_boxes_that_type_checkers_see_are_all():
    fields = [field.name for field in dataclasses.fields(BoxFields)]
    assert fields == [*BOXES], "write the box into BoxFields of diagrams/nonstop.py"


REVEALED = {
    'load_scenario("quintic").system': "SystemParameters",
    "ConstantParameters": "ConstantParameters",
    "ConstantParametersConfig().frequency": "float",
    "make_nonstop": "LoopConfig",
}


@pytest.mark.nightly("examples")
def test_types_of_the_readme(tmp_path):
    """By mypy as a user calls it, of the installed package where that is this one."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    parts = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    parts.append(
        "from drake_nonstop import (\n"
        "    ConstantParameters, ConstantParametersConfig, load_scenario, make_nonstop\n)\n"
        + "".join(f"reveal_type({expression})\n" for expression in REVEALED)
    )
    assert len(parts) == 3
    files = [tmp_path / f"part_{k}.py" for k in range(len(parts))]
    for file, part in zip(files, parts, strict=True):
        file.write_text(part, encoding="utf-8")
    place = importlib.metadata.distribution("drake-nonstop").read_text("direct_url.json") or "{}"
    is_own = json.loads(place).get("url") == ROOT.as_uri()
    result = subprocess.run(
        [sys.executable, "-m", "mypy", "--cache-dir", tmp_path / "cache", *files],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "MYPYPATH": "" if is_own else str(ROOT)},
    )
    assert result.returncode == 0, result.stdout + result.stderr
    for shown, expected in zip(result.stdout.splitlines(), REVEALED.values(), strict=False):
        assert expected in shown
        assert 'is "Any"' not in shown
