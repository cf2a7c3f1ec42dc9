import base64
import logging
import re
from collections import defaultdict

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix

from drake_nonstop import scene
from drake_nonstop.scenario import Scenario, load_scenario
from drake_nonstop.scene import record_replay
from drake_nonstop.simulate import Run, simulate
from drake_nonstop.system import System

MEGABYTE = 1e6


@pytest.fixture(scope="module")
def simulated():
    scenario = load_scenario("quintic")
    scenario.duration = 0.5
    return simulate(scenario)


def made_up(n=4, duration=0.5, cable_length=0.8):
    """A run of `n` carriers that circle above a turning load on its way along x."""
    angles = 2 * np.pi * np.arange(n) / n
    attachments = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n)])
    system = System(attachments=attachments.tolist(), cable_length=cable_length)
    time = np.arange(0, duration + 1e-9, 0.01)
    load = np.zeros((len(time), 13))
    load[:, 0], load[:, 3] = np.cos(time / 4), np.sin(time / 4)
    load[:, 4] = 0.7 * time
    reference = np.hstack([load, np.zeros((len(time), 9))])
    reference[:, 5] += 0.1
    turns = time[:, None] + angles
    positions = np.stack([np.cos(turns), np.sin(turns), np.full(turns.shape, cable_length)], 2)
    velocities = np.stack([-np.sin(turns), np.cos(turns), np.zeros(turns.shape)], 2)
    carriers = [values.reshape(len(time), -1) for values in (positions, velocities)]
    return Run(
        scenario=Scenario(system=system, duration=duration),
        diagram=None,
        time=time,
        signals={
            "load_plant.load_state": load,
            "load_trajectory.reference": reference,
            "carrier_dynamics.carrier_state": np.hstack(carriers),
        },
        steps={},
        solve_times=np.zeros(0),
        wall_time=0.0,
    )


def shortened(run, samples):
    signals = {name: values[:samples].copy() for name, values in run.signals.items()}
    return Run(**{**vars(run), "time": run.time[:samples], "signals": signals})


class Film:
    """What `_animate` writes to, by path; frames count from 0."""

    def __init__(self, run):
        self.poses = defaultdict(dict)
        self.properties = defaultdict(dict)
        self.motion = scene._motion(run, 25.0)
        scene._animate(self, self.motion)

    def SetTransform(self, frame, path, pose):  # noqa: N802
        self.poses[path][frame] = pose

    def SetProperty(self, frame, path, name, value):  # noqa: N802
        self.properties[path, name][frame] = value


def commands(html):
    """What the page tells the viewer, each in msgpack."""
    return map(base64.b64decode, re.findall(r"octet-binary;base64,([\w+/=]+)", html))


def paths(html):
    """The scene's bodies and trails that have an object in the page."""
    objects = [content for content in commands(html) if b"set_object" in content]
    path = rb"/(?:load|reference|carriers/\d+|cables/\d+|trails/(?:load|\d+))\b"
    return {found.decode() for content in objects for found in re.findall(path, content)}


def expected_paths(n, *, trails=True):
    found = {"/load", "/reference"}
    found |= {f"/{kind}/{i}" for kind in ("carriers", "cables") for i in range(n)}
    return found | ({f"/trails/{i}" for i in ("load", *range(n))} if trails else set())


def test_page_refers_to_nothing_outside(simulated):
    html = record_replay(simulated)
    assert "<script" in html
    tags = re.findall(r"<(?:script|link|img|iframe)\b[^>]*>", html)
    assert not [tag for tag in tags if re.search(r"\b(src|href)\s*=", tag)]
    addresses = re.findall(r"""fetch\(["'](.{0,40})""", html)
    assert addresses
    assert all(address.startswith("data:") for address in addresses)


@pytest.mark.parametrize("n", [3, 6])
def test_page_shows_all_bodies(n):
    assert paths(record_replay(made_up(n))) == expected_paths(n)


def test_page_of_a_simulated_run_shows_all_bodies(simulated):
    assert paths(record_replay(simulated)) == expected_paths(4)


def test_page_grows_slowly():
    empty = len(record_replay(shortened(made_up(), 0)))
    three_seconds = len(record_replay(made_up(duration=3.0))) - empty
    assert empty + 10 * three_seconds < 5 * MEGABYTE


def test_frames_are_those_of_the_frame_rate(simulated):
    film = Film(simulated)
    assert list(film.poses["/load"]) == list(range(13))  # 0.5 s at 25 Hz, ends included
    positions = [pose.translation() for pose in film.poses["/load"].values()]
    np.testing.assert_array_equal(positions, simulated.signal("load_state")[:50:4, 4:7])
    assert len(scene._motion(simulated, 100.0).load) == len(simulated.time)


def test_frame_rate_is_at_most_that_of_the_signals():
    fast, faster = (
        [content for content in commands(html) if b"set_animation" in content]
        for html in (record_replay(made_up(), frame_rate=rate) for rate in (100.0, 1000.0))
    )
    assert len(fast) == 1
    assert fast == faster


@pytest.mark.parametrize("n", [3, 4, 6])
def test_cables_end_at_attachments_and_carriers(simulated, n):
    run = simulated if n == 4 else made_up(n)
    film = Film(run)
    for i, attachment in enumerate(film.motion.attachments):
        for frame, cable in film.poses[f"/cables/{i}"].items():
            length = film.properties[f"/cables/{i}", "scale"][frame][2]
            start, end = (cable @ np.array([0, 0, side * length / 2]) for side in (-1, 1))
            np.testing.assert_allclose(
                start, film.poses["/load"][frame] @ attachment, rtol=0, atol=1e-3
            )
            position = run.signal("carrier_state")[4 * frame, 3 * i : 3 * i + 3]
            np.testing.assert_allclose(end, position, rtol=0, atol=1e-3)


def test_carriers_fly_along_their_velocity_with_their_top_away_from_the_cable(simulated):
    film = Film(simulated)
    for i, attachment in enumerate(film.motion.attachments):
        for frame, pose in film.poses[f"/carriers/{i}"].items():
            position, velocity = simulated.signal("carrier_state")[4 * frame].reshape(2, 4, 3)[:, i]
            nose, _, top = pose.rotation().matrix().T
            np.testing.assert_allclose(pose.translation(), position)
            np.testing.assert_allclose(nose, velocity / np.linalg.norm(velocity), atol=1e-9)
            assert top @ (position - film.poses["/load"][frame] @ attachment) > 0


def test_ghost_moves_along_the_reference():
    run = made_up()
    ghost = Film(run).poses["/reference"][12]
    np.testing.assert_allclose(ghost.translation(), run.signal("reference")[48, 4:7])
    wxyz = ghost.rotation().ToQuaternion().wxyz()
    np.testing.assert_allclose(wxyz, run.signal("reference")[48, :4])


def test_trails_appear_behind_the_bodies():
    film = Film(made_up(duration=2.0))
    ends = film.motion.boundaries[1:]
    assert len(ends) >= 8
    for trail in ("load", *range(4)):
        for end in ends:
            visible = film.properties[f"/trails/{trail}/{end}", "visible"]
            assert visible == {0: False, end: True, 50: True}


def test_trails_of_long_runs_have_few_pieces():
    assert len(scene._motion(made_up(duration=60.0), 25.0).boundaries) <= 1 + scene.TRAIL_PIECES


def test_degenerate_poses():
    up = np.array([0.0, 0.0, 1.0])
    for direction in (up, -up, np.array([1e-9, 0.0, -1.0])):
        pose, length = scene._between(np.zeros(3), 60 * direction)
        np.testing.assert_allclose(pose @ [0, 0, length / 2], 60 * direction, atol=1e-6)
        assert isinstance(scene._attitude(up, up=direction), RotationMatrix)
    pose, length = scene._between(up, up)
    assert length > 0
    assert isinstance(pose, RigidTransform)
    almost_along = scene._attitude(up, up=np.array([2e-6, 0.0, 60.0]))
    np.testing.assert_allclose(almost_along.matrix()[:, 0], up)


def test_a_carrier_that_stops_keeps_its_heading():
    run = made_up()
    run.signal("carrier_state")[20:, 12:] = 0.0
    poses = Film(run).poses["/carriers/2"]
    noses = [pose.rotation().matrix()[:, 0] for pose in poses.values()]
    np.testing.assert_allclose(noses[5:], np.tile(noses[4], (8, 1)))


@pytest.mark.parametrize("samples", [1, 2])
def test_run_of_hardly_any_samples(simulated, samples):
    html = record_replay(shortened(simulated, samples))
    assert paths(html) == expected_paths(4, trails=False)


def test_samples_from_the_first_that_is_not_finite_are_left_out(simulated):
    run = shortened(simulated, len(simulated.time))
    run.signal("carrier_state")[40, 2] = np.nan
    run.signal("load_state")[45:, 4] = np.inf
    assert len(Film(run).poses["/load"]) == 10
    assert paths(record_replay(run)) == expected_paths(4)


@pytest.mark.parametrize("broken", [np.nan, np.inf, 0.0])
def test_run_without_a_usable_sample_gives_an_empty_page(simulated, broken):
    run = shortened(simulated, 1)
    run.signal("load_state")[:] = broken
    assert paths(record_replay(run)) == set()


@pytest.mark.parametrize("size", [1.0, 60.0])
def test_camera_sees_the_motion(size):
    motion = scene._motion(made_up(duration=3.0, cable_length=size), 25.0)
    points = motion.points
    assert len(points) >= 76 * 5
    eye, target = scene._view(points, path=motion.reference[:, 4:])
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
    up = np.cross(right, ahead)
    seen = (points - eye) @ np.column_stack([ahead, right, up])
    depth, side, height = seen.T
    slope = np.tan(np.radians(scene.VERTICAL_VIEW / 2))
    fill = np.max([np.abs(side) / scene.ASPECT_RATIO, np.abs(height)], axis=0) / depth / slope
    assert 0.7 < np.max(fill) < 1.0
    assert right[0] > 0.9  # the load's way, +x, leads to the right


def test_camera_disregards_carriers_that_went_astray():
    run = made_up()
    points = scene._motion(run, 25.0).points
    run.signal("carrier_state")[40:, 3] = 1e5
    rest = scene._motion(run, 25.0).points
    assert len(rest) == len(points) - 3
    assert np.all(np.ptp(rest, axis=0) <= np.ptp(points, axis=0))


def test_recording_leaves_no_trace_in_the_log(caplog):
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.INFO)
    try:
        record_replay(made_up(duration=0.1))
        assert logger.level == logging.INFO
    finally:
        logger.setLevel(level)
    assert not caplog.records
