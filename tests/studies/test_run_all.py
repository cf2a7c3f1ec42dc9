"""Many runs in processes: results, errors, and processes that die."""

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.studies.run_all import (
    COMPLETED,
    DIVERGED,
    FAILED,
    UNBUILDABLE,
    SerialExecutor,
    attempt,
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
        [1, "error", 3],
        executor=executor,
        what="doubling",
        progress=lambda what, share: shares.append((what, share)),
        already_done=1,
    )
    assert found == {1: 2, "error": "failed: ValueError: no number", 3: 6}
    assert shares == [("doubling", 2 / 4), ("doubling", 3 / 4), ("doubling", 1.0)]


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
    for fault in ("none", "raises", "diverges", "constructor"):
        block = f"load_disturbance=!faulty_blocks.FaultyWind {{fault: {fault}}}"
        overrides = ["duration=0.1", "optimization_layer=ConstantParameters", block]
        tried = attempt(lambda given=overrides: load_scenario("line", given, trust=True))
        endings[fault] = tried.ending
        assert (tried.run is None) == (tried.ending == UNBUILDABLE)
        assert (tried.message == "") == (tried.ending == COMPLETED)
    assert endings == {
        "none": COMPLETED,
        "raises": FAILED,
        "diverges": DIVERGED,
        "constructor": UNBUILDABLE,
    }


def test_a_script_without_a_main_guard_is_told_so(tmp_path):
    """Its processes would run it again, and end as they start."""
    script = tmp_path / "study.py"
    script.write_text(
        "from drake_nonstop import load_scenario\n"
        "from drake_nonstop.studies.robustness import robustness\n"
        "robustness(load_scenario('quintic', ['duration=0.1']))\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120)
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert f"ScenarioError: __main__ = {script}: processes import it as they start" in last
    assert '`if __name__ == "__main__":`' in last
