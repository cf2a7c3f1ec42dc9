"""The bound of the optimization layer holds on tasks for which it was not tuned."""

import numpy as np
import pytest
from helpers import nightly_beyond

from drake_nonstop import Scenario, changed, compute_metrics, load_scenario, simulate


def assert_no_carrier_is_ever_below_its_bound(scenario: Scenario) -> None:
    metrics = compute_metrics(simulate(scenario))
    assert metrics["carriers"]["time_below_bound_s"] == 0
    assert metrics["carriers"]["speed_min_m_s"] >= scenario.optimization_layer.speed_bound
    optimizer = metrics["optimizer"]
    assert optimizer["updates"] > 0
    assert optimizer["relaxed"] == optimizer["held"] == 0


def variation(seed: int) -> Scenario:
    """One of the three tasks with another load, carriers, start, pose and reference.

    Masses within 20 %, each coordinate of the attachments within 10 %, any phase and
    heading, a tilt of up to 0.2 rad, and a move in any direction.
    """
    rng = np.random.default_rng([3, seed])
    name = ("quintic", "line", "three_carriers")[seed % 3]
    scenario = load_scenario(name, ["simulation_duration=10"])
    system, move = scenario.system, scenario.load_trajectory
    system.load_mass *= rng.uniform(0.8, 1.2)
    system.carrier_mass *= rng.uniform(0.8, 1.2)
    attachments = np.array(system.attachments)
    system.attachments = (attachments * rng.uniform(0.9, 1.1, attachments.shape)).tolist()
    start_phase = rng.uniform(0, 2 * np.pi)
    scenario.pattern.phases = [phase + start_phase for phase in scenario.pattern.phases]
    move.start_roll_pitch_yaw = [*rng.uniform(-0.2, 0.2, 2), rng.uniform(0, 2 * np.pi)]
    if name == "line":
        heading, speed = rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 0.9)
        climb = rng.uniform(-0.1, 0.1)
        move.velocity = [speed * np.cos(heading), speed * np.sin(heading), climb]
        move.start_time, move.move_time = rng.uniform(1, 3), rng.uniform(3, 5)
    else:
        move.displacement = rng.uniform(-1.5, 1.5, 3).tolist()
        move.roll_pitch_yaw = rng.uniform(-0.3, 0.3, 3).tolist()
        move.move_time = rng.uniform(6, 10)
    return scenario


@pytest.mark.nightly("flights")
@pytest.mark.parametrize("seed", range(15))
def test_bound_holds_on_variations(seed):
    assert_no_carrier_is_ever_below_its_bound(variation(seed))


@pytest.mark.nightly("flights")
def test_without_foresight_of_the_orbit_some_variations_break_the_bound():
    scenario = variation(7)
    bound = scenario.optimization_layer.speed_bound
    paper = f"optimization_layer=!PaperLayer {{speed_bound: {bound}, tightening: 0.02}}"
    carriers = compute_metrics(simulate(changed(scenario, [paper])))["carriers"]
    assert carriers["time_below_bound_s"] > 0.1


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
    assert_no_carrier_is_ever_below_its_bound(load_scenario(name, [*changes, layer]))
