"""The numbers of the Floquet analysis."""

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.systems.analysis import ApplySimulatorConfig, InitializeParams, Simulator

from drake_nonstop import (
    CompiledLoop,
    ScenarioError,
    linearize,
    load_scenario,
    make_nonstop,
    with_largest_step,
)
from drake_nonstop.analysis.stability import map_of_turn

RESTING = [
    "load_trajectory=!RestToRest {displacement: [0, 0, 0]}",
    *("optimization_layer=ConstantParameters", "phase=AccumulatedPhase"),
]
FINE = ["simulator_config.max_step_size=0.0004"]  # 25 steps in a sample
CASES = [("quintic", ["simulated.load_mass=1.1"]), ("three_carriers", FINE)]


@pytest.mark.parametrize(("name", "overrides"), nightly_beyond(1, "studies", CASES))
def test_the_map_of_a_sample_is_that_of_differences(name, overrides):
    scenario = load_scenario(name, [*RESTING, *overrides])
    nonstop, period = make_nonstop(scenario), scenario.control_period
    context = nonstop.CreateDefaultContext()
    config = with_largest_step(scenario.simulator_config, nonstop, context)
    loop = CompiledLoop(nonstop, config, period, signals=(), compiles=False)
    flight = loop.fly(context)
    flight.fly(2)
    own = [k for k, state in enumerate(loop.state_names) if "carrier_dynamics[" in state]
    exact = flight.map_jacobian()[np.ix_(own, own)]

    simulator = Simulator(nonstop, context.Clone())
    ApplySimulatorConfig(config, simulator)
    simulator.Initialize()
    simulator.AdvanceTo(2 * period)
    flown = simulator.get_mutable_context()
    at, block = flown.Clone(), nonstop.GetSubsystemByName("carrier_dynamics")

    def advanced(change):
        flown.SetTimeStateAndParametersFrom(at)
        mine = nonstop.GetMutableSubsystemContext(block, flown)
        mine.SetContinuousState(mine.get_continuous_state_vector().CopyToVector() + change)
        simulator.Initialize(InitializeParams(suppress_initialization_events=True))
        simulator.AdvanceTo(3 * period)
        return mine.get_continuous_state_vector().CopyToVector()

    steps = 1e-6 * np.eye(len(own))
    differenced = [(advanced(step) - advanced(-step)) / 2e-6 for step in steps]
    np.testing.assert_allclose(exact.T, differenced, rtol=1e-5, atol=1e-6)


def test_the_map_of_a_turn_is_the_product_of_the_interpolated_ones():
    phases = 2 * np.pi * np.arange(60) / 60
    maps = np.array([[[1.0, 0.01], [-0.02 * (1 + 0.5 * np.cos(p)), 0.99]] for p in phases])
    whole = np.linalg.multi_dot(maps[::-1])
    np.testing.assert_allclose(map_of_turn(maps[::4], 60), whole, rtol=1e-12)


@pytest.mark.nightly("studies")
def test_the_height_of_aircraft_decays_as_its_correction_says():
    """A load that follows its carriers: the slow root of s^2 + s + 0.05, of low-pass and rate."""
    found = linearize(load_scenario("aircraft_rest"))
    assert found.largest < 0.95
    is_real = np.abs(found.multipliers.imag) < 1e-6
    expected = np.exp(-(1 - np.sqrt(1 - 4 * 0.05)) / 2 * found.period)
    real = found.multipliers[is_real].real
    assert real[np.argmin(np.abs(real - expected))] == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize(
    ("name", "overrides", "said"),
    [
        ("quintic", ["control_period=0"], "control_period = 0"),
        ("aircraft_co_rotating", [], "SteadyTurn"),
    ],
)
def test_what_cannot_be_linearized_is_told(name, overrides, said):
    with pytest.raises(ScenarioError, match=said):
        linearize(load_scenario(name, overrides))
