"""Many runs in processes: results, errors, and processes that die."""

import functools
import itertools
import os
import subprocess
import sys
import time
import types
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor

import pytest

from drake_nonstop import ConstantParameters, SweepSpec, ablate, sweep
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.studies.robustness import robustness
from drake_nonstop.studies.run_all import (
    COMPLETED,
    DIVERGED,
    FAILED,
    UNBUILDABLE,
    SerialExecutor,
    attempts,
    run_all,
)
from drake_nonstop.validation import ScenarioError


def doubled(value):
    """Twice the value; some values stand for what may go wrong."""
    if value == "error":
        raise ValueError("no number")
    if value == "input":
        raise ScenarioError("value = input: give a number")
    if value == "interrupt":
        raise KeyboardInterrupt
    if value == "death":
        time.sleep(0.2)  # another process has begun a call
        os._exit(9)
    return 2 * value


def results(values, **options):
    found = {}
    run_all(
        doubled,
        values,
        lambda value: (value,),
        found.__setitem__,
        lambda value, error: f"failed: {error}",
        **options,
    )
    return found


@pytest.mark.parametrize("executor", [None, SerialExecutor(), ThreadPoolExecutor(2)])
def test_a_result_or_an_error_for_each_key(executor):
    shares = []
    found = results(
        [0, 1, "error", 3],
        done=[0],
        executor=executor,
        what="doubling",
        progress=lambda what, share: shares.append((what, share)),
    )
    assert found == {1: 2, "error": "failed: ValueError: no number", 3: 6}
    assert shares == [("doubling", 2 / 4), ("doubling", 3 / 4), ("doubling", 1.0)]


def test_progress_may_tell_what_was_found():
    said, found = [], {}
    run_all(
        doubled,
        [1, 2],
        lambda value: (value,),
        found.__setitem__,
        lambda value, error: error,
        executor=SerialExecutor(),
        what=lambda: f"the sum is {sum(found.values())}",
        progress=lambda what, share: said.append(what),
    )
    assert said == ["the sum is 2", "the sum is 6"]


def test_the_call_that_ends_its_process_is_found():
    values = [1, 2, "death", *range(3, 12)]
    found = results(values)
    assert found.pop("death") == "failed: its process died: it crashed or ran out of memory"
    assert found == {value: 2 * value for value in range(1, 12)}


def test_bad_input_and_ctrl_c_end_all_and_keep_what_was_recorded():
    for value, error in (("input", ScenarioError), ("interrupt", KeyboardInterrupt)):
        recorded = {}
        with pytest.raises(error):
            run_all(
                doubled,
                [1, value, 3],
                lambda key: (key,),
                recorded.__setitem__,
                lambda key, message: message,
                executor=SerialExecutor(),
            )
        assert recorded == {1: 2}
    with pytest.raises(ScenarioError, match="give a number"):
        results(["input", 1])


def test_no_keys_are_no_work():
    assert results([]) == {}


def test_the_ending_of_an_attempt(faulty_blocks):
    endings = {}
    for fault in ("none", "raises", "diverges", "constructor", "exits", "constructor exits"):
        block = f"load_disturbance=!faulty_blocks.FaultyWind {{fault: {fault}}}"
        overrides = ["simulation_duration=0.1", "optimization_layer=ConstantParameters", block]
        make = functools.partial(load_scenario, "line", overrides, trust=True)
        _, tried = next(attempts([(make, {})]))
        endings[fault] = tried.ending
        assert (tried.run is None) == fault.startswith("constructor")
        assert (tried.message == "") == (tried.ending == COMPLETED)
    assert endings == {
        "none": COMPLETED,
        "raises": FAILED,
        "diverges": DIVERGED,
        "constructor": UNBUILDABLE,
        "exits": FAILED,
        "constructor exits": UNBUILDABLE,
    }


CALLS = {
    "sweep": "sweep(scenario, SweepSpec(grid={'system.load_mass': [1.0, 1.1]}), 'out')",
    "ablate": "ablate(scenario, {'heavy': ['system.load_mass=1.1']}, 'out')",
    "robustness": "robustness(scenario, folder='out')",
    "margins": "find_margins(scenario, folder='out')",
}
SCRIPT = """
from drake_nonstop import *
from drake_nonstop.studies.stability_ranges import find_margins
from drake_nonstop.studies.robustness import robustness

scenario = load_scenario(
    'line', ['simulation_duration=0.1', 'optimization_layer=ConstantParameters']
)
"""


@pytest.mark.nightly("processes")
@pytest.mark.parametrize(
    ("study", "is_file"),
    itertools.product(CALLS, [True, False]),
)
def test_a_script_that_processes_cannot_import_is_told_so(tmp_path, study, is_file):
    """They would run it again, and end as they start; no study keeps anything of that."""
    script = tmp_path / "study.py"
    script.write_text(f"{SCRIPT}{CALLS[study]}\n")
    with script.open() as file:
        done = subprocess.run(
            [sys.executable, script if is_file else "-"],
            stdin=None if is_file else file,
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=120,
        )
    assert done.returncode == 1
    assert done.stderr.count("Traceback") == 1
    last = done.stderr.strip().splitlines()[-1]
    name = script if is_file else "<stdin>"
    assert f"ScenarioError: __main__ = {name}: processes import it as they start" in last
    assert '`if __name__ == "__main__":`' in last
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("study", CALLS)
def test_a_main_module_without_its_file_is_refused_by_every_study(tmp_path, monkeypatch, study):
    main = types.ModuleType("__main__")
    main.__file__ = "<stdin>"
    monkeypatch.setitem(sys.modules, "__main__", main)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ScenarioError, match=r"^__main__ = <stdin>: processes import it"):
        exec(f"{SCRIPT}{CALLS[study]}\n", {})
    assert not (tmp_path / "out").exists()


def test_modules_that_only_this_process_has_end_a_study(tmp_path, monkeypatch, faulty_blocks):
    """The fault is not the scenario's: no run is recorded as one that cannot be built."""
    module = types.ModuleType("blocks_in_memory")
    exec((faulty_blocks / "faulty_blocks.py").read_text(), module.__dict__)
    for name in ("FaultyWind", "FaultyWindConfig"):
        getattr(module, name).__module__ = "blocks_in_memory"
    monkeypatch.setitem(sys.modules, "blocks_in_memory", module)
    short = ["simulation_duration=0.1", "optimization_layer=ConstantParameters"]
    block = "load_disturbance=blocks_in_memory.FaultyWind"
    plain = load_scenario("line", short)
    own = load_scenario("line", [*short, block], trust=True)
    spec = SweepSpec(grid={"load_disturbance": ["blocks_in_memory.FaultyWind", "NoDisturbance"]})
    studies = (
        lambda: sweep(plain, spec, tmp_path / "a", trust=True),
        lambda: sweep(own, SweepSpec(grid={"system.load_mass": [1.0]}), tmp_path / "b"),
        lambda: ablate(plain, {"own": [block]}, tmp_path / "c", trust=True, replay=False),
        lambda: robustness(own, folder=tmp_path / "d"),
    )
    for study in studies:
        with pytest.raises(ScenarioError, match="blocks_in_memory"):
            study()
    for name in "abcd":
        journal = tmp_path / name / "journal.jsonl"
        assert not journal.exists() or "unbuildable" not in journal.read_text()


class BrokenPool(Executor):
    """Its workers end before a call does."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        future.set_exception(BrokenExecutor("a worker has ended"))
        return future


class BrokenAtOnce(Executor):
    """Its workers have ended before the call."""

    def submit(self, fn, /, *args, **kwargs):
        raise BrokenExecutor("a worker has ended")


def test_anything_but_an_executor_that_takes_calls_is_refused():
    closed = ThreadPoolExecutor(1)
    closed.shutdown()
    for executor, words in (
        ("x", "give one of concurrent.futures"),
        (ThreadPoolExecutor, "give one of concurrent.futures"),
        (closed, "give one that takes calls"),
        (BrokenPool(), "its workers end or cannot be used"),
        (BrokenAtOnce(), "its workers end or cannot be used"),
    ):
        with pytest.raises(ScenarioError, match="executor = ") as raised:
            results([1, 2], executor=executor)
        assert words in str(raised.value)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda s, f: ablate(s, {"a": ConstantParameters}, f), "variant a = <class"),
        (lambda s, f: ablate(s, {"a": "phase=PaperPhase"}, f), "give a list of path=value"),
        (lambda s, f: ablate(s, {"a": [3]}, f), "variant a = 3: give path=value"),
        (lambda s, f: ablate(s, {1: ["a=1"]}, f), "give a mapping from names"),
        (lambda s, f: ablate(s, ConstantParameters, f), "give a mapping from names"),
        (lambda s, f: ablate(s, ["phase=PaperPhase"], f), "give a mapping from names"),
        (lambda s, f: ablate(s, {"a": ["simulation_duration=1"]}, 3), "folder = 3: give a path"),
        (lambda s, f: sweep(s, {"grid": {}}, f), "give a SweepSpec"),
        (lambda s, f: sweep(s, SweepSpec(grid={"simulation_duration": [1]}), None), "give a path"),
        (lambda s, f: robustness(s, seed="a"), "seed = a"),
        (lambda s, f: robustness(s, progress=3, folder=f), "progress = 3: give a function"),
    ],
)
def test_wrong_types_are_one_clear_sentence(tmp_path, call, words):
    with pytest.raises(ScenarioError) as raised:
        call(load_scenario("line"), tmp_path / "out")
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)
    assert not (tmp_path / "out").exists()
