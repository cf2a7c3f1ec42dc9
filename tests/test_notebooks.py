"""Every notebook of the documentation runs from its first cell to the last."""

import ast
import json
import re
import sys
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "docs" / "notebooks").glob("*.ipynb"))


def test_there_are_notebooks():
    assert len(NOTEBOOKS) == 5


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_has_code_and_no_outputs(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert cells
    for cell in cells:
        assert not cell["outputs"], "commit it without outputs"
        assert cell["execution_count"] is None
        # Lines for IPython alone, such as %matplotlib, are no Python.
        lines = "".join(cell["source"]).splitlines()
        code = [line for line in lines if not line.startswith(("%", "!"))]
        compile("\n".join(code), path.name, "exec")


# What packages are called where they are installed: of modules, and of what public names import.
PACKAGES = {
    "IPython": "ipykernel",
    "griffe": "mkdocstrings",
    "make_gym_env": "gymnasium",
    "make_gym_vec_env": "gymnasium",
    "pydrake": "drake",
    "yaml": "pyyaml",
}


def code_of(path):
    if path.suffix == ".py":
        return path.read_text(encoding="utf-8")
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    lines = "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "code").splitlines()
    return "\n".join(line for line in lines if not line.startswith(("%", "!")))


def needed_by(path):
    """The packages that a notebook or a script imports, but for Python's own and this one."""
    for node in ast.walk(ast.parse(code_of(path))):
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            modules = [node.module, *(a.name for a in node.names if a.name in PACKAGES)]
        else:
            continue
        roots = {module.partition(".")[0] for module in modules}
        yield from (PACKAGES.get(r, r) for r in roots - sys.stdlib_module_names - {"drake_nonstop"})


def test_the_extra_of_the_documentation_has_what_its_code_imports():
    """A clean environment has nothing else; that of the tests has all."""
    text = (Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8")
    lists = dict(re.findall(r"(?m)^(\w+) = \[(.*)\]", text))
    (others,) = re.findall(r"drake-nonstop\[([\w,]+)\]", lists["docs"])
    required = [lists[name] for name in ("dependencies", "docs", *others.split(","))]
    named = {re.match(r"[\w-]+", r)[0] for text in required for r in re.findall(r'"(.*?)"', text)}
    scripts = sorted((Path(__file__).parents[1] / "docs").glob("*.py"))
    assert scripts
    for path in (*NOTEBOOKS, *scripts):
        assert {*needed_by(path)} <= named, path.name


@pytest.mark.nightly("examples")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, tmp_path):
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    notebook = nbformat.read(path, as_version=4)
    place = {"metadata": {"path": str(tmp_path)}}
    client = nbclient.NotebookClient(notebook, timeout=170, kernel_name="python3", resources=place)
    client.execute()
    assert any(cell.get("outputs") for cell in notebook.cells)
