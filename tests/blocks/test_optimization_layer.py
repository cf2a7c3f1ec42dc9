import numpy as np
import pytest
from helpers import fix, model, nightly_beyond, output
from nonstop_cases import (
    AT_REST,
    PERIOD,
    SOLVERS,
    START,
    TIGHTENING,
    carrier_speeds,
    config,
    moving,
    speed_at_rest,
    speed_bound_above,
)
from pydrake.systems.analysis import Simulator

from drake_nonstop.blocks.optimization_layer import NonstopOptimizer, NonstopOptimizerConfig
from drake_nonstop.optimization.diagnostics import Diagnostics, Outcome
from drake_nonstop.validation import ScenarioError


def test_speeds_from_first_principles_are_those_of_the_square_at_rest():
    np.testing.assert_allclose(carrier_speeds(START, AT_REST), speed_at_rest(*START), rtol=1e-10)


_built = {}


def built(config, control_period=0.0):
    """The block of a config, from an earlier test if there was one: its state is elsewhere."""
    key = repr(config), control_period
    if key not in _built:
        _built[key] = NonstopOptimizer(model(4, control_period), config)
    return _built[key]


class Layer:
    """The block alone in a simulator; each `update` gives it inputs and runs one update."""

    def __init__(self, config, control_period=0.0):
        self.block = built(config, control_period)
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


def test_nothing_has_happened_before_the_first_update():
    layer = Layer(config(0.2, frequency=1.5, amplitude=0.8))
    np.testing.assert_array_equal(layer.parameters, [1.5, 0.8])
    np.testing.assert_array_equal(layer.diagnostics, np.zeros(7))
    np.testing.assert_array_equal(output(layer.block, layer.context, "solve_time"), [0])


def test_feasible_parameters_are_kept_to_the_bit():
    layer = Layer(config(speed_at_rest(*START) / (1 + TIGHTENING) - 1e-6))
    np.testing.assert_array_equal(layer.update(AT_REST), START)
    margin = speed_at_rest(*START) - (speed_at_rest(*START) / (1 + TIGHTENING) - 1e-6)
    np.testing.assert_allclose(layer.diagnostics, [Outcome.KEPT, 1, 1, 0, 0, 0, margin], atol=1e-9)


def test_without_a_bound_everything_is_kept():
    layer = Layer(config(0.0, amplitude=0.01, frequency=0.1))
    np.testing.assert_array_equal(layer.update(moving(1)), [0.1, 0.01])
    assert layer.diagnostics.outcome == Outcome.KEPT


@pytest.mark.parametrize("excess", [1.0, 1.2, 2.0])
def test_solution_over_a_square_at_rest_is_the_global_optimum(excess):
    bound = excess * speed_at_rest(*START)
    layer = Layer(config(bound))
    frequency, amplitude = layer.update(AT_REST)
    target = (1 + TIGHTENING) * bound
    assert layer.diagnostics.outcome == Outcome.SOLVED
    assert speed_at_rest(frequency, amplitude) == pytest.approx(target, rel=1e-6)

    def cost(xi, A):  # Σ cos² = Σ sin² = 2 over the four phases
        return (xi - 2) ** 2 + 3 * (A - 1.2) ** 2 + 2 * (A * xi - 2.4) ** 2

    amplitudes = np.linspace(0.3, 10, 100_001)
    cheapest = np.min(cost(target / speed_at_rest(1.0, amplitudes), amplitudes))
    # The speeds may fall short by 1e-6 of the bound squared, which is worth that much cost.
    assert cost(frequency, amplitude) == pytest.approx(cheapest, rel=1e-5)


@pytest.mark.parametrize("load_motion", ["desired", "measured"])
@pytest.mark.parametrize("slope", [0.0, 3.0])
@pytest.mark.parametrize("seed", nightly_beyond(1, "studies", [1, 2]))
def test_solution_keeps_every_carrier_above_the_bound_until_the_next_update(
    seed, slope, load_motion
):
    inputs = moving(seed, slope)
    bound = speed_bound_above(inputs, 0.1, load_motion=load_motion)
    layer = Layer(config(bound, load_motion=load_motion))
    parameters = layer.update(inputs)
    assert layer.diagnostics.outcome == Outcome.SOLVED

    def slowest(time, lag=0.0):
        """The slowest carrier, its phase `lag` behind."""
        later = {**inputs, "phase": inputs["phase"] - [lag, 0.0]}
        return np.min(carrier_speeds(parameters, later, time, load_motion=load_motion))

    instants = np.linspace(0, PERIOD, 3)
    assert slowest(0.0) >= bound * (1 + TIGHTENING) * (1 - 1e-6)
    assert min(slowest(time) for time in instants) >= bound
    # The constraint takes the phase ahead to go on at the previous ξ.
    change = parameters[0] - START[0]
    constrained = min(slowest(time, change * time) for time in instants)
    assert constrained == pytest.approx(bound * (1 + TIGHTENING), abs=2e-4)
    assert layer.diagnostics.speed_margin == pytest.approx(constrained - bound, abs=2e-4)


@pytest.mark.parametrize("load_motion", ["desired", "measured"])
@pytest.mark.parametrize("seed", nightly_beyond(1, "studies", [4, 5, 6]))
def test_predicted_margin_of_now_is_that_of_first_principles(seed, load_motion):
    inputs = moving(seed)
    layer = Layer(config(0.01, load_motion=load_motion, look_ahead_points=1))
    layer.update(inputs)
    assert layer.diagnostics.outcome == Outcome.KEPT
    expected = np.min(carrier_speeds(START, inputs, load_motion=load_motion)) - 0.01
    assert layer.diagnostics.speed_margin == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("load_motion", ["desired", "measured"])
@pytest.mark.parametrize("seed", nightly_beyond(1, "studies", [4, 5, 6]))
def test_predicted_margin_looks_ahead(seed, load_motion):
    inputs = moving(seed)
    layer = Layer(config(0.01, load_motion=load_motion, look_ahead_points=3))
    layer.update(inputs)
    speeds = [
        np.min(carrier_speeds(START, inputs, time, load_motion=load_motion))
        for time in (0.0, PERIOD / 2, PERIOD)
    ]
    # To the third order in 10 ms, where the speeds differ by a hundred times as much.
    assert layer.diagnostics.speed_margin == pytest.approx(min(speeds) - 0.01, abs=1e-5)
    assert np.ptp(speeds) > 9e-4


@pytest.mark.parametrize("seed", nightly_beyond(1, "studies", [4, 6, 7]))
def test_predicted_margin_is_that_of_the_slowest_phase_of_the_orbit(seed):
    inputs, points = moving(seed), 12
    layer = Layer(config(0.01, orbit_points=points, orbit_updates=1, look_ahead_points=1))
    layer.update(inputs)
    slowest = []
    for turn in 2 * np.pi * np.arange(points) / points:
        shifted = {**inputs, "phase": inputs["phase"] + [turn, 0]}
        slowest.append(np.min(carrier_speeds(START, shifted)))
    assert layer.diagnostics.speed_margin == pytest.approx(min(slowest) - 0.01, abs=1e-9)
    assert min(slowest) < slowest[0] - 0.005


def test_updates_share_the_phases_of_the_orbit():
    inputs, points, updates = moving(6), 12, 3
    layer = Layer(config(0.01, orbit_points=points, orbit_updates=updates, look_ahead_points=1))
    for update in range(2 * updates):
        layer.update(inputs)
        slowest = [np.min(carrier_speeds(START, inputs))]
        for turn in 2 * np.pi * np.arange(update % updates, points, updates) / points:
            shifted = {**inputs, "phase": inputs["phase"] + [turn, 0]}
            slowest.append(np.min(carrier_speeds(START, shifted)))
        assert layer.diagnostics.speed_margin == pytest.approx(min(slowest) - 0.01, abs=1e-9)


@pytest.mark.parametrize("ahead", [0.0, 0.005])
@pytest.mark.parametrize("seed", nightly_beyond(1, "studies", [2, 5]))
def test_solution_keeps_every_carrier_above_the_bound_all_along_the_orbit(seed, ahead):
    inputs = moving(seed)
    bound = speed_bound_above(inputs, 0.1)
    layer = Layer(config(bound, orbit_points=16, orbit_updates=1, look_ahead_time=ahead))
    parameters = layer.update(inputs)
    assert layer.diagnostics.outcome == Outcome.SOLVED
    for turn in 2 * np.pi * np.arange(1, 16) / 16:
        shifted = {**inputs, "phase": inputs["phase"] + [turn, 0]}
        speeds = carrier_speeds(parameters, shifted, PERIOD + ahead)
        assert np.min(speeds) >= bound * (1 + TIGHTENING) - 2e-4


@pytest.mark.parametrize("seed", nightly_beyond(1, "studies", [2, 6]))
def test_predicted_margin_of_the_orbit_is_that_of_the_time_ahead(seed):
    inputs, ahead, points = moving(seed), 0.03, 12
    orbit = {"orbit_points": points, "orbit_updates": 1}
    layer = Layer(config(0.01, **orbit, look_ahead_time=ahead))
    layer.update(inputs)
    slowest = [np.min(carrier_speeds(START, inputs, time)) for time in (0.0, PERIOD)]
    for turn in 2 * np.pi * np.arange(points) / points:
        shifted = {**inputs, "phase": inputs["phase"] + [turn, 0]}
        slowest.append(np.min(carrier_speeds(START, shifted, PERIOD + ahead)))
    assert layer.diagnostics.speed_margin == pytest.approx(min(slowest) - 0.01, abs=2e-4)
    without = Layer(config(0.01, **orbit, look_ahead_time=0.0))
    without.update(inputs)
    assert abs(without.diagnostics.speed_margin - layer.diagnostics.speed_margin) > 2e-3


def test_wrench_is_extrapolated_by_the_change_of_its_rate():
    first, second = moving(7), moving(7)
    second["wrench_rate"] = first["wrench_rate"] + np.array([0.02, -0.03, 0.01, 0.2, 0.3, -0.2])
    layer = Layer(config(0.01, look_ahead_points=2))
    layer.update(first)
    layer.update(second)
    second_rate = (second["wrench_rate"] - first["wrench_rate"]) / PERIOD

    def slowest(rate):
        return min(
            np.min(carrier_speeds(START, second, time, second_rate=rate)) for time in (0.0, PERIOD)
        )

    assert layer.diagnostics.speed_margin == pytest.approx(slowest(second_rate) - 0.01, abs=1e-4)
    assert abs(slowest(second_rate) - slowest(0.0)) > 1e-3


solvers = pytest.mark.parametrize("solver", SOLVERS)


@solvers
def test_bound_out_of_reach_is_approached_as_far_as_the_bounds_allow(solver):
    limits = {"frequency_bounds": [0.1, 3.0], "amplitude_bounds": [0.01, 5.0]}
    layer = Layer(config(100.0, solver=solver, **limits))
    parameters = layer.update(AT_REST)
    np.testing.assert_allclose(parameters, [3.0, 5.0], rtol=1e-6)
    margin = speed_at_rest(3.0, 5.0) - 100
    np.testing.assert_allclose(
        layer.diagnostics, [Outcome.RELAXED, 1, 0, 0, 1, 0, margin], rtol=0, atol=1e-5
    )


@pytest.mark.parametrize("seed", nightly_beyond(1, "studies", [1, 2, 3]))
def test_relaxed_parameters_have_the_largest_worst_speed_of_a_moving_load(seed):
    inputs = moving(seed)
    bounds = {"frequency_bounds": [1.5, 2.5], "amplitude_bounds": [1.0, 1.5]}
    layer = Layer(config(5.0, look_ahead_points=1, **bounds))
    parameters = layer.update(inputs)
    assert layer.diagnostics.outcome == Outcome.RELAXED
    reached = np.min(carrier_speeds(parameters, inputs))
    around = [
        np.min(carrier_speeds(np.clip(parameters + step, [1.5, 1.0], [2.5, 1.5]), inputs))
        for step in 0.02 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1]])
    ]
    assert reached >= max(around) - 1e-6
    assert reached > np.min(carrier_speeds(START, inputs)) + 0.01


@solvers
def test_parameters_that_are_the_best_already_are_held(solver):
    limits = {"frequency_bounds": [0.1, 2.0], "amplitude_bounds": [0.01, 1.2]}
    layer = Layer(config(5.0, solver=solver, **limits))
    np.testing.assert_array_equal(layer.update(AT_REST), START)
    margin = speed_at_rest(*START) - 5
    np.testing.assert_allclose(layer.diagnostics, [Outcome.HELD, 1, 0, 0, 0, 1, margin], atol=1e-9)


def test_diagnostics_count_the_outcomes_of_successive_updates():
    bound = 1.2 * speed_at_rest(*START)
    layer = Layer(config(bound, frequency_bounds=[0.1, 3.0], amplitude_bounds=[0.01, 2.0]))
    lighter, heavier = ({**AT_REST, "wrench": k * AT_REST["wrench"]} for k in (0.9, 20.0))
    history = []
    for inputs in (AT_REST, lighter, heavier, heavier, AT_REST):
        layer.update(inputs)
        history.append(layer.diagnostics)
    np.testing.assert_array_equal(
        np.array(history)[:, :6],
        [
            [Outcome.SOLVED, 1, 0, 1, 0, 0],
            [Outcome.KEPT, 2, 1, 1, 0, 0],
            [Outcome.RELAXED, 3, 1, 1, 1, 0],
            [Outcome.HELD, 4, 1, 1, 1, 1],
            [Outcome.KEPT, 5, 2, 1, 1, 1],
        ],
    )


def test_a_lowered_bound_is_in_force_at_once_and_a_raised_one_gradually():
    layer = Layer(config(0.3))
    for bound, in_force in ((0.2, 0.2), (0.4, 0.2 + 0.4 * PERIOD / 2.0)):
        layer.block.set_speed_bound(layer.context, bound)
        layer.update(AT_REST)
        margin = speed_at_rest(*START) - in_force
        assert layer.diagnostics.speed_margin == pytest.approx(margin, abs=1e-9)


def test_a_commanded_bound_is_followed_like_one_that_is_set():
    commanded, told = Layer(config(0.3)), Layer(config(0.3))
    for bound in (0.2, 0.2, 0.9, 0.9, 0.0):
        if commanded.updates:
            told.block.set_speed_bound(told.context, bound)
        command = {"speed_bound_command": np.array([bound if commanded.updates else 0.3])}
        first, second = commanded.update(AT_REST | command), told.update(AT_REST)
        np.testing.assert_array_equal(first, second)
        np.testing.assert_array_equal(commanded.diagnostics, told.diagnostics)
        said = [output(layer.block, layer.context, "speed_bound") for layer in (commanded, told)]
        np.testing.assert_array_equal(*said)


def test_a_command_is_followed_from_the_next_update_on():
    layer = Layer(config(0.2))
    layer.update(AT_REST | {"speed_bound_command": np.array([0.2])})
    before = layer.diagnostics
    fix(layer.block, layer.context, speed_bound_command=np.array([0.1]))
    np.testing.assert_array_equal(output(layer.block, layer.context, "speed_bound"), [0.1])
    np.testing.assert_array_equal(layer.diagnostics, before)
    layer.update(AT_REST)
    assert layer.diagnostics.speed_margin == pytest.approx(before.speed_margin + 0.1, abs=1e-9)


@pytest.mark.parametrize("enabled", [True, False])
@pytest.mark.parametrize(
    ("command", "said"),
    [
        (-0.1, r"speed_bound_command = -0\.1: give 0 \(no bound\) or at least 0\.001 m/s"),
        (1e-4, r"speed_bound_command = 0\.0001: give 0 \(no bound\) or at least 0\.001 m/s"),
        (np.nan, "speed_bound_command = nan: give 0"),
        (np.inf, "speed_bound_command = inf: give 0"),
        (2.0, r"speed_bound_command = 2\.0: give less than 1\.4703 m/s, for the sake of max_sp"),
    ],
)
def test_a_command_out_of_range_is_an_error(command, said, enabled):
    layer = Layer(config(0.2, max_speed=1.5))
    layer.update(AT_REST | {"speed_bound_command": np.array([0.2])})
    layer.block.set_enabled(layer.context, enabled)
    with pytest.raises(ScenarioError, match=f"^optimization_layer.{said}"):
        layer.update(AT_REST | {"speed_bound_command": np.array([command])})


def test_a_bound_cannot_be_set_beside_a_command():
    layer = Layer(config(0.2))
    layer.update(AT_REST | {"speed_bound_command": np.array([0.2])})
    said = r"^optimization_layer.speed_bound = 0.3: the signal speed_bound_command sets the bound"
    with pytest.raises(ScenarioError, match=said):
        layer.block.set_speed_bound(layer.context, 0.3)


def test_solve_time_is_a_duration():
    layer = Layer(config(2.0))
    layer.update(AT_REST)
    assert 1e-6 < output(layer.block, layer.context, "solve_time")[0] < 10


@pytest.mark.parametrize("control_period", [0.0, 0.005, 0.01])
def test_updates_come_once_a_period(control_period):
    layer = Layer(config(0.2), control_period)
    fix(layer.block, layer.context, **AT_REST)
    layer.simulator.Initialize()
    assert layer.diagnostics.updates == 1
    layer.simulator.AdvanceTo(0.095)
    assert layer.diagnostics.updates == 10


def test_contexts_of_one_block_are_independent():
    first, second = moving(1), moving(5)
    layer = Layer(config(speed_bound_above(first, 0.1)))
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


def test_solve_survives_the_points_that_its_line_search_tries():
    # The nearest feasible point is far away, and the solver goes by A = 1000 N.
    inputs = moving(10)
    bound = speed_bound_above(inputs, 0.6)
    layer = Layer(config(bound, amplitude_bounds=[0.01, 1000.0]))
    parameters = layer.update(inputs)
    assert np.min(carrier_speeds(parameters, inputs)) > np.min(carrier_speeds(START, inputs))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("speed_bound", -0.1),
        ("speed_bound", np.nan),
        ("tightening", -0.01),
        ("internal_force_weight", -1.0),
        ("internal_force_rate_weight", np.inf),
        ("frequency", 0.0),
        ("amplitude", np.nan),
        ("period", 0.0),
        ("period", -0.01),
        ("look_ahead_points", 0),
        ("orbit_points", 0),
        ("orbit_updates", 0),
        ("orbit_updates", 5),
        ("load_motion", "planned"),
        ("max_frequency_rate", 0.0),
        ("max_amplitude_rate", -1.0),
        ("max_speed", 0.2),
        ("max_speed", np.nan),
        ("min_tension", -1.0),
        ("max_tension", 0.0),
        ("min_separation", np.inf),
        ("anchor_weight", -0.1),
        ("solver", "gurobi"),
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
        NonstopOptimizer(model(), NonstopOptimizerConfig(**{field: value}))
    assert str(error.value).startswith(f"optimization_layer.{field} = {value}: give")


@pytest.mark.parametrize("period", [0.015, 0.005, 0.0101])
def test_period_must_be_a_multiple_of_the_control_period(period):
    with pytest.raises(ScenarioError, match=f"optimization_layer.period = {period}: give a mult"):
        NonstopOptimizer(model(4, 0.01), NonstopOptimizerConfig(period=period))


def test_state_that_is_no_number_is_named():
    layer = Layer(config(0.21))
    layer.block.set_name("optimization_layer")
    inputs = {**AT_REST, "wrench_rate": np.full(6, np.nan)}
    with pytest.raises(Exception, match="optimization_layer"):
        layer.update(inputs)
