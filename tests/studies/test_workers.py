"""Calls in processes: results, errors, and processes that die."""

import os
import subprocess
import sys
import time
import types
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor

import pytest

from drake_nonstop.studies.workers import PROCESS_DIED, SerialExecutor, results_of
from drake_nonstop.validation import ScenarioError

BLAS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def doubled(values):
    """Twice each value; some values stand for what may go wrong."""
    time.sleep(0.05)
    for value in values:
        if value == "error":
            raise ValueError("no number")
        if value == "input":
            raise ScenarioError("value = input: give a number")
        if value == "interrupt":
            raise KeyboardInterrupt
        if value == "death":
            time.sleep(0.2)  # another process has begun a call
            os._exit(9)
    return [2 * value for value in values]


def results(values, executor=None):
    batches = [[value] for value in values]
    return {batch[0]: found for batch, found in results_of(doubled, batches, executor)}


@pytest.mark.parametrize("executor", [None, SerialExecutor(), ThreadPoolExecutor(2)])
def test_results_or_an_error_for_each_batch(executor):
    found = results([0, 1, "error"], executor)
    assert found == {0: [0], 1: [2], "error": "ValueError: no number"}
    assert results([], executor) == {}


def test_of_a_batch_that_ends_its_process_only_the_call_that_does_is_lost():
    batches = [[1, 2], [3, "death", 4], *([k] for k in range(5, 12))]
    found = dict(zip("x", [0], strict=True))
    for batch, answers in results_of(doubled, batches):
        found |= dict(zip(batch, [answers] if isinstance(answers, str) else answers, strict=True))
    assert found.pop("death") == PROCESS_DIED
    assert found == {"x": 0} | {k: 2 * k for k in range(1, 12)}


def test_bad_input_and_ctrl_c_end_all_and_what_was_there_is_kept():
    for value, error in (("input", ScenarioError), ("interrupt", KeyboardInterrupt)):
        found = []
        with pytest.raises(error):
            found.extend(results_of(doubled, [[1], [value], [3]], SerialExecutor()))
        assert found == [([1], [2])]
    with pytest.raises(ScenarioError, match="give a number"):
        results(["input", 1])


class Broken(Executor):
    """Its workers end before a call does."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        future.set_exception(BrokenExecutor("a worker has ended"))
        return future


def test_anything_but_an_executor_that_takes_calls_is_refused():
    closed = ThreadPoolExecutor(1)
    closed.shutdown()
    for executor in ("x", ThreadPoolExecutor, closed, Broken()):
        with pytest.raises(ScenarioError, match=r"^executor = .*give "):
            results([1, 2], executor)


SCRIPT = """
from drake_nonstop import load_scenario, study

scenario = load_scenario("line", ["simulation_duration=0.1"])
study(scenario, {"system.load_mass": [1.0, 1.1]}, folder="out")
"""


@pytest.mark.nightly("processes")
@pytest.mark.parametrize("is_file", [True, False])
def test_a_script_that_processes_cannot_import_is_told_so(tmp_path, is_file):
    """They would run it again, and end as they start; nothing is kept of that."""
    script = tmp_path / "study.py"
    script.write_text(SCRIPT)
    call = [sys.executable, script if is_file else "-"]
    given = None if is_file else SCRIPT
    about = {"capture_output": True, "text": True, "timeout": 120}
    done = subprocess.run(call, input=given, cwd=tmp_path, **about)
    assert done.returncode == 1
    assert done.stderr.count("Traceback") == 1
    last = done.stderr.strip().splitlines()[-1]
    assert f"__main__ = {script if is_file else '<stdin>'}" in last
    assert '`if __name__ == "__main__":`' in last
    assert not (tmp_path / "out").exists()


def test_a_main_module_without_its_file_is_refused(monkeypatch):
    main = types.ModuleType("__main__")
    main.__file__ = "<stdin>"
    monkeypatch.setitem(sys.modules, "__main__", main)
    with pytest.raises(ScenarioError, match=r"^__main__ = <stdin>: processes import it"):
        results([1])


def threads(calls):
    return [os.environ.get("OPENBLAS_NUM_THREADS") for _ in calls]


@pytest.mark.slow
@pytest.mark.parametrize("asked", [None, "2"])
def test_workers_have_one_thread_for_linear_algebra_unless_asked(tmp_path, asked):
    script = tmp_path / "script.py"
    script.write_text(
        "from test_workers import results_of, threads\n"
        "if __name__ == '__main__':\n"
        "    print(*results_of(threads, [[0]]))\n"
    )
    given = {k: v for k, v in os.environ.items() if k not in BLAS}
    given |= {"OPENBLAS_NUM_THREADS": asked} if asked else {}
    given["PYTHONPATH"] = os.pathsep.join([*sys.path, os.path.dirname(__file__)])
    call = [sys.executable, str(script)]
    done = subprocess.run(call, env=given, capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == ["([0],", f"['{asked or 1}'])"]
