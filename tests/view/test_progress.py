"""Progress on a terminal and in a log."""

import io
import re

import pytest

from drake_nonstop.view import progress
from drake_nonstop.view.progress import RunProgress, TaskProgress


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def at_once(monkeypatch):
    """Every state is shown, however soon after the one before."""
    monkeypatch.setattr(progress, "_LINE_PERIOD", 0.0)
    monkeypatch.setattr(progress, "_BAR_PERIOD", 0.0)


def test_a_log_has_a_line_for_each_state(at_once, capsys):
    with TaskProgress() as show:
        show("simulating", 0.25)
        show("simulating", 0.5)
        show("drawing", 0.1)  # the next task
    text = capsys.readouterr().err
    assert "\r" not in text
    lines = [line for line in text.splitlines() if line.startswith(("simulating", "drawing"))]
    assert [re.findall(r"(\w+) .* (\d+)%", line) for line in lines] == [
        [("simulating", "25")],
        [("simulating", "50")],
        [("drawing", "10")],
    ]
    assert all(re.search(r"% \[\d\d:\d\d, \d\d:\d\d left\]$", line) for line in lines)


def test_a_log_of_a_run_has_its_time_and_speed(at_once, capsys):
    with RunProgress("quintic", 15.0) as show:
        show(1.5)
        show(3.0)
        show(0.5)  # another run
        show(1.0)
    lines = capsys.readouterr().err.splitlines()
    pattern = r"quintic \|[#.]+\| +(\d+\.\d+) / 15 s(?:, (\d+\.\d) x real time)?"
    shown = [match for match in (re.fullmatch(pattern, line) for line in lines) if match]
    factors = {float(match[1]): match[2] for match in shown}
    assert [*factors] == [1.5, 3.0, 0.5, 1.0]
    assert all(float(factors[time]) > 0 for time in (3.0, 1.0))


def test_what_is_soon_over_leaves_no_lines(capsys):
    with TaskProgress() as show:
        for share in (0.0, 0.5, 1.0):
            show("simulating", share)
    assert capsys.readouterr().err == ""


def test_a_terminal_has_one_line_that_is_written_over(at_once, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    with TaskProgress() as show:
        show("simulating", 0.5)
        show("drawing", 0.2)
    text = terminal.getvalue()
    assert text.count("\n") == 1
    assert text.endswith("\n")
    states = [state for state in text.split("\r") if state.strip()]
    assert "simulating" in states[1]
    assert "drawing" in states[-1]
    assert "100%" in states[-1]
