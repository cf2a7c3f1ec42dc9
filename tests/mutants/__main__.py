"""Tests the tests by faults of a single line: `python -m mutants --drawn 120 --seed 0`, in `tests`.

Each fault is made in a copy of the checkout, whose tests are run until one fails: first those that
are named after the faulty file, then those of its room, golden flights, whole loops, and the rest.
"""

import argparse
import contextlib
import os
import queue
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path, PurePosixPath

sys.path.insert(0, str(Path(__file__).parents[1]))

from mutants.faults import CHOSEN, ROOT, Fault, chosen_faults, drawn_faults, explanations

LEAST_CHOSEN, LEAST_DRAWN = 0.95, 0.85  # shares that have to be caught
_LONGEST = 4 * 3600.0  # s, of all tests
_LONGEST_TEST = 300  # s
_FIRST = ("golden", "evals", "loop", "run")  # rooms that judge whole loops
# Those of a fault itself, and of processes that are slow and tell little of the rooms below.
_NOT_RUN = ("mutants", "adversary", "benchmarks")
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.M)
_running: set[subprocess.Popen] = set()


def files_of(file: str, root: Path = ROOT, *, is_brief: bool = False) -> list[str]:
    """The files of tests that look for a fault in a file, those first that are the likeliest.

    Those are all of them, or where it `is_brief` those of the file's room.
    """
    room, name = PurePosixPath(file).parts[-2], PurePosixPath(file).stem

    def order(test: Path) -> tuple[int, str]:
        own = test.parent.name
        if own == room:
            return (0 if test.stem.startswith(f"test_{name}") else 1), str(test)
        return 2 + (_FIRST.index(own) if own in _FIRST else len(_FIRST)), str(test)

    found = sorted((root / "tests").glob("*/test_*.py"), key=order)
    found = [path for path in found if path.parent.name not in _NOT_RUN]
    if is_brief:
        found = [path for path in found if path.parent.name == room]
    return [str(path.relative_to(root)) for path in found]


def copy_of_checkout(folder: Path) -> Path:
    """A copy of what git tracks, or would, with the content of the working tree."""
    call = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(call, cwd=ROOT, capture_output=True, check=True).stdout
    for name in filter(None, os.fsdecode(names).split("\0")):
        if os.path.lexists(ROOT / name):  # or it is deleted, and git does not know yet
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name, follow_symlinks=False)
    return folder


def run_tests(copy: Path, tests: list[str]) -> tuple[int, str]:
    """The exit code of tests up to the first one that fails, and which one that is."""
    (copy / "out").mkdir(exist_ok=True)
    kept = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST_") and k != "CI"}
    environment = kept | {"PYTHONPATH": str(copy), "OPENBLAS_NUM_THREADS": "1"}
    environment |= {"XDG_CACHE_HOME": str(copy / "out"), "PYTHONDONTWRITEBYTECODE": "1"}
    call = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-n", "0"]
    call += ["-m", "not nightly", f"--basetemp={copy / 'out' / 'tests'}", "--tb=no", "-W", "ignore"]
    call += ["-o", f"faulthandler_timeout={_LONGEST_TEST}"]
    call += ["-o", "faulthandler_exit_on_timeout=true", *tests]
    log = copy / "out" / "log"  # no pipe, which would stay open as long as a child has it
    with log.open("w") as out:
        process = subprocess.Popen(
            call, cwd=copy, env=environment, stdout=out, stderr=out, start_new_session=True
        )
        _running.add(process)
        try:
            code = process.wait(_LONGEST)
        except subprocess.TimeoutExpired:
            code = 1
        finally:
            with contextlib.suppress(ProcessLookupError):  # and all that it has started
                os.killpg(process.pid, signal.SIGKILL)
            _running.discard(process)
    failed = _FAILED.findall(log.read_text(errors="replace"))
    return code, failed[-1] if failed else f"exit code {code}"


def examined(
    fault: Fault, copies: "queue.SimpleQueue[Path]", *, is_brief: bool = False
) -> tuple[bool, str]:
    """Whether tests catch a fault, and which one does so first."""
    copy = copies.get()
    path = copy / fault.file
    text = path.read_text(encoding="utf-8")
    try:
        path.write_text(fault.made_in(text), encoding="utf-8")
        code, by = run_tests(copy, files_of(fault.file, copy, is_brief=is_brief))
    finally:
        path.write_text(text, encoding="utf-8")
        copies.put(copy)
    return code not in (0, -signal.SIGKILL, -signal.SIGTERM), by


def examine(faults: list[Fault], jobs: int, *, is_brief: bool) -> int:
    """Prints what becomes of faults; 1 where too few are caught, 2 where tests fail without one."""
    caught: dict[Fault, bool] = {}
    with tempfile.TemporaryDirectory(prefix="mutants-", ignore_cleanup_errors=True) as folder:
        copies: queue.SimpleQueue[Path] = queue.SimpleQueue()
        for number in range(jobs):
            copies.put(copy_of_checkout(Path(folder) / str(number)))
        with ThreadPoolExecutor(jobs) as pool:
            try:
                looking = {t for f in faults for t in files_of(f.file, is_brief=is_brief)}
                copy = copies.get()
                code, by = pool.submit(run_tests, copy, sorted(looking)).result()
                copies.put(copy)
                if code:
                    print(f"without a fault the tests fail: {by}", file=sys.stderr)
                    return 2
                futures = {
                    pool.submit(examined, fault, copies, is_brief=is_brief): fault
                    for fault in faults
                }
                for future in as_completed(futures):
                    fault = futures[future]
                    caught[fault], by = future.result()
                    said = f"caught by {by}" if caught[fault] else "SURVIVED"
                    print(f"{fault.file}:{fault.number} {said}", flush=True)
            except KeyboardInterrupt:
                pool.shutdown(wait=False, cancel_futures=True)
                for process in [*_running]:
                    os.killpg(process.pid, signal.SIGKILL)
                print(f"interrupted after {len(caught)} of {len(faults)}")
                return 130
    return summary(caught)


def summary(caught: dict[Fault, bool]) -> int:
    """Prints what survived, and why; the shares of what is caught; 1 where one is too small."""
    explained = explanations()
    for fault, is_caught in caught.items():
        if not is_caught:
            print(f"SURVIVED {fault.file}:{fault.number}\n    {fault.line}\n -> {fault.becomes}")
            print(f"    {explained.get(fault.key, 'not explained')}")
    is_enough = True
    for name, is_drawn, least in (("chosen", False, LEAST_CHOSEN), ("drawn", True, LEAST_DRAWN)):
        some = [is_caught for fault, is_caught in caught.items() if fault.is_drawn == is_drawn]
        is_enough &= sum(some) >= least * len(some)
        print(f"{name}: {sum(some)} of {len(some)} are caught (at least {least:.0%} asked)")
    return 0 if is_enough else 1


def main() -> int:
    """Runs the command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m mutants", description=__doc__)
    parser.add_argument("--chosen", type=int, metavar="N", help="so many of faults.yaml (all)")
    parser.add_argument("--drawn", type=int, default=120, metavar="N", help="drawn ones (120)")
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn (0)")
    parser.add_argument("--file", default="", metavar="PART", help="in files of such a path")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="copies at a time (2)")
    parser.add_argument("--brief", action="store_true", help="run the tests of its room alone")
    parser.add_argument("--list", action="store_true", help="print the faults, run no tests")
    options = parser.parse_args()
    chosen, gone = chosen_faults()
    for line in gone:
        print(f"change {CHOSEN.name}: {line}", file=sys.stderr)
    if options.chosen is not None:
        chosen = random.Random(options.seed).sample(chosen, min(options.chosen, len(chosen)))
    faults = [*chosen, *drawn_faults(options.seed, options.drawn)]
    faults = [fault for fault in faults if options.file in fault.file]
    if options.list:
        for fault in faults:
            print(f"{fault.file}:{fault.number}\n    {fault.line}\n -> {fault.becomes}")
        return 0
    return examine(faults, options.jobs, is_brief=options.brief)


if __name__ == "__main__":
    sys.exit(main())
