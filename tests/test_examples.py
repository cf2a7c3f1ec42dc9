"""Every example's main(), and every block of code in README and documentation, runs."""

import importlib.util
import inspect
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import nightly_beyond

import drake_nonstop
from drake_nonstop.cli.main import main

ROOT = Path(__file__).parent.parent
EXAMPLES = sorted([*(ROOT / "examples").glob("*.py"), *(ROOT / "examples").glob("*/fly.py")])
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
}
# The kind of each block of a page, the file that it is saved as or "", and its code.
BLOCKS = {
    page: [
        (kind, (re.match(r"# (\w+\.(?:py|yaml))\n", code) or ["", ""])[1], code)
        for kind, code in re.findall(r"(?s)```(python|sh|yaml)\n(.*?)```", text)
    ]
    for page, text in PAGES.items()
}
WITH_CODE, WITH_COMMANDS = (
    [page for page, blocks in BLOCKS.items() if kind in [block[0] for block in blocks]]
    for kind in ("python", "sh")
)


def name_of(path):
    return path.relative_to(ROOT / "examples").as_posix()


def imported(path, monkeypatch):
    if path.parent.name == "six_degrees_of_freedom":
        pytest.importorskip("jsbsim")
        monkeypatch.syspath_prepend(path.parent)
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, path.stem, module)
    spec.loader.exec_module(module)
    return module


def short_arguments(module, duration):
    parameters = inspect.signature(module.main).parameters
    assert "duration" in parameters
    few = {"runs": 4, "names": ["quintic"]}
    return {"duration": duration} | {name: few[name] for name in few if name in parameters}


QUICK = ("fly_nonstop", "swap_a_block", "articulated_load")


@pytest.mark.parametrize("path", EXAMPLES, ids=name_of)
def test_example_can_be_imported_and_a_quick_one_runs(path, capsys, monkeypatch, tmp_path):
    module = imported(path, monkeypatch)
    arguments = short_arguments(module, 0.1)
    if path.stem in QUICK:
        monkeypatch.chdir(tmp_path)  # where it may leave results
        module.main(**arguments)
        assert "load error" in capsys.readouterr().out


@pytest.mark.nightly("examples")
@pytest.mark.parametrize("path", EXAMPLES, ids=name_of)
def test_example_runs(path, monkeypatch, tmp_path):
    """In a process of its own: Drake's renderer has ended the one that it drew in."""
    arguments = short_arguments(imported(path, monkeypatch), 1.0)
    monkeypatch.setenv("PYTHONPATH", str(path.parent))
    call = [sys.executable, "-c", f"import {path.stem} as example; example.main(**{arguments})"]
    done = subprocess.run(call, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "load error" in done.stdout


@pytest.fixture
def saved(tmp_path, monkeypatch):
    """A function that saves the files of a page as its reader does, in the current folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])

    def save(page):
        for _, name, code in BLOCKS[page]:
            if name:
                (tmp_path / name).write_text(code.replace("runs: 1000", "runs: 9"))

    yield save
    for module in [*sys.modules]:
        if (tmp_path / f"{module}.py").exists():
            del sys.modules[module]


FIRST_PAGES = ("README.md", "docs/howto_vehicle.md")
PAGES_IN_ORDER = [*FIRST_PAGES, *(page for page in WITH_CODE if page not in FIRST_PAGES)]


def test_code_of_all_pages_compiles():
    assert len(WITH_CODE) >= 9
    for page, blocks in BLOCKS.items():
        for kind, name, code in blocks:
            assert not name or len(code.splitlines()) <= 40, page
            if kind == "python":
                compile(code, page, "exec")


@pytest.mark.parametrize("page", nightly_beyond(len(FIRST_PAGES), "examples", PAGES_IN_ORDER))
def test_code_of_a_page_runs(page, saved, capsys):
    """One block after the other, as a reader would try them; files are saved first."""
    saved(page)
    scripts = [code for kind, name, code in BLOCKS[page] if kind == "python" and not name]
    names = {"__name__": "__main__"}
    for code in scripts:
        exec(compile(code, page, "exec"), names)
    assert capsys.readouterr().out or not any("print(" in code for code in scripts)


def words_of(line):
    return shlex.split(line.partition("  #")[0].partition(" > ")[0], comments=True)


@pytest.mark.parametrize("page", WITH_COMMANDS)
def test_commands_of_a_page_are_commands(page, capsys):
    """Their options are in the help; scenarios that they name are there."""
    lines = [code.replace("\\\n", " ") for kind, _, code in BLOCKS[page] if kind == "sh"]
    for words in map(words_of, "".join(lines).splitlines()):
        if words[:1] == ["drake-nonstop"] and not words[1].startswith("-"):
            with pytest.raises(SystemExit, match=r"^0$"):
                main([words[1], "--help"])
            told = capsys.readouterr().out
            assert all(word.partition("=")[0] in told for word in words if word.startswith("--"))
            takes_scenario = re.search(r"(?m)^  scenario\b", told, re.IGNORECASE)
            if takes_scenario and len(words) > 2 and re.fullmatch(r"\w+", words[2]):
                assert words[2] in drake_nonstop.scenario_names(), words


# What is added to a command so that it takes seconds, and the exit codes that tell of results.
SHORTER = {
    "run": ("--no-figures --no-replay --set simulation_duration=0.5", {0, 3}),
    "ablate": ("--no-replay --set simulation_duration=0.5", {0}),
    "sweep": ("--set simulation_duration=0.5", {0}),
    "check": ("", {0, 1}),
    "design": ("--set carriers=[3] kinds=[co_rotating] starts=1 speed=0", {0}),
}
SERVED = "--live"  # until it is ended: tests/view/test_live_page.py


@pytest.mark.nightly("examples")
@pytest.mark.parametrize("page", WITH_COMMANDS)
def test_commands_of_a_page_run(page, saved, capfd):
    """In a reader's order, with the page's code in between, and with files saved first."""
    saved(page)
    names = {"__name__": "__main__"}
    for kind, name, code in BLOCKS[page]:
        if kind == "python" and not name and "out/" in code:
            exec(compile(code, page, "exec"), names)
        for line in code.replace("\\\n", " ").splitlines() if kind == "sh" else ():
            run_line(line, capfd)


def run_line(line, capfd):
    """A line of a page as its reader calls it, but shorter; that of other programs is looked up."""
    line, _, target = line.replace("make demo", "drake-nonstop run quintic").partition(" > ")
    words = shlex.split(line, comments=True)
    if not words or SERVED in words:
        return
    if words[0] == "drake-nonstop":
        addition, codes = SHORTER.get(words[1], ("", {0}))
        if "--print-request" in words or "--run" in words:
            addition = addition.partition("--set")[0]
        if "--figures" in words:
            addition = addition.replace("--no-figures ", "")
        capfd.readouterr()
        assert main([*words[1:], *shlex.split(addition)]) in codes, (line, capfd.readouterr())
        if target:
            Path(shlex.split(target, comments=True)[0]).write_text(capfd.readouterr().out)
    elif words[0] == "make":
        assert re.search(rf"(?m)^{words[1]}:", (ROOT / "Makefile").read_text()), line
    elif words[0] == "python" and words[1] != "-m":
        assert (ROOT / words[1]).is_file(), line


@pytest.mark.parametrize("page", PAGES)
def test_links_of_a_page_lead_somewhere(page):
    """Pages that are made from the code are `make docs`'s concern."""
    made = {"figure.md", "scenario.md", "signals.md", "metrics.md", "reference.md"}
    for link in re.findall(r"\]\((?!http)([^)#]+)", PAGES[page]):
        is_made = link in made or link.startswith(("boxes/", "reference/", "replays/"))
        assert is_made or (ROOT / page).parent.joinpath(link).exists(), link
