"""Calls in processes: results, errors, and processes that die."""

import os
import subprocess
import sys
import time
import types
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor

import pytest

from drake_nonstop.studies.workers import PROCESS_DIED, SerialExecutor, run_all
from drake_nonstop.validation import ScenarioError

BLAS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def doubled(value):
    """Twice the value; some values stand for what may go wrong."""
    if value == "error":
        raise ValueError("no number")
    if value == "input":
        raise ScenarioError("value = input: give a number")
    if value == "interrupt":
        raise KeyboardInterrupt
    if value == "exit":
        sys.exit(3)
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
        [0, 1, "error", "exit"],
        done=[0],
        executor=executor,
        what=lambda: "doubling",
        progress=lambda what, share: shares.append((what, share)),
    )
    assert found == {
        1: 2,
        "error": "failed: ValueError: no number",
        "exit": "failed: RuntimeError: SystemExit: 3",
    }
    assert shares == [("doubling", 2 / 4), ("doubling", 3 / 4), ("doubling", 1.0)]


def test_the_call_that_ends_its_process_is_found():
    found = results([1, 2, "death", *range(3, 12)])
    assert found.pop("death") == f"failed: {PROCESS_DIED}"
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
            results([1, 2], executor=executor)


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


def test_a_main_module_without_its_file_is_refused(monkeypatch):
    main = types.ModuleType("__main__")
    main.__file__ = "<stdin>"
    monkeypatch.setitem(sys.modules, "__main__", main)
    with pytest.raises(ScenarioError, match=r"^__main__ = <stdin>: processes import it"):
        results([1])


@pytest.mark.slow
@pytest.mark.parametrize("asked", [None, "2"])
def test_workers_have_one_thread_for_linear_algebra_unless_asked(tmp_path, asked):
    script = tmp_path / "script.py"
    script.write_text(
        "import os, sys\n"
        "from drake_nonstop.studies.workers import run_all\n"
        "def told(): return os.environ.get('OPENBLAS_NUM_THREADS')\n"
        "if __name__ == '__main__':\n"
        "    run_all(told, [0], lambda k: (), lambda k, r: print(r), lambda k, e: print(e))\n"
        "    print(told())\n"
    )
    given = {k: v for k, v in os.environ.items() if k not in BLAS}
    given |= {"OPENBLAS_NUM_THREADS": asked} if asked else {}
    call = [sys.executable, str(script)]
    done = subprocess.run(call, env=given, capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == [asked or "1", str(asked)]
