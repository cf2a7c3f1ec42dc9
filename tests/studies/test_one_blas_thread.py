"""Commands and worker processes keep linear algebra on one thread, unless they are asked not to."""

import ast
import os
import subprocess
import sys

import pytest

VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
# The threads that Python has not started, after a product that is worth some, and what was asked.
THREADS = """
import os, sys, threading
import numpy as np

def threads():
    square = np.ones((600, 600))
    square @ square
    others = len(os.listdir("/proc/self/task")) - threading.active_count()
    return others, os.environ.get("OPENBLAS_NUM_THREADS")
"""
COMMAND = """
import atexit, sys

def tell():
    exec(open("threads.py").read(), globals())
    print(threads())

from drake_nonstop.cli.main import main
atexit.register(tell)
sys.argv = ["drake-nonstop", "--version"]
main()
"""
WORKER = """
from functools import partial
from threads import threads
from drake_nonstop.studies.processes import call_in_processes, one_by_one

if __name__ == "__main__":
    def tell(key, answer):
        print(answer.result)

    call_in_processes(partial(one_by_one, threads), [[0]], lambda key: (), tell)
    print(threads())
"""


def told_by(script, folder, **asked):
    """What a script prints in a process of its own, for whose threads alone is asked."""
    (folder / "threads.py").write_text(THREADS)
    (folder / "script.py").write_text(script)
    environment = {k: v for k, v in os.environ.items() if k not in VARIABLES} | asked
    call = [sys.executable, "script.py"]
    done = subprocess.run(
        call, cwd=folder, env=environment, capture_output=True, text=True, check=True, timeout=120
    )
    return [ast.literal_eval(line) for line in done.stdout.splitlines() if line.startswith("(")]


@pytest.mark.slow
def test_a_command_has_one_thread(tmp_path):
    assert told_by(COMMAND, tmp_path) == [(0, "1")]


@pytest.mark.slow
def test_a_worker_has_one_thread_and_the_script_its_own(tmp_path):
    of_worker, of_script = told_by(WORKER, tmp_path)
    assert of_worker == (0, "1")
    assert of_script[1] is None


@pytest.mark.nightly("processes")
def test_who_asks_for_threads_has_them(tmp_path):
    assert told_by(COMMAND, tmp_path, OMP_NUM_THREADS="2")[0][1] is None
    of_worker, _ = told_by(WORKER, tmp_path, OPENBLAS_NUM_THREADS="2")
    assert of_worker[1] == "2"
