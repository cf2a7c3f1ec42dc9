"""Layers of a cost and constraints, the paper's and one's own, against first principles."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
from helpers import difference, fix, model, nightly_beyond, output
from nonstop_cases import (
    AT_REST,
    START,
    cables,
    change_cost,
    moving,
    speed_at_rest,
    speed_bound_above,
)
from nonstop_cases import carrier_speeds as speeds_by_differences
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.solvers import SnoptSolver
from pydrake.symbolic import Evaluate, Expression, Variable

from drake_nonstop import (
    AircraftLimits,
    AircraftParameters,
    Diagnostics,
    ScenarioError,
    cable_tensions,
    carrier_distances,
    carrier_speeds,
    flight_margins,
)
from drake_nonstop.blocks.nlp_layer import NlpLayer, NlpLayerConfig
from drake_nonstop.blocks.paper_layer import PaperLayer, PaperLayerConfig
from drake_nonstop.mechanics.rigid_load import load_acceleration

PAPER = {"orbit_points": 1, "look_ahead_time": 0.0, "tightening": 0.01}
WIND = np.array([0.3, -0.2, 0.1])
PRINTED = {"load_motion": "measured"}  # as eq. 24 has it


def on_its_reference(seed):
    """Inputs of a load whose state is that of its reference."""
    inputs = moving(seed)
    return inputs | {"measured_load_state": inputs["reference"][:13]}


def arguments(inputs):
    return model(), inputs["reference"], inputs["wrench"], inputs["wrench_rate"]


def updated(block, inputs, context=None):
    """The parameters and the diagnostics of a layer after an update."""
    context = context or block.CreateDefaultContext()
    fix(block, context, **inputs)
    context.SetDiscreteState(block.answer(context))
    told = Diagnostics.view(output(block, context, "diagnostics"))
    return output(block, context, "parameters"), told


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_carriers_do_is_that_of_first_principles_of_all_scalar_types(seed):
    inputs, x = on_its_reference(seed), START + np.array([0.3, -0.2])
    given, theta = arguments(inputs), inputs["phase"][0]

    def apart(x, inputs):
        positions, _ = cables(x, inputs)
        pairs = np.transpose(np.triu_indices(4, 1))
        return np.array([np.linalg.norm(positions[i] - positions[j]) for i, j in pairs])

    variables = np.array([Variable("xi"), Variable("amplitude")])
    for quantity, judge in (
        (carrier_speeds, speeds_by_differences),
        (partial(carrier_speeds, wind=WIND), partial(speeds_by_differences, wind=WIND)),
        (cable_tensions, lambda x, inputs: cables(x, inputs)[1][:, 0]),
        (carrier_distances, apart),
    ):
        expected = [judge(x, inputs | {"phase": np.array([t, 0.0])}) for t in (theta, theta + 1.5)]
        found = quantity(*given, *x, np.array([theta, theta + 1.5]))
        np.testing.assert_allclose(found, expected, rtol=1e-7)
        np.testing.assert_allclose(quantity(*given, *x, theta), expected[0], rtol=1e-7)
        slopes = ExtractGradient(quantity(*given, *InitializeAutoDiff(x)[:, 0], theta))
        for axis, slope in zip(np.eye(2), slopes.T, strict=True):
            by_steps = difference(lambda h, a=axis, q=quantity: q(*given, *(x + h * a), theta), 0)
            np.testing.assert_allclose(slope, by_steps, atol=1e-8)
        with np.errstate(invalid="ignore"):  # Expression raises the flag without a cause
            symbols = quantity(*given, *map(Expression, variables), theta)
        values = Evaluate(symbols, dict(zip(variables, x, strict=True)))
        np.testing.assert_allclose(values[:, 0], found[0], rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["snopt", "ipopt"])
@pytest.mark.parametrize(
    ("seed", "slope"), nightly_beyond(1, "studies", [(2, 3.0), (1, 0.0), (5, 0.0)])
)
def test_the_papers_solution_is_the_cheapest_above_the_bound(seed, slope, solver, rng):
    inputs = moving(seed, slope)
    bound = speed_bound_above(inputs, 0.1, **PRINTED)
    layer = PaperLayer(model(), PaperLayerConfig(speed_bound=bound, solver=solver))
    parameters, told = updated(layer, inputs)
    assert told.solved == 1
    slowest = speeds_by_differences(parameters, inputs, **PRINTED).min()
    assert slowest == pytest.approx(bound, abs=1e-6)
    assert told.speed_margin == pytest.approx(slowest - bound, abs=1e-7)
    least = change_cost(parameters, inputs)
    reach = 1.5 * np.linalg.norm(parameters - START)
    others = START + rng.uniform(-reach, reach, (300, 2))
    cheaper = [x for x in others if change_cost(x, inputs) < 0.999 * least]
    assert len(cheaper) > 20
    for x in cheaper:
        assert speeds_by_differences(x, inputs, **PRINTED).min() < bound


def test_updates_are_counted_alike_of_a_bound_that_is_commanded_and_of_one_that_is_set():
    layer = PaperLayer(model(), PaperLayerConfig(speed_bound=0.3))
    commanded, told = layer.CreateDefaultContext(), layer.CreateDefaultContext()
    counts = []
    for factor in (0.9, 1.1, 1.1, 50.0, 1.1):
        bound = factor * speed_at_rest(*START)
        layer.set_speed_bound(told, bound)
        parameters, found = updated(layer, AT_REST, told)
        counts.append([int(count) for count in found[:6]])
        command = {"speed_bound_command": np.array([bound])}
        same, also = updated(layer, AT_REST | command, commanded)
        np.testing.assert_array_equal([*same, *also], [*parameters, *found])
        np.testing.assert_array_equal(output(layer, commanded, "speed_bound"), [bound])
        np.testing.assert_array_equal(output(layer, told, "speed_bound"), [bound])
    assert counts == [  # the last outcome, updates, and how many kept, solved, relaxed and held
        [1, 1, 1, 0, 0, 0],
        [2, 2, 1, 1, 0, 0],
        [1, 3, 2, 1, 0, 0],
        [4, 4, 2, 1, 0, 1],
        [1, 5, 3, 1, 0, 1],
    ]


@pytest.mark.slow
@pytest.mark.parametrize("ahead", nightly_beyond(1, "studies", [0.05, 0.0]))
def test_along_the_orbit_it_keeps_every_carrier_above_the_bound_of_first_principles(ahead):
    inputs = on_its_reference(2)
    motion = load_acceleration(model().load, inputs["reference"][:13], inputs["wrench"])
    inputs["reference"][13:19] = np.concatenate(motion)
    bound = speed_bound_above(inputs, 0.2)
    fields = {"orbit_points": 64, "look_ahead_time": ahead, "tightening": 0.01}
    layer = NlpLayer(model(), NlpLayerConfig(speed_bound=bound, **fields))
    parameters, told = updated(layer, inputs)
    assert told.solved == 1
    slowest = min(
        speeds_by_differences(parameters, inputs | {"phase": np.array([theta, 0.0])}, ahead).min()
        for theta in np.linspace(0, 2 * np.pi, 60)
    )
    assert slowest == pytest.approx(1.01 * bound, rel=4e-3)


@dataclass(kw_only=True)
class LightConfig(NlpLayerConfig):
    largest: float = 2.6  # N


class Light(NlpLayer):
    """Of a signal more, and a cost that the last x does not make zero."""

    reads = (*NlpLayer.reads, "carrier_state")

    def cost(self, x, now):
        return (x[0] - 2.5) ** 2 + (now.carrier_state[0] * x[1] - 1.0) ** 2

    def constraints(self, x, now):
        given = self.model, now.reference, now.wrench, now.wrench_rate
        return self.config.largest - cable_tensions(*given, x[0], x[1], now.phase[0])


def test_a_cost_and_constraints_of_ones_own_with_a_signal_more():
    inputs = on_its_reference(1) | {"carrier_state": np.full(24, 0.5)}
    x, _ = updated(Light(model(), LightConfig(largest=10.0, **PAPER)), inputs)
    np.testing.assert_allclose(x, [2.5, 2.0], atol=1e-5)
    light = Light(model(), LightConfig(largest=2.8, **PAPER))
    context = light.CreateDefaultContext()
    x, _ = updated(light, inputs, context)
    tensions = cable_tensions(*arguments(inputs), *x, inputs["phase"][0])
    assert tensions.max() == pytest.approx(2.8, abs=1e-5)
    for _ in range(4):  # at the optimum nothing better is found, and x is kept
        again, told = updated(light, inputs, context)
    assert told.kept > 0 == told.held
    np.testing.assert_allclose(again, x, atol=1e-4)


@pytest.mark.parametrize(
    ("name", "function", "told"),
    [
        ("cost", lambda self, x, now: x, "2 numbers: return one number"),
        ("cost", lambda self, x, now: None, ".*compute numbers by arithmetic"),
        ("constraints", lambda self, x, now: [], "0 numbers: return an array"),
        ("constraints", lambda self, x, now: now.reference - x, ".*without branches"),
        ("constraints", lambda self, x, now: x >= 1.0, ".*without branches"),
        ("cost", lambda self, x, now: np.nan * x[0], r"not finite at xi = 2 rad/s"),
        ("constraints", lambda self, x, now: np.log(x - 5), "not finite at xi"),
    ],
)
def test_what_is_no_cost_or_constraint_is_said_in_a_sentence(name, function, told):
    wrong = type("Wrong", (NlpLayer,), {"__module__": __name__, name: function})
    with pytest.raises(ScenarioError, match=f"Wrong.{name} = {told}"):
        updated(wrong(model(), NlpLayerConfig(**PAPER)), on_its_reference(1))


class Banked(NlpLayer):
    """As fast as it may without a bank beyond a limit."""

    def cost(self, x, now):
        return (x[0] - 2.0) ** 2 + (x[1] - self.config.amplitude) ** 2

    def constraints(self, x, now):
        limits = AircraftLimits(max_bank=0.3)
        return flight_margins(self.model, limits, *self.prediction(x, now)[1:])


@pytest.mark.slow
def test_a_limit_of_the_bank_is_kept_on_a_level_circle():
    aircraft = AircraftParameters(model="rascal_110")
    own = model(aircraft=aircraft, cable_length=60.0, load_mass=6.0)
    config = NlpLayerConfig(frequency=0.3, amplitude=4.0, amplitude_bounds=[3.999, 4.001])
    weight, aircraft = own.load_mass * own.gravity, own.aircraft
    inputs = AT_REST | {"wrench": weight * np.eye(6)[5], "wind_estimate": np.zeros(3)}
    (xi, A), told = updated(Banked(own, config), inputs)
    assert told.solved == 1
    share = weight / own.n
    radius = A * (own.cable_length / np.hypot(A, share) + own.cable_compliance)
    sideways = aircraft.mass * xi**2 * radius - A  # the cable pulls inward, too
    bank = np.arctan(sideways / (aircraft.mass * aircraft.gravity + share))
    assert bank == pytest.approx(0.3, abs=1e-3)


def test_a_solver_that_this_drake_is_without_is_named(monkeypatch):
    monkeypatch.setattr(SnoptSolver, "available", lambda self: False)
    told = r"^optimization_layer.solver = snopt: this build of Drake is without it; give ipopt$"
    with pytest.raises(ScenarioError, match=told):
        PaperLayer(model())
