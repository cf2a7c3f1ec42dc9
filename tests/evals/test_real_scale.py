"""10 kg on 60 m cables below carriers of 6 kg that must not fall below 8 m/s."""

import numpy as np
import pytest
from helpers import nightly_beyond, regular

from drake_nonstop import compute_metrics, load_scenario
from drake_nonstop.run.run_quantities import load_errors
from drake_nonstop.run.simulate import simulate

RADIUS = 1.5  # m, of the circle of the attachments


def flown(n, fleet):
    """Run and metrics of the shipped scenario with n attachments, and nothing else changed."""
    if n == 4:
        return fleet.evaluated(load_scenario("real_scale_spread"))
    attachments = regular(n, RADIUS).tolist()
    run = simulate(load_scenario("real_scale_spread", [f"system.attachments={attachments}"]))
    return run, compute_metrics(run)


@pytest.mark.parametrize("n", nightly_beyond(1, "flights", [4, 3, 8]))
def test_spread_carousel_flies_any_number_of_carriers_apart(n, fleet):
    run, metrics = flown(n, fleet)
    carriers, cables = metrics["carriers"], metrics["cables"]
    assert metrics["optimizer"]["solved"] > 0
    assert metrics["optimizer"]["relaxed"] == 0
    assert carriers["n"] == n
    assert carriers["time_below_bound_s"] == 0
    assert carriers["separation_min_m"] >= 15
    spacing = 2 * RADIUS * np.sin(np.pi / n)
    assert 0.9 * spacing <= cables["separation_min_m"] <= spacing * 1.001
    assert cables["slack_time_s"] == 0
    error = np.linalg.norm(load_errors(run)[0], axis=1)
    assert np.mean(error) <= 0.05
    at_rest = (run.time <= 5) | (run.time >= 60)
    assert np.mean(error[at_rest]) <= 0.02
    assert np.linalg.norm(run.signal("load_state")[-1, 4:7] - [100, 0, 10]) <= 0.02
