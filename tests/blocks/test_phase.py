"""The phases in closed form, behind a layer that answers at each sample."""

import numpy as np
import pytest
from helpers import fix, model, output
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from drake_nonstop.blocks.phase import AccumulatedPhase, ShapedPhase, ShapedPhaseConfig
from drake_nonstop.systems.block import set_state_values, state_values

PERIOD = 0.01


class Layer(LeafSystem):
    """Parameters of each of some samples; the last ones stay."""

    def __init__(self, values):
        super().__init__()
        self._values = values
        self.DeclareStateOutputPort("parameters", self.DeclareDiscreteState([7.0, 8.0]))
        self.DeclareInitializationDiscreteUpdateEvent(self._set)
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, PERIOD, self._set)

    def _set(self, context, discrete_state):
        step = round(context.get_time() / PERIOD)
        discrete_state.set_value(self._values[min(step, len(self._values) - 1)])


def planned(phase, values, times):
    """What a phase makes of a layer's parameters, just after these times: (times, 8)."""
    builder = DiagramBuilder()
    layer, phase = builder.AddSystem(Layer(values)), builder.AddSystem(phase)
    builder.Connect(layer.get_output_port(), phase.GetInputPort("parameters"))
    for name in ("phase", "planned"):
        builder.ExportOutput(phase.GetOutputPort(name), name)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.get_mutable_integrator().set_target_accuracy(1e-8)
    found = []
    for time in times:
        simulator.AdvanceTo(time)
        simulator.AdvancePendingEvents()
        context = simulator.get_context()
        found.append(output(diagram, context, "planned"))
        np.testing.assert_array_equal(output(diagram, context, "phase"), [found[-1][0], 0.0])
        assert np.all(state_values(phase.GetMyContextFromRoot(context))[7:] == 1)  # it has started
    return np.array(found)


@pytest.mark.parametrize("period", [0.0, PERIOD])
def test_phase_is_the_integral_of_a_changing_frequency(period):
    values = [[2.0**k, 1.0] for k in range(6)]
    found = planned(AccumulatedPhase(model(4, period)), values, [0.04])
    np.testing.assert_allclose(found[0, 0], 0.01 * (1 + 2 + 4 + 8), atol=1e-7)


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
    shape = ShapedPhase(model(4, 0.0), ShapedPhaseConfig(bandwidth=40.0))
    found = planned(shape, [[1.7, 0.9], [1.7, 0.9], [2.7, 1.4]], times)
    for row, time in zip(found, times - 0.02, strict=True):
        value, first, second, third, integral = step_response(time)
        expected = [1.7 * (time + 0.02) + integral, 1.7 + value, 0.9 + value / 2]
        expected += [first, first / 2, second, second / 2, third / 2]
        np.testing.assert_allclose(row, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("period", [0.0, PERIOD])
def test_a_plan_takes_the_place_of_the_parameters(period):
    block = ShapedPhase(model(4, period))
    simulator, plan = Simulator(block), np.arange(8.0)
    fix(block, simulator.get_context(), parameters=np.array([1.7, 0.9]), plan=plan)
    set_state_values(simulator.get_mutable_context(), stands := np.arange(8.0) % 7.0 + 1.0)
    simulator.AdvanceTo(0.05)
    np.testing.assert_array_equal(state_values(simulator.get_context()), stands)
    for name, expected in (("planned", plan), ("phase", [plan[0], 0.0])):
        found = output(block, simulator.get_context(), name)
        np.testing.assert_array_equal(found, expected)
