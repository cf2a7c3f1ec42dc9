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


def test_speeds_from_first_principles_are_those_of_the_square_at_rest():
    np.testing.assert_allclose(carrier_speeds(START, AT_REST), speed_at_rest(*START), rtol=1e-10)


def test_nothing_has_happened_before_the_first_update():
    layer = Layer(0.2, frequency=1.5, amplitude=0.8)
    np.testing.assert_array_equal(layer.parameters, [1.5, 0.8])
    np.testing.assert_array_equal(layer.diagnostics, np.zeros(7))
    np.testing.assert_array_equal(output(layer.block, layer.context, "solve_time"), [0])


def test_feasible_parameters_are_kept_to_the_bit():
    bound = speed_at_rest(*START) - 1e-6
    layer = Layer(bound)
    np.testing.assert_array_equal(layer.update(AT_REST), START)
    np.testing.assert_allclose(layer.diagnostics, [Outcome.KEPT, 1, 1, 0, 0, 0, 1e-6], atol=1e-9)


def test_without_a_bound_everything_is_kept():
    layer = Layer(0.0, amplitude=0.01, frequency=0.1)
    np.testing.assert_array_equal(layer.update(moving(1)), [0.1, 0.01])
    assert layer.diagnostics.outcome == Outcome.KEPT


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


@pytest.mark.parametrize("solver", ["snopt", "ipopt"])
def test_a_bound_out_of_reach_keeps_the_parameters_and_counts_as_held(solver):
    layer = Layer(50.0, solver=solver)
    np.testing.assert_array_equal(layer.update(AT_REST), START)
    assert layer.diagnostics.outcome == Outcome.HELD


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


def test_a_command_is_followed_from_the_next_update_on():
    layer = Layer(0.2)
    layer.update(AT_REST | {"speed_bound_command": np.array([0.2])})
    before = layer.diagnostics
    fix(layer.block, layer.context, speed_bound_command=np.array([0.1]))
    np.testing.assert_array_equal(output(layer.block, layer.context, "speed_bound"), [0.1])
    np.testing.assert_array_equal(layer.diagnostics, before)
    layer.update(AT_REST)
    assert layer.diagnostics.speed_margin == pytest.approx(before.speed_margin + 0.1, abs=1e-9)


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (-0.1, r"speed_bound_command = -0\.1: give 0 \(no bound\) or at least 0\.001 m/s"),
        (1e-4, r"speed_bound_command = 0\.0001: give 0 \(no bound\) or at least 0\.001 m/s"),
        (np.nan, "speed_bound_command = nan: give 0"),
        (np.inf, "speed_bound_command = inf: give 0"),
    ],
)
def test_a_command_out_of_range_is_an_error(command, said):
    layer = Layer(0.2)
    layer.update(AT_REST | {"speed_bound_command": np.array([0.2])})
    with pytest.raises(ScenarioError, match=f"^optimization_layer.{said}"):
        layer.update(AT_REST | {"speed_bound_command": np.array([command])})


def test_a_bound_cannot_be_set_beside_a_command():
    layer = Layer(0.2)
    layer.update(AT_REST | {"speed_bound_command": np.array([0.2])})
    said = r"^optimization_layer.speed_bound = 0.3: the signal speed_bound_command sets the bound"
    with pytest.raises(ScenarioError, match=said):
        layer.block.set_speed_bound(layer.context, 0.3)


def test_solve_time_is_a_duration():
    layer = Layer(0.9)
    layer.update(AT_REST)
    assert 1e-6 < output(layer.block, layer.context, "solve_time")[0] < 10


@pytest.mark.parametrize("control_period", [0.0, 0.005, 0.01])
def test_updates_come_once_a_period(control_period):
    layer = Layer(0.2, control_period)
    fix(layer.block, layer.context, **AT_REST)
    layer.simulator.Initialize()
    assert layer.diagnostics.updates == 1
    layer.simulator.AdvanceTo(0.095)
    assert layer.diagnostics.updates == 10


def test_contexts_of_one_block_are_independent():
    first, second = moving(1), moving(5)
    layer = Layer(speed_bound_above(first, 0.1, **PRINTED))
    simulators = {}
    for name, inputs in (("A", first), ("B", second), ("A again", first)):
        simulators[name] = Simulator(layer.block, layer.block.CreateDefaultContext())
        fix(layer.block, simulators[name].get_mutable_context(), **inputs)
        simulators[name].Initialize()
    results = {
        name: output(layer.block, simulator.get_context(), "parameters")
        for name, simulator in simulators.items()
    }
    np.testing.assert_array_equal(results["A"], results["A again"])
    assert not np.array_equal(results["A"], results["B"])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("speed_bound", -0.1),
        ("speed_bound", np.nan),
        ("tightening", -0.01),
        ("tightening", 1.0),
        ("internal_force_weight", -1.0),
        ("internal_force_rate_weight", np.inf),
        ("frequency", 0.0),
        ("amplitude", np.nan),
        ("period", 0.0),
        ("period", -0.01),
        ("solver", "nlopt"),
        ("frequency_bounds", [3.0, 20.0]),
        ("frequency_bounds", [0.1, 1.9]),
        ("frequency_bounds", [0.0, 20.0]),
        ("frequency_bounds", [20.0, 0.1]),
        ("frequency_bounds", [0.1]),
        ("frequency_bounds", [0.1, np.nan]),
        ("amplitude_bounds", [-1.0, 20.0]),
        ("amplitude_bounds", [1.3, 20.0]),
        ("amplitude_bounds", [1.0]),
    ],
)
def test_bad_parameter_is_named(field, value):
    with pytest.raises(ScenarioError) as error:
        PaperLayer(model(), PaperLayerConfig(**{field: value}))
    assert str(error.value).startswith(f"optimization_layer.{field} = {value}: give")


def test_a_solver_that_this_drake_is_without_is_named(monkeypatch):
    monkeypatch.setattr(SnoptSolver, "available", lambda self: False)
    said = r"^optimization_layer.solver = snopt: this build of Drake is without it; give ipopt$"
    with pytest.raises(ScenarioError, match=said):
        PaperLayer(model())


@pytest.mark.parametrize("period", [0.015, 0.005, 0.0101])
def test_period_must_be_a_multiple_of_the_control_period(period):
    with pytest.raises(ScenarioError, match=f"optimization_layer.period = {period}: give a mult"):
        PaperLayer(model(4, 0.01), PaperLayerConfig(period=period))


def test_state_that_is_no_number_is_named():
    layer = Layer(0.21)
    layer.block.set_name("optimization_layer")
    inputs = {**AT_REST, "wrench_rate": np.full(6, np.nan)}
    with pytest.raises(Exception, match="optimization_layer"):
        layer.update(inputs)
