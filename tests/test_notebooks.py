"""Every notebook of the documentation runs from its first cell to the last."""

import json
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
