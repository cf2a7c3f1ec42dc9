"""Where a scene puts its objects, and in which colours; its camera, and its recordings."""

import dataclasses
from collections import defaultdict

import numpy as np
import pytest
from aircraft_runs import PERIOD, aircraft_run, instant_of, orbits
from pydrake.math import RigidTransform, RotationMatrix
from scenes import ListCanvas, polygon, scenario, shown, snapshot

from drake_nonstop.mechanics.signals import AircraftState, CarrierStates
from drake_nonstop.model.system import aircraft_in
from drake_nonstop.scenario.scene_config import SceneConfig
from drake_nonstop.validation import ScenarioError
from drake_nonstop.view import camera
from drake_nonstop.view.bodies import (
    CABLE_COLOURS,
    MARK_COLOURS,
    SLACK_COLOUR,
    attitudes,
    cylinder_poses,
    rgb,
    tube,
)
from drake_nonstop.view.canvas import LiveCanvas, RecordingCanvas
from drake_nonstop.view.meshcat_server import start_meshcat
from drake_nonstop.view.scene import ROOT, Scene

RED, YELLOW, GREEN = map(rgb, MARK_COLOURS)


@pytest.fixture(scope="module")
def meshcat():
    return start_meshcat()


@pytest.mark.parametrize(("n", "nodes", "pieces"), [(3, 0, 1), (6, 0, 1), (3, 5, 6), (3, 12, 6)])
def test_cables_lead_from_attachments_through_nodes_to_carriers(n, nodes, pieces):
    instant = snapshot(0.7, n)
    carriers = instant.carriers.positions
    shares = np.linspace(0, 1, nodes + 2)[1:-1, None, None]
    points = shares * carriers + [0.0, 0.3, -0.1] * shares * (1 - shares)
    instant.cable_state = np.concatenate([points.ravel(), np.full(points.size, 9.0)])
    canvas = shown(instant, n=n, nodes=nodes)
    for i, attachment in enumerate(polygon(n)):
        paths = [f"/cables/{i}/{k}" if nodes else f"/cables/{i}" for k in range(pieces)]
        lines = np.array([canvas.ends(path) for path in paths])
        np.testing.assert_allclose(lines[0, 0], canvas.poses["/load"][0] @ attachment, atol=1e-12)
        np.testing.assert_allclose(lines[-1, 1], carriers[i], atol=1e-12)
        np.testing.assert_allclose(lines[1:, 0], lines[:-1, 1], atol=1e-12)
        for end in lines[1:, 0]:
            assert np.abs(points[:, i] - end).max(axis=1).min() < 1e-12
    assert len([path for path in canvas.poses if path.startswith("/cables")]) == n * pieces


def test_bodies_are_at_their_poses_and_carriers_along_their_velocity():
    instant = snapshot(0.7)
    canvas = shown(instant)
    for path, pose in (("/load", instant.load), ("/reference", instant.reference)):
        (found,) = canvas.poses[path]
        np.testing.assert_allclose(found.translation(), pose.position)
        np.testing.assert_allclose(found.rotation().ToQuaternion().wxyz(), pose.quaternion)
    for i, attachment in enumerate(polygon(4)):
        (found,) = canvas.poses[f"/carriers/{i}"]
        nose, _, top = found.rotation().matrix().T
        position = instant.carriers.positions[i]
        np.testing.assert_allclose(found.translation(), position)
        np.testing.assert_allclose(nose, instant.carriers.velocities[i], atol=1e-12)
        assert top @ (position - canvas.poses["/load"][0] @ attachment) > 0


@pytest.mark.parametrize(
    ("bound", "speeds", "colours"),
    [(0.5, [0.0, 0.5, 0.625, 9.0], [RED, RED, YELLOW, GREEN]), (0.0, [0.0] * 4, [GREEN] * 4)],
)
def test_marks_turn_from_green_to_red_as_the_speed_nears_the_bound(bound, speeds, colours):
    velocities = np.column_stack([speeds, np.zeros((4, 2))])
    canvas = shown(snapshot(velocities=velocities, speed_bound=bound))
    found = [canvas.colours[f"/carriers/{i}/mark"][0] for i in range(4)]
    np.testing.assert_allclose(found, colours, atol=1e-12)


def test_cables_darken_with_their_tension_and_slack_ones_stand_out():
    light, dark = (np.array(rgb(colour)) for colour in CABLE_COLOURS)
    canvas = shown(snapshot(tensions=9.81 / 4 * np.array([0.0, 1e-9, 1.0, 5.0])))
    found = [canvas.colours[f"/cables/{i}"][0] for i in range(4)]
    np.testing.assert_allclose(found, [rgb(SLACK_COLOUR), light, (light + dark) / 2, dark])


def test_trails_follow_the_bodies_and_fade():
    period = SceneConfig().trail_time * np.sqrt(1.8 / 9.81) / 40
    instants = [snapshot(k * period) for k in range(44)]
    canvas = shown(*instants)
    # The 41st piece has taken the place of the first; it leads from instant 40 to 41.
    carriers = [instants[k].carriers.positions[0] for k in (40, 41)]
    np.testing.assert_allclose(canvas.ends("/trails/1/0", 1), carriers, atol=1e-9)
    loads = [instants[k].load.position for k in (2, 3)]
    np.testing.assert_allclose(canvas.ends("/trails/0/2"), loads, atol=1e-9)
    before, *life = canvas.opacities["/trails/1/0"]
    end = life.index(0.0)
    assert before == 0.0
    assert life[: end + 1] == sorted(life[: end + 1], reverse=True)
    assert life[0] == life[end + 1] == 1.0  # its second life
    assert len({canvas.colours[f"/trails/{body}/0"][0] for body in range(5)}) == 5


def test_drawing_again_replaces_what_was_there(meshcat):
    meshcat.SetTransform("/mine", RigidTransform())
    for n in (6, 3):
        Scene(scenario(n)).draw(meshcat)
        assert meshcat.HasPath(f"{ROOT}/carriers/{n - 1}/mark")
        assert not meshcat.HasPath(f"{ROOT}/carriers/{n}")
    assert meshcat.HasPath("/mine")


def test_a_bad_config_is_refused():
    with pytest.raises(ScenarioError, match=r"^scene\.wing_span = .*greater than zero"):
        Scene(scenario(scene=SceneConfig(wing_span=0.0)))


@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), (3.0, -1.0, 0.5)])
def test_aircraft_are_drawn_in_coordinated_flight(wind):
    """No air and no force from the side: the wing is across what the aircraft needs."""
    run = aircraft_run(3.0, wind=wind)
    canvas, made = ListCanvas(), Scene(run.scenario)
    aircraft = aircraft_in(run.scenario.system)
    velocities = CarrierStates.view(run.signal("carrier_state")).velocities
    for row in (1, 100, 200):
        instant = instant_of(run, row)
        made.show(canvas, instant)
        _, forces = orbits(run.time[row : row + 1])
        acceleration = (velocities[row + 1] - velocities[row - 1]) / (2 * PERIOD)
        needed = aircraft.mass * (acceleration + np.array([0, 0, aircraft.gravity])) + forces[0]
        lifts = AircraftState.view(instant.aircraft_state).lift
        for i in range(4):
            nose, left, top = canvas.poses[f"/carriers/{i}"][-1].rotation().matrix().T
            through_air = velocities[row, i] - wind
            through_air /= np.linalg.norm(through_air)
            assert abs(left @ through_air) < 1e-12
            assert abs(left @ needed[i]) < 1e-4 * np.linalg.norm(needed[i])
            assert top @ needed[i] > 0
            angle = np.arctan2(-top @ through_air, nose @ through_air)
            assert angle == pytest.approx((lifts[i] - 0.25) / 5.0, abs=1e-12)


def test_wings_turn_from_green_to_red_towards_the_stall():
    run, canvas = aircraft_run(0.1), ListCanvas()
    state = np.concatenate([[0.1, 0.7, 1.05, 0.3], np.zeros(8), [30.0, 30.0, 30.0, 8.3]])
    instant = dataclasses.replace(instant_of(run, 0), aircraft_state=state)
    Scene(run.scenario).show(canvas, instant)
    colours = [canvas.colours[f"/carriers/{i}/wing"][0] for i in range(4)]
    np.testing.assert_allclose(colours, [GREEN, GREEN, YELLOW, RED], atol=1e-12)
    assert not [path for path in canvas.colours if path.endswith("mark")]


@pytest.mark.parametrize("size", [1.0, 60.0])
def test_camera_sees_all(size):
    path = np.column_stack([np.linspace(0, size, 30), np.zeros((30, 2))])
    points = np.concatenate([path + size * direction for direction in np.eye(3)])
    eye, target, aspect = camera.fit_view(points, path=path)
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
    up = np.cross(right, ahead)
    depth, side, height = ((points - eye) @ np.column_stack([ahead, right, up])).T
    slope = np.tan(np.radians(camera.VERTICAL_FIELD_OF_VIEW / 2))
    fill = np.max([np.abs(side) / camera.ASPECT_RATIO, np.abs(height)], axis=0) / depth / slope
    assert 0.7 < np.max(fill) < 1.0
    width = np.max(np.abs(side) / depth) / slope
    assert 1.1 < aspect / width < 1.2  # a window that is as narrow has all in view
    assert right[0] > 0.9  # the load moves along +x, to the right


@pytest.mark.parametrize(("length", "follows"), [(1.0, False), (10.0, True)])
def test_on_a_long_path_only_all_is_shifted_as_the_reference_moves(meshcat, length, follows):
    made, canvas, instant = Scene(scenario()), ListCanvas(), snapshot(0.5)
    made.set_stage(meshcat, np.array([[0.0, 0, 0], [length, 0, 0]]))
    made.show(canvas, instant)
    shifts = [pose.translation() for pose in canvas.poses[""]]
    np.testing.assert_allclose(shifts, [-instant.reference.position] * follows)
    assert len(canvas.poses["/Grid"]) == follows


def test_camera_disregards_carriers_far_from_the_load(meshcat):
    carriers = np.array([[[1.0, 0, 1], [-1, 0, 1], [1, 0, 1]]] * 2)
    views = []
    for far in (1.0, 1e5):
        carriers[:, 2, 0] = far
        Scene(scenario()).set_stage(meshcat, np.zeros((2, 3)), carriers)
        views.append(meshcat._GetPackedProperty("/Cameras/default/rotated/<object>", "far"))
    assert views[0] == views[1]


def test_poses_where_directions_are_parallel_or_undefined():
    up = np.array([0.0, 0.0, 1.0])
    directions = np.array([up, -up, [1e-9, 0.0, -1.0], [1, 0, 0], [0, -1, 0]])
    poses, lengths = cylinder_poses(np.zeros((5, 3)), 60 * directions)
    for pose, length, direction in zip(poses, lengths, directions, strict=True):
        end = RigidTransform(pose) @ np.array([0, 0, length / 2])  # raises where it is no rotation
        np.testing.assert_allclose(end, 60 * direction, atol=1e-6)
    assert cylinder_poses(up[None], up[None])[1] > 0
    for heading in (up, np.array([1.0, 0, 0])):
        for tops in (heading, -heading, np.array([2e-6, 0, 60.0])):
            attitude = RotationMatrix(attitudes(heading[None], up=tops[None])[0])
            np.testing.assert_allclose(attitude.matrix()[:, 0], heading, atol=1e-9)


def test_a_tube_encloses_its_path(rng):
    path = np.cumsum(rng.normal(size=(6, 3)), axis=0)
    vertices, faces = tube(path, 0.1)
    bars = vertices.T.reshape(5, 2, 4, 3)
    ends = np.stack([path[:-1], path[1:]], axis=1)
    np.testing.assert_allclose(np.linalg.norm(bars - ends[:, :, None], axis=-1), 0.1)
    np.testing.assert_allclose(bars.mean(axis=2), ends, atol=1e-12)
    a, b, c = vertices.T[faces]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    np.testing.assert_allclose(area, 4 * np.sqrt(2) * 0.1 * length)
    assert np.isfinite(tube(path[:1], 0.1)[0]).all()


class Written:
    """A Meshcat or an animation that keeps the values that are written to it, by frame."""

    def __init__(self):
        self.keys = defaultdict(dict)

    def SetProperty(self, *given):  # noqa: N802
        frame, path, name, value = given if len(given) == 4 else (len(self.keys), *given)
        self.keys[path, name][frame] = value


@pytest.mark.parametrize(("fades", "held"), [(False, {4: 1.0}), (True, {})])
def test_a_recording_holds_a_value_until_it_changes(fades, held):
    animation = Written()
    canvas = RecordingCanvas(animation)
    for canvas.frame, opacity in [(0, 1.0), (1, 1.0), (5, 0.25), (6, 0.25)]:
        canvas.paint("/a", (1.0, 0.5, 0.0), opacity, fades=fades)
    canvas.frame = 9
    canvas.finish()
    path = "/a/<object>"
    assert animation.keys[path, "material.opacity"] == {0: 1.0, 5: 0.25, 9: 0.25} | held
    colours = animation.keys[path, "material.color"]
    assert colours.keys() == {0, 9}
    np.testing.assert_allclose(colours[9], [1.0, 0.2140, 0.0], atol=1e-4)  # sRGB's half is linear


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
