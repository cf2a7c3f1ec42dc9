"""The constraints that are off by default, kept by whole runs."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from helpers import nightly_beyond
from numpy.typing import NDArray

from drake_nonstop import (
    NlpLayer,
    NlpLayerConfig,
    Scenario,
    carrier_distances,
    compute_metrics,
    load_scenario,
    simulate,
)


@dataclass(kw_only=True)
class ApartConfig(NlpLayerConfig):
    least_distance: float = 0.8  # m


class Apart(NlpLayer):
    """Keeps carriers apart along the orbit, too."""

    def constraints(self, x: NDArray, now: Any) -> NDArray:
        distances = carrier_distances(*self.prediction(x, now))
        apart = distances - 1.02 * self.config.least_distance
        return np.concatenate([super().constraints(x, now).ravel(), apart.ravel()])


def metrics_of(scenario: Scenario, **blocks: Any) -> dict:
    """The metrics of a run in which every update of the optimization succeeded."""
    metrics = compute_metrics(simulate(scenario, **blocks))
    assert metrics["carriers"]["time_below_bound_s"] == 0
    assert metrics["optimizer"]["relaxed"] == metrics["optimizer"]["held"] == 0
    return metrics


@pytest.mark.nightly("flights")
def test_a_constraint_on_distances_keeps_the_carriers_apart():
    scenario = load_scenario("quintic_nlp", ["simulation_duration=8"])
    assert metrics_of(scenario)["carriers"]["separation_min_m"] < 0.79
    apart = metrics_of(scenario, optimization_layer=Apart)
    assert apart["carriers"]["separation_min_m"] >= 0.8


@pytest.mark.parametrize(
    ("limit", "value", "part", "metric", "others"),
    nightly_beyond(
        2,
        "flights",
        [  # with the time until which the load moves
            ("max_speed", 0.95, "carriers", "speed_max_m_s", (5, "speed_bound=0.25")),
            ("min_tension", 2.6, "cables", "tension_min_N", (8, "speed_bound=0.55")),
            ("max_tension", 2.85, "cables", "tension_max_N", (15, "speed_bound=0.55")),
        ],
    ),
)
def test_a_limit_is_kept_that_is_missed_without_it(limit, value, part, metric, others):
    duration, bound = others
    changes = [f"simulation_duration={duration}", f"optimization_layer.{bound}"]
    free = metrics_of(load_scenario("quintic", changes))[part][metric]
    limited = load_scenario("quintic", [*changes, f"optimization_layer.{limit}={value}"])
    kept = metrics_of(limited)[part][metric]
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
