"""What a scene makes of a run's instants, on a canvas that keeps it."""

from collections import defaultdict

import numpy as np
import pytest
from pydrake.geometry import MeshcatAnimation
from pydrake.math import RigidTransform, RotationMatrix

from drake_nonstop.model.system import SystemParameters
from drake_nonstop.validation import ScenarioError
from drake_nonstop.visualization import scene
from drake_nonstop.visualization.scene import (
    ROOT,
    FilmCanvas,
    LiveCanvas,
    Scene,
    SceneConfig,
    Snapshot,
    start_meshcat,
)


class Easel:
    """A canvas: all that was painted, in order, by path below the root."""

    def __init__(self):
        self.poses = defaultdict(list)
        self.lengths = defaultdict(list)
        self.colours = defaultdict(list)
        self.opacities = defaultdict(list)
        self.followed = []

    def follow(self, position, stage):
        self.followed.append(position)

    def place(self, path, pose, length=1.0):
        self.poses[path.removeprefix(ROOT)].append(RigidTransform(pose))
        self.lengths[path.removeprefix(ROOT)].append(length)

    def paint(self, path, colour, opacity, *, fades=False):
        self.colours[path.removeprefix(ROOT)].append(tuple(colour))
        self.opacities[path.removeprefix(ROOT)].append(opacity)


def polygon(n):
    angles = 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n)])


def system(n=4, cable_length=0.8):
    return SystemParameters(attachments=polygon(n).tolist(), cable_length=cable_length)


def snapshot(time=0.0, n=4, speed_bound=0.5, **fields):
    """Carriers that circle above a turning load on its way along x."""
    angles = time + 2 * np.pi * np.arange(n) / n
    positions = np.column_stack([np.cos(angles), np.sin(angles), np.full(n, 0.8)])
    load = np.array([np.cos(time / 4), 0, 0, np.sin(time / 4), 0.7 * time, 0, 0])
    values = {
        "load": load,
        "reference": load + np.array([0, 0, 0, 0, 0, 0.1, 0]),
        "carriers": positions + load[4:],
        "velocities": np.column_stack([-np.sin(angles), np.cos(angles), np.zeros(n)]),
        "tensions": np.full(n, 2.5),
    }
    return Snapshot(time=time, speed_bound=speed_bound, **(values | fields))


def shown(*snapshots, n=4, config=None):
    easel = Easel()
    made = Scene(system(n), config)
    for each in snapshots:
        made.show(easel, each)
    return easel


@pytest.mark.parametrize("n", [3, 4, 6])
def test_cables_end_at_attachments_and_carriers(n):
    instant = snapshot(0.7, n)
    easel = shown(instant, n=n)
    for i, attachment in enumerate(polygon(n)):
        pose, length = easel.poses[f"/cables/{i}"][0], easel.lengths[f"/cables/{i}"][0]
        start, end = (pose @ np.array([0, 0, side * length / 2]) for side in (-1, 1))
        np.testing.assert_allclose(start, easel.poses["/load"][0] @ attachment, atol=1e-12)
        np.testing.assert_allclose(end, instant.carriers[i], atol=1e-12)


def test_carriers_fly_along_their_velocity_with_their_top_away_from_the_cable():
    instant = snapshot(0.7)
    easel = shown(instant)
    for i, attachment in enumerate(polygon(4)):
        pose = easel.poses[f"/carriers/{i}"][0]
        nose, _, top = pose.rotation().matrix().T
        np.testing.assert_allclose(pose.translation(), instant.carriers[i])
        np.testing.assert_allclose(nose, instant.velocities[i], atol=1e-12)
        assert top @ (instant.carriers[i] - easel.poses["/load"][0] @ attachment) > 0


def test_a_carrier_that_stops_keeps_its_heading():
    easel = shown(snapshot(0.3), snapshot(0.31, velocities=np.zeros((4, 3))))
    before, after = (pose.rotation().matrix()[:, 0] for pose in easel.poses["/carriers/2"])
    np.testing.assert_allclose(before, after)


def test_load_and_ghost_are_where_the_states_say():
    instant = snapshot(0.9)
    easel = shown(instant)
    for path, state in (("/load", instant.load), ("/reference", instant.reference)):
        pose = easel.poses[path][0]
        np.testing.assert_allclose(pose.translation(), state[4:])
        np.testing.assert_allclose(pose.rotation().ToQuaternion().wxyz(), state[:4])


def test_quaternions_need_not_be_of_unit_length():
    load = snapshot(0.9).load * [3, 3, 3, 3, 1, 1, 1]
    np.testing.assert_allclose(
        shown(snapshot(0.9, load=load)).poses["/load"][0].GetAsMatrix4(),
        shown(snapshot(0.9)).poses["/load"][0].GetAsMatrix4(),
    )


def test_marks_turn_from_green_to_red_as_the_speed_nears_the_bound():
    made = Scene(system())
    red, yellow, green = (scene._rgb(colour) for colour in SceneConfig().mark_colours)
    for speed, colour in ((0.0, red), (0.5, red), (0.625, yellow), (0.75, green), (9.0, green)):
        np.testing.assert_allclose(made.mark_colour(speed, 0.5), colour, atol=1e-12)
    np.testing.assert_allclose(made.mark_colour(0.0, 0.0), green)  # no bound
    between = made.mark_colour(0.5625, 0.5)
    np.testing.assert_allclose(between, (np.array(red) + yellow) / 2)
    speeds = np.array([0.5, 0.625, 0.75, 9.0])
    velocities = np.column_stack([speeds, np.zeros((4, 2))])
    easel = shown(snapshot(velocities=velocities))
    colours = [easel.colours[f"/carriers/{i}/mark"][0] for i in range(4)]
    np.testing.assert_allclose(colours, [red, yellow, green, green], atol=1e-12)


def test_cables_darken_with_their_tension_and_slack_ones_stand_out():
    made = Scene(system())
    share = 9.81 / 4
    light, dark = (np.array(scene._rgb(colour)) for colour in SceneConfig().cable_colours)
    np.testing.assert_allclose(made.cable_colour(1e-9), light, atol=1e-8)
    np.testing.assert_allclose(made.cable_colour(share), (light + dark) / 2)
    np.testing.assert_allclose(made.cable_colour(5 * share), dark)
    slack = scene._rgb(SceneConfig().slack_colour)
    np.testing.assert_allclose(made.cable_colour(0.0), slack)
    easel = shown(snapshot(tensions=np.array([0.0, 2.5, 2.5, 2.5])))
    np.testing.assert_allclose(easel.colours["/cables/0"][0], slack)
    assert min(np.abs(np.subtract(slack, c)).max() for c in np.linspace(light, dark, 50)) > 0.4


def test_trails_follow_the_bodies_and_fade():
    config = SceneConfig(trail_pieces=8)
    period = config.trail_time * np.sqrt(1.8 / 9.81) / 8
    instants = [snapshot(k * period) for k in range(14)]
    easel = shown(*instants, config=config)
    # The ninth piece has taken the place of the first; it leads from instant 8 to 9.
    pose, length = easel.poses["/trails/1/0"][1], easel.lengths["/trails/1/0"][1]
    ends = [pose @ np.array([0, 0, side * length / 2]) for side in (-1, 1)]
    np.testing.assert_allclose(ends, [instants[8].carriers[0], instants[9].carriers[0]], atol=1e-9)
    opacities = easel.opacities["/trails/1/0"]
    first_life = opacities[1:9]
    assert opacities[0] == 0.0  # before there is a trail
    assert first_life == sorted(first_life, reverse=True)
    assert first_life[0] == 1.0
    assert 0.0 in first_life
    assert opacities[opacities.index(0.0, 1) + 1] == 1.0  # its second life
    load_ends = easel.poses["/trails/0/2"][0].translation()
    middle = (instants[2].load[4:] + instants[3].load[4:]) / 2
    np.testing.assert_allclose(load_ends, middle, atol=1e-9)


@pytest.mark.parametrize("length", [0.8, 60.0])
def test_sizes_and_times_grow_with_the_cables(length):
    small, large = Scene(system()), Scene(system(cable_length=length))
    assert large.reach == pytest.approx(1 + length)
    ratio = large.reach / small.reach
    assert large._piece_time / small._piece_time == pytest.approx(np.sqrt(ratio))


def test_degenerate_poses():
    up = np.array([0.0, 0.0, 1.0])
    ways = np.array([up, -up, [1e-9, 0.0, -1.0], [1, 0, 0], [0, -1, 0]])
    poses, lengths = scene._between(np.zeros((5, 3)), 60 * ways)
    for pose, length, way in zip(poses, lengths, ways, strict=True):
        end = RigidTransform(pose) @ np.array([0, 0, length / 2])  # and a proper rotation it is
        np.testing.assert_allclose(end, 60 * way, atol=1e-6)
    poses, lengths = scene._between(up[None], up[None])
    assert lengths[0] > 0
    RigidTransform(poses[0])
    for heading in (up, np.array([1.0, 0, 0])):
        for tops in (heading, -heading, np.array([2e-6, 0, 60.0])):
            attitude = RotationMatrix(scene._attitudes(heading[None], up=tops[None])[0])
            np.testing.assert_allclose(attitude.matrix()[:, 0], heading, atol=1e-9)


@pytest.mark.parametrize("size", [1.0, 60.0])
def test_camera_sees_all(size):
    path = np.column_stack([np.linspace(0, size, 30), np.zeros((30, 2))])
    points = np.concatenate([path + size * direction for direction in np.eye(3)])
    eye, target = scene._view(points, path=path)
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
    up = np.cross(right, ahead)
    depth, side, height = ((points - eye) @ np.column_stack([ahead, right, up])).T
    slope = np.tan(np.radians(scene.VERTICAL_VIEW / 2))
    fill = np.max([np.abs(side) / scene.ASPECT_RATIO, np.abs(height)], axis=0) / depth / slope
    assert 0.7 < np.max(fill) < 1.0
    assert right[0] > 0.9  # the load's way, +x, leads to the right


def test_camera_goes_along_on_a_long_way_only():
    meshcat = start_meshcat()
    for way, follows in ((1.0, False), (10.0, True)):
        made, easel = Scene(system()), Easel()
        made.set_stage(meshcat, np.array([[0.0, 0, 0], [way, 0, 0]]))
        made.show(easel, snapshot(0.5))
        assert bool(easel.followed) == follows
        if follows:
            np.testing.assert_array_equal(easel.followed[0], snapshot(0.5).reference[4:])


def test_camera_disregards_carriers_that_went_astray():
    meshcat = start_meshcat()
    path = np.zeros((2, 3))
    views = []
    for far in (1.0, 1e5):
        made = Scene(system())
        carriers = np.array([[[1.0, 0, 1], [-1, 0, 1]], [[1, 0, 1], [-1, 0, 1]]])
        extra = np.array([[[far, 0, 1]]] * 2) if far > 10 else carriers[:, :1]
        made.set_stage(meshcat, path, np.concatenate([carriers, extra], axis=1))
        views.append(meshcat._GetPackedProperty("/Cameras/default/rotated/<object>", "far"))
    assert views[0] == views[1]


class Reel:
    """An animation that keeps what is written to it."""

    def __init__(self):
        self.keys = defaultdict(dict)

    def SetTransform(self, frame, path, pose):  # noqa: N802
        self.keys[path, "transform"][frame] = pose.translation().tolist()

    def SetProperty(self, frame, path, name, value):  # noqa: N802
        self.keys[path, name][frame] = value


def filmed(writes, last):
    """What a film holds after (frame, function of the canvas) writes."""
    reel = Reel()
    canvas = FilmCanvas(reel)
    for frame, write in writes:
        canvas.frame = frame
        write(canvas)
    canvas.frame = last
    canvas.finish()
    return reel.keys


def test_a_film_holds_what_does_not_change_until_it_does():
    grey = np.full(3, 0.5)

    def painted(opacity, **fading):
        return lambda canvas: canvas.paint("/a", grey, opacity, **fading)

    writes = [(0, painted(1.0)), (1, painted(1.0)), (5, painted(0.25)), (6, painted(0.25))]
    keys = filmed(writes, 9)
    assert keys["/a/<object>", "material.opacity"] == {0: 1.0, 4: 1.0, 5: 0.25, 9: 0.25}
    assert keys["/a/<object>", "material.color"] == {0: [0.5] * 3, 9: [0.5] * 3}
    fading = filmed([(0, painted(1.0)), (5, painted(0.25, fades=True))], 9)
    assert fading["/a/<object>", "material.opacity"] == {0: 1.0, 5: 0.25, 9: 0.25}


def test_a_film_follows_by_moving_the_world():
    stage = scene.Stage(origin=np.array([1.0, 0, 0]), target=np.ones(3), floor=np.array([0, 0, -1]))
    keys = filmed([(0, lambda canvas: canvas.follow(np.array([4.0, 0, 0]), stage))], 0)
    assert keys[ROOT, "transform"][0] == [-3, 0, 0]
    assert keys["/Grid", "transform"][0] == [-3, 0, -1]


def test_a_film_can_be_given_to_meshcat():
    canvas = FilmCanvas(MeshcatAnimation(25))
    made = Scene(system())
    for frame in range(3):
        canvas.frame = frame
        made.show(canvas, snapshot(frame / 25))
    canvas.finish()


def test_a_live_canvas_paints_changes_only():
    class Counter:
        calls = 0

        def SetProperty(self, *arguments):  # noqa: N802
            self.calls += 1

    counter = Counter()
    canvas = LiveCanvas(counter)
    for opacity in (1.0, 1.0, 0.5, 0.5, 1.0):
        canvas.paint("/a", np.ones(3), opacity)
    assert counter.calls == 3


def test_drawing_again_replaces_what_was_there():
    meshcat = start_meshcat()
    Scene(system(6)).draw(meshcat)
    assert meshcat.HasPath(f"{ROOT}/carriers/5")
    meshcat.SetTransform("/mine", shown(snapshot()).poses["/load"][0])
    Scene(system(3)).draw(meshcat)
    assert meshcat.HasPath(f"{ROOT}/carriers/2")
    assert not meshcat.HasPath(f"{ROOT}/carriers/3")
    assert meshcat.HasPath("/mine")


@pytest.mark.parametrize(
    ("field", "value", "remedy"),
    [
        ("load_colour", "blue", "#rrggbb"),
        ("mark_colours", ["#000000"], "2 or more"),
        ("carrier_colours", [], "1 or more"),
        ("cable_colours", ["#000000", "12"], "#rrggbb"),
        ("wing_span", 0.0, "greater than zero"),
        ("trail_time", float("nan"), "greater than zero"),
        ("mark_range", 1.0, "greater than 1"),
        ("mark_opacity", -0.1, "not negative"),
        ("trail_pieces", 1, "2 to 1000"),
    ],
)
def test_bad_config_tells_field_value_and_remedy(field, value, remedy):
    with pytest.raises(ScenarioError, match=f"^scene\\.{field} = .*{remedy}"):
        Scene(system(), SceneConfig(**{field: value}))
