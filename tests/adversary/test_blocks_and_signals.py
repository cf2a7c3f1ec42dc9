"""Signals at drawn times, and blocks of the user's own that fail: what was flown is kept.

`tests/studies/test_interrupts.py` has signals and kills of studies.
"""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from helpers import handle_signals_as_a_shell_does
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_nonstop import load_scenario, simulate, write_results

pytestmark = pytest.mark.nightly("adversary")

RESULTS = ("scenario.yaml", "metrics.json", "signals.npz")
LONG = ["run", "line", "--no-figures", "--no-replay", "--set", "simulation_duration=1000"]
ENDS_WITHIN = 20.0  # s, on a busy machine
FEW = settings(max_examples=max(2, int(os.environ.get("ADVERSARY_COUNT", "40")) // 20))
# It tells when the command has begun, and how far its flight is.
PROGRAM = """
import sys
from drake_nonstop.cli.main import main
print("begins", flush=True)
sys.exit(main())
"""


def begun(folder: Path, arguments: list[str]) -> subprocess.Popen:
    """The command in a session of its own, once it has begun."""
    (folder / "program.py").write_text(PROGRAM)
    process = subprocess.Popen(
        [sys.executable, "program.py", *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": f"{Path(__file__).parents[2]}"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=handle_signals_as_a_shell_does,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "begins\n"
    return process


def processes_of(leader: int) -> list[str]:
    """The processes that a session still has."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, _, number = (folder / "stat").read_text().rsplit(")", 1)[1].split()[:4]
            if int(number) == leader and state != "Z":
                found.append((folder / "cmdline").read_text())
        except (OSError, ValueError):
            continue
    return found


def hashes(folder: Path) -> dict[str, str]:
    """The files of a folder."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def assert_whole(folder: Path) -> float:
    """Results can be read, and are of one run, whose length in s is returned."""
    metrics = json.loads((folder / "metrics.json").read_text())
    with np.load(folder / "signals.npz") as signals:
        assert signals["time"][-1] == pytest.approx(metrics["simulated_s"], abs=0.03)
    assert not [*folder.rglob(".new-*")]
    return metrics["simulated_s"]


@pytest.fixture(scope="module")
def earlier(tmp_path_factory):
    """Results of an earlier run, in a folder to copy."""
    folder = tmp_path_factory.mktemp("earlier")
    run = simulate(load_scenario("line", ["simulation_duration=0.05"]))
    write_results(run, folder, figures=False, replay=False)
    return folder


@FEW
@given(
    st.sampled_from([signal.SIGINT, signal.SIGTERM, signal.SIGHUP]),
    st.floats(0.1, 4),
    st.sampled_from([1, 1, 2]),
    st.booleans(),
    st.booleans(),
)
def test_a_signal_at_any_time_keeps_what_was_flown(
    tmp_path_factory, earlier, number, after, times, is_group, has_earlier
):
    folder = tmp_path_factory.mktemp("signals")
    if has_earlier:
        subprocess.run(["cp", "-r", earlier, folder / "out"], check=True)
    process = begun(folder, [*LONG, "--out", "out"])
    time.sleep(after)
    for _ in range(times):
        (os.killpg if is_group else os.kill)(process.pid, number)
        time.sleep(0.3)
    _, error = process.communicate(timeout=ENDS_WITHIN)
    assert process.returncode == 128 + number, error
    assert "Traceback" not in error
    assert not processes_of(process.pid)
    if has_earlier:
        kept = {name: code for name, code in hashes(folder / "out").items() if name in RESULTS}
        assert kept == {name: hashes(earlier)[name] for name in RESULTS}
    for made in (folder / "out", folder / "out_stopped"):
        if made.exists():
            assert_whole(made)
    assert times > 1 or after < 3.5 or (folder / "out").exists()


# What a block does in its third second, and how the run ends by it: its exit codes.
FAULTS = {
    **dict.fromkeys(["raise ValueError('no')", "raise ValueError('a\\nb')", "1 / 0"], (1,)),
    **dict.fromkeys(["raise KeyError", "raise OSError(5, 'x')", "assert False", "f()"], (1,)),
    **dict.fromkeys(["sys.exit(3)", "raise SystemExit", "raise KeyboardInterrupt"], (1,)),
    **dict.fromkeys(["np.zeros(10**12)", "import no_such_module", "value = 'text'"], (1,)),
    **dict.fromkeys(["value = np.full(3, np.nan)", "value = np.zeros(17)", "value = None"], (1,)),
    **dict.fromkeys(["print('mine')", "os.chdir('/')", "np.seterr(all='raise')"], (0, 3)),
    **dict.fromkeys(["gc.disable()", "os.environ.clear()", "sys.argv[:] = []"], (0, 3)),
    **dict.fromkeys(["warnings.simplefilter('error')", "os.umask(0o777)"], (0, 3)),
}
SAID = ("drake-nonstop: ", "mine", "warning")
MODULE = """
import gc, os, sys, warnings
from dataclasses import dataclass
import numpy as np
from pydrake.systems.framework import LeafSystem


def f():
    return f()


@dataclass
class BadConfig:
    pass


class Bad(LeafSystem):
    def __init__(self, model, config):
        super().__init__()
        self.DeclareVectorOutputPort("disturbance_wrench", 6, self.calc)

    def calc(self, context, output):
        value = np.zeros(6)
        if context.get_time() > 0.05:
            {fault}
        output.SetFromVector(value)
"""


@pytest.mark.parametrize("fault", FAULTS)
def test_a_block_that_fails_ends_the_run_in_a_sentence_and_keeps_it(tmp_path, fault):
    (tmp_path / "bad.py").write_text(MODULE.format(fault=fault))
    changes = ["simulation_duration=0.2", "load_disturbance=bad.Bad"]
    call = ["run", "line", "--no-figures", "--no-replay", "--trust", "--out", str(tmp_path / "out")]
    process = begun(tmp_path, [*call, "--set", *changes])
    _, error = process.communicate(timeout=60)
    assert process.returncode in FAULTS[fault], error
    assert "Traceback" not in error
    assert all(line.startswith(SAID) for line in error.splitlines())
    assert assert_whole(tmp_path / "out") > 0.04


@pytest.mark.parametrize("line", ["while True: pass", "import time; time.sleep(1e6)"])
def test_a_block_that_never_returns_is_ended_by_ctrl_c(tmp_path, line):
    (tmp_path / "bad.py").write_text(MODULE.format(fault=line))
    call = ["run", "line", "--no-figures", "--no-replay", "--trust", "--out", "out"]
    process = begun(tmp_path, [*call, "--set", "load_disturbance=bad.Bad"])
    time.sleep(5)
    for _ in range(2):
        os.killpg(process.pid, signal.SIGINT)
        time.sleep(0.5)
    _, error = process.communicate(timeout=ENDS_WITHIN)
    assert process.returncode == 130, error
    assert assert_whole(tmp_path / "out") > 0.04


STUDY = (
    "print(study(load_scenario('line', ['simulation_duration=0.02']), "
    "{'system.load_mass': [0.9, 1.0]}, folder='out').table)"
)
FORMS = {
    "guarded": 'if __name__ == "__main__":\n    {body}',
    "thread": "import threading\nt = threading.Thread(target=lambda: {body})\nt.start()\nt.join()",
    "plain": "{body}",
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("is_file", [True, False])
def test_a_script_of_any_form_runs_a_study_or_is_told_why_not(tmp_path, form, is_file):
    text = "from drake_nonstop import *\n" + FORMS[form].format(body=STUDY)
    (tmp_path / "mine.py").write_text(text)
    call = [sys.executable, "mine.py"] if is_file else [sys.executable, "-"]
    environment = {**os.environ, "PYTHONPATH": f"{Path(__file__).parents[2]}"}
    shown = subprocess.run(
        call, input=text, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120
    )
    if "ScenarioError: " not in shown.stderr:
        assert shown.returncode == 0, shown.stderr
        assert "failed" not in shown.stdout
        assert (tmp_path / "out" / "runs.csv").is_file()
    journal = tmp_path / "out" / "journal.jsonl"
    assert not journal.exists() or "process died" not in journal.read_text()
