"""Runs in the files of other tools, read back by readers that are not ours."""

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RotationMatrix

from drake_nonstop import ScenarioError, load_scenario, simulate
from drake_nonstop.cli.main import main
from drake_nonstop.mechanics.signals import CarrierStates, LoadState, Wrench
from drake_nonstop.studies.exports.rerun_recording import write_rerun
from drake_nonstop.studies.exports.ros_bag import write_mcap
from drake_nonstop.studies.exports.tables import write_csv, write_parquet
from drake_nonstop.studies.results_folder import write_data


@pytest.fixture(scope="module")
def run():
    return simulate(load_scenario("three_carriers", ["simulation_duration=0.3"]))


def test_csv_has_all_numbers_under_names_with_units(run, tmp_path):
    pandas = pytest.importorskip("pandas")
    write_csv(run, tmp_path / "run.csv")
    frame = pandas.read_csv(tmp_path / "run.csv")
    columns = run.columns()
    assert list(frame.columns) == list(columns)
    for name, values in columns.items():
        np.testing.assert_array_equal(frame[name], values)


def test_parquet_has_units_and_frames(run, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    write_parquet(run, tmp_path / "run.parquet", ["load_state", "tensions"])
    table = parquet.read_table(tmp_path / "run.parquet")
    assert table.num_columns == 1 + 13 + 3
    field = table.schema.field("load_state.position.x [m]")
    assert field.metadata == {b"unit": b"m", b"frame": b"W"}
    position = LoadState.view(run.signal("load_state")).position
    np.testing.assert_array_equal(table["load_state.position.x [m]"], position[:, 0])
    assert table.schema.metadata[b"scenario"] == b"three_carriers"


def test_a_bag_reads_back_without_ros_and_with_equal_values(run, tmp_path):
    reader = pytest.importorskip("mcap_ros2.reader")
    write_mcap(run, tmp_path / "run.mcap")
    found = {}
    for message in reader.read_ros2_messages(tmp_path / "run.mcap"):
        found.setdefault(message.channel.topic, []).append(message)
    count = len(run.time)
    n = 3
    numbers = range(1, n + 1)
    topics = {"/load/odometry", "/load/reference", "/load/wrench", "/load/disturbance", "/carriers"}
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
    for i in (0, 7, count - 1):
        odometry = found["/load/odometry"][i].ros_msg
        stamp = odometry.header.stamp
        assert stamp.sec + 1e-9 * stamp.nanosec == pytest.approx(run.time[i], abs=1e-9)
        assert found["/load/odometry"][i].log_time_ns == round(1e9 * run.time[i])
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
        asked = found["/load/wrench"][i].ros_msg.wrench
        assert vector(asked.force) == wrench.force[i].tolist()
        assert vector(asked.torque) == wrench.torque[i].tolist()
        for k, pose in enumerate(found["/carriers"][i].ros_msg.poses):
            assert vector(pose.position) == carriers.positions[i, k].tolist()
            q = pose.orientation
            R_WC = RotationMatrix(Quaternion([q.w, q.x, q.y, q.z])).matrix()
            velocity = carriers.velocities[i, k]
            forward = velocity / np.linalg.norm(velocity)
            np.testing.assert_allclose(R_WC[:, 0], forward, atol=1e-12)
            assert abs(R_WC[2, 1]) < 1e-12  # y is level
            own = found[f"/carriers/{k + 1}/odometry"][i].ros_msg.twist.twist.linear
            np.testing.assert_allclose(vector(own), [np.linalg.norm(velocity), 0, 0], atol=1e-12)
            force = found[f"/cables/{k + 1}/force"][i].ros_msg.wrench.force
            assert vector(force) == forces[i, k].tolist()


def test_a_recording_has_the_motion_and_the_plots(run, tmp_path):
    pytest.importorskip("rerun")
    path = tmp_path / "run.rrd"
    write_rerun(run, path)
    assert path.stat().st_size > 50_000
    assert path.read_bytes()[:3] == b"RRF"


def test_the_command_writes_them_beside_the_run(run, tmp_path, capsys):
    pytest.importorskip("pyarrow")
    write_data(run, tmp_path / "run")
    arguments = ["export", str(tmp_path / "run"), "--to", "parquet", "--signal", "tensions"]
    assert main(arguments) == 0
    assert (tmp_path / "run" / "signals.parquet").is_file()
    assert capsys.readouterr().out.startswith("written: ")
    assert main([*arguments[:2], "--to", "mcap", "--signal", "tensions"]) == 2
    assert "--signal = ['tensions']: leave it out" in capsys.readouterr().err
    assert main(["export", str(tmp_path), "--to", "csv"]) == 2
    assert "give the folder of a run" in capsys.readouterr().err
    assert main([*arguments[:4], "--signal", "tension"]) == 2
    assert "signal = tension: give a port of the run, such as" in capsys.readouterr().err


@pytest.mark.parametrize("write", [write_parquet, write_mcap, write_rerun])
def test_without_the_extra_it_is_named(run, tmp_path, monkeypatch, write):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ScenarioError, match=r"pip install 'drake-nonstop\[export\]'"):
        write(run, tmp_path / "run.out")
    assert not list(tmp_path.iterdir())
