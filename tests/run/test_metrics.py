"""The metrics: each row of the table, and runs made up so that figures are known."""

import itertools
import json

import numpy as np
import pytest
from aircraft_runs import FREQUENCY, aircraft_run, made_up
from pydrake.math import RollPitchYaw, RotationMatrix

from drake_nonstop import changed, compute_metrics, load_scenario
from drake_nonstop.mechanics.rounded_box import nearest_to
from drake_nonstop.mechanics.signals import AircraftState
from drake_nonstop.run.metrics import METRICS, metrics_table
from drake_nonstop.run.run_quantities import RunQuantities

TURN = 2 * np.pi / FREQUENCY
DIAGNOSTICS = [1, 7, 4, 1, 1, 1, 0.2]


def flown(time, positions, velocities, load=(0.003, 0.0, 0.0)):
    """A run of four carriers (k, 4, 3) above a level load, whose reference rests at the origin."""
    count = len(time)
    state, diagnostics = np.tile(np.eye(13)[0], (count, 1)), np.zeros((count, 7))
    state[:, 4:7], diagnostics[-1] = load, DIAGNOSTICS
    return made_up(
        load_scenario("quintic"),
        time,
        (positions, velocities),
        state,
        np.tile(np.eye(22)[0], (count, 1)),
        signals={"optimization_layer.parameters": np.tile([2.0, 1.3], (count, 1))},
        steps={"tensions": np.full((count, 4), 2.5), "diagnostics": diagnostics},
        solve_times=np.array([1e-3, 2e-3, 3e-3]),
        wall_time=0.5,
    )


def circling_run(*, radius=0.5, rate=2.0):
    """Level circles above the corners of a resting load."""
    time = np.linspace(0, 4, 4001)
    angle = rate * time[:, None]
    ring = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle + 1.6], axis=2)
    swing = radius * rate * np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=2)
    positions = np.array(load_scenario("quintic").system.attachments) + ring
    return flown(time, positions, np.broadcast_to(swing, positions.shape))


def everything():
    """A run of aircraft on cables with nodes, beside an obstacle: it has all that is measured."""
    run = aircraft_run(TURN, velocity=(0.75, 1.0, 0.0))
    carriers = run.signal("carrier_state")[:, :12].reshape(-1, 4, 3)
    nodes = carriers - [0, 0, 75.0]
    run.signals["cables.cable_state"] = np.tile(nodes.reshape(len(nodes), -1), (1, 2))
    run.scenario = changed(run.scenario, ["obstacles=[!Ground {height: -5}]"])
    run.scenario.reference_governor = {}
    diagnostics = np.zeros((len(run.time), 7))
    diagnostics[-1] = DIAGNOSTICS
    run.steps["diagnostics"], run.solve_times = diagnostics, np.array([1e-3, 2e-3, 3e-3])
    return run


@pytest.fixture(scope="module")
def of_everything():
    return compute_metrics(everything())


@pytest.mark.parametrize("metric", METRICS, ids=lambda metric: metric.path)
def test_each_metric_is_stored_and_shown_where_its_row_says(metric, of_everything):
    value = metric.value(of_everything)
    assert value is not None
    assert isinstance(value, (str, list)) or np.isfinite(value)
    assert [each.path for each in METRICS].count(metric.path) == 1
    assert [each.heading for each in METRICS].count(metric.heading) == 1
    lines = [line for line in metrics_table(of_everything).splitlines() if metric.line]
    if value != []:
        text = metric.text.format(
            value[0] if isinstance(value, list) else metric.shown(value), unit=metric.unit
        )
        is_shown = any(line.startswith(metric.line) and text.lstrip(", ") in line for line in lines)
        assert is_shown == (metric.line != "")


def test_what_a_run_does_not_have_is_left_out():
    metrics = compute_metrics(circling_run())
    assert not {"aircraft", "bowed_cables", "obstacles"} & {*metrics}
    assert metrics["load"]["reference_delay_max_s"] is None
    json.dumps(metrics, allow_nan=False)
    run = circling_run()
    run.steps["diagnostics"][-1, 1:] = 0
    assert "optimizer" not in metrics_table(compute_metrics(run))


def test_level_circles_have_known_figures():
    metrics = compute_metrics(circling_run(radius=0.5, rate=2.0))
    carriers = metrics["carriers"]
    assert carriers["n"] == 4
    assert carriers["speed_min_m_s"] == pytest.approx(1.0, abs=1e-12)
    assert carriers["speed_max_m_s"] == pytest.approx(1.0, abs=1e-12)
    assert carriers["separation_min_m"] == pytest.approx(1.5, abs=1e-12)
    assert carriers["acceleration_max_m_s2"] == pytest.approx(2.0, rel=2e-3)
    assert carriers["time_below_bound_s"] == 0
    assert metrics["load"]["position_error_mean_m"] == pytest.approx(0.003)
    assert metrics["real_time_factor"] == pytest.approx(8.0)
    assert metrics["optimizer"]["solve_time_ms"]["p50"] == pytest.approx(2.0)
    assert [metrics["optimizer"][name] for name in ("updates", "kept", "held")] == [7, 4, 1]


def test_times_below_the_bound_and_slack_are_those_of_any_carrier_or_cable():
    run = circling_run(radius=0.25, rate=2.0)  # 0.5 m/s, under the bound of 0.55
    assert compute_metrics(run)["carriers"]["time_below_bound_s"] == pytest.approx(4.0)
    time = run.steps["time"]
    run.steps["tensions"][0, 2] = 0
    slack_time = compute_metrics(run)["cables"]["slack_time_s"]
    assert slack_time == pytest.approx(time[1] / 2)  # of a step half of both intervals
    run.steps["carrier_state"][time > 1.0, 12:] *= 2
    run.steps["tensions"][(time > 1) & (time < 1.5), 2] = 0
    metrics = compute_metrics(run)
    assert metrics["carriers"]["time_below_bound_s"] == pytest.approx(1.0, abs=2e-3)
    assert metrics["cables"]["slack_time_s"] == pytest.approx(0.5, abs=3e-3)
    assert metrics["cables"]["tension_min_N"] == 0


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("yaw", [0.0, -0.4, 3.0])
@pytest.mark.parametrize("tilt", [0.0, 1e-9, 1e-4, 1.2])
def test_errors_are_the_angles_of_an_orientation_and_of_its_two_turns(tilt, yaw, sign):
    run = circling_run()
    turn = RollPitchYaw(0.0, tilt, 0.0).ToRotationMatrix() @ RotationMatrix.MakeZRotation(yaw)
    run.signal("load_state")[:, :4] = sign * turn.ToQuaternion().wxyz()
    load = compute_metrics(run)["load"]
    found = load["tilt_error_max_rad"], load["yaw_error_max_rad"]
    assert found == pytest.approx((tilt, abs(yaw)), abs=1e-9)
    if 0 in (tilt, yaw):
        expected = pytest.approx(max(tilt, abs(yaw)), rel=1e-9)
        assert load["orientation_error_max_rad"] == expected


@pytest.mark.parametrize("step", [0.004, 0.01, 0.03])
def test_extremes_between_two_steps_are_found(step, rng):
    """Carriers that stop, and meet, at instants that no step ends at; known in closed form."""
    time = np.sort(np.concatenate([np.arange(0, 1, step), rng.uniform(0, 1, 20), [0.5]]))
    t = time[:, None] - 0.5004  # no step's end
    start, acceleration = np.array([0.02, 0.0, 0.01]), np.array([0.0, 3.0, 1.0])
    path = t * [1.0, 2.0, 0.0]
    apart = path, np.array([0, 0, 0.004]) - path, path + 5.6, path + 6.6  # 4 mm, where two meet
    velocities = np.repeat((start + t * acceleration)[:, None], 4, axis=1)
    carriers = compute_metrics(flown(time, np.stack(apart, axis=1), velocities))["carriers"]
    place = -start @ acceleration / (acceleration @ acceleration)
    slowest = np.linalg.norm(start + place * acceleration)
    assert carriers["speed_min_m_s"] == pytest.approx(slowest, rel=1e-6)
    assert carriers["separation_min_m"] == pytest.approx(0.004, rel=1e-9)


def test_an_orbit_of_aircraft_has_the_published_figures():
    """150 m cables, 10 kg, four aircraft of 6 kg: as an independent prototype found them."""
    metrics = compute_metrics(aircraft_run(TURN))
    aircraft = metrics["aircraft"]
    assert aircraft["lift_share_max"] == pytest.approx(0.56, abs=0.005)
    assert aircraft["airspeed_min_m_s"] == pytest.approx(13.6, abs=0.05)
    assert aircraft["airspeed_over_stall_min"] == pytest.approx(13.6 / 8.4, abs=0.02)
    assert np.degrees(aircraft["bank_max_rad"]) == pytest.approx(33, abs=0.5)
    assert aircraft["thrust_min_N"] == pytest.approx(4.5, abs=0.25)  # its cables stretch
    assert aircraft["thrust_max_N"] == pytest.approx(23, abs=0.5)
    assert aircraft["power_mean_W"] == pytest.approx(225, abs=1)
    assert aircraft["energy_Wh_per_kg_km"] is None  # nothing is moved
    assert aircraft["saturated_share"] == 0
    assert metrics["carriers"]["separation_min_m"] == pytest.approx(20.7, abs=0.15)


def test_the_energy_is_that_of_all_batteries_per_mass_and_distance():
    moving = compute_metrics(aircraft_run(TURN, velocity=(0.75, 1.0, 0.0)))["aircraft"]
    per_kg_m = 4 * moving["power_mean_W"] / (0.65 * 10 * 1.25)  # J, of the battery
    assert moving["energy_Wh_per_kg_km"] == pytest.approx(1e3 * per_kg_m / 3600, rel=1e-12)
    assert moving["energy_Wh_per_kg_km"] == pytest.approx(30, abs=2)  # published
    run = aircraft_run(TURN, velocity=(0.75, 1.0, 0.0))
    rests, thrust = run.time > TURN / 2, AircraftState.view(run.signal("aircraft_state")).thrust
    run.signal("reference")[rests, 10:13] = 0
    thrust[rests] = 1e3  # does not count
    half = compute_metrics(run)["aircraft"]["energy_Wh_per_kg_km"]
    assert half == pytest.approx(moving["energy_Wh_per_kg_km"], rel=0.02)
    thrust[:] = -5.0  # a windmilling propeller gives no power back
    assert compute_metrics(run)["aircraft"]["power_mean_W"] == 0


def flown_past(obstacle, load, carriers):
    """A run of 7 steps in 3 s."""
    run = flown(np.linspace(0, 3, 7), carriers, 0 * carriers, load)
    run.scenario = changed(run.scenario, [f"obstacles=[{obstacle}]"])
    return run


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["Sphere", "Box", "Ground"])
def test_no_body_is_nearer_to_an_obstacle_at_any_of_many_instants(kind, seed):
    rng = np.random.default_rng(seed)
    far = 6 * (seed % 2)  # for one of them, no contact
    place = (far + rng.uniform(-1, 1, 3)).tolist()
    where = f"height: {-2 - far}" if kind == "Ground" else f"position: {place}"
    paths = [rng.normal(size=(7, 3)), *(2 * rng.normal(size=(2, 7, 4, 3)))]
    run = flown_past(f"!{kind} {{{where}}}", *paths[:2])
    times = np.linspace(0, 3, 3001)
    load, carriers, nodes = (
        np.stack([np.interp(times, run.time, c) for c in path.reshape(7, -1).T], axis=1)
        for path in paths
    )
    frame = load[:, None] + np.vstack([run.scenario.system.attachments, np.zeros(3)])
    points = [frame[:, :4], carriers.reshape(-1, 4, 3)]  # of cables
    if seed > 0:  # cables with a node
        run.signals["cables.cable_state"] = np.hstack(2 * [paths[2].reshape(7, -1)])
        points.insert(1, nodes.reshape(-1, 4, 3))
    bodies = {
        "load": frame[:, np.transpose(np.triu_indices(5, 1))],
        "cable": np.concatenate(
            [np.stack(pair, axis=2) for pair in itertools.pairwise(points)], axis=1
        ),
        "carrier": np.stack([points[-1], points[-1]], axis=2),
    }
    approaches = {each.kind: each for each in RunQuantities(run).approaches}
    assert approaches.keys() == bodies.keys()
    for name, segments in bodies.items():
        found = approaches[name]
        distances = nearest_to(run.scenario.obstacles[0].shape(), segments)[0].min(axis=1)
        least = distances.min()
        assert least - 0.01 < found.distance < max(least, 0.0) + 1e-3
        if least > 0.01:
            assert distances[np.argmin(np.abs(times - found.time))] < least + 0.02


def test_the_first_contact_and_the_body_are_told_also_between_two_steps():
    carriers = np.full((7, 4, 3), 9.0)
    carriers[:, 1] = 0.0
    carriers[:, 1, 0] = [-5, -3, -1, 1.02, 3, 5, 7]
    wall = "!Box {name: wall, size: [0.01, 9, 9]}"
    run = flown_past(wall, [99.0, 0, 0], carriers)
    found = RunQuantities(run).approaches
    (hit,) = (each for each in found if each.kind == "carrier")
    assert hit.distance < 0
    assert hit.time == pytest.approx(1.0 + 0.5 / 2.02, abs=5e-3)
    assert hit.body in hit.sentence
    assert (hit.body, hit.obstacle, found[-1].kind) == ("carrier 2", "wall", "load")
