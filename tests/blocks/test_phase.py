"""The phases."""

import numpy as np
import pytest
from helpers import fix, model, output
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from drake_nonstop.blocks.phase import AccumulatedPhase, PaperPhase

PARAMETERS = np.array([1.7, 0.9])


def test_continuous_phase_grows_with_the_frequency():
    block = AccumulatedPhase(model())
    context = block.CreateDefaultContext()
    fix(block, context, parameters=PARAMETERS)
    np.testing.assert_array_equal(output(block, context, "phase"), [0, 0])
    np.testing.assert_array_equal(block.EvalTimeDerivatives(context).CopyToVector(), [1.7, 0.0])
    context.SetContinuousState([0.6, 0.0])
    np.testing.assert_array_equal(output(block, context, "phase"), [0.6, 0])


def test_sampled_phase_steps_once_a_period():
    block = AccumulatedPhase(model(4, 0.02))
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    fix(block, context, parameters=PARAMETERS)
    simulator.Initialize()
    for time, steps in ((0.0, 0), (0.01, 0), (0.03, 1), (0.05, 2), (0.07, 3)):
        simulator.AdvanceTo(time)
        np.testing.assert_allclose(
            output(block, context, "phase"), [steps * 0.02 * 1.7, 0], rtol=1e-14
        )
    assert block.EvalTimeDerivatives(context).size() == 0


class DoublingFrequency(LeafSystem):
    """ξ = 1, 2, 4, … rad/s, doubled by a discrete update every 10 ms, as the optimizer's."""

    def __init__(self):
        super().__init__()
        index = self.DeclareDiscreteState([1.0, 1.0])
        self.DeclareStateOutputPort("parameters", index)
        self.DeclarePeriodicDiscreteUpdateEvent(0.01, 0.01, self._double)

    def _double(self, context, discrete_state):
        discrete_state.set_value(2 * context.get_discrete_state_vector().value())


@pytest.mark.parametrize("period", [0.0, 0.01])
def test_phase_is_the_integral_of_a_changing_frequency(period):
    builder = DiagramBuilder()
    source = builder.AddSystem(DoublingFrequency())
    phase = builder.AddSystem(AccumulatedPhase(model(4, period)))
    builder.Connect(source.get_output_port(), phase.get_input_port())
    builder.ExportOutput(phase.get_output_port(), "phase")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.04 - 1e-9)
    simulator.AdvanceTo(0.04 + 1e-9)
    angle = output(diagram, simulator.get_context(), "phase")[0]
    assert angle == pytest.approx(0.01 * (1 + 2 + 4 + 8), abs=1e-7)


def test_phase_of_the_paper_jumps_with_the_frequency():
    block = PaperPhase(model())
    context = block.CreateDefaultContext()
    context.SetTime(3.0)
    for frequency in (1.7, 2.7):
        fix(block, context, parameters=np.array([frequency, 1.0]))
        np.testing.assert_allclose(output(block, context, "phase"), [3 * frequency, 3], rtol=1e-15)


def test_sampled_phase_of_the_paper_is_constant_between_samples():
    block = PaperPhase(model(4, 0.01))
    context = block.CreateDefaultContext()
    fix(block, context, parameters=PARAMETERS, sample_time=np.array([2.0]))
    context.SetTime(2.009)
    np.testing.assert_allclose(output(block, context, "phase"), [3.4, 2], rtol=1e-15)
