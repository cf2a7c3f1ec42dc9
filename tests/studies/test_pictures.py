"""Figures that a fork of the process draws, while it makes the other pictures itself."""

import contextlib
import os
import sys
import time

import pytest

from drake_nonstop.studies import results_folder
from drake_nonstop.studies.results_folder import write_pictures

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="no other system forks")


@pytest.fixture
def write(monkeypatch, tmp_path):
    """Writes pictures by a function of the item; returns the texts of those that are there."""
    monkeypatch.setattr(results_folder, "figure_names", lambda run: ["tensions", "limits"])
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1})

    def written(content, error=(), **options):
        def picture(run, item, file):
            file.write(str(content(item)).encode())

        monkeypatch.setattr(results_folder, "_write_picture", picture)
        with contextlib.suppress(error):
            write_pictures(None, tmp_path, may_fork=True, **options)
        return {file.name: file.read_text() for file in tmp_path.rglob("*") if file.is_file()}

    return written


def test_a_fork_draws_the_figures(write):
    pids = write(lambda item: os.getpid())
    assert pids["diagram.svg"] == pids["replay.html"] == str(os.getpid())
    assert pids["tensions.png"] == pids["limits.png"] != str(os.getpid())


def test_what_a_fork_does_not_draw_is_drawn(write):
    own = os.getpid()

    def content(item):
        if os.getpid() != own:
            raise MemoryError
        return own

    pids = write(content)
    assert set(pids.values()) == {str(own)}
    assert len(pids) == 4


def test_an_interrupt_ends_the_fork_and_leaves_nothing_half_written(write):
    own, start = os.getpid(), time.monotonic()

    def content(item):
        if os.getpid() != own:
            time.sleep(60)
        time.sleep(0.3)
        raise KeyboardInterrupt

    assert write(content, KeyboardInterrupt) == {}
    assert time.monotonic() - start < 30
