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

DATA = {"scenario.yaml", "metrics.json", "signals.npz"}
GRACE = 2.0  # s, from the second signal to the end

BLOCKS = """
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
def test_a_block_that_never_returns_is_ended_by_the_second_signal(tmp_path, block):
    """What was flown is kept, unless the block swallows the KeyboardInterrupt."""
    (tmp_path / "stays.py").write_text(BLOCKS)
    options = ["--out", "o", "--trust", "--quiet", "--set", f"phase=stays.{block}"]
    process = subprocess.Popen(
        [sys.executable, "-m", "drake_nonstop.cli", "run", "quintic", *options],
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        start_new_session=True,
        preexec_fn=handle_signals_as_a_shell_does,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
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
    if block == "Spins":
        assert "the results up to 0.3" in error
        assert flown(tmp_path / "o") == pytest.approx(0.3, abs=0.011)
        assert {path.name for path in (tmp_path / "o").iterdir()} == DATA


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
    assert {path.name for path in tmp_path.iterdir()} == DATA | {"diagram.svg"}


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
