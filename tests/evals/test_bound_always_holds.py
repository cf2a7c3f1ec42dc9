"""The bound of the optimization layer holds at other rates than those of its tasks."""

import pytest
from helpers import nightly_beyond

from drake_nonstop import compute_metrics, load_scenario, simulate

CASES = [
    ("quintic", "optimization_layer.knot_spacing=0.4", 0.01),
    ("line", "optimization_layer.knot_spacing=0.2", 0.01),
    ("three_carriers", "optimization_layer.knot_spacing=0.4", 0.004),
    ("quintic", "optimization_layer=!NlpLayer {period: 0.02}", 0.01),
    ("quintic", "optimization_layer=!NlpLayer {period: 0.004}", 0.004),
]


@pytest.mark.parametrize(("name", "change", "period"), nightly_beyond(1, "flights", CASES))
def test_a_higher_bound_holds_at_any_rate(name, change, period):
    """The layers change ξ and A from 2.5 s on."""
    bound = 1.2 * load_scenario(name).optimization_layer.speed_bound
    changes = [f"control_period={period}", "simulation_duration=7", change]
    layer = f"optimization_layer.speed_bound={bound}"
    metrics = compute_metrics(simulate(load_scenario(name, [*changes, layer])))
    assert metrics["carriers"]["time_below_bound_s"] == 0
    assert metrics["carriers"]["speed_min_m_s"] >= bound
    optimizer = metrics["optimizer"]
    assert optimizer["updates"] > 0
    assert optimizer["relaxed"] == optimizer["held"] == 0
