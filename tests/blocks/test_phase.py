"""The phases."""

import numpy as np
import pytest
from helpers import fix, model, output
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from drake_nonstop.blocks.phase import (
    AccumulatedPhase,
    PaperPhase,
    ShapedPhase,
    ShapedPhaseConfig,
)

PARAMETERS = np.array([1.7, 0.9])


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
    builder.ExportOutput(phase.GetOutputPort("phase"), "phase")
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


class Layer(LeafSystem):
    """Parameters that are set at the initialization, and again at each of some samples."""

    def __init__(self, values, period=0.01):
        super().__init__()
        self._values, self._period = values, period
        self.DeclareStateOutputPort("parameters", self.DeclareDiscreteState([7.0, 8.0]))
        self.DeclareInitializationDiscreteUpdateEvent(self._set)
        self.DeclarePeriodicDiscreteUpdateEvent(period, period, self._set)

    def _set(self, context, discrete_state):
        step = round(context.get_time() / self._period)
        discrete_state.set_value(self._values[min(step, len(self._values) - 1)])


def planned(values, *, period=0.01, times, config=None):
    """What a shape makes of a layer's parameters, just after these times: (times, 8)."""
    builder = DiagramBuilder()
    layer = builder.AddSystem(Layer(values))
    config = config or ShapedPhaseConfig(bandwidth=40.0)
    shape = builder.AddSystem(ShapedPhase(model(4, period), config))
    builder.Connect(layer.get_output_port(), shape.GetInputPort("parameters"))
    for name in ("phase", "planned"):
        builder.ExportOutput(shape.GetOutputPort(name), name)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    integrator = simulator.get_mutable_integrator()
    integrator.set_target_accuracy(1e-8)
    found = []
    for time in times:
        simulator.AdvanceTo(time)
        simulator.AdvancePendingEvents()
        found.append(output(diagram, simulator.get_context(), "planned"))
        phase = output(diagram, simulator.get_context(), "phase")
        np.testing.assert_array_equal(phase, [found[-1][0], 0.0])
    return np.array(found)


def step_response(time, bandwidth=40.0):
    """Of three equal poles, from 0 to 1: the value and three rates, and the integral."""
    x = bandwidth * time
    decay = np.exp(-x)
    value = 1 - decay * (1 + x + x**2 / 2)
    rates = [x**2 / 2, x - x**2 / 2, 1 - 2 * x + x**2 / 2]
    rates = [decay * rate * bandwidth ** (k + 1) for k, rate in enumerate(rates)]
    integral = time - (3 - decay * (3 + 2 * x + x**2 / 2)) / bandwidth
    return value, *rates, integral


def test_continuous_parameters_follow_through_three_equal_poles():
    times = 0.02 + np.array([0.013, 0.041, 0.13])
    found = planned([[1.7, 0.9], [1.7, 0.9], [2.7, 1.4]], period=0.0, times=times)
    for row, time in zip(found, times - 0.02, strict=True):
        value, first, second, third, integral = step_response(time)
        expected = [1.7 * (time + 0.02) + integral, 1.7 + value, 0.9 + value / 2]
        expected += [first, first / 2, second, second / 2, third / 2]
        np.testing.assert_allclose(row, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("period", [0.0, 0.01])
def test_a_plan_takes_the_place_of_the_parameters(period):
    block = ShapedPhase(model(4, period))
    simulator = Simulator(block)
    plan = np.arange(8.0)
    fix(block, simulator.get_context(), parameters=PARAMETERS, plan=plan)
    simulator.AdvanceTo(0.05)
    np.testing.assert_array_equal(output(block, simulator.get_context(), "planned"), plan)
    np.testing.assert_array_equal(output(block, simulator.get_context(), "phase"), [plan[0], 0.0])
