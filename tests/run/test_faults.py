"""Faults that happen for real: no room, a solver that throws, Ctrl-C while a file is written."""

import json
import resource
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop.blocks.nlp_layer import NlpLayer
from drake_nonstop.cli.main import main
from drake_nonstop.planning.horizon_solver import HorizonSolver

pytestmark = pytest.mark.usefixtures("undrawn")

CONSTANT = "optimization_layer=ConstantParameters"
LIMIT = 20_000  # bytes of a file
BRIEF = ["--quiet", "--no-figures", "--no-replay", "--set", "simulation_duration=0.2"]


def contents(folder):
    assert not [path for path in folder.iterdir() if path.name.startswith(".new")]
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.fixture
def results(tmp_path):
    """The folder of a run, with its results."""
    assert main(["run", "quintic", "--out", str(tmp_path), *BRIEF, CONSTANT]) == 0
    return tmp_path


@pytest.mark.nightly("processes")
def test_results_that_cannot_be_written_leave_the_earlier_ones(results, capsys):
    """The kernel refuses to let any file grow beyond 20 kB, in the middle of signals.npz."""
    before = contents(results)
    assert len(before["signals.npz"]) > LIMIT
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT, hard))
    try:
        heavier = [*BRIEF, "system.load_mass=1.1", CONSTANT]
        assert main(["run", "quintic", "--out", str(results), *heavier]) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert "give a folder with room to write to" in capsys.readouterr().err
    assert contents(results) == before


def angle(data):
    """θ in rad at an update or a plan."""
    return data[-1][3] if isinstance(data[0], np.ndarray) else data[0].start_angle


@pytest.mark.parametrize(
    ("solver", "method", "settings"),
    nightly_beyond(
        1,
        "adversary",
        [
            (NlpLayer, "_solved", ["optimization_layer=NlpLayer"]),
            (HorizonSolver, "solve", ["optimization_layer.intervals=25"]),
        ],
    ),
)
def test_a_solver_that_throws_stops_the_run_with_its_cause_and_keeps_what_there_is(
    tmp_path, monkeypatch, capsys, solver, method, settings
):
    solve = getattr(solver, method)

    def failing(solver, *data, **options):
        if angle(data) > 0.2:  # rad: from 0.1 s on
            raise RuntimeError("the solver\nis out of licences")
        return solve(solver, *data, **options)

    monkeypatch.setattr(solver, method, failing)
    settings = [*settings, "engine=diagram"]
    assert main(["run", "quintic", "--out", str(tmp_path), *BRIEF, *settings]) == 1
    assert "RuntimeError: the solver is out of licences" in capsys.readouterr().err
    assert 0.09 < json.loads((tmp_path / "metrics.json").read_text())["simulated_s"] < 0.2
    with np.load(tmp_path / "signals.npz") as signals:
        assert all(np.isfinite(signals[name]).all() for name in signals if "." in name)


@pytest.mark.nightly("processes")
@pytest.mark.parametrize("delay", [0.0, 0.05])
def test_ctrl_c_while_results_are_written_leaves_what_was_flown(results, delay):
    before = contents(results)
    command = [sys.executable, "-m", "drake_nonstop.cli", "run", "quintic", "--out", str(results)]
    longer = [*BRIEF, "system.load_mass=1.1", "simulation_duration=1"]
    with subprocess.Popen([*command, *longer], stderr=subprocess.PIPE, text=True) as process:
        while process.poll() is None:  # the signal comes as the new folder appears
            if any(path.name.startswith(".new") for path in results.iterdir()):
                time.sleep(delay)
                process.send_signal(signal.SIGINT)
                break
            time.sleep(0.001)
        _, error = process.communicate(timeout=60)
    assert "Traceback" not in error
    assert process.returncode in (0, 130)
    after = contents(results)
    assert before.keys() - {"diagram.svg"} <= after.keys() <= before.keys()
    json.loads(after["metrics.json"])
    with np.load(results / "signals.npz") as signals:
        assert len(signals["time"]) == 101
