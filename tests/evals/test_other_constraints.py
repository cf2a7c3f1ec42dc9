"""The constraints that are off by default, kept by whole runs."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drake_nonstop import (
    NlpLayer,
    NlpLayerConfig,
    Run,
    Scenario,
    carrier_distances,
    compute_metrics,
    load_scenario,
)
from drake_nonstop.run.simulate import simulate


@dataclass(kw_only=True)
class ApartConfig(NlpLayerConfig):
    least_distance: float = 0.8  # m


class Apart(NlpLayer):
    """Keeps carriers apart along the orbit, too."""

    def constraints(self, x: NDArray, now: Any) -> NDArray:
        distances = carrier_distances(*self.prediction(x, now))
        apart = distances - 1.02 * self.config.least_distance
        return np.concatenate([super().constraints(x, now).ravel(), apart.ravel()])


def with_fields(scenario: Scenario, **fields: float) -> Scenario:
    for name, value in fields.items():
        setattr(scenario.optimization_layer, name, value)
    return scenario


def quintic(duration: float, **fields: float) -> Scenario:
    """Up to s at which the limits matter; the load moves until 9 s."""
    return with_fields(load_scenario("quintic", [f"simulation_duration={duration}"]), **fields)


def flown(scenario: Scenario, **blocks: Any) -> Run:
    return simulate(scenario, **blocks)


def metrics_of(scenario: Scenario, **blocks: Any) -> dict:
    return kept(compute_metrics(flown(scenario, **blocks)))


def kept(metrics: dict) -> dict:
    """The metrics of a run in which every update of the optimization succeeded."""
    assert metrics["carriers"]["time_below_bound_s"] == 0
    assert metrics["optimizer"]["relaxed"] == metrics["optimizer"]["held"] == 0
    return metrics


@pytest.mark.nightly("flights")
def test_a_constraint_on_distances_keeps_the_carriers_apart():
    scenario = load_scenario("quintic_nlp", ["simulation_duration=8"])
    assert metrics_of(scenario)["carriers"]["separation_min_m"] < 0.79
    apart = metrics_of(scenario, optimization_layer=Apart)
    assert apart["carriers"]["separation_min_m"] >= 0.8


def test_min_tension_keeps_every_cable_above_it(evaluated):
    run, free = evaluated("quintic")
    kept(free)
    assert run.steps["tensions"][run.steps["time"] <= 8].min() < 2.55
    taut = metrics_of(quintic(8.0, min_tension=2.6))
    assert taut["cables"]["tension_min_N"] >= 2.6


@pytest.mark.nightly("flights")
def test_max_tension_keeps_every_cable_below_it(evaluated):
    _, free = evaluated("quintic")
    assert kept(free)["cables"]["tension_max_N"] > 2.9
    spared = metrics_of(quintic(15.0, max_tension=2.85))
    assert spared["cables"]["tension_max_N"] <= 2.85


def test_max_speed_keeps_every_carrier_below_it():
    free = metrics_of(quintic(5.0, speed_bound=0.25))
    assert free["carriers"]["speed_max_m_s"] > 0.98
    slow = metrics_of(quintic(5.0, speed_bound=0.25, max_speed=0.95))
    assert slow["carriers"]["speed_max_m_s"] <= 0.95


def test_rates_of_the_parameters_stay_within_their_limits():
    limits = {"max_frequency_rate": 1.0, "max_amplitude_rate": 0.2}
    run = flown(quintic(5.0, **limits))
    parameters, largest = run.signal("parameters"), np.array(list(limits.values()))
    steps = np.abs(np.diff(parameters, axis=0))
    assert np.any(steps > 0)
    assert np.all(np.abs(run.signal("plan")[:, 3:5]) <= largest * (1 + 1e-6))
    # By rounding, an interval of the log may hold two samples or none.
    assert np.all(np.abs(parameters[2:] - parameters[:-2]) <= 0.03 * largest * (1 + 1e-6))
    assert compute_metrics(run)["carriers"]["time_below_bound_s"] == 0
