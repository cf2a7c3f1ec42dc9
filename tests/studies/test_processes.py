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
import time
import types
from multiprocessing import forkserver
from pathlib import Path

import helpers
import pytest

from drake_nonstop import Run, ScenarioError, SerialExecutor, study
from drake_nonstop.scenario.loading import load_scenario

COUNT = int(os.environ.get("NONSTOP_SIGNALS", "4"))
SEED = int(os.environ.get("NONSTOP_SEED", "0"))
ENDS_WITHIN = 2.0  # s, from the last signal, on a machine that has nothing else to do
FAULTY = "load_disturbance=!faulty_blocks.FaultyWind {}"
FAULT, MASS = "load_disturbance.fault", "system.load_mass"
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
SCRIPT = f"""
from drake_nonstop import load_scenario, study

scenario = load_scenario("line", {[*SHORT, FAULTY]}, trust=True)
print(study(scenario, {{"{FAULT}": ["flown tells", "none"]}}, folder="out").table["message"][0])
"""


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("line", SHORT)


@pytest.fixture
def faulty():
    return load_scenario("line", [*SHORT, FAULTY], trust=True)


def load_factor():
    """How many processes wait for each core."""
    return max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def processes():
    """The numbers of all processes that have not ended, of their parents and of their sessions."""
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, ValueError):  # it has ended
            state, parent, _, session = stat.read_text().rsplit(")", 1)[1].split()[:4]
            if state != "Z":
                yield int(stat.parent.name), int(parent), int(session)


def wait_until(condition, seconds=5.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.05)
    assert condition()


def begun(folder, arguments):
    """A command, once it has begun."""
    (folder / "spec.yaml").write_text(SPEC)
    (folder / "program.py").write_text(PROGRAM)
    return helpers.begun(["program.py", *arguments], folder)


def ended(process):
    """The exit code and errors of a command that ends soon, and leaves no process."""
    start = time.monotonic()
    _, error = process.communicate(timeout=60)
    assert time.monotonic() - start < ENDS_WITHIN * load_factor()
    wait_until(lambda: process.pid not in [session for *_, session in processes()])
    return process.returncode, error


def journalled(folder):
    """The whole lines of a journal, each of which can be read."""
    path = folder / "journal.jsonl"
    lines = path.read_bytes().splitlines(keepends=True) if path.exists() else []
    return [json.loads(line) for line in lines if line.endswith(b"\n")]


@pytest.mark.nightly("processes")
@pytest.mark.parametrize("number", range(COUNT))
def test_any_study_ends_by_ctrl_c_at_any_time(tmp_path, number):
    draw = random.Random(f"{SEED} {number}")
    name = [*COMMANDS][number % len(COMMANDS)]
    first, second = draw.uniform(0, draw.choice([0.3, 2.0, 6.0])), draw.choice([0, 0.02, 0.2, 0.8])
    times, is_group = draw.choice([1, 2, 2, 3]), draw.random() < 0.5
    drawn = f"{name}, {times} signals, the first at {first:.3f} s, every {second} s, {is_group}"
    arguments = [*COMMANDS[name], "--out", "out", "--set", *SHORT, "simulation_duration=0.5"]
    process = begun(tmp_path, arguments)
    send = os.killpg if is_group else os.kill  # a terminal sends it to the whole group
    time.sleep(first)
    for _ in range(times):
        send(process.pid, signal.SIGINT)
        time.sleep(second)
    code, error = ended(process)
    assert code == 130, drawn
    assert "Traceback" not in error, drawn
    done = len(journalled(tmp_path / "out")) - 1
    assert (f"interrupted: {done} runs are in out" in error) == (done > 0), drawn


@pytest.mark.nightly("processes")
@pytest.mark.parametrize(
    ("sign", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -9)]
)
def test_a_block_that_never_returns_keeps_no_process(tmp_path, monkeypatch, sign, code):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    swap = ["--swap", f"{FAULT}=flown hangs", "--trust", "--out", "out"]
    process = begun(tmp_path, ["ablate", "line", *swap, "--set", *SHORT, FAULTY])
    wait_until(lambda: len(journalled(tmp_path / "out")) == 2, 60)  # the unchanged scenario
    process.send_signal(sign)
    found, error = ended(process)
    assert found == code
    if sign != signal.SIGKILL:
        assert "1 runs are in out; the same call continues from there" in error
    assert len(journalled(tmp_path / "out")) == 2
    assert (tmp_path / "out" / "as_it_is" / "metrics.json").exists()


@pytest.mark.nightly("processes")
@pytest.mark.parametrize("how", ["hangs", "swallows"])
def test_a_run_whose_block_never_returns_is_ended_by_the_second_signal(tmp_path, monkeypatch, how):
    """What was flown is kept, unless the block swallows the KeyboardInterrupt."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    monkeypatch.setenv("FAULT_FILE", "there")
    block = f"load_disturbance=!faulty_blocks.FaultyWind {{begin: 0.3, fault: flown {how}}}"
    options = ["--out", "out", "--trust", "--quiet", "--set", block]
    process = begun(tmp_path, ["run", "quintic", *options])
    wait_until((tmp_path / "there").exists, 60)
    for _ in range(2):
        process.send_signal(signal.SIGINT)
        time.sleep(0.1)
    code, error = ended(process)
    assert code == 130
    assert error.count("drake-nonstop: interrupted") == 1
    assert "Traceback" not in error
    if how == "hangs":
        assert "the results up to 0.3" in error
        flown = Run.load(tmp_path / "out", trust=True).time[-1]
        assert flown == pytest.approx(0.3, abs=0.011)
        names = {path.name for path in (tmp_path / "out").iterdir()}
        assert names == {"scenario.yaml", "metrics.json", "signals.npz"}


@pytest.mark.nightly("processes")
def test_killed_workers_cost_no_run(tmp_path, scenario):
    """Also where the process is killed that they are forked from."""
    draw, kills = random.Random(SEED), []

    def kill(what, share):
        server = forkserver._forkserver._forkserver_pid
        victims = [process for process, parent, _ in processes() if parent == server]
        if len(victims) > 1 and len(kills) < 4:  # else a call is repeated
            kills.append(server if len(kills) == 1 else draw.choice(victims))
            with contextlib.suppress(ProcessLookupError):
                os.kill(kills[-1], signal.SIGKILL)

    factors = {MASS: [1 + k / 100 for k in range(48)]}
    whole = study(scenario, factors, executor=SerialExecutor()).table
    table = study(scenario, factors, folder=tmp_path / "killed", progress=kill).table
    assert kills
    assert (table["ending"] == "completed").all()
    errors = "load.position_error_mean_m"
    assert table[errors].tolist() == whole[errors].tolist()


@pytest.mark.nightly("processes")
def test_a_block_that_ends_its_process_spoils_nothing(faulty):
    """Nor the runs that its process was given together with it."""
    faults = {9: "flown dies", 20: "flown exits"}
    levels = {k: [f"{MASS}={1 + k / 100}", f"{FAULT}={faults.get(k, 'none')}"] for k in range(32)}
    table = study(faulty, {"what": levels}).table
    assert table["ending"].tolist() == ["failed" if k in faults else "completed" for k in levels]
    assert "process died" in table["message"][9]
    assert "SystemExit" in table["message"][20]


@pytest.mark.nightly("processes")
def test_nothing_is_lost_by_a_kill_of_the_command(tmp_path):
    call = [*COMMANDS["sweep"], "--out", "out", "--set", *SHORT]
    process = begun(tmp_path, call)
    wait_until(lambda: len(journalled(tmp_path / "out")) >= 20, 60)
    process.kill()
    ended(process)
    kept = journalled(tmp_path / "out")
    again = begun(tmp_path, call)
    again.communicate(timeout=120)
    assert again.returncode == 0
    assert journalled(tmp_path / "out")[: len(kept)] == kept
    assert len(journalled(tmp_path / "out")) == 301


def run_script(folder, script, environment=os.environ):
    """What a script prints, in a process that can import the block."""
    environment = environment | {"PYTHONPATH": os.pathsep.join(sys.path)}
    about = {"capture_output": True, "text": True, "timeout": 120, "cwd": folder}
    return subprocess.run([sys.executable, script], env=environment, **about)


@pytest.mark.nightly("processes")
def test_a_script_that_processes_cannot_import_is_told_so(tmp_path):
    """They would run it again, and end as they start; nothing is kept of that."""
    script = tmp_path / "study.py"
    script.write_text(SCRIPT)
    done = run_script(tmp_path, script)
    assert done.returncode == 1
    assert done.stderr.count("Traceback") == 1
    last = done.stderr.strip().splitlines()[-1]
    assert f"__main__ = {script}" in last
    assert '`if __name__ == "__main__":`' in last
    assert not (tmp_path / "out").exists()


def test_a_main_module_without_its_file_is_refused(scenario, monkeypatch):
    main = types.ModuleType("__main__")
    main.__file__ = "<stdin>"
    monkeypatch.setitem(sys.modules, "__main__", main)
    with pytest.raises(ScenarioError, match=r"^__main__ = <stdin>: processes import it"):
        study(scenario, {MASS: [1.0]})


@pytest.mark.nightly("processes")
@pytest.mark.parametrize("asked", [None, "2"])
def test_workers_have_one_thread_for_linear_algebra_unless_asked(tmp_path, asked):
    body = "".join(f"    {line}\n" for line in SCRIPT.splitlines())
    (tmp_path / "script.py").write_text(f"if __name__ == '__main__':\n{body}")
    given = {name: value for name, value in os.environ.items() if "_NUM_THREADS" not in name}
    given |= {"OPENBLAS_NUM_THREADS": asked} if asked else {}
    done = run_script(tmp_path, "script.py", given)
    assert f"threads: {asked or 1}\n" in done.stdout, done.stderr
