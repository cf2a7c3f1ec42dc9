"""Where a scene puts its objects, and in which colours, on a canvas that lists them."""

import dataclasses

import numpy as np
import pytest
from aircraft_runs import PERIOD, aircraft_run, instant_of, orbits
from scenes import ListCanvas, polygon, shown, snapshot, system

from drake_nonstop.mechanics.signals import AircraftState, CarrierStates
from drake_nonstop.model.system import aircraft_in
from drake_nonstop.scenario.scene_config import SceneConfig
from drake_nonstop.validation import ScenarioError
from drake_nonstop.view.bodies import rgb
from drake_nonstop.view.canvas import ROOT
from drake_nonstop.view.meshcat_server import start_meshcat
from drake_nonstop.view.scene import Scene


@pytest.mark.parametrize("n", [3, 4, 6])
def test_cables_end_at_attachments_and_carriers(n):
    instant = snapshot(0.7, n)
    canvas = shown(instant, n=n)
    for i, attachment in enumerate(polygon(n)):
        pose, length = canvas.poses[f"/cables/{i}"][0], canvas.lengths[f"/cables/{i}"][0]
        start, end = (pose @ np.array([0, 0, side * length / 2]) for side in (-1, 1))
        np.testing.assert_allclose(start, canvas.poses["/load"][0] @ attachment, atol=1e-12)
        np.testing.assert_allclose(end, instant.carriers[i], atol=1e-12)


@pytest.mark.parametrize(("nodes", "pieces"), [(1, 2), (5, 6), (12, 6)])
def test_cables_with_nodes_are_lines_through_them(nodes, pieces):
    instant = snapshot(0.7, 3)
    shares = np.linspace(0, 1, nodes + 2)[1:-1, None, None]
    points = shares * instant.carriers + [0.0, 0.3, -0.1] * shares * (1 - shares)
    instant.cable_state = np.concatenate([points.ravel(), np.full(points.size, 9.0)])
    canvas = shown(instant, n=3, nodes=nodes)
    assert "/cables/0" not in canvas.poses
    for i, attachment in enumerate(polygon(3)):
        ends = [canvas.poses["/load"][0] @ attachment]
        for k in range(pieces):
            path = f"/cables/{i}/{k}"
            pose, length = canvas.poses[path][0], canvas.lengths[path][0]
            low, high = (pose @ np.array([0, 0, side * length / 2]) for side in (-1, 1))
            np.testing.assert_allclose(low, ends[-1], atol=1e-12)
            ends.append(high)
        np.testing.assert_allclose(ends[-1], instant.carriers[i], atol=1e-12)
        for end in ends[1:-1]:
            assert np.abs(points[:, i] - end).max(axis=1).min() < 1e-12
    assert f"/cables/0/{pieces}" not in canvas.poses


def test_carriers_fly_along_their_velocity_with_their_top_away_from_the_cable():
    instant = snapshot(0.7)
    canvas = shown(instant)
    for i, attachment in enumerate(polygon(4)):
        pose = canvas.poses[f"/carriers/{i}"][0]
        nose, _, top = pose.rotation().matrix().T
        np.testing.assert_allclose(pose.translation(), instant.carriers[i])
        np.testing.assert_allclose(nose, instant.velocities[i], atol=1e-12)
        assert top @ (instant.carriers[i] - canvas.poses["/load"][0] @ attachment) > 0


def test_load_and_reference_are_at_their_poses():
    instant = snapshot(0.9)
    canvas = shown(instant)
    for path, quaternion, position in (
        ("/load", instant.load_quaternion, instant.load_position),
        ("/reference", instant.reference_quaternion, instant.reference_position),
    ):
        pose = canvas.poses[path][0]
        np.testing.assert_allclose(pose.translation(), position)
        np.testing.assert_allclose(pose.rotation().ToQuaternion().wxyz(), quaternion)


def test_marks_turn_from_green_to_red_as_the_speed_nears_the_bound():
    made = Scene(system())
    red, yellow, green = (rgb(colour) for colour in SceneConfig().mark_colours)
    for speed, colour in ((0.0, red), (0.5, red), (0.625, yellow), (0.75, green), (9.0, green)):
        np.testing.assert_allclose(made.mark_colour(speed, 0.5), colour, atol=1e-12)
    np.testing.assert_allclose(made.mark_colour(0.0, 0.0), green)  # no bound
    between = made.mark_colour(0.5625, 0.5)
    np.testing.assert_allclose(between, (np.array(red) + yellow) / 2)
    speeds = np.array([0.5, 0.625, 0.75, 9.0])
    velocities = np.column_stack([speeds, np.zeros((4, 2))])
    canvas = shown(snapshot(velocities=velocities))
    colours = [canvas.colours[f"/carriers/{i}/mark"][0] for i in range(4)]
    np.testing.assert_allclose(colours, [red, yellow, green, green], atol=1e-12)


def test_cables_darken_with_their_tension_and_slack_ones_stand_out():
    made = Scene(system())
    share = 9.81 / 4
    light, dark = (np.array(rgb(colour)) for colour in SceneConfig().cable_colours)
    np.testing.assert_allclose(made.cable_colour(1e-9), light, atol=1e-8)
    np.testing.assert_allclose(made.cable_colour(share), (light + dark) / 2)
    np.testing.assert_allclose(made.cable_colour(5 * share), dark)
    slack = rgb(SceneConfig().slack_colour)
    np.testing.assert_allclose(made.cable_colour(0.0), slack)
    canvas = shown(snapshot(tensions=np.array([0.0, 2.5, 2.5, 2.5])))
    np.testing.assert_allclose(canvas.colours["/cables/0"][0], slack)
    assert min(np.abs(np.subtract(slack, c)).max() for c in np.linspace(light, dark, 50)) > 0.4


def test_trails_follow_the_bodies_and_fade():
    config = SceneConfig(trail_pieces=8)
    period = config.trail_time * np.sqrt(1.8 / 9.81) / 8
    instants = [snapshot(k * period) for k in range(14)]
    canvas = shown(*instants, config=config)
    # The ninth piece has taken the place of the first; it leads from instant 8 to 9.
    pose, length = canvas.poses["/trails/1/0"][1], canvas.lengths["/trails/1/0"][1]
    ends = [pose @ np.array([0, 0, side * length / 2]) for side in (-1, 1)]
    np.testing.assert_allclose(ends, [instants[8].carriers[0], instants[9].carriers[0]], atol=1e-9)
    opacities = canvas.opacities["/trails/1/0"]
    first_life = opacities[1:9]
    assert opacities[0] == 0.0  # before there is a trail
    assert first_life == sorted(first_life, reverse=True)
    assert first_life[0] == 1.0
    assert 0.0 in first_life
    assert opacities[opacities.index(0.0, 1) + 1] == 1.0  # its second life
    load_ends = canvas.poses["/trails/0/2"][0].translation()
    middle = (instants[2].load_position + instants[3].load_position) / 2
    np.testing.assert_allclose(load_ends, middle, atol=1e-9)


def test_drawing_again_replaces_what_was_there():
    meshcat = start_meshcat()
    Scene(system(6)).draw(meshcat)
    assert meshcat.HasPath(f"{ROOT}/carriers/5")
    meshcat.SetTransform("/mine", shown(snapshot()).poses["/load"][0])
    Scene(system(3)).draw(meshcat)
    assert meshcat.HasPath(f"{ROOT}/carriers/2")
    assert not meshcat.HasPath(f"{ROOT}/carriers/3")
    assert meshcat.HasPath("/mine")


def test_a_bad_config_is_refused():
    with pytest.raises(ScenarioError, match=r"^scene\.wing_span = .*greater than zero"):
        Scene(system(), SceneConfig(wing_span=0.0))


@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), (3.0, -1.0, 0.5)])
def test_aircraft_are_drawn_in_coordinated_flight(wind):
    """No air and no force from the side: the wing is across what the aircraft needs."""
    run = aircraft_run(3.0, wind=wind)
    canvas = ListCanvas()
    made = Scene(run.scenario.system)
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
            through_air = instant.velocities[i] - wind
            through_air /= np.linalg.norm(through_air)
            assert abs(left @ through_air) < 1e-12
            assert abs(left @ needed[i]) < 1e-4 * np.linalg.norm(needed[i])
            assert top @ needed[i] > 0
            angle = np.arctan2(-top @ through_air, nose @ through_air)
            assert angle == pytest.approx((lifts[i] - 0.25) / 5.0, abs=1e-12)


def test_wings_turn_from_green_to_red_towards_the_stall():
    run = aircraft_run(0.1)
    made, canvas = Scene(run.scenario.system), ListCanvas()
    red, yellow, green = (rgb(colour) for colour in SceneConfig().mark_colours)
    state = np.concatenate([[0.1, 0.7, 1.05, 0.3], np.zeros(8), [30.0, 30.0, 30.0, 8.3]])
    made.show(canvas, dataclasses.replace(instant_of(run, 0), aircraft_state=state))
    colours = [canvas.colours[f"/carriers/{i}/wing"][0] for i in range(4)]
    np.testing.assert_allclose(colours, [green, green, yellow, red], atol=1e-12)
    assert not [path for path in canvas.colours if path.endswith("mark")]


def test_the_wind_is_an_arrow_at_the_load():
    run = aircraft_run(0.1, wind=(3.0, -4.0, 0.0))
    made, canvas = Scene(run.scenario.system), ListCanvas()
    made.show(canvas, instant_of(run, 0))
    shaft, head = (canvas.poses[f"/wind/{part}"][0] for part in ("shaft", "head"))
    direction = shaft.rotation().matrix()[:, 2]
    np.testing.assert_allclose(direction, [0.6, -0.8, 0.0], atol=1e-12)
    length = canvas.lengths["/wind/shaft"][0]
    assert length == pytest.approx(0.25 * made.reach)
    tip = head.translation()
    np.testing.assert_allclose(head.rotation().matrix()[:, 2], -direction, atol=1e-12)
    assert (tip - shaft.translation()) @ direction > length / 2
    assert canvas.opacities["/wind/shaft"] == canvas.opacities["/wind/head"] == [1.0]
    made.show(canvas, dataclasses.replace(instant_of(run, 1), load_wind=np.zeros(3)))
    assert canvas.opacities["/wind/shaft"] == canvas.opacities["/wind/head"] == [1.0, 0.0]
