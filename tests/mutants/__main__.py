"""Tests the tests by faults of a single line: `python -m mutants --only 3 7`, in `tests`."""

import argparse
import queue
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from mutants import drawing
from mutants.copies import Copy, EndedError, Processes, Ran
from mutants.faults import FILE, ORIGINS, ROOT, Fault, FaultError, read_faults
from mutants.results import LEAST_CAUGHT, LEAST_WITHOUT_GOLDEN, Result, line_of, summary
from mutants.stages import (
    TIME_LIMIT,
    Ending,
    Stage,
    files_of_tests,
    group_of,
    judge,
    stages_of,
)

_LEAST_LIMIT = 600.0  # s, of a stage, and of a group of tests of which no time is known
_SLOWER = 3.0  # times as long as without a fault a stage may take
_TOLD = 4000  # characters of what tests print that fail without a fault
_LONGEST = 4 * 3600.0  # s, of a group of tests without a fault


class _UnsoundError(RuntimeError):
    """The unchanged checkout does not do for tests of faults."""


class _Copies:
    """Copies for some processes at a time, and what is known of the tests in them."""

    def __init__(self, folder: Path, jobs: int):
        self._processes, self._free = Processes(), queue.SimpleQueue[Copy]()
        self._pool = ThreadPoolExecutor(jobs)
        self._seconds: dict[str, float] = {}  # that groups of tests take without a fault
        for number in range(jobs):
            copy = Copy(ROOT, folder / str(number), self._processes)
            found = copy.imported_from()
            if found != copy.root / "drake_nonstop":
                raise _UnsoundError(f"in the copy Python imports drake_nonstop from {found}")
            self._free.put(copy)
        self.tests = files_of_tests(copy.root)

    def end(self) -> None:
        """Ends all that is running."""
        self._processes.end()
        self._pool.shutdown(cancel_futures=True)

    def check_unchanged(self, groups: Sequence[str]) -> Iterator[str]:
        """Runs groups of tests without a fault; tells of each as it passes.

        Raises:
            _UnsoundError: one of them does not.
        """
        futures = {self._pool.submit(self._unchanged, group): group for group in groups}
        for future in as_completed(futures):
            group, ran = futures[future], future.result()
            verdict = judge(ran.code, ran.output)
            if verdict.ending not in (Ending.PASSED, Ending.SKIPPED):
                raise _UnsoundError(
                    f"without a fault the tests fail, so that no figure would say anything: "
                    f"{verdict.by}, in tests/{group}\n{ran.output[-_TOLD:]}"
                )
            self._seconds[group] = ran.seconds
            yield f"without a fault: tests/{group:22}{verdict.ending.value:8} {ran.seconds:6.0f} s"

    def _unchanged(self, group: str) -> Ran:
        tests = [test for test in self.tests if group_of(test) == group]
        copy = self._free.get()
        try:
            return copy.run_tests(tests, _LONGEST)
        finally:
            self._free.put(copy)

    def examine(self, faults: Sequence[tuple[int, Fault]]) -> Iterator[Result]:
        """What becomes of numbered faults, each as it is known."""
        futures: list[Future[Result]] = [
            self._pool.submit(self._examined, number, fault) for number, fault in faults
        ]
        for future in as_completed(futures):
            yield future.result()

    def _examined(self, number: int, fault: Fault) -> Result:
        copy, start = self._free.get(), time.monotonic()
        try:
            line = fault.line_number((copy.root / fault.file).read_text(encoding="utf-8"))
            result = Result(number, fault, line)
            with copy.with_fault(fault):
                for stage in stages_of(fault.file, self.tests):
                    ran = copy.run_tests(stage.tests, self._limit(stage))
                    verdict = judge(ran.code, ran.output)
                    if verdict.ending in (Ending.CAUGHT, Ending.UNCLEAR):
                        result = result._replace(verdict=verdict, stage=stage.number)
                        break
            test = result.verdict.test
            again = (test,) if test else ()
            if result.verdict.by == TIME_LIMIT:
                again = stage.tests
            if again:
                ran = copy.run_tests(again, self._limit(Stage(0, again)))
                if judge(ran.code, ran.output).ending is Ending.CAUGHT:
                    said = f"{test or TIME_LIMIT} ends it now and then without the fault, too"
                    result = result._replace(
                        verdict=result.verdict._replace(ending=Ending.UNCLEAR, by=said)
                    )
            return result._replace(seconds=time.monotonic() - start)
        finally:
            self._free.put(copy)

    def _limit(self, stage: Stage) -> float:
        """The longest time of a stage, s."""
        known = self._seconds
        groups = {group_of(test) for test in stage.tests}
        times = (_SLOWER * known[g] if g in known else _LEAST_LIMIT for g in groups)
        return max(_LEAST_LIMIT, sum(times))


def main() -> int:
    """Runs the command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m mutants", description=__doc__)
    parser.add_argument("--only", type=int, nargs="+", metavar="N", help="these faults, from 1 on")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="copies at a time (2)")
    parser.add_argument("--origin", choices=ORIGINS, help="faults of that origin")
    commands = parser.add_subparsers(dest="command", metavar="")
    draw = commands.add_parser("draw", help="append faults that are drawn at random")
    draw.add_argument("--seed", type=int, required=True, help="of what is drawn")
    draw.add_argument("--count", type=int, default=24, metavar="N", help="of faults (24)")
    draw.add_argument("--file", type=Path, default=FILE, help="that they are appended to")
    options = parser.parse_args()
    if options.command == "draw":
        return drawing.append(options.file, options.seed, options.count)
    faults = list(enumerate(read_faults(), start=1))
    wrong = [number for number in options.only or [] if not 1 <= number <= len(faults)]
    if wrong or options.jobs < 1:
        parser.error(f"give numbers from 1 to {len(faults)}, and at least one job")
    faults = [
        (number, fault)
        for number, fault in faults
        if (options.only is None or number in options.only)
        and options.origin in (None, fault.origin)
    ]
    for _, fault in faults:
        fault.line_number((ROOT / fault.file).read_text(encoding="utf-8"))  # or an error at once
    for number in (signal.SIGINT, signal.SIGTERM):  # in the background the first is ignored
        signal.signal(number, signal.default_int_handler)
    with tempfile.TemporaryDirectory(
        prefix="drake-nonstop-mutants-", ignore_cleanup_errors=True
    ) as folder:
        return _run(Path(folder), faults, options.jobs, is_whole=options.only is None)


def _run(folder: Path, faults: list[tuple[int, Fault]], jobs: int, *, is_whole: bool) -> int:
    results: list[Result] = []
    copies = None
    try:
        copies = _Copies(folder, jobs)
        looked_at = copies.tests
        if not is_whole:
            stages = [stage for _, fault in faults for stage in stages_of(fault.file, looked_at)]
            looked_at = [test for stage in stages if stage.number == 1 for test in stage.tests]
        for said in copies.check_unchanged(sorted({group_of(test) for test in looked_at})):
            print(said, flush=True)
        for result in copies.examine(faults):
            results.append(result)
            print(line_of(result), flush=True)
    except _UnsoundError as error:
        print(error, file=sys.stderr)
        return 2
    except (KeyboardInterrupt, EndedError):
        print(f"interrupted after {len(results)} of {len(faults)} faults")
        print(summary(results))
        return 130
    finally:
        if copies is not None:
            copies.end()
    print(summary(results))
    shares = [result.is_caught for result in results], [r.is_caught_early for r in results]
    least = LEAST_CAUGHT, LEAST_WITHOUT_GOLDEN
    is_enough = all(sum(s) >= share * len(s) for s, share in zip(shares, least, strict=True))
    return 0 if is_enough else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except FaultError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
