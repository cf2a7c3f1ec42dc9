"""Constant parameters, the phases, λ and the force distribution, each alone."""

import numpy as np
import pytest
from helpers import Motion, fix, model, output
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from drake_nonstop.blocks.force_distribution import CableForceDistribution
from drake_nonstop.blocks.internal_force import InternalForceTrajectory
from drake_nonstop.blocks.optimization_layer import ConstantParameters, ConstantParametersConfig
from drake_nonstop.blocks.phase import AccumulatedPhase, PaperPhase
from drake_nonstop.mechanics.grasp import cable_forces_and_rates
from drake_nonstop.validation import ScenarioError

PARAMETERS = np.array([1.7, 0.9])
counts = pytest.mark.parametrize("n", [3, 4, 6])


def test_constant_parameters():
    block = ConstantParameters(model(), ConstantParametersConfig(frequency=1.5, amplitude=0.7))
    parameters = output(block, block.CreateDefaultContext(), "parameters")
    np.testing.assert_array_equal(parameters, [1.5, 0.7])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("frequency", 0.0),
        ("frequency", np.nan),
        ("amplitude", -1.0),
        ("amplitude", np.inf),
        ("speed_bound", -0.1),
    ],
)
def test_bad_constant_parameter_is_named(field, value):
    with pytest.raises(ScenarioError, match=f"optimization_layer.{field} = {value}: give"):
        ConstantParameters(model(), ConstantParametersConfig(**{field: value}))


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


def test_printed_phase_jumps_with_the_frequency():
    block = PaperPhase(model())
    context = block.CreateDefaultContext()
    context.SetTime(3.0)
    for frequency in (1.7, 2.7):
        fix(block, context, parameters=np.array([frequency, 1.0]))
        np.testing.assert_allclose(output(block, context, "phase"), [3 * frequency, 3], rtol=1e-15)


def test_sampled_printed_phase_stands_still_between_samples():
    block = PaperPhase(model(4, 0.01))
    context = block.CreateDefaultContext()
    fix(block, context, parameters=PARAMETERS, sample_time=np.array([2.0]))
    context.SetTime(2.009)
    np.testing.assert_allclose(output(block, context, "phase"), [3.4, 2], rtol=1e-15)


@counts
def test_internal_forces_in_closed_form(n):
    block = InternalForceTrajectory(model(n))
    context = block.CreateDefaultContext()
    fix(block, context, parameters=PARAMETERS, phase=np.array([0.4, 5.0]))
    angles = 0.4 + 2 * np.pi * np.arange(n) / n
    expected = np.concatenate([0.9 * np.cos(angles), -0.9 * 1.7 * np.sin(angles)])
    np.testing.assert_allclose(
        output(block, context, "internal_force"), expected, rtol=0, atol=1e-14
    )


@counts
def test_force_distribution_of_the_mechanics(rng, n):
    constants = model(n)
    block = CableForceDistribution(constants)
    context = block.CreateDefaultContext()
    inputs = {
        "measured_load_state": Motion(70).state(0.2),
        "wrench": rng.normal(size=6),
        "wrench_rate": rng.normal(size=6),
        "internal_force": rng.normal(size=2 * n),
    }
    fix(block, context, **inputs)
    forces, rates = cable_forces_and_rates(
        *inputs.values(),
        pseudo_inverse=constants.pseudo_inverse,
        basis=constants.pattern.basis,
        offset=constants.pattern.offset,
    )
    for name, expected in (
        ("desired_cable_forces", forces),
        ("desired_cable_force_rates", rates),
    ):
        np.testing.assert_allclose(
            output(block, context, name), expected.ravel(), rtol=0, atol=1e-13
        )


@counts
def test_level_load_at_rest_hangs_on_equal_vertical_forces(n):
    block = CableForceDistribution(model(n))
    context = block.CreateDefaultContext()
    fix(
        block,
        context,
        measured_load_state=np.array([1.0, *np.zeros(12)]),
        wrench=np.array([0, 0, 0, 0, 0, 9.81]),
        wrench_rate=np.zeros(6),
        internal_force=np.zeros(2 * n),
    )
    np.testing.assert_allclose(
        output(block, context, "desired_cable_forces"), [0, 0, 9.81 / n] * n, rtol=0, atol=1e-14
    )
    np.testing.assert_array_equal(output(block, context, "desired_cable_force_rates"), 0)
