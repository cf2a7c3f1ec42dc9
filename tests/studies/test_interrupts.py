"""Signals, kills and blocks that do not return: every study ends, and what is done stays.

NONSTOP_SIGNALS sets the number of drawn signals, and NONSTOP_SEED other ones.
"""

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from helpers import handle_signals_as_a_shell_does

from drake_nonstop import load_scenario, study
from drake_nonstop.studies import workers
from drake_nonstop.studies.attempts import COMPLETED, FAILED
from drake_nonstop.studies.journal import JOURNAL, StudyInterrupted
from drake_nonstop.studies.workers import SerialExecutor

pytestmark = pytest.mark.usefixtures("faulty_blocks")

COUNT = int(os.environ.get("NONSTOP_SIGNALS", "4"))
SEED = int(os.environ.get("NONSTOP_SEED", "0"))
ENDS_WITHIN = 2.0  # s, from the last signal, on a machine that has nothing else to do
SHORT = ["simulation_duration=0.1", "optimization_layer=ConstantParameters"]
SPEC = "overrides: ['system.load_mass=!Uniform {min: 0.9, max: 1.1}']\nseeds: 300\n"
COMMANDS = {
    "sweep": ["sweep", "line", "spec.yaml"],
    "ablate": ["ablate", "line", "--grid", "departures", "--no-replay"],
    "robustness": ["robustness", "line"],
}
# The imports, in which Python itself answers signals, are behind it as it begins.
PROGRAM = """
import sys

from drake_nonstop.cli.main import main

if __name__ == "__main__":
    print("begins", flush=True)
    sys.exit(main())
"""


def load_factor():
    """How many processes wait for each core."""
    return max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def session(leader):
    """The processes that a program has started and left, as their command lines."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, _, number = (folder / "stat").read_text().rsplit(")", 1)[1].split()[:4]
            if int(number) == leader and state != "Z":
                found.append((folder / "cmdline").read_text().replace("\0", " "))
        except (OSError, ValueError):  # it has ended
            continue
    return found


def workers_of(process):
    """The processes that were forked for this one and have begun."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError):
            parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if parent == process:
                found.append(int(folder.name))
    return found


def forkserver():
    return workers.forkserver._forkserver._forkserver_pid


def is_alive(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def begun(folder, arguments):
    """A command in a session of its own, once it has begun."""
    (folder / "spec.yaml").write_text(SPEC)
    program = folder / "program.py"
    program.write_text(PROGRAM)
    process = subprocess.Popen(
        [sys.executable, program, *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=handle_signals_as_a_shell_does,
    )
    assert process.stdout.readline() == "begins\n"
    return process


def journalled(folder):
    """The whole lines of a journal, each of which can be read."""
    path = folder / JOURNAL
    lines = path.read_bytes().splitlines(keepends=True) if path.exists() else []
    return [json.loads(line) for line in lines if line.endswith(b"\n")]


@pytest.mark.nightly("processes")
@pytest.mark.parametrize("number", range(COUNT))
def test_any_study_ends_by_ctrl_c_at_any_time(tmp_path, number):
    draw = random.Random(f"{SEED} {number}")
    name = [*COMMANDS][number % len(COMMANDS)]
    first, second = draw.uniform(0, draw.choice([0.3, 2.0, 6.0])), draw.choice([0, 0.02, 0.2, 0.8])
    times, is_group = draw.choice([1, 2, 2, 3]), draw.random() < 0.5
    drawn = (
        f"{name}, {times} signals, the first at {first:.3f} s, then every {second} s, {is_group}"
    )
    arguments = [*COMMANDS[name], "--out", "out", "--set", *SHORT, "simulation_duration=0.5"]
    process = begun(tmp_path, arguments)
    send = os.killpg if is_group else os.kill  # a terminal sends it to the whole group
    time.sleep(first)
    for _ in range(times):
        send(process.pid, signal.SIGINT)
        time.sleep(second)
    start = time.monotonic()
    _, error = process.communicate(timeout=60)
    assert time.monotonic() - start < ENDS_WITHIN * load_factor(), drawn
    assert process.returncode == 130, drawn
    assert "Traceback" not in error, drawn
    end = time.monotonic() + 5
    while session(process.pid) and time.monotonic() < end:
        time.sleep(0.05)
    assert session(process.pid) == [], drawn
    done = len(journalled(tmp_path / "out")) - 1
    assert (f"interrupted: {done} runs are in out" in error) == (done > 0), drawn


@pytest.mark.nightly("processes")
@pytest.mark.parametrize(
    ("sign", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -9)]
)
def test_a_block_that_never_returns_keeps_no_process(
    tmp_path, faulty_blocks, monkeypatch, sign, code
):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([*sys.path, str(faulty_blocks)]))
    block = "load_disturbance=!faulty_blocks.FaultyWind {}"
    swap = ["--swap", "load_disturbance.fault=hangs", "--trust", "--out", "out"]
    process = begun(tmp_path, ["ablate", "line", *swap, "--set", *SHORT, block])
    while len(journalled(tmp_path / "out")) < 2:  # the unchanged scenario
        time.sleep(0.05)
    process.send_signal(sign)
    start = time.monotonic()
    _, error = process.communicate(timeout=60)
    assert time.monotonic() - start < ENDS_WITHIN * load_factor()
    assert process.returncode == code
    if sign != signal.SIGKILL:
        assert "1 runs are in out; the same call continues from there" in error
    assert len(journalled(tmp_path / "out")) == 2
    assert (tmp_path / "out" / "as_it_is" / "metrics.json").exists()
    end = time.monotonic() + 5
    while session(process.pid) and time.monotonic() < end:
        time.sleep(0.05)
    assert session(process.pid) == []


@pytest.mark.nightly("processes")
def test_an_interrupt_leaves_no_process_behind_where_python_goes_on(tmp_path, scenario):
    own = load_scenario(
        "line", [*SHORT, "load_disturbance=!faulty_blocks.FaultyWind {}"], trust=True
    )
    left = []

    def interrupt(what, share):
        left.extend(workers_of(forkserver()))
        raise KeyboardInterrupt

    faults = {"load_disturbance.fault": ["none", "hangs", "dies"]}
    with pytest.raises(StudyInterrupted, match="1 runs are in"):
        study(own, faults, folder=tmp_path / "out", progress=interrupt)
    assert left
    end = time.monotonic() + 5
    while any(map(is_alive, left)) and time.monotonic() < end:
        time.sleep(0.05)
    assert not any(map(is_alive, left))


class Killer:
    """Kills workers, and now and then the process that they are forked from, at drawn times."""

    def __init__(self, seed, count=4):
        self.kills, self._draw, self._count = 0, random.Random(seed), count

    def __enter__(self):
        self._thread = threading.Thread(target=self._kill)
        self._is_over = threading.Event()
        self._thread.start()
        return self

    def __exit__(self, *error):
        self._is_over.set()
        self._thread.join()

    def _kill(self):
        while self.kills < self._count and not self._is_over.wait(self._draw.uniform(0, 0.4)):
            victims = workers_of(forkserver()) if forkserver() else []
            if len(victims) < 2:  # a call that is repeated
                continue
            if self._draw.random() < 0.2:
                victims = [forkserver()]
            victim = self._draw.choice(victims)
            if victim is not None:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(victim, signal.SIGKILL)
                    self.kills += 1


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("line", SHORT)


@pytest.mark.nightly("processes")
def test_killed_workers_cost_no_run(tmp_path, scenario):
    factors = {"system.load_mass": [1 + k / 100 for k in range(48)]}
    whole = study(scenario, factors, executor=SerialExecutor()).table
    with Killer(SEED) as killer:
        table = study(scenario, factors, folder=tmp_path / "killed").table
    assert killer.kills > 0
    assert (table["ending"] == COMPLETED).all()
    errors = "load.position_error_mean_m"
    assert table[errors].tolist() == whole[errors].tolist()


@pytest.mark.nightly("processes")
@pytest.mark.parametrize(("fault", "words"), [("dies", "process died"), ("exits", "SystemExit")])
def test_a_block_that_ends_its_process_spoils_nothing(tmp_path, fault, words):
    own = load_scenario(
        "line", [*SHORT, "load_disturbance=!faulty_blocks.FaultyWind {}"], trust=True
    )
    factors = {"load_disturbance.fault": [fault, "none"], "system.load_mass": [1.0, 1.1, 1.2]}
    table = study(own, factors, folder=tmp_path).table
    assert table["ending"].tolist() == 3 * [FAILED] + 3 * [COMPLETED]
    assert words in table["message"][0]


@pytest.mark.nightly("processes")
def test_nothing_is_lost_by_a_kill_of_the_command(tmp_path):
    call = [*COMMANDS["sweep"], "--out", "out", "--set", *SHORT]
    process = begun(tmp_path, call)
    while len(journalled(tmp_path / "out")) < 20:
        time.sleep(0.05)
    process.kill()
    process.communicate(timeout=60)
    kept = journalled(tmp_path / "out")
    end = time.monotonic() + 5
    while session(process.pid) and time.monotonic() < end:
        time.sleep(0.05)
    assert session(process.pid) == []
    again = begun(tmp_path, call)
    again.communicate(timeout=120)
    assert again.returncode == 0
    assert journalled(tmp_path / "out")[: len(kept)] == kept
    assert len(journalled(tmp_path / "out")) == 301
