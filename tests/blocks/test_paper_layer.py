import numpy as np
import pytest
from helpers import fix, model, output
from nonstop_cases import (
    AT_REST,
    START,
    carrier_speeds,
    change_cost,
    moving,
    speed_at_rest,
    speed_bound_above,
)
from pydrake.solvers import SnoptSolver
from pydrake.systems.analysis import Simulator

from drake_nonstop.blocks.paper_layer import PaperLayer, PaperLayerConfig
from drake_nonstop.planning.diagnostics import Diagnostics, Outcome
from drake_nonstop.validation import ScenarioError

PERIOD = 0.01
PRINTED = {"load_motion": "measured"}  # as eq. 24 has it


class Layer:
    """The block alone in a simulator; each `update` gives it inputs and runs one update."""

    def __init__(self, speed_bound, control_period=0.0, **fields):
        config = PaperLayerConfig(speed_bound=speed_bound, **fields)
        self.block = PaperLayer(model(4, control_period), config)
        self.simulator = Simulator(self.block)
        self.context = self.simulator.get_mutable_context()
        self.updates = 0

    def update(self, inputs):
        fix(self.block, self.context, **inputs)
        if self.updates == 0:
            self.simulator.Initialize()
        else:
            # An update of time t shows only after it.
            self.simulator.AdvanceTo((self.updates + 0.5) * PERIOD)
        self.updates += 1
        return self.parameters

    @property
    def parameters(self):
        return output(self.block, self.context, "parameters")

    @property
    def diagnostics(self):
        return Diagnostics.view(output(self.block, self.context, "diagnostics"))


@pytest.mark.parametrize("excess", [1.0, 1.2, 2.0])
def test_solution_over_a_square_at_rest_is_the_global_optimum(excess):
    bound = excess * speed_at_rest(*START)
    layer = Layer(bound, tightening=0.01)
    frequency, amplitude = layer.update(AT_REST)
    target = 1.01 * bound
    assert layer.diagnostics.outcome == Outcome.SOLVED
    assert speed_at_rest(frequency, amplitude) == pytest.approx(target, rel=1e-6)

    def cost(xi, A):  # Σ cos² = Σ sin² = 2 over the four phases
        return (xi - 2) ** 2 + 3 * (A - 1.2) ** 2 + 2 * (A * xi - 2.4) ** 2

    amplitudes = np.linspace(0.3, 10, 100_001)
    cheapest = np.min(cost(target / speed_at_rest(1.0, amplitudes), amplitudes))
    assert cost(frequency, amplitude) == pytest.approx(cheapest, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["snopt", "ipopt"])
@pytest.mark.parametrize(("seed", "slope"), [(1, 0.0), (2, 3.0), (5, 0.0)])
def test_solution_is_the_cheapest_above_the_bound_of_first_principles(seed, slope, solver, rng):
    inputs = moving(seed, slope)
    bound = speed_bound_above(inputs, 0.1, **PRINTED)
    layer = Layer(bound, solver=solver)
    parameters = layer.update(inputs)
    assert layer.diagnostics.outcome == Outcome.SOLVED
    slowest = carrier_speeds(parameters, inputs, **PRINTED).min()
    assert slowest == pytest.approx(bound, abs=1e-6)
    assert layer.diagnostics.speed_margin == pytest.approx(slowest - bound, abs=1e-7)
    least = change_cost(parameters, inputs)
    reach = 1.5 * np.linalg.norm(parameters - START)
    others = START + rng.uniform(-reach, reach, (300, 2))
    cheaper = [x for x in others if change_cost(x, inputs) < 0.999 * least]
    assert len(cheaper) > 20
    for x in cheaper:
        assert carrier_speeds(x, inputs, **PRINTED).min() < bound


def test_diagnostics_count_the_outcomes_of_successive_updates():
    layer, counts = Layer(speed_at_rest(*START)), []
    for bound in (0.9, 1.1, 1.1, 50.0, 1.1):
        layer.block.set_speed_bound(layer.context, bound * speed_at_rest(*START))
        layer.update(AT_REST)
        counts.append([int(count) for count in layer.diagnostics[:6]])
    assert counts == [
        [Outcome.KEPT, 1, 1, 0, 0, 0],
        [Outcome.SOLVED, 2, 1, 1, 0, 0],
        [Outcome.KEPT, 3, 2, 1, 0, 0],
        [Outcome.HELD, 4, 2, 1, 0, 1],
        [Outcome.KEPT, 5, 3, 1, 0, 1],
    ]


def test_a_commanded_bound_is_followed_like_one_that_is_set():
    commanded, told = Layer(0.3), Layer(0.3)
    for bound in (0.3, 0.2, 0.9, 0.9, 0.0):
        told.block.set_speed_bound(told.context, bound)
        command = {"speed_bound_command": np.array([bound])}
        first, second = commanded.update(AT_REST | command), told.update(AT_REST)
        np.testing.assert_array_equal(first, second)
        np.testing.assert_array_equal(commanded.diagnostics, told.diagnostics)
        said = [output(layer.block, layer.context, "speed_bound") for layer in (commanded, told)]
        np.testing.assert_array_equal(said, [[bound], [bound]])


def test_a_solver_that_this_drake_is_without_is_named(monkeypatch):
    monkeypatch.setattr(SnoptSolver, "available", lambda self: False)
    said = r"^optimization_layer.solver = snopt: this build of Drake is without it; give ipopt$"
    with pytest.raises(ScenarioError, match=said):
        PaperLayer(model())
