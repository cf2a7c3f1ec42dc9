"""The layer of a cost and constraints of one's own, and what carriers do, to write them with."""

from dataclasses import dataclass

import numpy as np
import pytest
from helpers import fix, model, nightly_beyond, output
from nonstop_cases import (
    AT_REST,
    START,
    cables,
    moving,
    speed_bound_above,
)
from nonstop_cases import carrier_speeds as speeds_by_differences
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.symbolic import Evaluate, Expression, Variable

from drake_nonstop import (
    cable_tensions,
    carrier_distances,
    carrier_speeds,
    flight_margins,
)
from drake_nonstop.blocks.nlp_layer import NlpLayer, NlpLayerConfig
from drake_nonstop.blocks.paper_layer import PaperLayer, PaperLayerConfig
from drake_nonstop.mechanics.rigid_load import load_acceleration
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.planning.diagnostics import Diagnostics, Outcome
from drake_nonstop.planning.problem_config import AircraftLimits
from drake_nonstop.validation import ScenarioError

PAPER = {"orbit_points": 1, "look_ahead_time": 0.0, "tightening": 0.01}


def on_its_reference(seed):
    """Inputs of a load whose state is that of its reference."""
    inputs = moving(seed)
    return inputs | {"measured_load_state": inputs["reference"][:13]}


def arguments(inputs):
    return model(), inputs["reference"], inputs["wrench"], inputs["wrench_rate"]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_carriers_do_is_that_of_first_principles(seed):
    inputs, x = on_its_reference(seed), START + np.array([0.3, -0.2])
    given = (*arguments(inputs), *x, inputs["phase"][0])
    positions, tensions = cables(x, inputs)
    apart = [np.linalg.norm(positions[i] - positions[j]) for i in range(4) for j in range(i + 1, 4)]
    np.testing.assert_allclose(carrier_speeds(*given), speeds_by_differences(x, inputs), rtol=1e-7)
    np.testing.assert_allclose(cable_tensions(*given), tensions[:, 0], rtol=1e-12)
    np.testing.assert_allclose(carrier_distances(*given), apart, rtol=1e-12)


@pytest.mark.parametrize("quantity", [carrier_speeds, cable_tensions, carrier_distances])
def test_they_are_the_same_of_all_scalar_types_and_of_several_phases(quantity):
    inputs, phases = on_its_reference(4), np.array([0.2, 1.7])
    given = arguments(inputs)
    expected = np.stack([quantity(*given, *START, phase) for phase in phases])
    np.testing.assert_allclose(quantity(*given, *START, phases), expected, rtol=1e-14)
    x = InitializeAutoDiff(START)[:, 0]
    found = quantity(*given, *x, 1.7)
    np.testing.assert_allclose(ExtractValue(found)[:, 0], expected[1], rtol=1e-14)
    step = 1e-6 * np.eye(2)
    by_steps = [
        (quantity(*given, *(START + h), 1.7) - quantity(*given, *(START - h), 1.7)) / 2e-6
        for h in step
    ]
    np.testing.assert_allclose(ExtractGradient(found).T, by_steps, atol=1e-8)
    xi, amplitude = Variable("xi"), Variable("amplitude")
    with np.errstate(invalid="ignore"):  # Expression raises the flag without a cause
        symbols = quantity(*given, Expression(xi), Expression(amplitude), 1.7)
    values = Evaluate(symbols, {xi: START[0], amplitude: START[1]})
    np.testing.assert_allclose(values[:, 0], expected[1], rtol=1e-12)


def answered(block, inputs):
    """What a layer shows after an update."""
    context = block.CreateDefaultContext()
    fix(block, context, **inputs)
    context.SetDiscreteState(block.answer(context))
    diagnostics = Diagnostics.view(output(block, context, "diagnostics"))
    return output(block, context, "parameters"), diagnostics


def updated(kind, inputs, **fields):
    """What a layer that begins with `START` shows after an update."""
    return answered(kind(model(), NlpLayerConfig(**fields)), inputs)


@pytest.mark.parametrize("solver", ["snopt", "ipopt"])
@pytest.mark.parametrize("seed", [1, 5])
def test_at_one_phase_of_a_load_on_its_reference_it_is_the_paper_s_layer(seed, solver):
    inputs = on_its_reference(seed)
    bound = speed_bound_above(inputs, 0.1)
    given = {"speed_bound": bound, "solver": solver}
    paper = PaperLayer(model(), PaperLayerConfig(tightening=0.01, **given))
    expected, _ = answered(paper, inputs)
    parameters, told = updated(NlpLayer, inputs, **given, **PAPER)
    assert (told.outcome, told.updates, told.solved) == (Outcome.SOLVED, 1, 1)
    # The wrench accelerates the load otherwise than the reference, which speeds do not feel.
    np.testing.assert_allclose(parameters, expected, atol=2e-4)
    assert told.speed_margin == pytest.approx(0.01 * bound, abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("ahead", nightly_beyond(1, "studies", [0.05, 0.0]))
def test_along_the_orbit_it_keeps_every_carrier_above_the_bound_of_first_principles(ahead):
    inputs = on_its_reference(2)
    motion = load_acceleration(model().load, inputs["reference"][:13], inputs["wrench"])
    inputs["reference"][13:19] = np.concatenate(motion)
    bound = speed_bound_above(inputs, 0.2)
    fields = {"orbit_points": 64, "look_ahead_time": ahead, "tightening": 0.01}
    parameters, told = updated(NlpLayer, inputs, speed_bound=bound, **fields)
    assert told.outcome == Outcome.SOLVED
    slowest = min(
        speeds_by_differences(parameters, inputs | {"phase": np.array([theta, 0.0])}, ahead).min()
        for theta in np.linspace(0, 2 * np.pi, 60)
    )
    assert slowest == pytest.approx(1.01 * bound, rel=4e-3)


class Impossible(NlpLayer):
    """No x is fast enough."""

    def constraints(self, x, now):
        return self.predicted_speeds(x, now) - 1e3


def test_where_nothing_keeps_the_constraints_the_last_parameters_stay_and_are_counted():
    parameters, told = updated(Impossible, on_its_reference(1), **PAPER)
    np.testing.assert_array_equal(parameters, START)
    assert (told.outcome, told.held, told.solved) == (Outcome.HELD, 1, 0)


@dataclass(kw_only=True)
class LightConfig(NlpLayerConfig):
    """A field of its own."""

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
    x, _ = answered(Light(model(), LightConfig(largest=10.0, **PAPER)), inputs)
    np.testing.assert_allclose(x, [2.5, 2.0], atol=1e-5)
    x, _ = answered(Light(model(), LightConfig(largest=2.8, **PAPER)), inputs)
    tensions = cable_tensions(*arguments(inputs), *x, inputs["phase"][0])
    assert tensions.max() == pytest.approx(2.8, abs=1e-5)


def member(name, function):
    return type("Wrong", (NlpLayer,), {"__module__": __name__, name: function})


@pytest.mark.parametrize(
    ("name", "function", "said"),
    [
        ("cost", lambda self, x, now: x, r"Wrong.cost = 2 numbers: return one number"),
        ("cost", lambda self, x, now: None, r"Wrong.cost = .*compute numbers by arithmetic"),
        ("constraints", lambda self, x, now: [], r"Wrong.constraints = 0 numbers: return an array"),
        (
            "constraints",
            lambda self, x, now: now.reference - x,
            "without branches",
        ),
        ("constraints", lambda self, x, now: x >= 1.0, "without branches"),
        ("cost", lambda self, x, now: np.nan * x[0], r"Wrong.cost = not finite at xi = 2 rad/s"),
        ("constraints", lambda self, x, now: np.log(x - 5), "Wrong.constraints = not finite at xi"),
    ],
)
def test_what_is_no_cost_or_constraint_is_said_in_a_sentence(name, function, said):
    with pytest.raises(ScenarioError, match=said):
        updated(member(name, function), on_its_reference(1), **PAPER)


def model_of_aircraft():
    own = AircraftParameters(model="rascal_110")
    return model(aircraft=own, cable_length=60.0, load_mass=6.0)


class Banked(NlpLayer):
    """As fast as it may without a bank beyond a limit."""

    def cost(self, x, now):
        return (x[0] - 2.0) ** 2 + (x[1] - self.config.amplitude) ** 2

    def constraints(self, x, now):
        limits = AircraftLimits(max_bank=0.3)
        return flight_margins(self.model, limits, *self.prediction(x, now)[1:])


@pytest.mark.slow
def test_a_limit_of_the_bank_is_kept_on_a_level_circle():
    own = model_of_aircraft()
    config = NlpLayerConfig(frequency=0.3, amplitude=4.0, amplitude_bounds=[3.999, 4.001])
    weight = own.load_mass * own.gravity
    inputs = AT_REST | {"wrench": weight * np.eye(6)[5], "wind_estimate": np.zeros(3)}
    (xi, A), told = answered(Banked(own, config), inputs)
    assert told.outcome == Outcome.SOLVED
    share, aircraft = weight / own.n, own.aircraft
    tension = np.hypot(A, share)
    radius = A * (own.cable_length / tension + own.cable_compliance)
    sideways = aircraft.mass * xi**2 * radius - A  # the cable pulls inward, too
    bank = np.arctan(sideways / (aircraft.mass * aircraft.gravity + share))
    assert bank == pytest.approx(0.3, abs=1e-3)
