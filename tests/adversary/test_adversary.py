"""A small part of what `make adversary` tries."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import nightly_beyond

from adversary.trying import CLASSES, draw, shares, try_all
from adversary.values import SPELLINGS
from adversary.verdicts import Verdict, judge_sentence

TESTS = Path(__file__).parents[1]


def test_cases_that_are_tried_are_judged():
    tried = try_all([("overrides", 1), ("python", 1)], 7, jobs=1)
    assert [case.verdict.faults for case in tried] == [[], []]
    assert [case.verdict.ending for case in tried] == ["refused", "refused"]


@pytest.mark.nightly("adversary")
@pytest.mark.parametrize(
    ("classes", "count"),
    [
        (["yaml", "overrides", "python"], 40),
        (["files", "command_line", "blocks"], 9),
        (["signals", "kills"], 2),
    ],
)
def test_bad_inputs_get_one_sentence_and_nothing_is_lost(classes, count):
    call = [sys.executable, "-m", "adversary", "--class", *classes, "--count", str(count)]
    result = subprocess.run(
        [*call, "--seed", "7"], cwd=TESTS, capture_output=True, text=True, env=dict(os.environ)
    )
    assert result.returncode == 0, result.stdout + result.stderr


# Those of files are drawn of the results of a flight.
DRAWN_FAST = [name for name in CLASSES if name != "files"]


@pytest.mark.parametrize(
    "class_name", nightly_beyond(len(DRAWN_FAST), "adversary", [*DRAWN_FAST, "files"])
)
def test_a_case_depends_on_its_class_seed_and_number_only(class_name):
    first = [draw(class_name, 3, number).text for number in range(5)]
    assert [draw(class_name, 3, number).text for number in reversed(range(5))] == first[::-1]
    assert [draw(class_name, 4, number).text for number in range(5)] != first


def test_two_thousand_cases_are_of_all_classes():
    drawn = shares(2000)
    assert len(drawn) == len(set(drawn)) == 2000
    assert {name for name, _ in drawn} == set(CLASSES)


@pytest.mark.parametrize(
    ("sentence", "is_good"),
    [
        ("system.load_mass = -1.0: give a finite number greater than zero", True),
        ("load_mass must be positive", False),
        ("system.load_mass = -1.0: give\na number", False),
        ("system.load_mass = -1.0: TypeError: no number", False),
    ],
)
def test_a_sentence_names_field_value_and_remedy(sentence, is_good):
    verdict = Verdict()
    judge_sentence(verdict, sentence)
    assert bool(verdict.faults) is not is_good


def test_spellings_mean_what_python_reads_where_it_reads_them():
    for spelling, meant in SPELLINGS.items():
        if meant is not None and spelling[:2] not in ("0x", "0b", "0o"):
            assert np.isclose(float(spelling.replace("__", "_")), meant)
