"""Faults that happen for real: no room for results, Ctrl-C while they are written."""

import json
import resource
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from drake_nonstop.cli.main import main

pytestmark = [pytest.mark.usefixtures("undrawn"), pytest.mark.nightly("processes")]

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
