"""The constraints that are off by default, kept by whole runs."""

import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop import Run, Scenario, compute_metrics, load_scenario
from drake_nonstop.simulation.run import StepCheck
from drake_nonstop.simulation.simulate import simulate

ONE_SAMPLE = [  # the layer that looks one sample ahead, with what reads its ξ and A
    "optimization_layer=NonstopOptimizer",
    "optimization_layer.tightening=0.01",
    "phase=AccumulatedPhase",
    "internal_force=InternalForceTrajectory",
]


def octagon(**fields: float) -> Scenario:
    """A load on the corners of an octagon of radius 1 m, whose carriers would meet."""
    scenario = load_scenario("quintic", ONE_SAMPLE)
    scenario.simulation_duration = 8.0
    angles = 2 * np.pi * np.arange(8) / 8
    corners = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(8)])
    scenario.system.attachments = corners.tolist()
    scenario.pattern.phases = [0.0, np.pi / 2] * 4
    scenario.optimization_layer.speed_bound = 0.3
    return with_fields(scenario, **fields)


def with_fields(scenario: Scenario, **fields: float) -> Scenario:
    for name, value in fields.items():
        setattr(scenario.optimization_layer, name, value)
    return scenario


def quintic(duration: float, **fields: float) -> Scenario:
    """Up to s at which the limits matter; the load moves until 9 s."""
    return with_fields(load_scenario("quintic", [f"simulation_duration={duration}"]), **fields)


def flown(scenario: Scenario) -> Run:
    return simulate(scenario, check_step=StepCheck.NOTHING)


def metrics_of(scenario: Scenario) -> dict:
    return kept(compute_metrics(flown(scenario)))


def kept(metrics: dict) -> dict:
    """The metrics of a run in which every update of the optimization succeeded."""
    assert metrics["carriers"]["time_below_bound_s"] == 0
    assert metrics["optimizer"]["relaxed"] == metrics["optimizer"]["held"] == 0
    return metrics


@pytest.mark.nightly("flights")
def test_min_separation_keeps_the_carriers_of_an_octagon_apart():
    assert metrics_of(octagon())["carriers"]["separation_min_m"] < 0.05
    apart = metrics_of(octagon(min_separation=0.15))
    assert apart["carriers"]["separation_min_m"] >= 0.15


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


@pytest.mark.parametrize("layer", nightly_beyond(1, "flights", ["horizon", "one sample"]))
def test_rates_of_the_parameters_stay_within_their_limits(layer):
    overrides = ONE_SAMPLE if layer == "one sample" else ["simulation_duration=5"]
    limits = {"max_frequency_rate": 1.0, "max_amplitude_rate": 0.2}
    scenario = with_fields(load_scenario("quintic", overrides), **limits)
    run = flown(scenario)
    parameters, largest = run.signal("parameters"), np.array(list(limits.values()))
    steps = np.abs(np.diff(parameters, axis=0))
    assert np.any(steps > 0)
    if layer == "one sample":
        # By rounding, an interval of the log may hold two updates or none.
        updates = np.diff(run.signal("diagnostics")[:, 1:2], axis=0)
        assert np.all(steps <= 0.01 * updates * largest * (1 + 1e-9))
    else:
        assert np.all(np.abs(run.signal("plan")[:, 3:5]) <= largest * (1 + 1e-6))
        # So may it hold two samples.
        assert np.all(np.abs(parameters[2:] - parameters[:-2]) <= 0.03 * largest * (1 + 1e-6))
    assert compute_metrics(run)["carriers"]["time_below_bound_s"] == 0


@pytest.mark.nightly("flights")
def test_anchor_brings_the_parameters_back_without_breaking_the_bound():
    scenario = load_scenario("quintic", ONE_SAMPLE)
    layer = scenario.optimization_layer
    nominal = np.array([layer.frequency, layer.amplitude])
    free = flown(scenario).signal("parameters")[-1]
    anchored = flown(with_fields(scenario, anchor_weight=0.05))
    metrics = compute_metrics(anchored)
    assert metrics["carriers"]["time_below_bound_s"] == 0
    left = np.abs(anchored.signal("parameters")[-1] - nominal)
    assert np.max(left) < np.max(np.abs(free - nominal)) / 4
