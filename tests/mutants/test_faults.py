"""Faults can be made, are the same for a seed, and are caught by the tests that look for them."""

import queue

import pytest

pytest.importorskip("cosmic_ray")  # it is not where the lowest versions are tried

from mutants import faults
from mutants.__main__ import examined, files_of, summary
from mutants.faults import ROOT, chosen_faults, drawn_faults, explanations


def test_chosen_faults_change_a_line_that_is_found_once_and_compile():
    found, gone = chosen_faults()
    assert not gone, "\n".join(gone)
    for fault in found:
        made = fault.made_in((ROOT / fault.file).read_text(encoding="utf-8"))
        assert made.split("\n")[fault.number - 1].strip() == fault.becomes.strip()
        compile(made, fault.file, "exec")


def test_explained_faults_are_of_lines_that_are_there():
    for file, line, _ in explanations():
        lines = (ROOT / file).read_text(encoding="utf-8").split("\n")
        assert line in [line.strip() for line in lines], f"{file}: {line}"


def test_a_line_that_is_not_found_once_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(faults, "CHOSEN", tmp_path / "faults.yaml")
    faults.CHOSEN.write_text(
        "Makefile: {no such line: another, 'PYTHON ?= python3': a}\na.py: {b: c}"
    )
    found, gone = chosen_faults()
    assert [fault.becomes for fault in found] == ["a"]
    assert [line.partition(": ")[0] for line in gone] == ["Makefile", "a.py"]


def test_drawn_faults_are_those_of_their_seed_and_of_a_line_each(monkeypatch):
    monkeypatch.setattr(faults, "DRAWN_OF", ("loop",))
    first, again, others = (drawn_faults(seed, 5) for seed in (1, 1, 2))
    assert first == again != others
    for fault in first:
        assert fault.file.startswith("drake_nonstop/loop/")
        text = (ROOT / fault.file).read_text(encoding="utf-8")
        pairs = zip(text.split("\n"), fault.made_in(text).split("\n"), strict=True)
        changed = [k for k, (old, new) in enumerate(pairs, start=1) if old != new]
        assert changed == [fault.number]


def test_the_tests_of_the_file_come_first_then_its_room_then_whole_loops():
    rooms = [name.split("/")[1] for name in files_of("drake_nonstop/mechanics/cable.py")]
    assert files_of("drake_nonstop/mechanics/cable.py")[0] == "tests/mechanics/test_cable.py"
    order = [*dict.fromkeys(rooms)]
    assert order[0] == "mechanics"
    assert {*order[1:3]} == {"golden", "evals"}
    assert {"blocks", "loop", "run"} <= {*order[3:]}


@pytest.mark.nightly("processes")
@pytest.mark.parametrize(("stated", "is_caught"), [("1", True), ("2", False)])
def test_a_fault_is_caught_where_a_test_fails(tmp_path, stated, is_caught):
    (tmp_path / "drake_nonstop" / "some").mkdir(parents=True)
    (tmp_path / "tests" / "some").mkdir(parents=True)
    (tmp_path / "drake_nonstop" / "some" / "part.py").write_text("    value = 1\n")
    test = f"def test_it():\n    assert {stated!r} in open('drake_nonstop/some/part.py').read()\n"
    (tmp_path / "tests" / "some" / "test_part.py").write_text(test)
    copies: queue.SimpleQueue = queue.SimpleQueue()
    copies.put(tmp_path)
    fault = faults.Fault("drake_nonstop/some/part.py", 1, "value = 1", "value = 2")
    found, by = examined(fault, copies)
    assert found == is_caught
    assert by == ("tests/some/test_part.py::test_it" if is_caught else "exit code 0")
    assert "value = 1" in (tmp_path / fault.file).read_text()


def test_survivors_are_told_and_too_many_of_them_fail(capsys):
    some = [faults.Fault("a.py", k, f"old {k}", "new", k > 20) for k in range(1, 31)]
    assert summary({fault: fault.number not in (1, 25) for fault in some}) == 0
    told = capsys.readouterr().out
    assert "SURVIVED a.py:25\n    old 25\n -> new" in told
    assert "chosen: 19 of 20 are caught" in told
    assert summary({fault: fault.number not in (25, 26) for fault in some}) == 1
