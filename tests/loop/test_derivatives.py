"""A loop's derivatives are those that differences of its flights show."""

import numpy as np
import pytest
from helpers import QuadraticDrag, nightly_beyond

from drake_nonstop import (
    CompiledLoop,
    ScenarioError,
    load_scenario,
    make_nonstop,
    with_largest_step,
)

CONSTANT = "optimization_layer=ConstantParameters"
SHOWN = ("load_state", "carrier_state")
COLUMNS = 16  # that are compared, of some 150


def loop_of(scenario, signals=(), **blocks):
    diagram = make_nonstop(scenario, **blocks)
    context = diagram.CreateDefaultContext()
    config = with_largest_step(scenario.simulator_config, diagram, context)
    options = {"signals": signals, "compiles": False}
    return CompiledLoop(diagram, config, scenario.control_period, **options), context


def flown(loop, context, samples, change):
    """The end, and the signals, of a flight whose states and parameters are changed at first."""
    flight = loop.fly(context)
    size = len(flight.state)
    flight.go_to(0, flight.state + change[:size])
    flight.set_parameters(slice(None), flight.parameters + change[size:])
    shown = [flight.start()[0]]
    while flight.samples < samples:
        shown.append(flight.advance(samples - flight.samples)[0])
    return flight.state, np.vstack(shown)[1:]


GUSTY = [CONSTANT, "wind=!GustyWind {gust: 0.3}", "system.load_drag=0.1"]
CASES = [
    ("quintic", [CONSTANT, "control_period=0.02", "simulated.load_mass=1.2"], SHOWN, 0.4),
    ("quintic", [*GUSTY, "simulated.load_mass=1.05"], SHOWN, 0.4),
    ("paper_line", [CONSTANT, "carrier_controller.integral_gain=1"], (), 1.0),
    ("aircraft_six", [CONSTANT], (), 1.0),
]


@pytest.mark.parametrize(
    ("name", "overrides", "signals", "duration"), nightly_beyond(1, "engines", CASES)
)
def test_they_are_those_of_central_differences(name, overrides, signals, duration, rng):
    loop, context = loop_of(load_scenario(name, overrides), signals)
    found = loop.sensitivities(context, duration)
    slopes = np.hstack([found.by_state, found.by_parameters])
    by_states, by_parameters = (
        np.concatenate([by[each] for each in signals], axis=1) if signals else np.zeros((0, 0, 0))
        for by in (found.signals_by_state, found.signals_by_parameters)
    )
    of_signals = np.concatenate([by_states, by_parameters], axis=2)
    sizes = len(found.state_names), len(found.parameter_names)
    assert slopes.shape == (sizes[0], sum(sizes))
    flight = loop.fly(context)
    start = np.concatenate([flight.state, flight.parameters])
    samples = round(duration / loop.control_period)
    expected, _ = flown(loop, context, samples, np.zeros(sum(sizes)))
    np.testing.assert_allclose(found.state, expected, rtol=1e-9, atol=1e-9)
    compared = 0
    for column in rng.permutation(sum(sizes))[:COLUMNS]:
        step = 3e-5 * max(1.0, abs(start[column]))
        change = step * np.eye(sum(sizes))[column]
        ends = [flown(loop, context, samples, sign * change) for sign in (1, -1, 2, -2)]
        for own, (one, other, far, farther) in zip(
            (slopes, of_signals), zip(*ends, strict=True), strict=True
        ):
            if own.size:
                # Fourth order: what is left is rounding.
                difference = (8 * (one - other) - (far - farther)) / (12 * step)
                largest = np.abs(difference).max()
                np.testing.assert_allclose(own[..., column], difference, atol=1e-6 * (1 + largest))
                compared += largest > 1e-3
    assert compared >= 3


def test_derivatives_that_there_are_not_are_refused():
    loop, context = loop_of(load_scenario("quintic", ["optimization_layer=NlpLayer"]))
    with pytest.raises(ScenarioError, match="optimization_layer = NlpLayer: its answers"):
        loop.sensitivities(context, 0.1)
    loop, context = loop_of(load_scenario("quintic", [CONSTANT]), load_disturbance=QuadraticDrag)
    with pytest.raises(ArithmeticError, match="derivatives, such as those of a norm at zero"):
        loop.sensitivities(context, 0.02)
