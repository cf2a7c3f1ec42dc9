"""The metrics, on runs made up so that each figure is known."""

import numpy as np
import pytest

from drake_nonstop import load_scenario
from drake_nonstop.run import run_quantities
from drake_nonstop.run.metrics import compute_metrics, flattened, metrics_table
from drake_nonstop.run.run import Run
from drake_nonstop.run.run_quantities import load_errors


def circling_run(*, radius=0.5, rate=2.0, tensions=None):
    """Four carriers on level circles above the corners of a resting, level load."""
    scenario = load_scenario("quintic")
    time = np.linspace(0, 4, 4001)
    corners = np.array(scenario.system.attachments)
    angle = rate * time[:, None]
    ring = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle + 1.6], axis=2)
    swing = radius * rate * np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=2)
    positions = corners + ring
    velocities = np.broadcast_to(swing, positions.shape)
    carriers = np.concatenate(
        [positions.reshape(len(time), -1), velocities.reshape(len(time), -1)], axis=1
    )
    load = np.zeros((len(time), 13))
    load[:, 0] = 1
    load[:, 4] = 0.003
    reference = np.zeros((len(time), 22))
    reference[:, 0] = 1
    diagnostics = np.zeros((len(time), 7))
    diagnostics[-1] = [1, 7, 4, 1, 1, 1, 0.2]
    return Run(
        scenario=scenario,
        diagram=None,
        time=time,
        signals={
            "load_plant.load_state": load,
            "load_trajectory.reference": reference,
            "carrier_dynamics.carrier_state": carriers,
            "optimization_layer.parameters": np.tile([2.0, 1.3], (len(time), 1)),
        },
        steps={
            "time": time,
            "load_state": load,
            "carrier_state": carriers,
            "tensions": np.full((len(time), 4), 2.5) if tensions is None else tensions(time),
            "diagnostics": diagnostics,
        },
        solve_times=np.array([1e-3, 2e-3, 3e-3]),
        wall_time=0.5,
    )


def test_the_table_of_a_run():
    run = circling_run(radius=0.5, rate=2.0)
    assert metrics_table(compute_metrics(run)).splitlines() == [
        "outcome                 ok",
        "simulated               4 s in 0.50 s (8.0 x real time)",
        "engine                  diagram",
        "load position error     mean 3 mm, max 3 mm",
        "load orientation error  mean 0 mrad, max 0 mrad",
        "carrier speed           1.000 to 1.000 m/s, bound 0.55 m/s, below it for 0 s",
        "closest                 carriers 1.500 m, cables 1.270 m",
        "tension                 2.5 to 2.5 N, slack for 0 s",
        "optimizer               7 updates: 4 kept xi and A, 1 solved, 1 relaxed (not feasible), "
        "1 held (no solution)",
    ]
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
    assert metrics["optimizer"]["held"] == 1


def test_time_below_the_bound_is_the_time_that_any_carrier_is_slow():
    run = circling_run(radius=0.25, rate=2.0)  # 0.5 m/s, under the bound of 0.55
    assert compute_metrics(run)["carriers"]["time_below_bound_s"] == pytest.approx(4.0)
    slow = run.steps["carrier_state"]
    slow[run.steps["time"] > 1.0, 12:] *= 2
    assert compute_metrics(run)["carriers"]["time_below_bound_s"] == pytest.approx(1.0, abs=2e-3)


def test_slack_time_counts_any_slack_cable():
    def tensions(time):
        values = np.full((len(time), 4), 2.5)
        values[(time > 1) & (time < 1.5), 2] = 0
        return values

    metrics = compute_metrics(circling_run(tensions=tensions))
    assert metrics["cables"]["slack_time_s"] == pytest.approx(0.5, abs=3e-3)
    assert metrics["cables"]["tension_min_N"] == 0


def test_orientation_error_is_the_angle_even_when_small_or_the_quaternion_flips_sign():
    run = circling_run()
    for angle in (1e-9, 1e-4, 0.3, 3.0):
        for sign in (1, -1):
            run.signals["load_plant.load_state"][:, :4] = sign * np.array(
                [np.cos(angle / 2), 0, np.sin(angle / 2), 0]
            )
            _, error = load_errors(run)
            np.testing.assert_allclose(error[0], [0, angle, 0], rtol=1e-9, atol=1e-16)


@pytest.mark.parametrize("chunk", [50, 1000])
def test_metrics_do_not_depend_on_how_many_steps_are_computed_at_a_time(chunk, monkeypatch):
    run = circling_run()
    rng = np.random.default_rng(chunk)
    for signals in (run.signals, run.steps):
        for name, values in signals.items():
            if name != "time" and "diagnostics" not in name:
                values += 0.1 * rng.normal(size=values.shape)
    whole = flattened(compute_metrics(run))
    monkeypatch.setattr(run_quantities, "_CHUNK", chunk)
    parts = flattened(compute_metrics(run))
    assert parts.keys() == whole.keys()
    for name, value in whole.items():
        expected = pytest.approx(value, rel=1e-12) if isinstance(value, float) else value
        assert parts[name] == expected, name


@pytest.mark.parametrize("step", [0.004, 0.01, 0.03])
def test_extremes_between_two_steps_are_found(step):
    """Carriers that stop, and meet, at instants that no step ends at; known in closed form."""
    rng = np.random.default_rng(3)
    run = circling_run()
    time = np.sort(np.concatenate([np.arange(0, 1, step), rng.uniform(0, 1, 20), [0.5]]))
    t = time - 0.5004  # no step's end
    start, acceleration = np.array([0.02, 0.0, 0.01]), np.array([0.0, 3.0, 1.0])
    velocities = start + t[:, None] * acceleration
    positions = [0.3 * i + t[:, None] * [1.0, 2.0, 0.0] * (-1) ** i for i in range(3)]
    positions = [position + 5.0 * (i == 2) for i, position in enumerate(positions)]
    positions[1] = positions[1] - 0.3 + np.array([0, 0, 0.004])  # passes the first 4 mm above it
    carriers = np.concatenate([*positions, positions[2] + 1, *[velocities] * 4], axis=1)
    run.steps |= {
        "time": time,
        "carrier_state": carriers,
        "load_state": np.eye(13)[[0] * len(time)],
    }
    run.steps["tensions"] = np.full((len(time), 4), 2.5)
    run.steps["diagnostics"] = np.zeros((len(time), 7))
    carriers = compute_metrics(run)["carriers"]
    place = -start @ acceleration / (acceleration @ acceleration)
    slowest = np.linalg.norm(start + place * acceleration)
    assert carriers["speed_min_m_s"] == pytest.approx(slowest, rel=1e-6)
    assert carriers["separation_min_m"] == pytest.approx(0.004, rel=1e-9)
