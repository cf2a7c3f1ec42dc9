"""Progress on a terminal and in a log."""

import io
import itertools
import re
import time

import pytest

from drake_nonstop import RunProgress, TaskProgress

RUN = [(1.5,), (3.0,), (0.5,), (7.5,)]  # two runs, s
TASK = [("simulating", 0.25), ("simulating", 0.5), ("drawing", 0.1), ("drawing", 0.05)]


@pytest.mark.parametrize("is_terminal", [False, True])
@pytest.mark.parametrize(
    ("make", "told", "states"),
    [
        (
            TaskProgress,
            TASK,
            ["simulating: 25%", "simulating: 50%", "drawing: 10%", "drawing (2): 5%"],
        ),
        (
            lambda: RunProgress("quintic", 15.0),
            RUN,
            [
                f"quintic{number}: {time:.2f} of 15 s: {time / 15:.0%}"
                for (time,), number in zip(RUN, ("", "", " (2)", " (2)"), strict=True)
            ],
        ),
    ],
)
def test_each_state_is_a_line_or_written_over(is_terminal, make, told, states, monkeypatch):
    clock, stream = itertools.count(step=10), io.StringIO()
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))  # s
    stream.isatty = lambda: is_terminal
    monkeypatch.setattr("sys.stderr", stream)
    with make() as show:
        for each in told:
            show(*each)
    text = stream.getvalue()
    assert ("\r" in text, "\n" in text) == (is_terminal, not is_terminal)
    lines = [line.rstrip() for line in re.split("[\r\n]+", text) if line.strip()]
    assert [line.partition(" [")[0] for line in lines] == states
    assert all(re.search(r" \[\d+ s(, \d+ s left)?\]$", line) for line in lines)
    assert not is_terminal or text.endswith(f"\r{79 * ' '}\r")


def test_what_is_soon_over_leaves_no_lines(capsys):
    with TaskProgress() as show:
        for share in (0.0, 0.5, 1.0):
            show("simulating", share)
    assert capsys.readouterr().err == ""
