"""The constraints that are off by default, kept by whole runs."""

import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop import compute_metrics, load_scenario, simulate


def metrics_of(changes):
    """The metrics of a run in which every update of the optimization succeeded."""
    metrics = compute_metrics(simulate(load_scenario("quintic", changes)))
    assert metrics["carriers"]["time_below_bound_s"] == 0
    assert metrics["optimizer"]["relaxed"] == metrics["optimizer"]["held"] == 0
    return metrics


# A limit, its metric, the time until which the load moves, and the bound on the speeds.
LIMITS = [
    ("max_speed", 0.95, "carriers", "speed_max_m_s", 5, 0.25),
    ("min_tension", 2.6, "cables", "tension_min_N", 8, 0.55),
    ("max_tension", 2.85, "cables", "tension_max_N", 15, 0.55),
]


@pytest.mark.parametrize(
    ("limit", "value", "part", "metric", "duration", "bound"), nightly_beyond(2, "flights", LIMITS)
)
def test_a_limit_is_kept_that_is_missed_without_it(limit, value, part, metric, duration, bound):
    changes = [f"simulation_duration={duration}", f"optimization_layer.speed_bound={bound}"]
    limited = [*changes, f"optimization_layer.{limit}={value}"]
    free, kept = (metrics_of(each)[part][metric] for each in (changes, limited))
    sign = 1 if "max" in limit else -1
    assert sign * free > sign * value + 0.03
    assert sign * kept <= sign * value


def test_rates_of_the_parameters_stay_within_their_limits():
    limits = {"max_frequency_rate": 1.0, "max_amplitude_rate": 0.2}
    changes = [f"optimization_layer.{name}={value}" for name, value in limits.items()]
    run = simulate(load_scenario("quintic", ["simulation_duration=5", *changes]))
    parameters, largest = run.signal("parameters"), np.array(list(limits.values()))
    assert np.any(np.abs(np.diff(parameters, axis=0)) > 0)
    assert np.all(np.abs(run.signal("plan")[:, 3:5]) <= largest * (1 + 1e-6))
    # By rounding, an interval of the log may hold two samples or none.
    assert np.all(np.abs(parameters[2:] - parameters[:-2]) <= 0.03 * largest * (1 + 1e-6))
    assert compute_metrics(run)["carriers"]["time_below_bound_s"] == 0
