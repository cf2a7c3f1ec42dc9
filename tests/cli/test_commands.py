"""The commands, as a user meets them: their help, errors, files, exit codes, ends by signals."""

import json
import os
import random
import re
import subprocess
import sys

import numpy as np
import pytest
from helpers import nightly_beyond
from PIL import Image

from drake_nonstop import Run, simulate, write_results
from drake_nonstop.cli.main import main
from drake_nonstop.scenario.loading import load_scenario

DATA = {"scenario.yaml", "metrics.json", "signals.npz"}
RESULTS = DATA | {"diagram.svg", "replay.html", "figures"}
BRIEF = ["--quiet", "--no-figures", "--no-replay"]
SHORT = ["simulation_duration=0.05", "optimization_layer=ConstantParameters"]
RUN = "{run}"  # a folder with a run's results
ENVIRONMENT = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}


def contents(folder):
    return {path.name for path in folder.iterdir()}


def files(folder):
    """All files of a folder, with their contents but for pipes."""
    found = {path for path in folder.rglob("*") if not path.is_dir()}
    return {path: path.is_file() and path.read_bytes() for path in found}


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stored") / "run"
    write_results(simulate(load_scenario("line", SHORT)), folder, figures=False, replay=False)
    return folder


def test_the_help_imports_no_drake():
    call = [sys.executable, "-X", "importtime", "-m", "drake_nonstop.cli", "--help"]
    done = subprocess.run(call, check=True, env=ENVIRONMENT, capture_output=True, text=True)
    assert "drake_nonstop.cli" in done.stderr
    assert "pydrake" not in done.stderr


# Arguments, and what the sentence has: the field, the value or what it should be, the remedy.
REFUSED = [
    (["run", "quintik"], ("quintik", "did you mean quintic")),
    (["run", "line", "--realtime", "2"], ("--realtime", "2.0", "give --live with it")),
    (["run", "line", "--live", "--realtime", "-1"], ("--realtime", "-1.0", "give a finite number")),
    (["run", "line", "--live", "--verify-step"], ("--verify-step", "--live", "give one of them")),
    (["robustness", "line", "--seeds", "0"], ("seeds", "0", "give a number of seeds")),
    (["design", "none.yaml"], ("REQUEST", "none.yaml", "give a file that can be read")),
    (["export", ".", "--to", "csv"], (".", "give the folder of a run")),
    (["export", RUN, "--to", "csv", "--signal", "tension"], ("signal", "tension", "give a port")),
    (["export", RUN, "--to", "mcap", "--signal", "x"], ("--signal", "x", "leave it out")),
    (["export", RUN, "--to", "csv", "--out", "signals.npz"], ("signals.npz", "ends in .csv")),
    (["export", RUN, "--to", "csv", "--out", "pipe.csv"], ("pipe.csv", "give another file")),
    (["plot", RUN, RUN, "--figure", "snapshots"], ("RUN", "2 runs", "give one run")),
    (["plot", RUN, "--signal", "tensions", "--out", "a.txt"], ("--out", "a.txt", "give a name")),
    (["video", RUN, "--size", "3"], ("--size", "3", "such as 640x480")),
    (["video", RUN, "--out", "a.txt"], ("--out", "a.txt", "give a name in .gif")),
    (["blocks", "phases"], ("phases", "phase")),
    (["new", ""], ("NAME", "give the name of a file")),
    (["new", "a.txt"], ("NAME", "a.txt", "give a name that ends in .yaml")),
    (["new", "mine.yaml"], ("NAME", "mine.yaml", "give another name")),
    (["schema", "--out", "pipe.csv"], ("--out", "pipe.csv", "give another file")),
]


@pytest.mark.parametrize(("arguments", "words"), REFUSED, ids=lambda given: " ".join(given))
def test_bad_input_is_one_sentence_and_changes_nothing(
    stored, tmp_path, monkeypatch, capsys, arguments, words
):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe.csv")
    (tmp_path / "mine.yaml").write_text("mine")
    before = files(tmp_path), files(stored)
    given = [str(stored) if argument == RUN else argument for argument in arguments]
    assert main(given) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("drake-nonstop: ")
    assert all(word in error for word in words)
    assert (files(tmp_path), files(stored)) == before


def test_an_unwritable_folder_is_reported_before_the_run(faulty, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        assert faulty("flown raises", "run", "line", "--out", str(folder)) == 2
        assert "--out = " in capsys.readouterr().err


def test_a_run_leaves_all_its_results_which_repeat_it(tmp_path, capsys):
    for place in ("a", "b"):
        (tmp_path / place / "figures").mkdir(parents=True)
        (tmp_path / place / "figures" / "sketch.png").write_text("mine")
    folder = tmp_path / "a"
    change = ["--set", "simulation_duration=0.3", "system.load_mass=1.3"]
    assert main(["run", "quintic", "--out", str(folder), *change]) == 0
    assert contents(folder) == RESULTS
    drawn = [path for path in (folder / "figures").iterdir() if path.name != "sketch.png"]
    assert all(path.stat().st_size > 5000 for path in drawn)
    assert str(folder) in capsys.readouterr().out
    assert main(["run", str(folder / "scenario.yaml"), "--out", str(tmp_path / "b"), *BRIEF]) == 0
    assert contents(tmp_path / "b") == RESULTS - {"replay.html"}
    assert contents(tmp_path / "b" / "figures") == {"sketch.png"}  # nobody else's is touched
    assert capsys.readouterr() == ("", "")
    with np.load(folder / "signals.npz") as first, np.load(tmp_path / "b/signals.npz") as second:
        names = {name for name in first if "." in name or name == "time"}
        assert names
        assert all(first[name].tobytes() == second[name].tobytes() for name in names)


def test_a_live_run_without_a_browser_ends_with_its_results(tmp_path, capsys):
    options = ["--live", "--realtime", "0", "--set", "simulation_duration=0.2", *BRIEF[1:]]
    assert main(["run", "quintic", "--out", str(tmp_path), *options]) == 0
    assert "http://localhost:" in capsys.readouterr().out
    assert contents(tmp_path) == RESULTS - {"figures", "replay.html"}


@pytest.mark.nightly("processes")
@pytest.mark.parametrize(
    ("redirection", "code", "words"),
    [(">/dev/full", 1, "the output was not written"), ("2>/dev/full", 0, ""), ("| head -0", 0, "")],
)
def test_results_do_not_depend_on_what_is_printed(tmp_path, redirection, code, words):
    options = "--no-figures --no-replay --set simulation_duration=0.05"
    script = f"{sys.executable} -m drake_nonstop.cli run static_hold_open_loop {options}"
    call = ["sh", "-c", f"{script} {redirection}"]
    done = subprocess.run(call, capture_output=True, text=True, cwd=tmp_path, env=ENVIRONMENT)
    assert done.returncode == code
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert contents(tmp_path / "out" / "static_hold_open_loop") == DATA | {"diagram.svg"}


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("options", "seed"),
    nightly_beyond(
        1,
        "studies",
        [(place, k) for k in range(2) for place in ([], ["--out", "mine"], ["--out", "."])],
    ),
)
def test_in_any_order_results_of_a_whole_run_stay(
    faulty, tmp_path, monkeypatch, capsys, options, seed
):
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    folder = tmp_path / "work" / (options[1] if options else "out/line")
    stopped = folder.resolve().with_name(f"{folder.resolve().name}_stopped")
    kept, kinds = None, {"whole": 0, "flown raises": 1, "flown 2": 130, "flown 15": 143}
    told = {"flown 2": "interrupted", "flown 15": "ended by SIGTERM", "flown raises": r".*broke.*"}
    for how in ["flown 2", "whole", *random.Random(seed).choices([*kinds], k=5)]:
        assert faulty(how, "run", "line", *BRIEF[1:], *options) == kinds[how]
        said = capsys.readouterr().err
        place = folder if how == "whole" or kept is None else stopped
        outcome = json.loads((place / "metrics.json").read_text())["outcome"]
        assert (outcome == "ok") == (how == "whole")
        flown = Run.load(place, trust=True).time[-1]
        if how != "whole":
            sentence = rf"drake-nonstop: {told[how]}[:;] the results up to ([\d.]+) s are in "
            assert float(re.match(sentence, said)[1]) == pytest.approx(flown, abs=0.011)
            assert 0 < flown < 0.05
        if how == "whole":
            kept = files(folder)
        elif kept is not None:
            assert files(folder) == kept
            assert f"{stopped.name}; those of an earlier run stay in " in said
    if not options:  # and another scenario's go elsewhere
        assert main(["run", "line", *BRIEF, "--set", *SHORT]) == 0
        assert contents(folder.parent) == {"line", "line_2", "line_stopped"}


NOISE = "load_feedback=!NoisyFeedback {position_noise: 0.005, velocity_noise: 0.02}"
WINDY = "wind.velocity=[3, -4, 0]"
# A scenario and options, its changes, the exit code, and a part of the verdict.
CHECKED = [
    (["quintic"], ["simulation_duration=1"], 0, "\nok: the flight keeps all limits\n"),
    (["aircraft_co_rotating"], ["simulation_duration=0.2", WINDY], 0, "within all limits"),
    (["quintic", "--seeds", "2"], [NOISE, "simulation_duration=0.3"], 1, "2 flights of 0.3 s\n"),
]


@pytest.mark.parametrize(("call", "changes", "code", "said"), nightly_beyond(2, "studies", CHECKED))
def test_check_says_and_writes_what_comes_of_a_scenario(
    tmp_path, capsys, call, changes, code, said
):
    assert main(["check", *call, "--out", str(tmp_path), "--set", *changes]) == code
    told = capsys.readouterr().out
    assert said in told
    assert f"results: {tmp_path}\n" in told
    written = {"scenario.yaml", "check.json", "task.png"}
    assert contents(tmp_path) == written | ({"check.png"} if "aircraft" in call[0] else set())
    report = json.loads((tmp_path / "check.json").read_text())
    assert report["is_ok"] == (code == 0)
    if "aircraft" in call[0]:
        assert report["wind_m_s"] == [3.0, -4.0, 0.0]
        assert report["ranges"]["lift_share"][1] == pytest.approx(0.49, abs=0.01)
    with Image.open(tmp_path / "task.png") as picture:
        assert picture.width > 1000


def test_a_design_that_cannot_be_is_said_in_a_folder_of_its_own(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    other = tmp_path / "out" / "design" / "formation"
    other.mkdir(parents=True)
    (other / "request.yaml").write_text("load_mass: 1.0\n")
    heavy = ["carriers=[3]", "kinds=[co_rotating]", "load_mass=80", "starts=1"]
    assert main(["design", "--set", *heavy]) == 1
    shown = capsys.readouterr().out
    assert shown.startswith("1 kinds and numbers of carriers, 1 at a time")
    assert re.search(
        r"3 co-rotating, is at -[\d.]+ of them: .*(thrust|C_L).*; give longer cables", shown
    )
    assert "results: out/design/formation_2" in shown
    assert (other / "request.yaml").read_text() == "load_mass: 1.0\n"
    assert main(["design", "--print-request"]) == 0
    (tmp_path / "again.yaml").write_text(capsys.readouterr().out)
    assert main(["design", "again.yaml", "--print-request"]) == 0
    assert capsys.readouterr().out == (tmp_path / "again.yaml").read_text()


def test_a_keyboard_interrupt_that_became_another_error_is_one(faulty, monkeypatch, capsys):
    """As pybind11 makes of it where it comes while arguments are converted."""
    assert faulty("built 2", "stability", "line", box="wrench_controller") == 130
    assert capsys.readouterr().err == "drake-nonstop: interrupted\n"
    monkeypatch.setattr(json, "dumps", lambda *_, **__: int("a"))
    with pytest.raises(ValueError, match="invalid literal"):  # an error of ours is shown whole
        main(["schema"])


def test_an_interrupt_before_the_flight_ends_it_and_leaves_no_folder(faulty, tmp_path, capsys):
    assert faulty("built 2", "run", "line", "--quiet", "--out", str(tmp_path / "out")) == 130
    assert capsys.readouterr().err == "drake-nonstop: interrupted: nothing had been flown yet\n"
    assert not any(tmp_path.iterdir())
