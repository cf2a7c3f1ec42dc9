"""The load plants."""

import numpy as np
import pytest
from helpers import fix, model, output
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import VectorLogSink

from drake_nonstop.blocks.load_plant import LoadPlant, MultibodyLoadPlant


def test_falling_load_in_closed_form():
    block = LoadPlant(model(load_drag=0.7))
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    fix(
        block,
        context,
        cable_forces=np.zeros(12),
        disturbance_wrench=np.zeros(6),
        load_wind=np.zeros(3),
    )
    simulator.get_mutable_integrator().set_target_accuracy(1e-10)
    simulator.AdvanceTo(2.0)
    velocity = -9.81 / 0.7 * (1 - np.exp(-0.7 * 2.0))  # m = 1 kg
    expected = [1, 0, 0, 0, 0, 0, -(9.81 * 2.0 + velocity) / 0.7, 0, 0, 0, 0, 0, velocity]
    np.testing.assert_allclose(output(block, context, "load_state"), expected, rtol=0, atol=1e-7)


def test_angular_drag_brings_a_spinning_load_to_rest():
    for plant in (LoadPlant, MultibodyLoadPlant):
        block = plant(model(load_angular_drag=0.02, load_inertia=np.diag([0.01] * 3).tolist()))
        builder = DiagramBuilder()
        builder.AddSystem(block)
        sink = builder.AddSystem(VectorLogSink(13))
        builder.Connect(block.GetOutputPort("load_state"), sink.get_input_port())
        diagram = builder.Build()
        simulator = Simulator(diagram)
        context = block.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        fix(
            block,
            context,
            cable_forces=np.zeros(12),
            disturbance_wrench=np.zeros(6),
            load_wind=np.zeros(3),
        )
        context.SetContinuousState([1, *[0.0] * 6, 0, 0, 3.0, 0, 0, 0])
        simulator.AdvanceTo(0.5)
        spin = context.get_continuous_state_vector().CopyToVector()[9]
        assert spin == pytest.approx(3 * np.exp(-0.5 * 0.02 / 0.01), rel=1e-3)
