"""The visualizer: what it shows, by closed forms of single instants; it changes nothing."""

import time

import numpy as np
import pytest
from aircraft_runs import PERIOD, aircraft_run, orbits
from helpers import circling_run, rotation
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import DiagramBuilder
from scenes import Screen, instant, shown, watch

from drake_nonstop import (
    NonstopVisualizer,
    make_nonstop,
    set_equilibrium,
    show_in,
    start_meshcat,
)
from drake_nonstop.mechanics.signals import AircraftState, CarrierStates
from drake_nonstop.model.system import aircraft_in
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario


@pytest.fixture(scope="module")
def meshcat():
    return start_meshcat()


def short(name="quintic", duration=0.3, *changes):
    return load_scenario(name, [f"simulation_duration={duration}", *changes])


@pytest.mark.parametrize(("tick", "least", "most"), [(0.0, 1, 1), (1.0, 20, 1000)])
def test_it_shows_the_start_and_frames_as_they_are_due_and_what_is_forced(
    monkeypatch, tick, least, most
):
    class Clocked(Screen):
        def SetSimulationTime(self, at):  # noqa: N802
            times.append(at)

    times, clock = [], iter(range(10**9))
    monkeypatch.setattr(time, "perf_counter", lambda: tick * next(clock))  # s
    scenario, builder = short(), DiagramBuilder()
    nonstop = builder.AddSystem(make_nonstop(scenario))
    visualizer = NonstopVisualizer.AddToBuilder(builder, nonstop, scenario, Clocked())
    simulator = Simulator(builder.Build())
    ApplySimulatorConfig(scenario.simulator_config, simulator)
    context = simulator.get_mutable_context()
    set_equilibrium(nonstop, nonstop.GetMyMutableContextFromRoot(context))
    simulator.AdvanceTo(0.1)
    assert times[0] == 0.0
    assert least <= len(times) <= most
    assert times == sorted(times)
    visualizer.ForcedPublish(visualizer.GetMyContextFromRoot(context))
    assert times[-1] == 0.1


def test_all_but_load_carriers_and_tensions_may_be_left_out_or_not_be_finite():
    aircraft = aircraft_run(0.1, wind=(2.0, 0.0, 0.0))
    given = instant(aircraft, 3)
    optional = {"aircraft_state", "wind", "speed_bound"}
    left_out = {name: given[name] for name in given.keys() - optional}
    carrier = "/nonstop/carriers/0"
    with_all, without = (shown(aircraft.scenario, each) for each in (given, left_out))
    assert with_all.colours.keys() - without.colours.keys() == {
        f"/nonstop/carriers/{i}/wing" for i in range(4)
    }
    assert not np.allclose(with_all.matrices[carrier], without.matrices[carrier])
    run = circling_run()
    instants = [instant(run), instant(run, 1, tensions=[1.0, np.nan, 1.0, 1.0])]
    first, last = (screen.matrices[carrier] for screen in watch(run.scenario, instants, Screen()))
    np.testing.assert_array_equal(first, last)  # what is not finite is left to the blocks


@pytest.mark.parametrize(
    ("name", "changes", "last"),
    [
        ("three_carriers", [], "carriers/2/mark"),
        ("static_hold_open_loop", [], "carriers/3/mark"),
        ("line", [], "carriers/3/mark"),
        ("aircraft_rest", ["cables=LumpedCables", "cables.nodes=2"], "cables/3/2"),
    ],
)
def test_it_shows_any_scenario_in_place_of_an_earlier_one(meshcat, name, changes, last):
    meshcat.SetTransform("/mine", RigidTransform())
    simulate(short(name, 0.02, *changes), viewers=[show_in(meshcat)])
    assert meshcat.HasPath(f"/nonstop/{last}")
    count = len(load_scenario(name).system.attachments)
    assert not meshcat.HasPath(f"/nonstop/carriers/{count}")
    assert meshcat.HasPath("/mine")


RED, YELLOW, GREEN = "e0101a", "f5b800", "18a048"  # of marks and wings
LIGHT, DARK, SLACK = "9cc4e4", "08306b", "ff00c8"  # of cables


def rgb(colour):
    return np.array([*bytes.fromhex(colour)]) / 255


def positions_of(values):
    return CarrierStates.view(values["carrier_state"]).positions


@pytest.mark.parametrize(("n", "nodes", "pieces"), [(3, 0, 1), (6, 0, 1), (3, 5, 6), (3, 12, 6)])
def test_cables_lead_from_attachments_through_nodes_to_carriers(n, nodes, pieces):
    run = circling_run(n)
    values = instant(run, 30)
    carriers = positions_of(values)
    shares = np.linspace(0, 1, nodes + 2)[1:-1, None, None]
    points = shares * carriers + [0.0, 0.3, -0.1] * shares * (1 - shares)
    if nodes:
        values["cable_state"] = np.concatenate([points.ravel(), np.full(points.size, 9.0)])
    screen = shown(run.scenario, values, nodes=nodes)
    attachments = np.array(run.scenario.system.attachments) @ rotation(values["load_state"][:4]).T
    for i, attachment in enumerate(attachments + values["load_state"][4:7]):
        paths = [f"/nonstop/cables/{i}{f'/{k}' if nodes else ''}" for k in range(pieces)]
        lines = np.array([screen.ends(path) for path in paths])
        np.testing.assert_allclose(lines[0, 0], attachment, atol=1e-12)
        np.testing.assert_allclose(lines[-1, 1], carriers[i], atol=1e-12)
        np.testing.assert_allclose(lines[1:, 0], lines[:-1, 1], atol=1e-12)
        for end in lines[1:, 0]:
            assert np.abs(points[:, i] - end).max(axis=1).min() < 1e-12
    assert len([path for path in screen.matrices if "/cables/" in path]) == n * pieces


def test_bodies_are_at_their_poses_and_carriers_along_their_velocity():
    run = circling_run()
    reference = np.array([0.6, 0.8, 0, 0, 0.3, 0.1, -0.2, *np.zeros(15)])
    values = instant(run, 30, reference=reference)
    screen = shown(run.scenario, values)
    for name, state in (("load", values["load_state"]), ("reference", reference)):
        matrix = screen.matrices[f"/nonstop/{name}"]
        np.testing.assert_allclose(matrix[:3, :3], rotation(state[:4]), atol=1e-12)
        np.testing.assert_allclose(matrix[:3, 3], state[4:7])
    positions, velocities = CarrierStates.view(values["carrier_state"])
    for i in range(4):
        matrix = screen.matrices[f"/nonstop/carriers/{i}"]
        np.testing.assert_allclose(matrix[:3, 3], positions[i])
        speed = np.linalg.norm(velocities[i])
        np.testing.assert_allclose(speed * matrix[:3, 0], velocities[i], atol=1e-12)
        start, end = screen.ends(f"/nonstop/cables/{i}")
        assert matrix[:3, 2] @ (end - start) > 0  # the top is away from the cable


@pytest.mark.parametrize("velocity", [(0, 0, 0), (0, 0, 1), (0, 0, -1), (2e-6, 0, -60), (1, 0, 0)])
def test_directions_that_are_parallel_or_undefined_make_poses(velocity):
    run = circling_run(3)
    attachments = np.array(run.scenario.system.attachments)
    upright = np.array([1.0, *np.zeros(21)])
    away = np.array([[0, 0, 0.8], [0, 0, -0.8], [1e-9, 0, -60.0]])
    state = np.concatenate([(attachments + away).ravel(), np.tile(velocity, 3)])
    given = {"load_state": upright[:13], "reference": upright, "carrier_state": state}
    screen = shown(run.scenario, instant(run, **given))
    for i in range(3):
        ends = screen.ends(f"/nonstop/cables/{i}")
        np.testing.assert_allclose(ends, [attachments[i], attachments[i] + away[i]], atol=1e-6)
        matrix = screen.matrices[f"/nonstop/cables/{i}"][:3, :3].copy()
        matrix[:, 2] /= np.linalg.norm(matrix[:, 2])
        RotationMatrix(matrix)  # raises where it is none
        pose = RigidTransform(screen.matrices[f"/nonstop/carriers/{i}"])  # raises for no rotation
        speed = np.linalg.norm(velocity)
        np.testing.assert_allclose(speed * pose.rotation().col(0), velocity, atol=1e-9 * speed)


@pytest.mark.parametrize(
    ("bound", "speeds", "colours"),
    [(0.5, [0.0, 0.5, 0.625, 9.0], [RED, RED, YELLOW, GREEN]), (0.0, [0.0] * 4, [GREEN] * 4)],
)
def test_marks_turn_from_green_to_red_as_the_speed_nears_the_bound(bound, speeds, colours):
    run = circling_run()
    velocities = np.column_stack([speeds, np.zeros((4, 2))])
    state = np.concatenate([run.signal("carrier_state")[0, :12], velocities.ravel()])
    screen = shown(run.scenario, instant(run, carrier_state=state, speed_bound=[bound]))
    for i, colour in enumerate(colours):
        found = screen.colours[f"/nonstop/carriers/{i}/mark"]
        np.testing.assert_allclose(found, [*rgb(colour), 0.25], atol=1e-12)


def test_cables_darken_with_their_tension_and_slack_ones_stand_out():
    run = circling_run()
    system = run.scenario.system
    share = system.load_mass * system.gravity / 4
    screen = shown(run.scenario, instant(run, tensions=share * np.array([0.0, 1e-9, 1.0, 5.0])))
    found = [screen.colours[f"/nonstop/cables/{i}"][:3] for i in range(4)]
    light, dark = rgb(LIGHT), rgb(DARK)
    np.testing.assert_allclose(found, [rgb(SLACK), light, (light + dark) / 2, dark])


def test_nothing_is_painted_again_that_has_not_changed():
    run = circling_run()
    screen = shown(run.scenario, instant(run))
    count = screen.paint_calls
    again = [instant(run), instant(run, time=0.001), instant(run, time=0.002)]
    assert shown(run.scenario, *again).paint_calls == count > 0


def test_trails_follow_the_bodies_and_fade():
    run = circling_run(duration=5.0)
    period = run.scenario.scene.trail_time * np.sqrt(1.8 / 9.81) / 40  # reach over gravity
    times = np.arange(44) * period
    rows = np.round(times / 0.01).astype(int)
    instants = [instant(run, row, time=time) for row, time in zip(rows, times, strict=True)]
    opacities = []
    for screen in watch(run.scenario, instants, Screen()):
        opacities.append(screen.colours["/nonstop/trails/1/0"][3])
    # The 41st piece has taken the place of the first; it leads from instant 40 to 41.
    carriers = [positions_of(instants[k])[0] for k in (40, 41)]
    np.testing.assert_allclose(screen.ends("/nonstop/trails/1/0"), carriers, atol=1e-9)
    loads = [instants[k]["load_state"][4:7] for k in (42, 43)]
    np.testing.assert_allclose(screen.ends("/nonstop/trails/0/2"), loads, atol=1e-9)
    before, *life = opacities
    assert before == life[39] == 0.0
    assert life[:40] == sorted(life[:40], reverse=True)
    assert life[0] == life[40] == 1.0  # its second life
    assert len({*(tuple(screen.colours[f"/nonstop/trails/{k}/0"][:3]) for k in range(5))}) == 5


@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), (3.0, -1.0, 0.5)])
def test_aircraft_are_drawn_in_coordinated_flight(wind):
    """No air and no force from the side: the wing is across what the aircraft needs."""
    run = aircraft_run(3.0, wind=wind)
    aircraft = aircraft_in(run.scenario.system)
    velocities = CarrierStates.view(run.signal("carrier_state")).velocities
    for row in (1, 100, 200):
        values = instant(run, row)
        screen = shown(run.scenario, values)
        _, forces = orbits(run.time[row : row + 1])
        acceleration = (velocities[row + 1] - velocities[row - 1]) / (2 * PERIOD)
        needed = aircraft.mass * (acceleration + np.array([0, 0, aircraft.gravity])) + forces[0]
        lifts = AircraftState.view(values["aircraft_state"]).lift
        for i in range(4):
            nose, left, top = screen.matrices[f"/nonstop/carriers/{i}"][:3, :3].T
            through_air = velocities[row, i] - wind
            through_air /= np.linalg.norm(through_air)
            assert abs(left @ through_air) < 1e-12
            assert abs(left @ needed[i]) < 1e-4 * np.linalg.norm(needed[i])
            assert top @ needed[i] > 0
            angle = np.arctan2(-top @ through_air, nose @ through_air)
            assert angle == pytest.approx((lifts[i] - 0.25) / 5.0, abs=1e-12)


def test_wings_turn_from_green_to_red_towards_the_stall():
    run = aircraft_run(0.1)
    state = np.concatenate([[0.1, 0.7, 1.05, 0.3], np.zeros(8), [30.0, 30.0, 30.0, 8.3]])
    screen = shown(run.scenario, instant(run, aircraft_state=state))
    found = [screen.colours[f"/nonstop/carriers/{i}/wing"][:3] for i in range(4)]
    np.testing.assert_allclose(found, [*map(rgb, (GREEN, GREEN, YELLOW, RED))], atol=1e-12)
    assert not [path for path in screen.colours if path.endswith("mark")]
