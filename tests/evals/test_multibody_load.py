"""Drake's own rigid body in the place of ours, along every scenario."""

import numpy as np
import pytest
from helpers import fix, model
from scipy.spatial.transform import Rotation

from drake_nonstop.blocks.load_plant import LoadPlant, MultibodyLoadPlant
from drake_nonstop.run.simulate import simulate
from drake_nonstop.scenario.loading import load_scenario, scenario_names
from drake_nonstop.scenario.overrides import changed


@pytest.mark.nightly("engines")
@pytest.mark.parametrize("name", scenario_names())
def test_both_plants_agree(name):
    scenario = load_scenario(name)
    start = getattr(scenario.load_trajectory, "start_time", 0.0)
    overrides = [f"simulation_duration={min(start, 4.0) + 3.0}"]  # all that move do by then
    size = scenario.system.load_inertia[0][0]
    inertia = size * np.array([[1.2, 0.1, 0.0], [0.1, 1.0, 0.2], [0.0, 0.2, 1.5]])
    overrides += [f"simulated.load_inertia={inertia.tolist()}"]
    overrides += [f"simulated.load_angular_drag={size}"]
    if name == "static_hold_open_loop":  # which rests where nothing pushes it
        overrides += ["load_disturbance=!DisturbanceForce {force: [0.1, 0.05, 0.0]}"]
    scenario = changed(scenario, overrides)
    ours, drakes = (
        simulate(
            load_scenario(name, [*overrides, f"load_plant=!{plant} {{}}"]),
        ).signal("load_state")
        for plant in ("LoadPlant", "MultibodyLoadPlant")
    )
    assert np.abs(ours[:, 4:7] - drakes[:, 4:7]).max() < 1e-10
    a, b = (
        states[:, :4] / np.linalg.norm(states[:, :4], axis=1)[:, None] for states in (ours, drakes)
    )
    angles = 2 * np.linalg.norm(a * np.sign((a * b).sum(1))[:, None] - b, axis=1)
    assert angles.max() < 1e-10
    assert np.ptp(ours, axis=0).max() > 1e-4  # something happened


def test_both_plants_agree_on_a_load_that_tumbles():
    """Random poses, twists, forces and inertias, where gyroscopic terms weigh."""
    rng = np.random.default_rng(1)
    for n in (3, 4, 6):
        spin = Rotation.random(random_state=n).as_matrix()
        inertia = spin @ np.diag([0.01, 0.03, 0.035]) @ spin.T
        fields = {"load_inertia": ((inertia + inertia.T) / 2).tolist(), "load_angular_drag": 0.02}
        plants = [plant(model(n, **fields)) for plant in (LoadPlant, MultibodyLoadPlant)]
        for _ in range(20):
            state = np.concatenate([rng.standard_normal(4), 5 * rng.standard_normal(9)])
            state[:4] /= np.linalg.norm(state[:4])
            forces, wrench = 5 * rng.standard_normal(3 * n), rng.standard_normal(6)
            wind = 5 * rng.standard_normal(3)
            rates = []
            for plant in plants:
                context = plant.CreateDefaultContext()
                context.SetContinuousState(state)
                inputs = {"cable_forces": forces, "disturbance_wrench": wrench}
                fix(plant, context, **inputs, load_wind=wind)
                rates.append(plant.EvalTimeDerivatives(context).CopyToVector())
            np.testing.assert_allclose(*rates, rtol=1e-9, atol=1e-9)
            assert np.abs(rates[0][7:10]).max() > 1.0
