"""A run in the files of other tools: tables, bags of ROS 2, recordings of Rerun."""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_nonstop.mechanics.rotation import roll_pitch_yaw_to_quaternion, rotation_matrix
from drake_nonstop.mechanics.signals import CarrierStates, LoadState, Wrench
from drake_nonstop.run.run import Run
from drake_nonstop.run.run_quantities import attachment_positions
from drake_nonstop.run.signal_table import SignalTable
from drake_nonstop.studies.files import replacing_file, replacing_files
from drake_nonstop.validation import require_installed

WORLD, LOAD, DESIRED = "world", "load", "desired"

# The fields of each type, as ROS 2 has them, with those of the types that they are made of.
_PARTS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
}
_TYPES = {
    "nav_msgs/msg/Odometry": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist",
    "geometry_msgs/msg/WrenchStamped": "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
}
_ODOMETRY, _WRENCH = _TYPES
_NO_COVARIANCE = [0.0] * 36

Message = dict[str, Any]
_DOT = 0.06  # of the size of the load, the radius of a carrier


def write_csv(table: SignalTable, path: Path, signals: Sequence[str] = ()) -> None:
    """Writes a row per sample; the first line has the columns' names with their units.

    Raises:
        ScenarioError: there is no such signal, see `SignalTable.columns`, or the file cannot be
            written.
    """
    frame = table.to_pandas(signals)
    with replacing_file(path) as file:
        frame.to_csv(file)


def write_parquet(table: SignalTable, path: Path, signals: Sequence[str] = ()) -> None:
    """Writes a row per sample; `pandas.read_parquet(path).attrs` has "units" and "frames".

    Raises:
        ScenarioError: as of `write_csv`, or PyArrow is not installed.
    """
    require_installed("export", pyarrow="drake-nonstop[export]")
    frame = table.to_pandas(signals)
    with replacing_file(path) as file:
        frame.to_parquet(file)


def write_mcap(run: Run, path: Path) -> None:
    """Writes a bag of ROS 2 messages, an MCAP file, which needs no ROS to be written or read.

    | topic | type | what it is |
    | --- | --- | --- |
    | /load/odometry | nav_msgs/msg/Odometry | the load: pose in `world`, twist in `load` |
    | /load/reference | nav_msgs/msg/Odometry | the desired motion, twist in `desired` |
    | /load/wrench | geometry_msgs/msg/WrenchStamped | what the controller asks for, in `world` |
    | /carriers/K/odometry | nav_msgs/msg/Odometry | a carrier, twist along its own axes |
    | /cables/K/force | geometry_msgs/msg/WrenchStamped | its force on the load, in `world` |

    Stamps are the simulated time. A carrier's x axis points along its velocity, its y axis to the
    left and level; its bank is not shown.

    Raises:
        ScenarioError: the package `mcap-ros2-support` is not installed, or the file cannot be
            written.
    """
    require_installed("export", mcap_ros2="drake-nonstop[export]")
    from mcap_ros2.writer import Writer

    topics = list(_topics(run))
    with replacing_file(path) as file, Writer(file) as writer:
        schemas = {name: writer.register_msgdef(name, _definition(name)) for name in _TYPES}
        writer.add_metadata("drake_nonstop", {"scenario": run.scenario.name})
        for i, time in enumerate(run.time.tolist()):
            nanoseconds = round(1e9 * time)
            stamp = {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
            for topic, kind, frame, message in topics:
                header = {"stamp": stamp, "frame_id": frame}
                content = {"header": header, **message(i)}
                writer.write_message(topic, schemas[kind], content, nanoseconds, nanoseconds, i)


def _definition(name: str) -> str:
    """The text of a type with those of the parts of all types."""
    parts = [f"MSG: {part}\n{fields}" for part, fields in _PARTS.items()]
    return f"\n{80 * '='}\n".join([_TYPES[name], *parts])


def _topics(run: Run) -> Iterator[tuple[str, str, str, Callable[[int], Message]]]:
    """Topic, type, frame, and what makes the message of a sample."""
    for topic, port, child in (
        ("/load/odometry", "load_state", LOAD),
        ("/load/reference", "reference", DESIRED),
    ):
        state = LoadState.view(run.signal(port))
        yield topic, _ODOMETRY, WORLD, _odometry(state, child)
    ports = {name.partition(".")[2] for name in run.signals}
    if "wrench" in ports:
        yield "/load/wrench", _WRENCH, WORLD, _wrench(Wrench.view(run.signal("wrench")))
    positions, velocities = CarrierStates.view(run.signal("carrier_state"))
    attitudes = _along(velocities)
    zero = np.zeros((len(run.time), 3))
    for k in range(positions.shape[1]):
        motion = LoadState(attitudes[:, k], positions[:, k], zero, velocities[:, k])
        yield f"/carriers/{k + 1}/odometry", _ODOMETRY, WORLD, _odometry(motion, f"carrier_{k + 1}")
    for k in range(positions.shape[1] if "cable_forces" in ports else 0):
        force = _wrench(Wrench(zero, run.signal("cable_forces")[:, 3 * k : 3 * k + 3]))
        yield f"/cables/{k + 1}/force", _WRENCH, WORLD, force


def _odometry(state: LoadState, child: str) -> Callable[[int], Message]:
    """With the twist in the axes of the child's frame, as ROS has it."""
    rotation = rotation_matrix(state.quaternion)
    linear, angular = (
        np.einsum("kji,kj->ki", rotation, vectors)
        for vectors in (state.velocity, state.angular_velocity)
    )

    return lambda i: {
        "child_frame_id": child,
        "pose": {
            "pose": _pose(state.position[i], state.quaternion[i]),
            "covariance": _NO_COVARIANCE,
        },
        "twist": {
            "twist": {"linear": _vector(linear[i]), "angular": _vector(angular[i])},
            "covariance": _NO_COVARIANCE,
        },
    }


def _wrench(wrench: Wrench) -> Callable[[int], Message]:
    return lambda i: {
        "wrench": {"force": _vector(wrench.force[i]), "torque": _vector(wrench.torque[i])}
    }


def _pose(position: NDArray, quaternion: NDArray) -> Message:
    w, x, y, z = quaternion.tolist()
    return {"position": _vector(position), "orientation": {"x": x, "y": y, "z": z, "w": w}}


def _vector(values: NDArray) -> Message:
    return dict(zip("xyz", values.tolist(), strict=True))


def _along(velocities: NDArray) -> NDArray:
    """The quaternions (k, n, 4), w x y z, whose x axis is along velocities (k, n, 3), y level."""
    east, north, up = np.moveaxis(velocities, -1, 0)
    yaw, pitch = np.arctan2(north, east), -np.arctan2(up, np.hypot(east, north))
    return roll_pitch_yaw_to_quaternion(np.stack([0 * yaw, pitch, yaw], axis=-1))


def write_rerun(run: Run, path: Path) -> None:
    """Writes a recording for the viewer Rerun, with the motion in space and plots of all signals.

    The name of the file ends in .rrd; `rerun FILE` shows it.

    Raises:
        ScenarioError: the package `rerun-sdk` is not installed, or the file cannot be written.
    """
    require_installed("export", rerun="drake-nonstop[export]")
    import rerun

    # The same run makes the same recording, and viewers keep others apart.
    flown = b"".join(values.tobytes() for values in (run.time, *run.signals.values()))
    name = f"{run.scenario.name} {hashlib.sha256(flown).hexdigest()[:32]}"
    recording = rerun.RecordingStream("drake_nonstop", recording_id=name, send_properties=False)
    with replacing_files(path.parent, [path.name]) as new:
        recording.save(str(new / path.name))
        _send_motion(run, recording)
        _send_plots(run, recording)
        recording.flush()
        recording.disconnect()


def _send_motion(run: Run, recording: Any) -> None:
    import rerun

    index = rerun.TimeColumn("time", duration=run.time)
    positions = CarrierStates.view(run.signal("carrier_state")).positions
    ends = attachment_positions(run, run.signal("load_state"))
    count, n = positions.shape[:2]
    size = float(np.max(np.ptp(ends[0], axis=0)))
    recording.log("/", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    load = LoadState.view(run.signal("load_state"))
    attachments = np.asarray(run.scenario.system.attachments, dtype=float)
    half = np.maximum(np.ptp(attachments, axis=0) / 2, 0.02 * size)
    middle = (attachments.max(axis=0) + attachments.min(axis=0)) / 2
    recording.log("load", rerun.Boxes3D(centers=[middle], half_sizes=[half]), static=True)
    turned = rerun.Transform3D.columns(
        translation=load.position, quaternion=np.roll(load.quaternion, -1, axis=1)
    )
    recording.send_columns("load", indexes=[index], columns=turned)
    dots = rerun.Points3D.columns(
        positions=positions.reshape(-1, 3), radii=np.full(count * n, _DOT * size)
    ).partition(np.full(count, n))
    recording.send_columns("carriers", indexes=[index], columns=dots)
    lines = np.stack([ends, positions], axis=2)
    for k in range(n):
        cable = rerun.LineStrips3D.columns(strips=list(lines[:, k]))
        recording.send_columns(f"cables/{k + 1}", indexes=[index], columns=cable)


def _send_plots(run: Run, recording: Any) -> None:
    import rerun

    index = rerun.TimeColumn("time", duration=run.time)
    for signal, entries in run.entries.items():
        values = run.signals[signal]
        parts: dict[str, list[int]] = {}
        for column, entry in enumerate(entries):  # one plot for a vector
            parts.setdefault(entry.name.rpartition(".")[0] or entry.name, []).append(column)
        for part, columns in parts.items():
            place = f"plots/{part.replace('.', '/')}"
            names = [entries[column].label for column in columns]
            recording.log(place, rerun.SeriesLines(names=names), static=True)
            scalars = rerun.Scalars.columns(scalars=values[:, columns])
            recording.send_columns(place, indexes=[index], columns=scalars)
