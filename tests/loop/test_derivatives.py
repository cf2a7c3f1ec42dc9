"""A loop's derivatives are those that differences of its flights show."""

import numpy as np
import pytest
from helpers import QuadraticDrag, nightly_beyond

from drake_nonstop import (
    CompiledLoop,
    ScenarioError,
    load_scenario,
    make_nonstop,
)
from drake_nonstop.loop.step import with_largest_step
from drake_nonstop.systems.tracing import NotFiniteError

CONSTANT = "optimization_layer=ConstantParameters"
COLUMNS = 16  # that are compared, of some 150


def loop_of(scenario):
    diagram = make_nonstop(scenario)
    context = diagram.CreateDefaultContext()
    config = with_largest_step(scenario.simulator_config, diagram, context)
    options = {"signals": (), "compiles": False}
    return CompiledLoop(diagram, config, scenario.control_period, **options), context


def state_after(loop, context, samples, change):
    """Of a flight whose states and parameters are changed at the start."""
    flight = loop.fly(context)
    size = len(flight.state)
    flight._state = flight._state + change[:size]
    flight._parameters = flight._parameters + change[size:]
    flight.start()
    while flight.samples < samples:
        flight.advance(samples - flight.samples)
    return flight.state


GUSTY = [CONSTANT, "wind=!GustyWind {gust: 0.3}", "system.load_drag=0.1"]
CASES = [
    ("quintic", GUSTY, 0.4),
    ("quintic", GUSTY, 1.0),
    ("quintic", [CONSTANT], 1.0),
    ("quintic", [CONSTANT, "control_period=0.02", "simulated.load_mass=1.2"], 1.0),
    ("paper_line", [CONSTANT, "carrier_controller.integral_gain=1"], 1.0),
    ("aircraft_six", [CONSTANT], 1.0),
]


@pytest.mark.parametrize(("name", "overrides", "duration"), nightly_beyond(1, "engines", CASES))
def test_they_are_those_of_central_differences(name, overrides, duration, rng):
    loop, context = loop_of(load_scenario(name, overrides))
    found = loop.sensitivities(context, duration)
    slopes = np.hstack([found.by_state, found.by_parameters])
    sizes = len(found.state_names), len(found.parameter_names)
    assert slopes.shape == (sizes[0], sum(sizes))
    flight = loop.fly(context)
    start = np.concatenate([flight.state, flight.parameters])
    samples = round(duration / loop.control_period)
    expected = state_after(loop, context, samples, np.zeros(sum(sizes)))
    np.testing.assert_allclose(found.state, expected, rtol=1e-9, atol=1e-9)
    compared = 0
    for column in rng.permutation(sum(sizes))[:COLUMNS]:
        step = 3e-5 * max(1.0, abs(start[column]))
        change = step * np.eye(sum(sizes))[column]
        ends = [state_after(loop, context, samples, sign * change) for sign in (1, -1, 2, -2)]
        # Fourth order: what is left is rounding.
        difference = (8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12 * step)
        largest = np.abs(difference).max()
        np.testing.assert_allclose(slopes[:, column], difference, atol=1e-6 * (1 + largest))
        compared += largest > 1e-3
    assert compared >= 3


def test_signals_and_metrics_have_the_gradients_of_differences():
    """By states and parameters, along the flight; the chain rule gives those of any metric."""
    scenario = load_scenario("quintic", [*GUSTY, "wrench_controller.position_integral_gain=0"])
    diagram = make_nonstop(scenario)
    context, duration = diagram.CreateDefaultContext(), 0.2
    names = ["load_state", "carrier_state"]
    options = {"signals": names, "compiles": False}
    loop = CompiledLoop(diagram, scenario.simulator_config, scenario.control_period, **options)
    found = loop.sensitivities(context, duration)
    samples = round(duration / loop.control_period)
    states, parameters = len(found.state_names), len(found.parameter_names)
    for name in names:
        size = loop.signals[name]
        assert found.signals[name].shape == (samples, size)
        assert found.signals_by_state[name].shape == (samples, size, states)
        assert found.signals_by_parameters[name].shape == (samples, size, parameters)

    def shown(change):
        flight = loop.fly(context)
        flight._state = flight._state + change[:states]
        flight._parameters = flight._parameters + change[states:]
        rows = flight.fly(samples)[1:]
        return {"load_state": rows[:, :13], "carrier_state": rows[:, 13:]}

    start = loop.fly(context)
    values = np.concatenate([start.state, start.parameters])
    box = "carrier_controller.position_gain", "wrench_controller.velocity_gain"
    columns = [states + found.parameter_names.index(name) for name in box]
    columns += [k for k, name in enumerate(found.state_names) if name == "load_plant[6]"]
    columns += [states + k for k, name in enumerate(found.parameter_names) if "load_mass" in name]
    assert len(columns) >= 4

    def metric(signals):
        """The mean square of the load's distance from the origin, m²."""
        return np.mean(np.sum(signals["load_state"][:, 4:7] ** 2, axis=1))

    by_row = np.zeros_like(found.signals["load_state"])
    by_row[:, 4:7] = 2 * found.signals["load_state"][:, 4:7] / samples
    by_all = [found.signals_by_state["load_state"], found.signals_by_parameters["load_state"]]
    gradient = np.tensordot(by_row, np.concatenate(by_all, axis=2), 2)
    for column in columns:
        step = 3e-5 * max(1.0, abs(values[column]))
        change = step * np.eye(states + parameters)[column]
        ends = [shown(sign * change) for sign in (1, -1, 2, -2)]
        for name in names:
            one, other, far, farther = (end[name] for end in ends)
            expected = (8 * (one - other) - (far - farther)) / (12 * step)
            by = [found.signals_by_state[name], found.signals_by_parameters[name]]
            slopes = np.concatenate(by, axis=2)[:, :, column]
            np.testing.assert_allclose(slopes, expected, atol=1e-6 * (1 + np.abs(expected).max()))
        one, other, far, farther = map(metric, ends)
        expected = (8 * (one - other) - (far - farther)) / (12 * step)
        assert gradient[column] == pytest.approx(expected, rel=1e-6, abs=1e-7)


def test_a_layer_that_searches_is_named():
    loop, context = loop_of(load_scenario("quintic", ["optimization_layer=NlpLayer"]))
    with pytest.raises(ScenarioError, match="optimization_layer = NlpLayer: its answers"):
        loop.sensitivities(context, 0.1)


def test_derivatives_that_are_no_numbers_are_refused():
    diagram = make_nonstop(load_scenario("quintic", [CONSTANT]), load_disturbance=QuadraticDrag)
    context = diagram.CreateDefaultContext()
    scenario = load_scenario("quintic", [CONSTANT])
    loop = CompiledLoop(diagram, scenario.simulator_config, 0.01, signals=(), compiles=False)
    with pytest.raises(NotFiniteError, match="derivatives, such as those of a norm at zero"):
        loop.sensitivities(context, 0.02)
