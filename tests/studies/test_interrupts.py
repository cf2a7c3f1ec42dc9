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
from helpers import handle_signals_as_a_shell_does, nightly_beyond

from drake_nonstop import SweepSpec, ablate, load_scenario, sweep
from drake_nonstop.studies import processes, stability_ranges
from drake_nonstop.studies import robustness as robustness_module
from drake_nonstop.studies.journal import JOURNAL, StudyInterrupted
from drake_nonstop.studies.robustness import robustness
from drake_nonstop.studies.run_all import COMPLETED, FAILED, SerialExecutor
from drake_nonstop.studies.stability_ranges import find_margins

pytestmark = pytest.mark.usefixtures("faulty_blocks")

COUNT = int(os.environ.get("NONSTOP_SIGNALS", "4"))
SEED = int(os.environ.get("NONSTOP_SEED", "0"))
ENDS_WITHIN = 2.0  # s, from the last signal, on a machine that has nothing else to do
SHORT = ["simulation_duration=0.1", "optimization_layer=ConstantParameters"]
SPEC = "draws: {system.load_mass: {uniform: [0.9, 1.1]}}\nruns: 300\n"
COMMANDS = {
    "sweep": ["sweep", "line", "spec.yaml"],
    "ablate": ["ablate", "line", "--grid", "departures", "--no-replay"],
    "robustness": ["robustness", "line"],
    "stability": ["stability", "line"],
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


def is_alive(worker):
    try:
        state = Path(f"/proc/{worker.process.pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
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
    assert (f"interrupted: {done} of " in error) == (done > 0), drawn


@pytest.mark.nightly("processes")
@pytest.mark.parametrize(
    ("sign", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -9)]
)
def test_a_block_that_never_returns_keeps_no_process(
    tmp_path, faulty_blocks, monkeypatch, sign, code
):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([*sys.path, str(faulty_blocks)]))
    block = "load_disturbance=!faulty_blocks.FaultyWind {}"
    swap = ["--swap", "load_disturbance.fault=hangs", "--trust", "--no-replay", "--out", "out"]
    process = begun(tmp_path, ["ablate", "line", *swap, "--set", *SHORT, block])
    while len(journalled(tmp_path / "out")) < 2:  # the unchanged scenario
        time.sleep(0.05)
    process.send_signal(sign)
    start = time.monotonic()
    _, error = process.communicate(timeout=60)
    assert time.monotonic() - start < ENDS_WITHIN * load_factor()
    assert process.returncode == code
    if sign != signal.SIGKILL:
        assert "1 of 2 variants are in out; the same call continues from there" in error
    assert len(journalled(tmp_path / "out")) == 2
    assert (tmp_path / "out" / "as_it_is" / "metrics.json").exists()
    end = time.monotonic() + 5
    while session(process.pid) and time.monotonic() < end:
        time.sleep(0.05)
    assert session(process.pid) == []


@pytest.mark.nightly("processes")
def test_an_interrupt_leaves_no_process_behind_where_python_goes_on(tmp_path, scenario):
    block = "load_disturbance=!faulty_blocks.FaultyWind {}"
    spec = SweepSpec(overrides=[block], grid={"load_disturbance.fault": ["none", "hangs", "dies"]})
    workers = []

    def interrupt(what, share):
        workers.extend(processes._workers)
        raise KeyboardInterrupt

    with pytest.raises(StudyInterrupted, match="1 of 3 runs"):
        sweep(scenario, spec, tmp_path / "out", trust=True, progress=interrupt)
    assert len(workers) > 0
    end = time.monotonic() + 5
    while any(map(is_alive, workers)) and time.monotonic() < end:
        time.sleep(0.05)
    assert not any(map(is_alive, workers))
    assert not processes._workers


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
            workers = list(processes._workers)
            if len(workers) < 2:  # a call that is repeated
                continue
            victims = [worker.process.pid for worker in workers]
            if self._draw.random() < 0.2:
                victims = [processes.forkserver._forkserver._forkserver_pid]
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
    spec = SweepSpec(grid={"system.load_mass": [1 + k / 100 for k in range(12)]})
    whole = sweep(scenario, spec, tmp_path / "whole", executor=SerialExecutor())
    with Killer(SEED) as killer:
        done = sweep(scenario, spec, tmp_path / "killed")
    assert killer.kills > 0
    assert done.endings == {COMPLETED: 12}
    assert done.table.read_bytes() == whole.table.read_bytes()


@pytest.fixture(params=nightly_beyond(1, "processes", ["serial", "processes"]))
def runs_of_studies(request):
    """Studies with their runs in this process, or in others."""
    if request.param == "serial":
        request.getfixturevalue("serial_runs")


class After:
    """A progress that is interrupted after some calls, or counts them."""

    def __init__(self, most=1000):
        self.shares, self._most = [], most

    def __call__(self, what, share):
        self.shares.append(share)
        if len(self.shares) == self._most:
            raise KeyboardInterrupt


def csv_without_clocks(folder):
    lines = (folder / "table.csv").read_text().splitlines()
    clocks = [
        k
        for k, name in enumerate(lines[0].split(","))
        if "wall" in name or "real_time" in name or name == "engine"  # C may be there by then
    ]
    rows = [line.split(",") for line in lines]
    return [[cell for k, cell in enumerate(row) if k not in clocks] for row in rows]


@pytest.mark.usefixtures("runs_of_studies")
def test_ablate_keeps_variants_and_continues(tmp_path, scenario):
    variants = {f"mass {k}": [f"system.load_mass={1 + k / 10}"] for k in range(2)}
    ablate(scenario, variants, tmp_path / "whole", replay=False)
    folder = tmp_path / "parts"
    # In processes a third one may have ended with the second.
    with pytest.raises(StudyInterrupted, match=r"^[23] of 3 variants are in ") as interrupted:
        ablate(scenario, variants, folder, replay=False, progress=After(2))
    kept_count = int(str(interrupted.value)[0])
    done = sorted(folder.glob("*/metrics.json"))
    assert len(done) >= 2
    before = [path.stat().st_mtime_ns for path in done[:2]]
    assert not (folder / "table.csv").exists()
    with pytest.raises(Exception, match="has the runs of another scenario or spec"):
        ablate(scenario, {"other": ["system.load_mass=2"]}, folder, replay=False)
    progress = After()
    ablate(scenario, variants, folder, replay=False, progress=progress)
    assert progress.shares == [number / 3 for number in range(kept_count + 1, 4)]
    kept = [path.stat().st_mtime_ns for path in done[:2]]
    assert sum(a == b for a, b in zip(before, kept, strict=True)) >= 1
    assert csv_without_clocks(folder) == csv_without_clocks(tmp_path / "whole")


@pytest.mark.nightly("processes")
@pytest.mark.usefixtures("runs_of_studies")
def test_a_variant_whose_files_are_gone_is_run_again(tmp_path, scenario):
    variants = {"heavy": ["system.load_mass=1.1"]}
    with pytest.raises(StudyInterrupted):
        ablate(scenario, variants, tmp_path, replay=False, progress=After(2))
    for path in tmp_path.glob("*/scenario.yaml"):
        path.write_text("another: {}")
    progress = After()
    rows = ablate(scenario, variants, tmp_path, replay=False, progress=progress)
    assert len(progress.shares) == 2
    assert all(row.ending == COMPLETED for row in rows)


def stable(resting, override, value):
    """What is measured of a loop, without that loop."""
    return [0.9, -0.1, None]


@pytest.mark.nightly("processes")
@pytest.mark.usefixtures("runs_of_studies")
def test_robustness_and_margins_continue(tmp_path, scenario, monkeypatch):
    axes, errors = stability_ranges._axes, robustness_module._errors

    def few(scenario):
        mass = axes(scenario)[0]
        mass.values = [0.05, 0.1]
        return [mass]

    monkeypatch.setattr(stability_ranges, "_axes", few)
    monkeypatch.setattr(stability_ranges, "_measure", stable)
    monkeypatch.setattr(robustness_module, "_errors", lambda *given: [*errors(*given)][:4])
    for k, study in enumerate((robustness, find_margins)):
        folder = tmp_path / str(k)
        with pytest.raises(StudyInterrupted, match=r"^[23] of 4 \w+ are in") as interrupted:
            study(scenario, folder=folder, progress=After(2))
        progress = After()
        parts = study(scenario, folder=folder, progress=progress)
        assert len(progress.shares) == 4 - int(str(interrupted.value)[0])
        assert len(parts) == (4, 1)[k]


@pytest.mark.nightly("processes")
@pytest.mark.parametrize(("fault", "words"), [("dies", "process died"), ("exits", "SystemExit")])
def test_a_block_that_ends_its_process_spoils_nothing(tmp_path, scenario, fault, words):
    block = f"load_disturbance=!faulty_blocks.FaultyWind {{fault: {fault}}}"
    variants = {"bad": [block], "heavy": ["system.load_mass=1.1"]}
    rows = {
        row.variant: row
        for row in ablate(scenario, variants, tmp_path / "a", replay=False, trust=True)
    }
    assert rows["bad"].ending == FAILED
    assert words in rows["bad"].message
    assert rows["heavy"].ending == COMPLETED
    spec = SweepSpec(
        overrides=["load_disturbance=!faulty_blocks.FaultyWind {}"],
        grid={"load_disturbance.fault": [fault, "none"]},
    )
    done = sweep(scenario, spec, tmp_path / "s", trust=True)
    assert done.endings == {FAILED: 1, COMPLETED: 1}
    ((ending, message),) = done.errors
    assert (ending, words in message) == (FAILED, True)
