"""Folders of results, whole or not at all; journals of studies; exports, by readers not ours."""

import errno
import functools
import json
import operator
import os
import re
import shutil
import signal
import tempfile
import time

import numpy as np
import pandas
import pytest
from helpers import nightly_beyond, rotation
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from drake_nonstop import (
    ConstantParameters,
    Run,
    ScenarioError,
    SerialExecutor,
    StudyInterrupted,
    simulate,
    study,
    write_results,
)
from drake_nonstop.cli.main import main
from drake_nonstop.mechanics.signals import CarrierStates, LoadState, Wrench
from drake_nonstop.scenario.loading import load_scenario

JOURNAL, MASS = "journal.jsonl", "system.load_mass"
DATA = {"scenario.yaml", "metrics.json", "signals.npz"}
SHORT = ["simulation_duration=0.1", "optimization_layer=ConstantParameters"]


@pytest.fixture(scope="module")
def run():
    return simulate(load_scenario("three_carriers", ["simulation_duration=1.1"]))


@pytest.fixture
def written(run, tmp_path, undrawn):
    """Writes the data of the run, or of another, to the folder "a", which it returns."""

    def write(other=None, folder="a"):
        write_results(other or run, tmp_path / folder, figures=False, replay=False)
        return tmp_path / folder

    return write


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("kind", nightly_beyond(2, "studies", ["png", False, "pdf", "svg"]))
def test_pictures_are_of_one_kind_and_files_of_others_stay(run, tmp_path, kind):
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "tensions.png").write_text("of an earlier run")
    (tmp_path / "notes.txt").write_text("mine")
    metrics = write_results(run, tmp_path, figures=kind, replay=False)
    assert json.loads((tmp_path / "metrics.json").read_text()) == metrics
    figures = {path.name for path in tmp_path.glob("figures/*")}
    assert ("tensions.png" in figures) == (kind == "png")
    assert bool(figures) == bool(kind)
    assert {path.partition(".")[2] for path in figures} <= {kind}
    assert (tmp_path / "notes.txt").exists()


def test_files_replace_earlier_ones_together_and_none_on_an_error(written, monkeypatch):
    folder = written()
    (folder / "replay.html").write_text("of the earlier run")
    before = contents(folder)
    other = simulate(load_scenario("line", SHORT))

    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(np.lib.format, "write_array", full)
        with pytest.raises(ScenarioError, match=r"--out = .*: give a folder with room to write to"):
            written(other)
    assert contents(folder) == before
    written(other)
    after = contents(folder)
    assert {path.name for path in after} == DATA | {"diagram.svg"}
    assert all(after[folder / name] != before[folder / name] for name in DATA)


# What is in the way, the folder, and what the sentence has.
REFUSED = [
    ("a/metrics.json/", "a", ("--out", "metrics.json is no file", "move it")),
    ("a/figures", "a", ("--out", "file figures is in the way", "move it")),
    ("", "a\0b", ("--out", "give a folder that can be written")),
]


@pytest.mark.parametrize(("there", "folder", "words"), REFUSED)
def test_what_cannot_be_written_is_one_sentence(written, tmp_path, there, folder, words):
    if there:
        (tmp_path / there).parent.mkdir(exist_ok=True)
        (tmp_path / there).mkdir() if there.endswith("/") else (tmp_path / there).write_text("")
    with pytest.raises(ScenarioError) as raised:
        written(folder=folder)
    assert all(word in str(raised.value) for word in words)


def test_a_disk_without_room_is_refused(monkeypatch, capsys):
    full = shutil.disk_usage(".")._replace(free=1e6)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: full)
    assert main(["run", "line", "--set", "simulation_duration=10000"]) == 2
    assert re.search(r"give a folder with room for \d+ MB, 1 MB are free", capsys.readouterr().err)


def test_numbers_that_are_not_finite_are_null_in_json(written):
    broken = simulate(load_scenario("line", SHORT))
    for name, values in broken.signals.items():
        broken.signals[name] = np.full_like(values, np.nan)
    metrics = (written(broken) / "metrics.json").read_text()
    found = json.loads(metrics, parse_constant=lambda name: pytest.fail(name))
    assert found["load"]["position_error_mean_m"] is None


serial = functools.partial(study, executor=SerialExecutor())


@pytest.fixture
def flown(tmp_path, monkeypatch):
    """Goes on with a study of so many masses, and returns for how many it flew."""
    monkeypatch.setattr(Figure, "savefig", lambda *_, **__: None)

    def go_on(masses=2, **options):
        told = []
        given = {"progress": lambda *_: told.append(1)} | options
        factors = {MASS: [1.0 + k / 10 for k in range(masses)]}
        serial(load_scenario("line", SHORT), factors, folder=tmp_path / "s", **given)
        return len(told)

    return go_on


@pytest.mark.nightly("studies")
def test_rows_stay_until_a_restart_and_a_last_line_that_was_cut_short_is_flown_again(
    flown, tmp_path
):
    assert (flown(), flown(), flown(restart=True)) == (2, 0, 2)
    path = tmp_path / "s" / JOURNAL
    content = path.read_bytes()
    ends = [k + 1 for k, byte in enumerate(content) if byte == ord("\n")]
    assert len(ends) == 3
    for length in (0, 10, ends[0], ends[0] + 5, ends[1], ends[1] + 5, ends[2] - 1):
        path.write_bytes(content[:length])
        assert flown() == 2 - max(0, content[:length].count(b"\n") - 1)
        assert path.read_bytes().count(b"\n") == 3


SETTINGS = b'{"settings": "s"}\n'


@pytest.mark.parametrize(
    "content", [b"x\n", b"\xff\n", SETTINGS, SETTINGS + b"3\n", SETTINGS + b"{}\n"]
)
def test_a_damaged_journal_and_one_of_other_settings_stay_and_are_refused(flown, tmp_path, content):
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / JOURNAL).write_bytes(content)
    with pytest.raises(ScenarioError, match=r"--out = .*; give another folder, or --restart"):
        flown()
    assert (tmp_path / "s" / JOURNAL).read_bytes() == content


def test_what_is_there_stays_whatever_ends_the_study(flown, tmp_path):
    def end(error):
        def progress(what, share):
            raise error

        return progress

    with pytest.raises(ScenarioError, match="another study is running in it"):
        flown(1, progress=lambda *_: flown(1))
    with pytest.raises(StudyInterrupted, match=r"^2 runs are in .*; the same call continues"):
        flown(3, progress=end(KeyboardInterrupt()))
    with pytest.raises(ScenarioError, match="room to write to"):
        flown(4, progress=end(OSError(errno.ENOSPC, "No space left on device")))
    assert flown(4) == 1
    new = tmp_path / "new"
    wind = "load_disturbance=!faulty_blocks.FaultyWind {fault: flown interrupts}"
    with pytest.raises(StudyInterrupted, match=r"^$"):
        serial(load_scenario("line", [*SHORT, wind], trust=True), {MASS: [1.0]}, folder=new)
    assert not new.exists()


def test_an_interrupt_while_pictures_are_drawn_keeps_all_else(tmp_path, monkeypatch, capsys):
    def interrupted(*_, **__):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1)

    monkeypatch.setattr(FigureCanvasAgg, "print_png", interrupted)
    assert main(["run", "line", "--out", str(tmp_path), "--set", *SHORT]) == 130
    assert "interrupted: the results are in " in (told := capsys.readouterr().err)
    assert "without all pictures" in told
    written = {path.name for path in tmp_path.iterdir()}
    assert written == DATA | {"diagram.svg", "replay.html"}  # and nothing half written


def test_a_full_disk_at_the_end_keeps_the_results_elsewhere(tmp_path, monkeypatch, capsys):
    replace = os.replace

    def full(source, target):
        if str(target).startswith(str(tmp_path / "out")):
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(os, "replace", full)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    short = ["--set", "simulation_duration=0.05"]
    assert main(["run", "line", "--out", str(tmp_path / "out"), "--quiet", *short]) == 2
    (place,) = re.findall(r"the results are in (.*)\n", capsys.readouterr().err)
    assert Run.load(place).time[-1] == pytest.approx(0.05)


@pytest.fixture
def export(run, tmp_path, undrawn):
    """Exports the run, or another, from a folder of results; returns the exit code."""

    def call(kind, *signals, of=run):
        if of is not None:
            write_results(of, tmp_path / "run", figures=False, replay=False)
        file = tmp_path / f"run.{'rrd' if kind == 'rerun' else kind}"
        options = [word for name in signals for word in ("--signal", name)]
        return main(["export", str(tmp_path / "run"), "--to", kind, "--out", str(file), *options])

    return call


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_tables_have_all_numbers_under_names_with_units(run, export, tmp_path, kind):
    """Those of some signals need neither the scenario nor its blocks."""
    pytest.importorskip("pyarrow")
    assert export(kind) == 0
    file, columns = tmp_path / f"run.{kind}", run.columns()
    read = functools.partial(pandas.read_csv, dtype=str) if kind == "csv" else pandas.read_parquet
    frame = read(file).reset_index(drop=kind == "csv")
    assert list(frame.columns) == list(columns)
    for name, values in columns.items():
        np.testing.assert_array_equal(frame[name].astype(float), values)
    if kind == "parquet":
        name, attributes = "load_state.position.x [m]", read(file).attrs
        assert (attributes["units"][name], attributes["frames"][name]) == ("m", "W")
    (tmp_path / "run" / "scenario.yaml").write_text("own: {phase: !no_such_module.Phase {}}")
    assert export(kind, "tensions", of=None) == 0
    numbers = read(file).to_numpy(dtype=float)[:, -3:]
    np.testing.assert_array_equal(numbers, run.signal("tensions"))


def test_a_bag_reads_back_without_ros_and_with_equal_values(run, export, tmp_path):
    """By rosbags, which has a reader, a decoder and definitions of messages of its own."""
    pytest.importorskip("mcap_ros2")
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    assert export("mcap") == 0
    types = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    found, log_times = {}, {}
    with rosbag2.Reader(tmp_path / "run.mcap") as bag:
        for connection, log_time, data in bag.messages():
            message = types.deserialize_cdr(data, connection.msgtype)
            found.setdefault(connection.topic, []).append(message)
            log_times.setdefault(connection.topic, []).append(log_time)
    several = [("carriers", "odometry"), ("cables", "force")]
    topics = {f"/{kind}/{k}/{name}" for kind, name in several for k in (1, 2, 3)}
    assert found.keys() == topics | {"/load/odometry", "/load/reference", "/load/wrench"}
    for topic, messages in found.items():
        stamps = [each.header.stamp for each in messages]
        times = [stamp.sec + 1e-9 * stamp.nanosec for stamp in stamps]
        np.testing.assert_allclose(times, run.time, atol=1e-9)
        np.testing.assert_array_equal(log_times[topic], np.round(1e9 * run.time))

    def values(topic, path, axes="xyz"):
        get = operator.attrgetter(*(f"{path}.{axis}" for axis in axes))
        return np.array([get(message) for message in found[topic]])

    def in_world(topic, path):
        turns = map(rotation, values(topic, "pose.pose.orientation", "wxyz"))
        return np.einsum("kij,kj->ki", [*turns], values(topic, path))

    first = found["/load/odometry"][0]
    assert (first.header.frame_id, first.child_frame_id) == ("world", "load")
    for topic, port in (("/load/odometry", "load_state"), ("/load/reference", "reference")):
        state, twist = LoadState.view(run.signal(port)), "twist.twist"
        np.testing.assert_array_equal(values(topic, "pose.pose.position"), state.position)
        quaternions = values(topic, "pose.pose.orientation", "wxyz")
        np.testing.assert_array_equal(quaternions, state.quaternion)
        moved = in_world(topic, f"{twist}.linear"), in_world(topic, f"{twist}.angular")
        np.testing.assert_allclose(moved, (state.velocity, state.angular_velocity), atol=1e-12)
    wrench = Wrench.view(run.signal("wrench"))
    np.testing.assert_array_equal(values("/load/wrench", "wrench.force"), wrench.force)
    np.testing.assert_array_equal(values("/load/wrench", "wrench.torque"), wrench.torque)
    carriers = CarrierStates.view(run.signal("carrier_state"))
    for k in range(3):
        topic, velocities = f"/carriers/{k + 1}/odometry", carriers.velocities[:, k]
        place = values(topic, "pose.pose.position")
        np.testing.assert_array_equal(place, carriers.positions[:, k])
        np.testing.assert_allclose(in_world(topic, "twist.twist.linear"), velocities, atol=1e-12)
        ahead = np.linalg.norm(velocities, axis=1)[:, None] * [1, 0, 0]
        np.testing.assert_allclose(values(topic, "twist.twist.linear"), ahead, atol=1e-12)
        turns = map(rotation, values(topic, "pose.pose.orientation", "wxyz"))
        assert max(abs(turn[2, 1]) for turn in turns) < 1e-12  # y is level
        forces = run.signal("cable_forces")[:, 3 * k : 3 * k + 3]
        np.testing.assert_array_equal(values(f"/cables/{k + 1}/force", "wrench.force"), forces)


def test_recordings_have_one_name_if_they_are_of_one_flight(run, export, tmp_path):
    """A viewer merges recordings of one name."""
    pytest.importorskip("rerun")
    names = []
    for flown in (run, run, simulate(run.scenario, optimization_layer=ConstantParameters)):
        assert export("rerun", of=flown) == 0
        content = (tmp_path / "run.rrd").read_bytes()
        assert content[:3] == b"RRF"
        assert len(content) > 50_000  # the motion and the plots
        names.append(re.findall(rb"three_carriers [0-9a-f]{32}", content)[0])
    assert names[0] == names[1] != names[2]


@pytest.mark.parametrize("kind", ["parquet", "mcap", "rerun"])
def test_without_the_extra_it_is_named(export, tmp_path, monkeypatch, capsys, kind):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert export(kind) == 2
    assert "pip install 'drake-nonstop[export]'" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
