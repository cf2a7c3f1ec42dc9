"""With the better defaults: no carrier below its bound, and the load on its path."""

import numpy as np
import pytest

from drake_nonstop import compute_metrics, load_scenario
from drake_nonstop.run.simulate import simulate


@pytest.mark.parametrize("name", ["line", "quintic", "three_carriers"])
def test_no_carrier_is_ever_below_its_bound(evaluated, name):
    _, metrics = evaluated(name)
    assert metrics["carriers"]["time_below_bound_s"] == 0
    assert metrics["carriers"]["speed_min_m_s"] >= metrics["carriers"]["speed_bound_m_s"]
    optimizer = metrics["optimizer"]
    assert optimizer["solved"] > 0
    assert optimizer["relaxed"] == optimizer["held"] == 0
    assert optimizer["updates"] == optimizer["kept"] + optimizer["solved"]


@pytest.mark.parametrize("name", ["line", "quintic", "three_carriers"])
def test_the_load_stays_on_its_path_and_the_cables_taut(evaluated, name):
    _, metrics = evaluated(name)
    assert metrics["load"]["position_error_mean_m"] <= 0.0005
    assert metrics["cables"]["slack_time_s"] == 0
    assert metrics["cables"]["tension_min_N"] > 0


def test_without_optimization_the_same_task_would_stop_the_carriers(evaluated):
    _, metrics = evaluated("line_without_optimization")
    assert metrics["carriers"]["speed_min_m_s"] < 0.05
    assert metrics["carriers"]["time_below_bound_s"] > 1
    assert metrics["optimizer"]["updates"] == 0


@pytest.mark.nightly("flights")
def test_the_bound_holds_between_the_steps_too():
    """The default step of 5 ms hides no dip that one of 1 ms would show."""
    scenario = load_scenario(
        "line", ["simulator_config.max_step_size=0.001", "simulation_duration=9"]
    )
    metrics = compute_metrics(simulate(scenario))
    assert metrics["optimizer"]["solved"] > 0
    assert metrics["carriers"]["time_below_bound_s"] == 0


def test_the_open_loop_method_holds_a_still_load(evaluated):
    run, metrics = evaluated("static_hold_open_loop")
    assert metrics["load"]["position_error_max_m"] < 1e-3
    f0, amplitude, frequency, length = 9.81 / 4, 1.2, 2.0, 0.8
    tension = np.hypot(amplitude, f0)
    stretched = length + tension / 500
    speed = frequency * stretched * amplitude / tension  # theory, section 3
    np.testing.assert_allclose(metrics["carriers"]["speed_final_m_s"], speed, rtol=2e-3)
    np.testing.assert_allclose(run.steps["tensions"][-1], tension, rtol=2e-3)


def test_the_better_defaults_track_far_better_than_the_print(evaluated):
    _, better = evaluated("quintic")
    _, printed = evaluated("paper_quintic")
    ratio = printed["load"]["position_error_mean_m"] / better["load"]["position_error_mean_m"]
    assert ratio > 20
