"""Drake's own rigid body in the place of ours, along every scenario."""

import numpy as np
import pytest
from helpers import nightly_beyond
from scipy.spatial.transform import Rotation

from drake_nonstop import changed, load_scenario, scenario_names, simulate

NAMES = ["three_carriers", *(name for name in scenario_names() if name != "three_carriers")]


@pytest.mark.parametrize("name", nightly_beyond(1, "engines", NAMES))
def test_both_plants_agree(name):
    scenario = load_scenario(name)
    start = getattr(scenario.load_trajectory, "start_time", 0.0)
    size = scenario.system.load_inertia[0][0]
    inertia = size * np.array([[1.2, 0.1, 0.0], [0.1, 1.0, 0.2], [0.0, 0.2, 1.5]])
    overrides = [
        f"simulation_duration={min(start, 4.0) + 3.0}",  # all that move do by then
        f"simulated.load_inertia={inertia.tolist()}",
        f"simulated.load_angular_drag={size}",
    ]
    if name == "static_hold_open_loop":  # which rests where nothing pushes it
        overrides += ["load_disturbance=!DisturbanceForce {force: [0.1, 0.05, 0.0]}"]
    plants = [f"load_plant=!{plant} {{}}" for plant in ("LoadPlant", "MultibodyLoadPlant")]
    ours, drakes = (
        simulate(changed(scenario, [*overrides, plant])).signal("load_state") for plant in plants
    )
    assert np.abs(ours[:, 4:7] - drakes[:, 4:7]).max() < 1e-10
    turns = [Rotation.from_quat(states[:, [1, 2, 3, 0]]) for states in (ours, drakes)]
    assert (turns[0].inv() * turns[1]).magnitude().max() < 1e-10
    assert np.ptp(ours, axis=0).max() > 1e-4  # something happened
