"""Drake's own rigid body in the place of ours, along every scenario."""

import numpy as np
import pytest

from drake_nonstop.scenario import load_scenario, scenario_names
from drake_nonstop.simulate import simulate


@pytest.mark.parametrize("name", scenario_names())
def test_both_plants_agree(name):
    settings = [] if name in ("quintic", "line") else ["duration=3"]
    settings += ["simulated.load_inertia=[[0.012,0.001,0],[0.001,0.01,0.002],[0,0.002,0.015]]"]
    settings += ["simulated.load_angular_drag=0.01"]
    ours, drakes = (
        simulate(load_scenario(name, [*settings, f"load_plant=!{plant} {{}}"])).signal("load_state")
        for plant in ("LoadPlant", "MultibodyLoadPlant")
    )
    assert np.abs(ours[:, 4:7] - drakes[:, 4:7]).max() < 1e-10
    a, b = (
        states[:, :4] / np.linalg.norm(states[:, :4], axis=1)[:, None] for states in (ours, drakes)
    )
    angles = 2 * np.linalg.norm(a * np.sign((a * b).sum(1))[:, None] - b, axis=1)
    assert angles.max() < 1e-10
    assert np.ptp(ours, axis=0).max() > 1e-4  # something happened
