"""Signals: one sentence, the shell's exit code, and nothing lost."""

import json
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from helpers import handle_signals_as_a_shell_does

from drake_nonstop.cli.main import main

DATA = {"scenario.yaml", "metrics.json", "signals.npz"}
GRACE = 2.0  # s, from the second signal to the end
LONG = ["simulation_duration=1000", "optimization_layer=ConstantParameters"]


def flown(folder):
    """The time to which the results of a folder go; they have to be whole."""
    metrics = json.loads((folder / "metrics.json").read_text())
    with np.load(folder / "signals.npz") as signals:
        assert signals["time"][-1] == pytest.approx(metrics["simulated_s"], abs=0.011)
        names = {name for name in signals if "." in name}
        assert all(len(signals[name]) == len(signals["time"]) for name in names)
    return metrics["simulated_s"]


@pytest.mark.nightly("processes")
@pytest.mark.parametrize("how", ["hangs", "swallows"])
def test_a_block_that_never_returns_is_ended_by_the_second_signal(tmp_path, how):
    """What was flown is kept, unless the block swallows the KeyboardInterrupt."""
    block = f"load_disturbance=!faulty_blocks.FaultyWind {{begin: 0.3, fault: flown {how}}}"
    options = ["--out", "o", "--trust", "--quiet", "--set", block]
    process = subprocess.Popen(
        [sys.executable, "-m", "drake_nonstop.cli", "run", "quintic", *options],
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        start_new_session=True,
        preexec_fn=handle_signals_as_a_shell_does,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "FAULT_FILE": "there"},
    )
    end = time.monotonic() + 30
    while not (tmp_path / "there").exists() and time.monotonic() < end:
        time.sleep(0.01)
    for _ in range(2):
        process.send_signal(signal.SIGINT)
        time.sleep(0.1)
    begin = time.monotonic()
    _, error = process.communicate(timeout=30)
    assert time.monotonic() - begin < GRACE
    assert process.returncode == 130
    assert error.count("drake-nonstop: interrupted") == 1
    assert "Traceback" not in error
    if how == "hangs":
        assert "the results up to 0.3" in error
        assert flown(tmp_path / "o") == pytest.approx(0.3, abs=0.011)
        assert {path.name for path in (tmp_path / "o").iterdir()} == DATA


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_a_run_goes_on_keeps_what_was_flown(faulty, tmp_path, capsys, number):
    options = ["--no-figures", "--no-replay", "--quiet", "--out", str(tmp_path)]
    fault = f"flown {number.value}"
    assert faulty(fault, "run", "line", *options, changes=LONG) == 128 + number
    name = {signal.SIGINT: "interrupted", signal.SIGTERM: "ended by SIGTERM"}[number]
    kept = rf"drake-nonstop: {name}: the results up to ([\d.]+) s are in {tmp_path}\n"
    (simulated,) = re.fullmatch(kept, capsys.readouterr().err).groups()
    assert 0 < flown(tmp_path) < 1000
    assert flown(tmp_path) == pytest.approx(float(simulated), abs=6e-4)
    assert {path.name for path in tmp_path.iterdir()} == DATA | {"diagram.svg"}


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
