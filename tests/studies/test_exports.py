"""Runs in the files of other tools, read back by readers that are not ours."""

import re

import numpy as np
import pandas
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RotationMatrix

from drake_nonstop import ConstantParameters, load_scenario, simulate, write_results
from drake_nonstop.cli.main import main
from drake_nonstop.mechanics.signals import CarrierStates, LoadState, Wrench


@pytest.fixture(scope="module")
def run():
    return simulate(load_scenario("three_carriers", ["simulation_duration=1.1"]))


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


def test_csv_has_all_numbers_under_names_with_units(run, export, tmp_path):
    assert export("csv") == 0
    frame = pandas.read_csv(tmp_path / "run.csv", dtype=str).astype(float)
    columns = run.columns()
    assert list(frame.columns) == list(columns)
    for name, values in columns.items():
        np.testing.assert_array_equal(frame[name], values)


def test_parquet_has_units_and_frames(run, export, tmp_path):
    pytest.importorskip("pyarrow.parquet")
    assert export("parquet", "load_state", "tensions") == 0
    table = pandas.read_parquet(tmp_path / "run.parquet")
    assert len(table.columns) == 13 + 3
    name = "load_state.position.x [m]"
    assert (table.attrs["units"][name], table.attrs["frames"][name]) == ("m", "W")
    position = LoadState.view(run.signal("load_state")).position
    np.testing.assert_array_equal(table[name], position[:, 0])


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
    count = len(run.time)
    n = 3
    numbers = range(1, n + 1)
    topics = {"/load/odometry", "/load/reference", "/load/wrench"}
    topics |= {f"/carriers/{k}/odometry" for k in numbers} | {f"/cables/{k}/force" for k in numbers}
    assert {topic: len(messages) for topic, messages in found.items()} == dict.fromkeys(
        topics, count
    )

    def vector(message):
        return [message.x, message.y, message.z]

    state = LoadState.view(run.signal("load_state"))
    wrench = Wrench.view(run.signal("wrench"))
    carriers = CarrierStates.view(run.signal("carrier_state"))
    forces = run.signal("cable_forces").reshape(count, n, 3)
    for i in range(count):
        odometry = found["/load/odometry"][i]
        stamp = odometry.header.stamp
        assert stamp.sec + 1e-9 * stamp.nanosec == pytest.approx(run.time[i], abs=1e-9)
        assert log_times["/load/odometry"][i] == round(1e9 * run.time[i])
        assert (odometry.header.frame_id, odometry.child_frame_id) == ("world", "load")
        pose, twist = odometry.pose.pose, odometry.twist.twist
        assert vector(pose.position) == state.position[i].tolist()
        q = pose.orientation
        assert [q.w, q.x, q.y, q.z] == state.quaternion[i].tolist()
        R_WL = RotationMatrix(Quaternion(state.quaternion[i])).matrix()
        np.testing.assert_allclose(R_WL @ vector(twist.linear), state.velocity[i], atol=1e-12)
        np.testing.assert_allclose(
            R_WL @ vector(twist.angular), state.angular_velocity[i], atol=1e-12
        )
        asked = found["/load/wrench"][i].wrench
        assert vector(asked.force) == wrench.force[i].tolist()
        assert vector(asked.torque) == wrench.torque[i].tolist()
        for k in range(n):
            own = found[f"/carriers/{k + 1}/odometry"][i]
            pose, twist = own.pose.pose, own.twist.twist
            assert vector(pose.position) == carriers.positions[i, k].tolist()
            q = pose.orientation
            R_WC = RotationMatrix(Quaternion([q.w, q.x, q.y, q.z])).matrix()
            velocity = carriers.velocities[i, k]
            speed = np.linalg.norm(velocity)
            np.testing.assert_allclose(R_WC[:, 0], velocity / speed, atol=1e-12)
            assert abs(R_WC[2, 1]) < 1e-12  # y is level
            np.testing.assert_allclose(vector(twist.linear), [speed, 0, 0], atol=1e-12)
            force = found[f"/cables/{k + 1}/force"][i].wrench.force
            assert vector(force) == forces[i, k].tolist()


def test_a_recording_has_the_motion_and_the_plots(export, tmp_path):
    pytest.importorskip("rerun")
    assert export("rerun") == 0
    content = (tmp_path / "run.rrd").read_bytes()
    assert len(content) > 50_000
    assert content[:3] == b"RRF"


def test_recordings_have_one_name_if_they_are_of_one_flight(run, export, tmp_path):
    """A viewer merges recordings of one name."""
    pytest.importorskip("rerun")
    names = []
    for flown in (run, run, simulate(run.scenario, optimization_layer=ConstantParameters)):
        assert export("rerun", of=flown) == 0
        found = re.findall(rb"three_carriers [0-9a-f]{32}", (tmp_path / "run.rrd").read_bytes())
        names.append(found[0])
    assert names[0] == names[1] != names[2]


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_the_command_writes_tables_without_the_scenario_and_its_blocks(run, export, tmp_path, kind):
    pytest.importorskip("pyarrow")
    assert export(kind) == 0
    (tmp_path / "run" / "scenario.yaml").write_text("own: {phase: !no_such_module.Phase {}}")
    assert export(kind, "tensions", of=None) == 0
    file = tmp_path / f"run.{kind}"
    frame = pandas.read_csv(file, index_col=0) if kind == "csv" else pandas.read_parquet(file)
    np.testing.assert_allclose(frame.to_numpy(), run.signal("tensions"), rtol=1e-15)


@pytest.mark.parametrize("kind", ["parquet", "mcap", "rerun"])
def test_without_the_extra_it_is_named(export, tmp_path, monkeypatch, capsys, kind):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert export(kind) == 2
    assert "pip install 'drake-nonstop[export]'" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
