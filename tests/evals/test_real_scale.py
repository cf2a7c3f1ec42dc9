"""10 kg on 60 m cables below carriers of 6 kg that must not fall below 8 m/s."""

import numpy as np
import pytest
from helpers import nightly_beyond, regular

from drake_nonstop import load_scenario
from drake_nonstop.run.run_quantities import RunQuantities

RADIUS = 1.5  # m, of the circle of the attachments


@pytest.mark.parametrize("n", nightly_beyond(1, "flights", [4, 3, 8]))
def test_spread_carousel_flies_any_number_of_carriers_apart(n, fleet):
    """The shipped scenario with n attachments, and nothing else changed."""
    attachments = f"system.attachments={regular(n, RADIUS).tolist()}"
    scenario = load_scenario("real_scale_spread", [attachments] if n != 4 else [])
    run, metrics = fleet.evaluated(scenario)
    carriers, cables = metrics["carriers"], metrics["cables"]
    assert metrics["outcome"] == "ok"
    assert metrics["optimizer"]["solved"] > 0
    assert metrics["optimizer"]["relaxed"] == 0
    assert carriers["n"] == n
    assert carriers["separation_min_m"] >= 15
    spacing = 2 * RADIUS * np.sin(np.pi / n)
    assert 0.9 * spacing <= cables["separation_min_m"] <= spacing * 1.001
    quantities = RunQuantities(run)
    error, time = quantities.position_error, run.time
    assert metrics["load"]["position_error_mean_m"] <= 0.05
    assert np.mean(error[(time <= 5) | (time >= 60)]) <= 0.02
    assert np.linalg.norm(run.signal("load_state")[-1, 4:7] - [100, 0, 10]) <= 0.02
