"""The load plants in closed form; evals/test_multibody_load.py holds them against each other."""

import numpy as np
import pytest
from helpers import fix, model, nightly_beyond, output
from pydrake.systems.analysis import Simulator

from drake_nonstop.blocks.load_plant import LoadPlant, MultibodyLoadPlant


@pytest.mark.parametrize("plant", nightly_beyond(1, "engines", [LoadPlant, MultibodyLoadPlant]))
def test_a_spinning_load_falls_as_both_drags_and_a_constant_wrench_let_it(plant):
    inertia = np.diag([0.01] * 3).tolist()
    block = plant(model(load_drag=0.7, load_angular_drag=0.02, load_inertia=inertia))
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    inputs = {"cable_forces": np.zeros(12), "disturbance_wrench": np.array([0, 0, 0.03, 0, 0, 0.5])}
    fix(block, context, **inputs, load_wind=np.zeros(3))
    context.SetContinuousState([1, *[0.0] * 8, 3.0, 0, 0, 0])
    simulator.get_mutable_integrator().set_target_accuracy(1e-10)
    simulator.AdvanceTo(2.0)
    velocity = -9.31 / 0.7 * (1 - np.exp(-0.7 * 2.0))  # m = 1 kg
    angle = 1.5 * 2 + 1.5 * 0.01 / 0.02 * (1 - np.exp(-2.0 * 2))  # it tends to 1.5 rad/s
    expected = [np.cos(angle / 2), 0, 0, np.sin(angle / 2), 0, 0, -(9.31 * 2 + velocity) / 0.7]
    expected += [0, 0, 1.5 + 1.5 * np.exp(-2.0 * 2), 0, 0, velocity]
    np.testing.assert_allclose(output(block, context, "load_state"), expected, rtol=0, atol=1e-6)
