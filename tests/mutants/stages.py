"""Which tests look for a fault, in which order, and what the end of their run says."""

import re
import signal
from collections.abc import Iterable
from enum import Enum
from pathlib import Path, PurePosixPath
from typing import NamedTuple

GOLDEN, OWN = "golden", "mutants"  # folders of tests
_WHOLE = ("evals",)  # rooms that judge whole loops: the first ones after a fault's own room

TIME_LIMIT = "time limit"  # what ends a stage that takes too long
# What the end of a process by a signal says: these are what a fault does, others what was done to
# the process, such as by the system where memory is short.
_CRASHES = (signal.SIGABRT, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGSEGV)
# A file, or a test with what it is parametrized by.
_SUMMARY = re.compile(r"^(?:FAILED|ERROR) (\S+?\.py(?:::[^\[\s]+(?:\[.*?\](?= - |$))?)?)", re.M)
_SUMMARY_BEGINS = "short test summary info"
_OF_CONFTEST = re.compile(r"^ImportError while loading conftest '(.+)'", re.M)


class Stage(NamedTuple):
    """Tests that are run together."""

    number: int  # 1: the room of the faulty file, 2: all others, 3: those against stored numbers
    tests: tuple[str, ...]  # files, from the checkout's root


class Ending(Enum):
    """What the end of a run says of a fault."""

    PASSED = "passed"
    SKIPPED = "no tests"
    CAUGHT = "caught"
    UNCLEAR = "unclear"


class Verdict(NamedTuple):
    """The ending with what it is known by."""

    ending: Ending
    by: str = ""  # the test, or a few words
    test: str = ""  # the test again, where it is one that can be run alone


def files_of_tests(root: Path) -> list[str]:
    """All files of tests but those of the faults, from the checkout's root."""
    found = sorted((root / "tests").rglob("test_*.py"))
    files = [path.relative_to(root).as_posix() for path in found]
    return [file for file in files if group_of(file) != OWN]


def group_of(test: str) -> str:
    """The folder of tests that a file is in; "" for one in none."""
    parts = PurePosixPath(test).parts
    return parts[1] if len(parts) > 2 else ""


def room_of(file: str) -> str:
    """The folder of a source file, as of its tests; "" for one in none."""
    parts = [part for part in PurePosixPath(file).parts if part != "drake_nonstop"]
    return parts[0] if len(parts) > 1 else ""


def stages_of(file: str, tests: Iterable[str]) -> list[Stage]:
    """The stages of a fault in a file, those without tests left out.

    First the tests that are named after the file, then those of its room, all others, and last
    those of stored numbers.

    Args:
        file: the faulty one, from the checkout's root.
        tests: all files of tests.
    """
    room, name = room_of(file), f"test_{PurePosixPath(file).stem}"
    of_room = [test for test in tests if room and group_of(test) == room]
    mirrored = [test for test in of_room if PurePosixPath(test).stem.startswith(name)]
    golden = [test for test in tests if group_of(test) == GOLDEN]
    others = [test for test in tests if test not in {*of_room, *golden}]
    others.sort(key=lambda test: group_of(test) not in _WHOLE)
    stages = [
        Stage(1, tuple(mirrored)),
        Stage(1, tuple(test for test in of_room if test not in mirrored)),
        Stage(2, tuple(others)),
        Stage(3, tuple(golden)),
    ]
    return [stage for stage in stages if stage.tests]


def judge(code: int | None, output: str) -> Verdict:
    """What the end of a run with a fault says, where the same tests pass without it.

    Exit code 1 is a failed test. An error at collection ends with 2, or with 1 where others were
    collected before, and one in a conftest.py with 4: these are imports that the fault breaks. Any
    other 2 (interrupted), 3 (an error of pytest's own) or 4 (a wrong call) says nothing.

    Args:
        code: of pytest; negative: minus the signal that ended it; None: it took too long.
        output: of pytest.
    """
    if code is None:
        return Verdict(Ending.CAUGHT, TIME_LIMIT)
    if code == 0:
        return Verdict(Ending.PASSED)
    if code == 5:
        return Verdict(Ending.SKIPPED)
    if code < 0:
        ending = Ending.CAUGHT if -code in _CRASHES else Ending.UNCLEAR
        return Verdict(ending, f"the end of pytest by signal {-code}")
    found = _SUMMARY.search(output.rpartition(_SUMMARY_BEGINS)[2])
    if found is not None and "::" in found[1] and code == 1:
        return Verdict(Ending.CAUGHT, found[1], found[1])
    if found is not None and "::" not in found[1] and code in (1, 2):
        return Verdict(Ending.CAUGHT, f"collection of {found[1]}")
    conftest = _OF_CONFTEST.search(output)
    if conftest is not None and code == 4:
        return Verdict(Ending.CAUGHT, f"collection, by {PurePosixPath(conftest[1]).name}")
    said = output.strip().splitlines() or ["it says nothing"]
    return Verdict(Ending.UNCLEAR, f"exit code {code} of pytest, {said[-1].strip()[:100]}")
