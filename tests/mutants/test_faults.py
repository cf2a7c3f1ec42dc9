import signal

import pytest

from mutants.faults import ROOT, Fault, FaultError, as_yaml, read_faults
from mutants.results import Result, summary
from mutants.stages import Ending, Verdict, files_of_tests, group_of, judge, room_of, stages_of

FAULTS = read_faults()
COLLECTION = "short test summary info =====\nERROR tests/blocks/test_wind.py\n!!!! stopping"
FAILURE = "short test summary info =====\nFAILED tests/blocks/test_wind.py::test_it[a - b] - no\n"
CONFTEST = "ImportError while loading conftest '/tmp/copy/tests/conftest.py'.\nE   no module"


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: f"{fault.file}: {fault.line}"[:80])
def test_a_fault_changes_a_line_that_is_found_once_and_compiles(fault):
    text = (ROOT / fault.file).read_text(encoding="utf-8")
    made = fault.made_in(text)
    pairs = zip(text.split("\n"), made.split("\n"), strict=True)
    assert [number for number, (old, new) in enumerate(pairs, 1) if old != new] == [
        fault.line_number(text)
    ]
    if fault.file.endswith(".py"):
        compile(made, fault.file, "exec")


def test_a_third_of_sixty_and_more_faults_is_drawn():
    drawn = [fault for fault in FAULTS if fault.origin == "drawn"]
    assert len(FAULTS) >= 60
    assert 3 * len(drawn) >= len(FAULTS)


def test_no_fault_is_there_twice():
    assert len({(fault.file, fault.line, fault.becomes) for fault in FAULTS}) == len(FAULTS)


@pytest.mark.parametrize("text", ["a = 1\n", "    b = 2\nb = 2\n"])
def test_a_line_that_is_not_found_once_is_refused(text):
    with pytest.raises(FaultError, match=r"found [02] times"):
        Fault("some.py", "b = 2", "b = 3", "factor", "chosen").made_in(text)


@pytest.mark.parametrize(
    "text",
    [
        "- {file: a.py, line: b, becomes: c, kind: sign}",
        "- {file: a.py, line: b, becomes: c, kind: sign, origin: given}",
        "- {file: a.py, line: 1, becomes: c, kind: sign, origin: drawn}",
        "- a.py",
    ],
)
def test_entries_that_are_no_faults_are_refused(tmp_path, text):
    path = tmp_path / "faults.yaml"
    path.write_text(text)
    with pytest.raises(FaultError, match="entry 1"):
        read_faults(path)


def test_what_is_written_is_read_again(tmp_path):
    path = tmp_path / "faults.yaml"
    path.write_text("".join(map(as_yaml, FAULTS)))
    assert read_faults(path) == FAULTS


TESTS = [
    "tests/blocks/test_wind.py",
    "tests/blocks/test_wind_profile.py",
    "tests/blocks/test_phase.py",
    "tests/cli/test_check.py",
    "tests/evals/test_wind.py",
    "tests/golden/test_signals.py",
    "tests/test_examples.py",
]


def test_the_tests_of_the_file_come_first_and_the_golden_ones_last():
    stages = stages_of("drake_nonstop/blocks/wind.py", TESTS)
    assert [(stage.number, list(stage.tests)) for stage in stages] == [
        (1, ["tests/blocks/test_wind.py", "tests/blocks/test_wind_profile.py"]),
        (1, ["tests/blocks/test_phase.py"]),
        (2, ["tests/evals/test_wind.py", "tests/cli/test_check.py", "tests/test_examples.py"]),
        (3, ["tests/golden/test_signals.py"]),
    ]


def test_stages_without_tests_are_left_out():
    stages = stages_of("drake_nonstop/planning/search.c", TESTS[:5])
    assert [(stage.number, len(stage.tests)) for stage in stages] == [(2, 5)]


@pytest.mark.parametrize(
    ("file", "room"),
    [
        ("diagrams/nonstop.py", "diagrams"),
        ("drake_nonstop/studies/ablation_report.py", "studies"),
        ("drake_nonstop/validation.py", ""),
    ],
)
def test_the_room_of_a_file(file, room):
    assert room_of(file) == room


def test_all_tests_but_those_of_the_faults_are_in_some_stage():
    tests = files_of_tests(ROOT)
    assert "tests/mechanics/test_cable.py" in tests
    assert "mutants" not in {group_of(test) for test in tests}
    for fault in FAULTS:
        stages = stages_of(fault.file, tests)
        assert sorted(test for stage in stages for test in stage.tests) == tests
        assert stages[0].number == 1


@pytest.mark.parametrize(
    ("code", "output", "ending", "by"),
    [
        (0, "", Ending.PASSED, ""),
        (1, FAILURE, Ending.CAUGHT, "tests/blocks/test_wind.py::test_it[a - b]"),
        (1, FAILURE.replace("FAILED", "ERROR"), Ending.CAUGHT, "test_it[a - b]"),
        (1, COLLECTION, Ending.CAUGHT, "collection of tests/blocks/test_wind.py"),
        (2, COLLECTION, Ending.CAUGHT, "collection of tests/blocks/test_wind.py"),
        (2, "!!!!! KeyboardInterrupt !!!!!", Ending.UNCLEAR, "exit code 2"),
        (2, FAILURE, Ending.UNCLEAR, "exit code 2"),
        (3, "INTERNALERROR> KeyError", Ending.UNCLEAR, "exit code 3"),
        (4, CONFTEST, Ending.CAUGHT, "collection, by conftest.py"),
        (4, "ERROR: file or directory not found", Ending.UNCLEAR, "exit code 4"),
        (5, "no tests ran", Ending.SKIPPED, ""),
        (None, "", Ending.CAUGHT, "time limit"),
        (-signal.SIGSEGV, "", Ending.CAUGHT, "signal 11"),
        (-signal.SIGABRT, "", Ending.CAUGHT, "signal 6"),
        (-signal.SIGKILL, "", Ending.UNCLEAR, "signal 9"),
        (-signal.SIGINT, "", Ending.UNCLEAR, "signal 2"),
    ],
)
def test_what_exit_codes_say(code, output, ending, by):
    verdict = judge(code, output)
    assert verdict.ending is ending
    assert by in verdict.by
    assert bool(verdict.test) == ("::" in by or "test_it" in by)


def test_what_is_only_printed_by_a_test_is_not_taken_for_its_failure():
    printed = "FAILED tests/cli/test_check.py::test_other - by a child\n"
    assert judge(1, printed + FAILURE).test == "tests/blocks/test_wind.py::test_it[a - b]"


def test_the_summary_has_the_survivors_and_both_shares():
    caught, golden = (Verdict(Ending.CAUGHT, "tests/test_a.py::test_b") for _ in range(2))
    unclear = Verdict(Ending.UNCLEAR, "exit code 3 of pytest")
    results = [
        Result(4, FAULTS[3], 10),
        Result(1, FAULTS[0], 20, caught, 1),
        Result(3, FAULTS[2], 30, golden, 3),
        Result(2, FAULTS[1], 40, unclear, 2),
    ]
    lines = summary(results).split("\n")
    assert "UNCLEAR" in lines[0]
    assert "SURVIVED" in lines[3]
    assert FAULTS[3].line in lines[4]
    assert "caught: 2 of 4, 50.0 %" in lines[-2]
    assert "without the golden tests: 1 of 4, 25.0 %" in lines[-1]


def test_the_summary_of_nothing():
    assert "0 of 0" in summary([])
