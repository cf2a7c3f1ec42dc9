"""Progress on a terminal and in a log."""

import io
import itertools
import re
import time

import pytest

from drake_nonstop import RunProgress, TaskProgress

# What they are told, and what they show of that.
OF_TASK = {
    ("simulating", 0.25): "simulating: 25%",
    ("simulating", 0.5): "simulating: 50%",
    ("drawing", 0.1): "drawing: 10%",
    ("drawing", 0.05): "drawing (2): 5%",
}
OF_RUN = {
    (1.5,): "quintic: 1.50 of 15 s: 10%",
    (3.0,): "quintic: 3.00 of 15 s: 20%",
    (0.6,): "quintic (2): 0.60 of 15 s: 4%",
}


@pytest.mark.parametrize("is_terminal", [False, True])
@pytest.mark.parametrize("rows", [OF_TASK, OF_RUN])
def test_each_state_is_a_line_or_written_over(is_terminal, rows, monkeypatch):
    clock, stream = itertools.count(step=10), io.StringIO()
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))  # s
    stream.isatty = lambda: is_terminal
    monkeypatch.setattr("sys.stderr", stream)
    with TaskProgress() if rows is OF_TASK else RunProgress("quintic", 15.0) as show:
        for told in rows:
            show(*told)
    text = stream.getvalue()
    assert ("\r" in text, "\n" in text) == (is_terminal, not is_terminal)
    lines = [line.rstrip() for line in re.split("[\r\n]+", text) if line.strip()]
    assert [line.partition(" [")[0] for line in lines] == [*rows.values()]
    assert all(re.search(r" \[\d+ s(, \d+ s left)?\]$", line) for line in lines)
    assert not is_terminal or text.endswith(f"\r{79 * ' '}\r")


def test_what_is_soon_over_leaves_no_lines(capsys):
    with TaskProgress() as show:
        for share in (0.0, 0.5, 1.0):
            show("simulating", share)
    assert capsys.readouterr().err == ""
