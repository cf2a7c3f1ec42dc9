"""Speeds that follow from the theory, and those between the steps."""

import numpy as np
import pytest

from drake_nonstop import compute_metrics, load_scenario, simulate


@pytest.mark.nightly("flights")
def test_the_bound_holds_between_the_steps_too():
    """The default step of 5 ms hides no dip that one of 1 ms would show."""
    fine = ["simulator_config.max_step_size=0.001", "simulation_duration=9"]
    metrics = compute_metrics(simulate(load_scenario("line", fine)))
    assert metrics["optimizer"]["solved"] > 0
    assert metrics["carriers"]["time_below_bound_s"] == 0


def test_the_open_loop_method_holds_a_still_load(fleet):
    run, metrics = fleet.evaluated("static_hold_open_loop")
    assert metrics["load"]["position_error_max_m"] < 1e-3
    amplitude, frequency, tension = 1.2, 2.0, np.hypot(1.2, 9.81 / 4)
    speed = frequency * (0.8 + tension / 500) * amplitude / tension  # theory, section 3
    np.testing.assert_allclose(metrics["carriers"]["speed_final_m_s"], speed, rtol=2e-3)
    np.testing.assert_allclose(run.steps["tensions"][-1], tension, rtol=2e-3)
