"""Every example's main(), and every block of code in README and documentation, runs."""

import dataclasses
import importlib.util
import inspect
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import nightly_beyond

import drake_nonstop
from drake_nonstop.cli.main import main, make_parser

ROOT = Path(__file__).parent.parent
EXAMPLES = sorted([*(ROOT / "examples").glob("*.py"), *(ROOT / "examples").glob("*/fly.py")])
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
}
BLOCKS = {name: re.findall(r"```python\n(.*?)```", text, re.DOTALL) for name, text in PAGES.items()}
WITH_CODE = [name for name, blocks in BLOCKS.items() if blocks]
COMMANDS = {name: re.findall(r"```sh\n(.*?)```", text, re.DOTALL) for name, text in PAGES.items()}


def name_of(path):
    return path.relative_to(ROOT / "examples").as_posix()


def test_there_are_examples_and_blocks():
    assert EXAMPLES
    assert len(WITH_CODE) >= 9


def imported(path, monkeypatch):
    if path.parent.name == "six_degrees_of_freedom":
        pytest.importorskip("jsbsim")
        monkeypatch.syspath_prepend(path.parent)
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, path.stem, module)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("path", EXAMPLES, ids=name_of)
def test_example_can_be_imported_and_shortened(path, monkeypatch):
    main_of_example = imported(path, monkeypatch).main
    assert "duration" in inspect.signature(main_of_example).parameters


QUICK = ("fly_nonstop", "swap_a_block", "articulated_load")


@pytest.mark.parametrize("name", QUICK)
def test_quick_example_runs(name, capsys, monkeypatch, tmp_path):
    module = imported(ROOT / "examples" / f"{name}.py", monkeypatch)
    monkeypatch.chdir(tmp_path)  # where it may leave results
    module.main(**short_arguments(module, 0.1))
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


def short_arguments(module, duration):
    few = {"runs": 4} if "runs" in inspect.signature(module.main).parameters else {}
    return {"duration": duration, **few}


@pytest.fixture
def shared_simulate(fleet, monkeypatch):
    """Has `simulate` answer with the shared run where a scenario is all that it is given."""
    simulate = drake_nonstop.simulate

    def shared(scenario, **options):
        if options:
            return simulate(scenario, **options)
        run = fleet.run(scenario)
        return dataclasses.replace(run, diagram=drake_nonstop.make_nonstop(scenario))

    monkeypatch.setattr(drake_nonstop, "simulate", shared)


def file_name(code):
    """The name of the file that a block is, by its first line; empty: it is a script."""
    match = re.match(r"# (\w+\.(?:py|yaml))\n", code)
    return match[1] if match else ""


FIRST_PAGES = ("README.md", "docs/howto_vehicle.md")
PAGES_IN_ORDER = [*FIRST_PAGES, *(page for page in WITH_CODE if page not in FIRST_PAGES)]


@pytest.mark.parametrize("page", WITH_CODE)
def test_code_of_a_page_compiles(page):
    for code in BLOCKS[page]:
        compile(code, page, "exec")


@pytest.mark.usefixtures("shared_simulate")
@pytest.mark.parametrize("page", nightly_beyond(len(FIRST_PAGES), "examples", PAGES_IN_ORDER))
def test_code_of_a_page_runs(page, capsys, monkeypatch, tmp_path):
    """One block after the other, as a reader would try them; files are saved first."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    modules = set(sys.modules)
    for name, code in ((file_name(code), code) for code in BLOCKS[page]):
        if name:
            assert len(code.splitlines()) < 40
            (tmp_path / name).write_text(code)
    scripts = [code for code in BLOCKS[page] if not file_name(code)]
    names = {"__name__": "__main__"}
    for code in scripts:
        exec(compile(code, page, "exec"), names)
    if any("print(" in code for code in scripts):
        assert capsys.readouterr().out
    for module in set(sys.modules) - modules:
        if (tmp_path / f"{module}.py").exists():
            del sys.modules[module]


@pytest.mark.parametrize("page", [name for name, found in COMMANDS.items() if found])
def test_commands_of_a_page_are_commands(page):
    """Their arguments are parsed; scenarios that they name are there."""
    for block in COMMANDS[page]:
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line.partition("  #")[0].partition(" > ")[0], comments=True)
            if words[:1] == ["drake-nonstop"]:
                options = make_parser(words[1]).parse_args(words[1:])
                named = getattr(options, "scenario", None)
                if named and Path(named).suffix == "":
                    assert named in drake_nonstop.scenario_names(), line


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
@pytest.mark.parametrize("page", [name for name, found in COMMANDS.items() if found])
def test_commands_of_a_page_run(page, capfd, monkeypatch, tmp_path):
    """In a reader's order, with the page's code in between, and with files saved first."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    blocks = re.findall(r"(?s)```(python|sh|yaml)\n(.*?)```", PAGES[page])
    for _, code in blocks:
        if file_name(code):
            (tmp_path / file_name(code)).write_text(code.replace("runs: 1000", "runs: 9"))
    names = {"__name__": "__main__"}
    for kind, code in blocks:
        if kind == "python" and not file_name(code) and "out/" in code:
            exec(compile(code, page, "exec"), names)
        for line in code.replace("\\\n", " ").splitlines() if kind == "sh" else ():
            run_line(line, capfd)
    for module in (*sys.modules,):
        if (tmp_path / f"{module}.py").exists():
            del sys.modules[module]


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
    elif words[:3] == ["python", "-m", "tests.benchmarks"]:
        call = [sys.executable, *words[1:4], "--help"]
        assert subprocess.run(call, cwd=ROOT, capture_output=True).returncode == 0, line
    elif words[0] == "python":
        assert (ROOT / words[1]).is_file(), line
    else:
        assert words[0].endswith("pip"), f"{line}: how is it tried?"


def module_of(page, name, tmp_path, monkeypatch):
    """A module that a page has its readers save, in the current folder."""
    (code,) = [code for code in BLOCKS[page] if file_name(code) == name]
    (tmp_path / name).write_text(code)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    return code


def test_a_block_of_a_page_is_the_same_in_both_engines_and_on_autodiff(tmp_path, monkeypatch):
    code = module_of("docs/swap.md", "my_controllers.py", tmp_path, monkeypatch)
    definition = code[code.index("@dataclass") :]
    assert len(definition.splitlines()) <= 20
    settings = ["simulation_duration=1", "optimization_layer=ConstantParameters"]
    named = ["wrench_controller=my_controllers.PositionPd", "wrench_controller.stiffness=15"]
    scenario = drake_nonstop.load_scenario("quintic", [*settings, *named], trust=True)
    runs = [drake_nonstop.simulate(scenario, engine=each) for each in ("compiled", "diagram")]
    states = [run.signals["load_plant.load_state"] for run in runs]
    np.testing.assert_allclose(*states, rtol=0, atol=1e-9)
    block = type(runs[0].diagram.GetSubsystemByName("wrench_controller"))
    assert "- `stiffness`: N/m" in block.__doc__
    assert "- `wrench` (6): torque (3) N m" in block.__doc__
    diagram = drake_nonstop.make_nonstop(scenario).ToAutoDiffXd()
    assert diagram.CreateDefaultContext().num_continuous_states() > 0
    sys.modules.pop("my_controllers")


@pytest.mark.parametrize("page", PAGES)
def test_links_of_a_page_lead_somewhere(page):
    """Pages that are made from the code are `make docs`'s concern."""
    made = {"figure.md", "scenario.md", "signals.md", "reference.md"}
    for link in re.findall(r"\]\((?!http)([^)#]+)", PAGES[page]):
        is_made = link in made or link.startswith(("boxes/", "reference/", "replays/"))
        assert is_made or (ROOT / page).parent.joinpath(link).exists(), link
