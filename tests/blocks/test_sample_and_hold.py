import numpy as np
import pytest
from helpers import Motion, fix, model, output
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from drake_nonstop.blocks.load_trajectory import RestToRest, RestToRestConfig
from drake_nonstop.blocks.sample_and_hold import SampleAndHold

PERIOD = 0.02
HELD = ("held_reference", "held_reference_higher_rates")


class DiscreteReader(LeafSystem):
    """Copies its input by a discrete update every period, as the optimization layer reads."""

    def __init__(self, size):
        super().__init__()
        self._input = self.DeclareVectorInputPort("input", size)
        self.DeclareStateOutputPort("read", self.DeclareDiscreteState(size))
        self.DeclareInitializationDiscreteUpdateEvent(self._read)
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, PERIOD, self._read)

    def _read(self, context, discrete_state):
        discrete_state.set_value(self._input.Eval(context))


@pytest.fixture
def loop():
    """A moving reference, sampled, and what a discrete update of the same period reads."""
    builder = DiagramBuilder()
    constants = model(4, PERIOD)
    config = RestToRestConfig(displacement=[1.0, 2.0, 3.0], move_time=1.0)
    trajectory = builder.AddSystem(RestToRest(constants, config))
    hold = builder.AddSystem(SampleAndHold(constants))
    reader = builder.AddSystem(DiscreteReader(22))
    for name in ("reference", "reference_higher_rates"):
        builder.Connect(trajectory.GetOutputPort(name), hold.GetInputPort(name))
    builder.Connect(hold.GetOutputPort("held_reference"), reader.get_input_port())
    for name in (*HELD, "held_measured_load_state", "sample_time"):
        builder.ExportOutput(hold.GetOutputPort(name), name)
    builder.ExportOutput(reader.get_output_port(), "read")
    builder.ExportInput(hold.GetInputPort("measured_load_state"), "measured_load_state")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    fix(diagram, simulator.get_mutable_context(), measured_load_state=Motion(80).state(0))
    simulator.Initialize()
    own = RestToRest(constants, config)
    context = own.CreateDefaultContext()

    def reference(time, name="reference"):
        context.SetTime(time)
        return output(own, context, name)

    return diagram, simulator, reference


def test_sample_is_held_until_the_next(loop):
    diagram, simulator, reference = loop
    context = simulator.get_context()
    for time in (0.301, 0.31, 0.319, 0.321):
        simulator.AdvanceTo(time)
        (sampled,) = output(diagram, context, "sample_time")
        assert sampled == pytest.approx(PERIOD * int(time / PERIOD), abs=1e-12)
        for name in HELD:
            expected = reference(sampled, name.removeprefix("held_"))
            np.testing.assert_array_equal(output(diagram, context, name), expected)
        assert np.max(np.abs(expected)) > 1
