"""Folders of results: what is in the way, and what killed processes have left."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.studies import files, results_folder
from drake_nonstop.studies.files import (
    open_regular,
    replacing_file,
    replacing_files,
    require_writable,
    shared,
    write_json,
)
from drake_nonstop.studies.journal import JOURNAL, open_journal
from drake_nonstop.studies.results_folder import RUN_FILES, default_folder, stopped_folder
from drake_nonstop.validation import ScenarioError

_WRITER = """
import sys, time
from pathlib import Path
from drake_nonstop.studies.files import replacing_file, replacing_files
folder = Path(sys.argv[1])
with replacing_files(folder, ["a"]) as new, replacing_file(folder / "b") as file:
    (new / "a").write_text("new")
    print("writing", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def writer(tmp_path):
    """A process that is writing a file and a folder to tmp_path."""
    process = subprocess.Popen(
        [sys.executable, "-c", _WRITER, str(tmp_path)],
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert process.stdout.readline() == b"writing\n"
    yield process
    process.kill()
    process.communicate()


def unfinished(folder):
    return [path for path in folder.iterdir() if path.name.startswith(".new-")]


def write_both_ways(folder):
    with replacing_files(folder, ["c"]) as new:
        (new / "c").write_text("c")
    with replacing_file(folder / "d") as file:
        file.write(b"d")


def test_what_a_killed_process_was_writing_is_removed_by_the_next(tmp_path, writer, monkeypatch):
    monkeypatch.setattr(files, "_YOUNGEST_STALE", 0.0)
    assert len(unfinished(tmp_path)) == 2
    write_both_ways(tmp_path)
    assert len(unfinished(tmp_path)) == 2  # its process lives
    writer.send_signal(signal.SIGKILL)
    writer.wait()
    assert len(unfinished(tmp_path)) == 2
    write_both_ways(tmp_path)
    assert unfinished(tmp_path) == []
    assert {path.name for path in tmp_path.iterdir()} == {"c", "d"}


def test_what_has_just_begun_is_not_taken_for_stale(tmp_path):
    (tmp_path / ".new-1").mkdir()
    write_both_ways(tmp_path)
    assert len(unfinished(tmp_path)) == 1
    time.sleep(1.1)
    write_both_ways(tmp_path)
    assert unfinished(tmp_path) == []


@settings(max_examples=40, deadline=None)
@given(item=st.sampled_from(RUN_FILES), kind=st.sampled_from(["folder", "file", "link"]))
def test_what_is_in_the_way_of_a_file_is_said_before(tmp_path_factory, item, kind):
    folder = tmp_path_factory.mktemp("results")
    path = folder / item
    is_inside = path.parent != folder
    if kind == "folder":
        path.mkdir(parents=True)
        (path / "mine").write_text("")
        words = f"its folder {item} is in the way"
    elif kind == "file" and is_inside:
        path.parent.write_text("")
        words = f"its file {path.parent.name} is in the way"
    else:  # what can be replaced
        path.parent.mkdir(exist_ok=True)
        path.symlink_to(folder) if kind == "link" else path.write_text("")
        words = ""
    if not words:
        require_writable(folder, RUN_FILES)
        return
    before = sorted(folder.rglob("*"))
    with pytest.raises(ScenarioError, match=f"^--out = .*: {words}: move it"):
        require_writable(folder, RUN_FILES)
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("name", ["x" * 300, "x" * 240 + "/" + "y" * 300, "a\0b"])
def test_a_name_that_is_none_is_one_sentence(tmp_path, name):
    with pytest.raises(ScenarioError, match=r"^--out = .*: give a folder that can be written"):
        require_writable(tmp_path / name, RUN_FILES)


def test_a_path_that_leaves_no_room_for_the_files_names_is_refused(tmp_path):
    folder = str(tmp_path)
    while len(folder) < 4040:  # the longest path has 4095 characters
        folder += "/" + "x" * min(200, 4060 - len(folder))
    require_writable(folder)
    with pytest.raises(ScenarioError, match="File name too long"):
        require_writable(folder, RUN_FILES)


def test_a_full_disk_is_said_before(tmp_path):
    with pytest.raises(ScenarioError, match="give a folder with room for 1000000000000 MB"):
        require_writable(tmp_path, room=1e18)


@pytest.mark.parametrize("folder", [3, None, ["a"], b"a"])
def test_what_is_no_path_is_one_sentence(folder):
    with pytest.raises(ScenarioError, match=r"^folder = .*: give a path"):
        require_writable(folder)


def test_what_a_killed_process_of_its_own_was_writing_is_removed_at_the_end(tmp_path, writer):
    with shared([tmp_path]):
        write_both_ways(tmp_path)
        assert len(unfinished(tmp_path)) == 2
        writer.send_signal(signal.SIGKILL)
    assert unfinished(tmp_path) == []


def test_what_another_process_is_writing_stays(tmp_path, writer):
    with shared([tmp_path]):
        pass
    assert len(unfinished(tmp_path)) == 2


_ENDS = """
import os, signal, sys, threading, time
from multiprocessing import get_context
from pathlib import Path
from drake_nonstop.cli.ending import CommandInterruption
from drake_nonstop.studies.files import replacing_file, replacing_files
from drake_nonstop.studies.processes import _exit_with_parent

def write(then):
    folder = Path(sys.argv[1])
    with replacing_files(folder, ["a"]) as new, replacing_file(folder / "b") as file:
        (new / "a").write_text("new")
        (new / "more").mkdir()
        then()

def ends_at_once():
    interruption = CommandInterruption()
    interruption.number = signal.SIGINT
    threading.Timer(0.05, interruption._end).start()
    while True:  # and begins again and again what it writes
        write(lambda: time.sleep(0.01))

def work(connection):
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    write(lambda: (connection.send(1), time.sleep(60)))

def parent_is_killed():
    here, there = get_context("fork").Pipe()
    get_context("fork").Process(target=work, args=(there,)).start()
    here.recv()
    os.kill(os.getpid(), signal.SIGKILL)

globals()[sys.argv[2]]()
"""


@pytest.mark.parametrize(("end", "code"), [("ends_at_once", 130), ("parent_is_killed", -9)])
def test_a_process_that_ends_at_once_leaves_nothing_half_written(tmp_path, end, code):
    (tmp_path / "a").write_text("old")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    call = [sys.executable, "-c", _ENDS, str(tmp_path), end]
    process = subprocess.run(call, capture_output=True, env=environment, timeout=60)
    assert process.returncode == code, process.stderr
    limit = time.monotonic() + 20
    while unfinished(tmp_path) and time.monotonic() < limit:  # the worker ends after its parent
        time.sleep(0.02)
    assert unfinished(tmp_path) == []
    assert (tmp_path / "a").read_text() in ("old", "new")


@pytest.fixture
def at_most_ten_seconds():
    def hang(number, frame):
        raise AssertionError("it waits")

    before = signal.signal(signal.SIGALRM, hang)
    signal.setitimer(signal.ITIMER_REAL, 10, 10)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.usefixtures("at_most_ten_seconds")
@pytest.mark.parametrize("kind", ["pipe", "/dev/zero"])
@pytest.mark.parametrize("name", [*RUN_FILES[:3], JOURNAL, ".new-mine"])
def test_nobody_waits_for_what_is_no_file(tmp_path, monkeypatch, name, kind):
    monkeypatch.setattr(files, "_YOUNGEST_STALE", 0.0)
    path = tmp_path / name
    os.mkfifo(path) if kind == "pipe" else path.symlink_to(kind)
    scenario = load_scenario("line")
    assert default_folder(tmp_path, scenario) in (
        tmp_path,
        tmp_path.with_name(f"{tmp_path.name}_2"),
    )
    stopped_folder(tmp_path)
    assert results_folder._flight_in(tmp_path) is None
    with pytest.raises(OSError, match=r"no regular file|No such file"):
        open_regular(path if name != ".new-mine" else path.with_name("none"))
    write_both_ways(tmp_path)
    if name == JOURNAL:
        with pytest.raises(ScenarioError, match=r"its journal\.jsonl is no file"):
            open_journal(tmp_path, "s", [1], {}).__enter__()


def test_numbers_of_numpy_are_written_as_those_of_python(tmp_path):
    path = tmp_path / "data.json"
    write_json(path, {"is": np.bool_(True), "some": [np.float32(0.5), np.float32("nan")]})
    assert json.loads(path.read_text()) == {"is": True, "some": [0.5, None]}
