"""The command, as a user meets it."""

import contextlib
import io
import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest

from drake_nonstop.cli import run
from drake_nonstop.cli.main import commands, main
from drake_nonstop.scenario.loading import dump_scenario, load_scenario, scenario_names

DATA = {"scenario.yaml", "metrics.json", "signals.npz"}
RESULTS = DATA | {"diagram.svg", "replay.html", "figures"}
FIGURES = {
    "carrier_paths_from_above",
    "load_errors",
    "carrier_speeds",
    "tensions",
    "internal_force_parameters",
    "snapshots",
}
BRIEF = ["--quiet", "--no-figures", "--no-replay"]


def contents(folder):
    return {path.name for path in folder.iterdir()}


def test_list_has_a_line_for_each_scenario(capsys):
    assert main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(scenario_names())
    assert all(len(line.split()) > 4 for line in lines)


def test_a_run_leaves_all_its_results_and_a_table(tmp_path, capsys):
    assert (
        main(["run", "quintic", "--out", str(tmp_path / "a"), "--set", "simulation_duration=0.3"])
        == 0
    )
    folder = tmp_path / "a"
    assert contents(folder) == RESULTS
    assert contents(folder / "figures") == {f"{name}.png" for name in FIGURES}
    assert all(path.stat().st_size > 5000 for path in (folder / "figures").iterdir())
    with np.load(folder / "signals.npz") as signals:
        assert signals["time"][-1] == pytest.approx(0.3)
        assert signals["load_plant.load_state"].shape == (31, 13)
        assert signals["carrier_dynamics.carrier_state"].shape == (31, 24)
        assert "steps/load_state" in signals
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["simulated_s"] == pytest.approx(0.3)
    resolved = load_scenario(folder / "scenario.yaml")
    assert dump_scenario(resolved) == (folder / "scenario.yaml").read_text()
    shown = capsys.readouterr().out
    assert "carrier speed" in shown
    assert str(folder) in shown


@pytest.fixture(scope="module")
def brief_runs(tmp_path_factory):
    """The folders of two equal runs, one of which replaces an earlier one, and what they print."""
    new, used = (tmp_path_factory.mktemp(name) for name in ("new", "used"))
    (used / "figures").mkdir()
    (used / "figures" / "tensions.png").write_text("old")
    (used / "figures" / "sketch.png").write_text("mine")
    (used / "replay.html").write_text("old")
    (used / "notes.txt").write_text("mine")
    text = io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.redirect_stderr(text):
        for folder in (new, used):
            overrides = ["--set", "simulation_duration=0.3", "system.load_mass=1.3"]
            assert main(["run", "quintic", "--out", str(folder), *overrides, *BRIEF]) == 0
    return new, used, text.getvalue()


def signals_in(folder):
    """The bytes of a run's signals at 100 Hz, by their names."""
    with np.load(folder / "signals.npz") as signals:
        return {name: signals[name].tobytes() for name in signals if "." in name or name == "time"}


def test_the_resolved_scenario_repeats_the_run(brief_runs, tmp_path):
    resolved = str(brief_runs[0] / "scenario.yaml")
    assert main(["run", resolved, "--out", str(tmp_path), *BRIEF]) == 0
    first, second = map(signals_in, (brief_runs[0], tmp_path))
    assert first == second
    assert signals_in(brief_runs[1]) == first
    assert brief_runs[2] == ""  # --quiet


def test_a_run_replaces_all_of_an_earlier_one_and_touches_nothing_else(brief_runs):
    folder = brief_runs[1]
    assert contents(folder) == RESULTS - {"replay.html"} | {"notes.txt"}
    assert contents(folder / "figures") == {"sketch.png"}


def test_bad_input_leaves_no_new_folder(tmp_path):
    assert (
        main(["run", "quintic", "--out", str(tmp_path / "a"), "--set", "pattern.phases=[0]"]) == 2
    )
    assert contents(tmp_path) == set()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["quintik"], "quintic"),
        (["quintic", "--set", "system.load_mass=-1"], "system.load_mass = -1.0"),
        (["quintic", "--set", "optimization_layer.knot_spacing=0.003"], "multiple"),
        (
            [
                "quintic",
                "--set",
                "optimization_layer=NlpLayer",
                "optimization_layer.period=0.003",
            ],
            "multiple",
        ),
        (["nothing.yaml"], "nothing.yaml"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_earlier_results(tmp_path, capsys, arguments, words):
    (tmp_path / "metrics.json").write_text("earlier")
    assert main(["run", *arguments, "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("drake-nonstop: ")
    assert error.count("\n") == 1
    assert words in error
    assert contents(tmp_path) == {"metrics.json"}
    assert (tmp_path / "metrics.json").read_text() == "earlier"


def test_an_unwritable_folder_is_reported_before_the_run(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(run, "simulate", lambda *_: pytest.fail("the run began"))
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        assert main(["run", "line", "--out", str(folder)]) == 2
        assert "--out = " in capsys.readouterr().err


def test_a_diverging_run_exits_with_1_and_writes_what_there_is(tmp_path, capsys):
    overrides = [
        "--set",
        "simulator_config.integration_scheme=explicit_euler",
        "simulation_duration=2",
    ]
    assert main(["run", "quintic", "--out", str(tmp_path), *overrides, *BRIEF]) == 1
    error = capsys.readouterr().err
    assert "diverged at t = " in error
    assert "Traceback" not in error
    with np.load(tmp_path / "signals.npz") as signals:
        assert 0 < signals["time"][-1] < 2
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["simulated_s"] < 2
    assert metrics["outcome"] == "stopped"
    assert "diverged at t = " in metrics["reasons"][0]


def test_a_live_run_without_a_browser_ends_with_its_results(tmp_path, capsys):
    options = ["--live", "--realtime", "0", "--set", "simulation_duration=0.2", *BRIEF[1:]]
    assert main(["run", "quintic", "--out", str(tmp_path), *options]) == 0
    assert "http://localhost:" in capsys.readouterr().out
    assert contents(tmp_path) == RESULTS - {"figures", "replay.html"}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--realtime", "2"], "--realtime = 2.0: give --live with it"),
        (["--live", "--realtime", "-1"], "--realtime = -1.0"),
    ],
)
def test_bad_options_of_a_live_run(options, words, tmp_path, capsys):
    folder = tmp_path / "out"
    assert main(["run", "quintic", "--out", str(folder), *options]) == 2
    assert words in capsys.readouterr().err
    assert not folder.exists()


def test_run_says_all_its_exit_codes(capsys):
    with pytest.raises(SystemExit):
        main(["run", "--help"])
    said = capsys.readouterr().out.split("Exit codes:")[1]
    assert set(re.findall(r"\d+", said)) == {"0", "1", "2", "3", "129", "130", "143"}


def test_the_help_names_all_commands_and_imports_none():
    found = commands()
    script = "import sys; from drake_nonstop.cli.main import make_parser; make_parser('--help')"
    script += "; assert 'pydrake' not in sys.modules, 'pydrake'"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", script], check=True, env=environment)
    assert {"run", "check", "list", "sweep", "design"} <= {*found}
    for name, (module, about) in found.items():
        assert about, module
        with pytest.raises(SystemExit, match=r"^0$"):
            main([name, "--help"])


@pytest.mark.nightly("processes")
@pytest.mark.parametrize(
    ("redirection", "code", "words"),
    [(">/dev/full", 1, "the output was not written"), ("2>/dev/full", 0, ""), ("| head -0", 0, "")],
)
def test_results_do_not_depend_on_what_is_printed(tmp_path, redirection, code, words):
    options = "--no-figures --no-replay --set simulation_duration=0.05"
    script = f"{sys.executable} -m drake_nonstop.cli run static_hold_open_loop {options}"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    call = ["sh", "-c", f"{script} {redirection}"]
    done = subprocess.run(call, capture_output=True, text=True, cwd=tmp_path, env=environment)
    assert done.returncode == code
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert contents(tmp_path / "out" / "static_hold_open_loop") == DATA | {"diagram.svg"}
