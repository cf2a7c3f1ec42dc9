"""Every notebook of the documentation runs from its first cell to the last."""

import ast
import json
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
# What packages are called where they are installed: of modules, and of what public names import.
PACKAGES = {
    "IPython": "ipykernel",
    "griffe": "mkdocstrings",
    "pydrake": "drake",
    "yaml": "pyyaml",
    **dict.fromkeys(["make_gym_env", "make_gym_vec_env"], "gymnasium"),
}


def cells_of(path):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


def code_of(path):
    """Its code without lines for IPython alone, such as %matplotlib."""
    if path.suffix == ".py":
        return path.read_text(encoding="utf-8")
    return re.sub(r"(?m)^[%!].*", "", "\n".join("".join(c["source"]) for c in cells_of(path)))


def test_notebooks_have_code_and_no_outputs():
    assert len(NOTEBOOKS) == 5
    for path in NOTEBOOKS:
        compile(code_of(path), path.name, "exec")
        cells = cells_of(path)
        assert cells
        assert not any(c["outputs"] or c["execution_count"] for c in cells), "commit it without"


def needed_by(path):
    """The packages that a notebook or a script imports, but for Python's own and this one."""
    for node in ast.walk(ast.parse(code_of(path))):
        names = [alias.name for alias in getattr(node, "names", [])]
        if isinstance(node, ast.ImportFrom):
            names = [node.module, *(name for name in names if name in PACKAGES)]
        elif not isinstance(node, ast.Import):
            continue
        roots = {name.partition(".")[0] for name in names}
        yield from (PACKAGES.get(r, r) for r in roots - sys.stdlib_module_names - {"drake_nonstop"})


def test_the_extra_of_the_documentation_has_what_its_code_imports():
    """A clean environment has nothing else; that of the tests has all."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    lists = dict(re.findall(r"(?m)^(\w+) = \[(.*)\]", text))
    (others,) = re.findall(r"drake-nonstop\[([\w,]+)\]", lists["docs"])
    required = "".join(lists[name] for name in ("dependencies", "docs", *others.split(",")))
    named = {re.match(r"[\w-]+", each)[0] for each in re.findall(r'"(.*?)"', required)}
    scripts = sorted((ROOT / "docs").glob("*.py"))
    assert scripts
    for path in (*NOTEBOOKS, *scripts):
        assert {*needed_by(path)} <= named, path.name


@pytest.mark.nightly("examples")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, tmp_path):
    nbclient, nbformat = map(pytest.importorskip, ("nbclient", "nbformat"))
    notebook = nbformat.read(path, as_version=4)
    place = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=170, resources=place).execute()
    assert any(cell.get("outputs") for cell in notebook.cells)
