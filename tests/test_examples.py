"""Every example's main(), and every Python block of the README, runs."""

import dataclasses
import importlib.util
import inspect
import re
import shlex
import sys
from pathlib import Path

import pytest

import drake_nonstop
from drake_nonstop.cli.main import main

ROOT = Path(__file__).parent.parent
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
README = (ROOT / "README.md").read_text(encoding="utf-8")
README_BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
FILES = [code for code in README_BLOCKS if code.startswith("# ")]  # and the file's name
SCRIPTS = [code for code in README_BLOCKS if code not in FILES]


def test_there_are_examples_and_blocks():
    assert EXAMPLES
    assert len(SCRIPTS) >= 2
    assert len(FILES) == 1


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path, capsys, monkeypatch, tmp_path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, path.stem, module)
    spec.loader.exec_module(module)
    monkeypatch.chdir(tmp_path)  # where it may leave results
    few = {"runs": 4} if "runs" in inspect.signature(module.main).parameters else {}
    module.main(duration=1.0, **few)
    assert "load error" in capsys.readouterr().out


@pytest.fixture
def shared_simulate(shared_runs, monkeypatch):
    """Has `simulate` answer with the shared run where a scenario is all that it is given."""
    simulate = drake_nonstop.simulate

    def shared(scenario, **options):
        if options:
            return simulate(scenario, **options)
        run = shared_runs.run(scenario)
        return dataclasses.replace(run, diagram=drake_nonstop.make_nonstop(scenario))

    monkeypatch.setattr(drake_nonstop, "simulate", shared)


@pytest.mark.usefixtures("shared_simulate")
@pytest.mark.parametrize("code", SCRIPTS)
def test_readme_block_runs(code, capsys):
    exec(compile(code, "README.md", "exec"), {})
    assert capsys.readouterr().out


def test_readme_layer_runs_in_an_ablation(tmp_path, monkeypatch):
    """The custom optimization layer, as a file in the current folder, and the README's command."""
    (code,) = FILES
    assert len(code.splitlines()) < 40
    (tmp_path / code.split()[1]).write_text(code)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    after = README[README.index(code) :]
    command = re.search(r"drake-nonstop (ablate .*?)```", after, re.DOTALL).group(1)
    arguments = shlex.split(command.replace("\\\n", " "))
    assert (
        main([*arguments, "--no-replay", "--out", "out", "--set", "simulation_duration=0.5"]) == 0
    )
    table = (tmp_path / "out" / "table.md").read_text()
    assert "Faster" in table
    assert "ConstantParameters" in table


def test_readme_links_lead_somewhere():
    links = re.findall(r"\]\((?!http)([^)#]+)", README)
    assert len(links) >= 5
    for link in links:
        assert (ROOT / link).exists(), link
