"""Files of results: whole or not at all, and each run's row kept from its end on."""

import contextlib
import json
import os
import re
import sys
import tempfile
import time

import numpy as np
import pytest

from drake_nonstop import ScenarioError, load_scenario, simulate, write_results
from drake_nonstop.cli.main import main
from drake_nonstop.run.run import Run
from drake_nonstop.studies import results_folder
from drake_nonstop.studies.files import (
    as_path,
    free_folder,
    replacing_file,
    replacing_files,
    require_writable,
    require_writable_file,
    write_json,
)
from drake_nonstop.studies.journal import JOURNAL, StudyInterrupted, open_journal, settings_of
from drake_nonstop.studies.results_folder import write_pictures
from drake_nonstop.view.figure_style import FORMATS


@pytest.fixture(scope="module")
def run():
    return simulate(load_scenario("quintic", ["simulation_duration=0.1"]))


@pytest.mark.parametrize("kind", [*FORMATS, False])
def test_a_folder_reads_back_as_the_run_that_made_it(run, tmp_path, kind):
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "tensions.png").write_text("of an earlier run")
    (tmp_path / "notes.txt").write_text("mine")
    metrics = write_results(run, tmp_path, figures=kind, replay=False)
    assert json.loads((tmp_path / "metrics.json").read_text()) == metrics
    again = Run.load(tmp_path)
    assert again.scenario == run.scenario
    for name, values in run.signals.items():
        np.testing.assert_array_equal(again.signals[name], values)
    figures = {path.name for path in tmp_path.glob("figures/*")}
    assert ("tensions.png" in figures) == (kind == "png")
    assert bool(figures) == bool(kind)
    assert {path.partition(".")[2] for path in figures} <= {kind}
    assert (tmp_path / "notes.txt").exists()


def test_files_replace_earlier_ones_together_and_none_on_an_error(tmp_path):
    (tmp_path / "old").mkdir()
    for name in ("a", "b", "old/c"):
        (tmp_path / name).write_text("before")
    items = ["a", "b", "old/c", "new/d"]
    with contextlib.suppress(ZeroDivisionError), replacing_files(tmp_path, items) as new:
        (new / "a").write_text("after")
        raise ZeroDivisionError
    assert (tmp_path / "a").read_text() == "before"
    with replacing_files(tmp_path, items) as new:
        (new / "new").mkdir()
        for name in ("a", "new/d"):
            (new / name).write_text("after")
    left = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*")}
    assert left == {"a", "new", "new/d"}


def replace_in_a_folder_that_is_gone(folder):
    with replacing_file(folder / "no" / "a"):
        pass


# What is in the way, what is done there, and what the sentence has.
REFUSED = [
    ("folder", lambda p: require_writable(p, ["it"]), ("--out", "it is no file", "move it")),
    ("file", lambda p: require_writable(p, ["it/a"]), ("--out", "file it", "move it")),
    ("folder", lambda p: require_writable_file(p / "it"), ("--out", "it", "give another file")),
    ("pipe", lambda p: require_writable_file(p / "it"), ("--out", "it", "give another file")),
    ("", lambda p: require_writable(p / "a\0b"), ("--out", "give a folder that can be written")),
    ("", lambda p: require_writable(p / ("x" * 300)), ("--out", "that can be written")),
    ("", lambda p: require_writable(p, room=1e18), ("--out", "with room for 1000000000000 MB")),
    ("", replace_in_a_folder_that_is_gone, ("--out", "no", "give a folder")),
    ("", lambda p: as_path(3), ("folder", "3", "give a path")),
]


@pytest.mark.parametrize(("there", "act", "words"), REFUSED)
def test_what_cannot_be_written_is_one_sentence(tmp_path, there, act, words):
    make = {"folder": os.mkdir, "file": lambda p: p.write_text(""), "pipe": os.mkfifo}
    if there:
        make[there](tmp_path / "it")
    with pytest.raises(ScenarioError) as raised:
        act(tmp_path)
    assert all(word in str(raised.value) for word in words)


def test_results_of_other_settings_have_folders_of_their_own(tmp_path):
    place = tmp_path / "quintic"
    assert free_folder(place, "scenario.yaml", "a") == place
    place.mkdir()
    (place / "scenario.yaml").write_text("a")
    assert free_folder(place, "scenario.yaml", "a") == place
    assert free_folder(place, "scenario.yaml", "b") == tmp_path / "quintic_2"


def test_numbers_of_numpy_and_none_that_is_finite_are_json(tmp_path):
    write_json(tmp_path / "a.json", {"a": np.float64(0.5), "b": np.nan, "c": [np.int64(3)]})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": 0.5, "b": None, "c": [3]}


def write(folder, settings="s", keys="ab", error=None, **options):
    with open_journal(folder, settings, **options) as journal:
        for key in keys:
            journal.record(key, {"value": key * 3})
        if error:
            raise error
        return journal.rows


def test_rows_stay_until_a_restart(tmp_path):
    write(tmp_path)
    assert write(tmp_path, keys="") == {"a": {"value": "aaa"}, "b": {"value": "bbb"}}
    assert write(tmp_path, keys="", restart=True) == {}
    assert not (tmp_path / JOURNAL).exists()


def test_a_last_line_that_was_cut_short_is_dropped(tmp_path):
    write(tmp_path)
    path = tmp_path / JOURNAL
    content = path.read_bytes()
    for length in range(len(content)):
        path.write_bytes(content[:length])
        lines = content[:length].count(b"\n")
        assert [*write(tmp_path, keys="")] == ["a", "b"][: max(0, lines - 1)]
    path.write_bytes(content[:-3])
    assert [*write(tmp_path, keys="c")] == ["a", "c"]
    assert [*write(tmp_path, keys="")] == ["a", "c"]


DAMAGED = [b"x\n", b"[]\n", b'{"settings": "s"}\n3\n', b'{"settings": "s"}\n{}\n', b"\xff\n"]
OTHER = b'{"settings": "t"}\n'


@pytest.mark.parametrize("content", [*DAMAGED, OTHER])
def test_a_damaged_journal_and_one_of_other_settings_stay_and_are_refused(tmp_path, content):
    (tmp_path / JOURNAL).write_bytes(content)
    with pytest.raises(ScenarioError, match=r"--out = .*; give another folder, or --restart"):
        write(tmp_path)
    assert (tmp_path / JOURNAL).read_bytes() == content


def test_two_studies_do_not_run_in_one_folder(tmp_path):
    with open_journal(tmp_path, "s"), pytest.raises(ScenarioError, match="is running in it"):
        write(tmp_path)


def test_what_is_there_stays_whatever_ends_the_study(tmp_path):
    new = tmp_path / "new"
    with pytest.raises(StudyInterrupted, match=r"^$"):
        write(new, keys="", error=KeyboardInterrupt())
    assert not new.exists()
    with pytest.raises(StudyInterrupted, match=r"^2 runs are in .*; the same call continues"):
        write(new, error=KeyboardInterrupt())
    with pytest.raises(ScenarioError, match="room to write to"):
        write(new, keys="c", error=OSError(28, "No space left on device"))
    assert [*write(new, keys="")] == ["a", "b", "c"]


def test_other_code_is_other_settings(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    module = tmp_path / "my_block_of_settings.py"
    found = set()
    for k in range(2):
        module.write_text(f"a = {k}\n")
        found.add(settings_of("x", "phase: !my_block_of_settings.Mine {}"))
    assert len(found) == 2


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """Writes pictures of functions of the item, with a fork; returns the texts that are there."""
    monkeypatch.setattr(results_folder, "figure_names", lambda run: ["tensions", "limits"])
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1})

    def written(content, error=()):
        def picture(run, item, file):
            file.write(str(content(item)).encode())

        monkeypatch.setattr(results_folder, "_write_picture", picture)
        with contextlib.suppress(error):
            write_pictures(None, tmp_path, may_fork=True)
        return {file.name: file.read_text() for file in tmp_path.rglob("*") if file.is_file()}

    return written


@pytest.mark.skipif(sys.platform != "linux", reason="no other system forks")
def test_a_fork_draws_figures_and_this_process_those_that_it_does_not(drawn):
    own = str(os.getpid())
    pids = drawn(lambda item: os.getpid())
    assert {name for name, pid in pids.items() if pid == own} == {"diagram.svg", "replay.html"}

    def content(item):
        if str(os.getpid()) != own:
            raise MemoryError
        return own

    assert {*drawn(content).values()} == {own}


@pytest.mark.skipif(sys.platform != "linux", reason="no other system forks")
def test_an_interrupt_ends_the_fork_and_leaves_nothing_half_written(drawn):
    own, start = os.getpid(), time.monotonic()

    def content(item):
        if os.getpid() != own:
            time.sleep(60)
        time.sleep(0.3)
        raise KeyboardInterrupt

    assert drawn(content, KeyboardInterrupt) == {}
    assert time.monotonic() - start < 30


def test_a_full_disk_at_the_end_keeps_the_results_elsewhere(tmp_path, monkeypatch, capsys):
    from drake_nonstop.cli import run as command

    whole = command.write_data

    def full(run, folder):
        if folder == tmp_path / "out":
            raise ScenarioError(f"--out = {folder}: give a folder with room to write to")
        return whole(run, folder)

    monkeypatch.setattr(command, "write_data", full)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    short = ["--set", "simulation_duration=0.05"]
    assert main(["run", "line", "--out", str(tmp_path / "out"), "--quiet", *short]) == 2
    (place,) = re.findall(r"the results are in (.*)\n", capsys.readouterr().err)
    assert Run.load(place).time[-1] == pytest.approx(0.05)
