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

from drake_nonstop.cli import run as run_command
from drake_nonstop.cli import scenarios
from drake_nonstop.cli.main import main
from drake_nonstop.run import flight

_DATA = {"scenario.yaml", "metrics.json", "signals.npz"}
_GRACE = 2.0  # s, from the second signal to the end

_BLOCKS = """
import time
from dataclasses import dataclass
from pydrake.systems.framework import LeafSystem

@dataclass(kw_only=True)
class SpinsConfig:
    begin: float = 0.3  # s

class Spins(LeafSystem):
    def __init__(self, model, config):
        super().__init__()
        self.begin = config.begin
        self.DeclareVectorOutputPort("planned", 8, self.calc)

    def calc(self, context, output):
        if context.get_time() > self.begin:
            open("there", "w").close()
            self.stay()
        output.SetFromVector([2 * context.get_time(), 2.0, 1.2, 0, 0, 0, 0, 0])

    def stay(self):
        while True:
            pass

class SwallowsConfig(SpinsConfig): pass
class Swallows(Spins):
    def stay(self):
        while True:
            try:
                time.sleep(0.01)
            except BaseException:
                pass

"""


@pytest.fixture
def start(tmp_path):
    """Starts the command as a terminal would, in tmp_path, and waits until it hears signals."""
    (tmp_path / "stays.py").write_text(_BLOCKS)
    processes = []

    def started(*arguments):
        process = subprocess.Popen(
            [sys.executable, "-m", "drake_nonstop.cli", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=tmp_path,
            start_new_session=True,
            preexec_fn=handle_signals_as_a_shell_does,
            env=os.environ | {"PYTHONUNBUFFERED": "1", "PYTHONPATH": os.pathsep.join(sys.path)},
        )
        processes.append(process)
        while process.poll() is None and not _handles(process.pid, signal.SIGHUP):
            time.sleep(0.001)
        return process

    yield started
    for process in processes:
        process.kill()
        process.communicate()


def _handles(pid, number):
    """Whether a process has a handler for the signal (Linux)."""
    with open(f"/proc/{pid}/status") as file:
        caught = int(re.search(r"SigCgt:\s*(\w+)", file.read())[1], 16)
    return bool(caught >> (number - 1) & 1)


def ended(process):
    """The exit code, the sentences and the time from now to the end of a process."""
    begin = time.monotonic()
    _, error = process.communicate(timeout=30)
    assert "Traceback" not in error, error
    sentences = [line for line in error.splitlines() if line.startswith("drake-nonstop: ")]
    return process.returncode, sentences, time.monotonic() - begin


def wait_for(path):
    begin = time.monotonic()
    while not path.exists():
        assert time.monotonic() - begin < 30
        time.sleep(0.01)


def flown(folder):
    """The time to which the results of a folder go; they have to be whole."""
    metrics = json.loads((folder / "metrics.json").read_text())
    with np.load(folder / "signals.npz") as signals:
        assert signals["time"][-1] == pytest.approx(metrics["simulated_s"], abs=0.011)
        names = {name for name in signals if "." in name}
        assert all(len(signals[name]) == len(signals["time"]) for name in names)
    return metrics["simulated_s"]


@pytest.mark.nightly("processes")
@pytest.mark.parametrize("block", ["Spins", "Swallows"])
def test_a_block_that_never_returns_is_ended_and_what_was_flown_is_kept(start, tmp_path, block):
    options = ["--out", "o", "--trust", "--quiet", "--set", f"phase=stays.{block}"]
    process = start("run", "quintic", *options)
    wait_for(tmp_path / "there")
    process.send_signal(signal.SIGINT)
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    code, sentences, took = ended(process)
    assert code == 130
    assert took < _GRACE
    assert len(sentences) == 1
    assert "the results up to 0.3" in sentences[0]
    assert flown(tmp_path / "o") == pytest.approx(0.3, abs=0.011)
    assert {path.name for path in (tmp_path / "o").iterdir()} == _DATA


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_a_run_goes_on_keeps_what_was_flown(tmp_path, monkeypatch, capsys, number):
    def show(progress, simulated):
        if simulated > 0:
            os.kill(os.getpid(), number)

    monkeypatch.setattr(run_command.RunProgress, "__call__", show)
    options = ["--no-figures", "--no-replay", "--out", str(tmp_path), "--set"]
    options += ["simulation_duration=1000", "optimization_layer=ConstantParameters"]
    assert main(["run", "line", *options]) == 128 + number
    name = {signal.SIGINT: "interrupted", signal.SIGTERM: "ended by SIGTERM"}[number]
    kept = rf"drake-nonstop: {name}: the results up to ([\d.]+) s are in {tmp_path}\n"
    (simulated,) = re.fullmatch(kept, capsys.readouterr().err).groups()
    assert 0 < flown(tmp_path) < 1000
    assert flown(tmp_path) == pytest.approx(float(simulated), abs=6e-4)
    assert {path.name for path in tmp_path.iterdir()} == _DATA | {"diagram.svg"}


def test_a_keyboard_interrupt_that_became_another_error_is_one(monkeypatch, capsys):
    """As pybind11 makes of it where it comes while arguments are converted."""

    def convert():
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1)
        except KeyboardInterrupt:
            raise TypeError("incompatible constructor arguments") from None

    monkeypatch.setattr(scenarios, "scenario_names", convert)
    assert main(["list"]) == 130
    assert capsys.readouterr().err == "drake-nonstop: interrupted\n"
    monkeypatch.setattr(scenarios, "scenario_names", lambda: int("a"))
    with pytest.raises(ValueError, match="invalid literal"):  # an error of ours is shown whole
        main(["list"])


@pytest.mark.parametrize("step", ["set_equilibrium", "CompiledRun"])
def test_an_interrupt_before_the_flight_ends_it_and_leaves_no_folder(
    tmp_path, capsys, monkeypatch, step
):
    prepare = getattr(flight, step)

    def interrupted(*arguments):
        os.kill(os.getpid(), signal.SIGINT)
        return prepare(*arguments)

    monkeypatch.setattr(flight, step, interrupted)
    assert main(["run", "quintic", "--quiet", "--out", str(tmp_path / "out")]) == 130
    assert capsys.readouterr().err == "drake-nonstop: interrupted: nothing had been flown yet\n"
    assert not any(tmp_path.iterdir())
