"""The numbers of the Floquet analysis."""

import numpy as np
import pytest
from helpers import nightly_beyond
from pydrake.systems.analysis import ApplySimulatorConfig, InitializeParams, Simulator

from drake_nonstop import load_scenario
from drake_nonstop.analysis import stability
from drake_nonstop.analysis.stability import at_rest, linearize, map_of_turn
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.loop.step import with_largest_step
from drake_nonstop.systems.block import set_state_values, state_values
from drake_nonstop.systems.compiled_loop import CompiledLoop
from drake_nonstop.validation import ScenarioError

FINE = ["simulator_config.max_step_size=0.0004"]  # 25 steps in a sample
CASES = [("quintic", ["simulated.load_mass=1.1"]), ("three_carriers", FINE)]


@pytest.mark.parametrize(("name", "overrides"), nightly_beyond(1, "studies", CASES))
def test_the_map_of_a_sample_is_that_of_differences(name, overrides):
    scenario = at_rest(load_scenario(name, overrides))
    nonstop = make_nonstop(scenario)
    context = nonstop.CreateDefaultContext()
    config = with_largest_step(scenario.simulator_config, nonstop, context)
    loop = CompiledLoop(nonstop, config, scenario.control_period, signals=(), compiles=False)
    flight = loop.fly(context)
    flight.fly(2)
    exact = flight.map_jacobian()

    simulator = Simulator(nonstop, context.Clone())
    ApplySimulatorConfig(config, simulator)
    simulator.Initialize()
    simulator.AdvanceTo(2 * scenario.control_period)
    flown = simulator.get_mutable_context()
    at = flown.Clone()
    block = nonstop.GetSubsystemByName("carrier_dynamics")
    places = stability._places(nonstop, loop)
    own = places["carrier_dynamics"]

    def advanced(change):
        flown.SetTimeStateAndParametersFrom(at)
        mine = nonstop.GetMutableSubsystemContext(block, flown)
        set_state_values(mine, state_values(mine) + change)
        simulator.Initialize(InitializeParams(suppress_initialization_events=True))
        simulator.AdvanceTo(3 * scenario.control_period)
        return state_values(nonstop.GetMutableSubsystemContext(block, flown))

    steps = 1e-6 * np.eye(len(own))
    differenced = [(advanced(step) - advanced(-step)) / 2e-6 for step in steps]
    np.testing.assert_allclose(exact[np.ix_(own, own)].T, differenced, rtol=1e-5, atol=1e-6)


def test_the_height_of_aircraft_decays_as_its_correction_says():
    """A load that follows its carriers, whose references move slowly: exp(-0.03 T)."""
    found = linearize(load_scenario("aircraft_rest"))
    assert found.largest < 0.95
    is_real = np.abs(found.multipliers.imag) < 1e-6
    (height,) = (m.real for m in found.multipliers[is_real] if 0.6 < m.real < 0.8)
    assert height == pytest.approx(np.exp(-0.03 * found.period), rel=3e-3)


def test_the_map_of_a_turn_is_the_product_of_the_interpolated_ones():
    phases = 2 * np.pi * np.arange(60) / 60
    maps = np.array([[[1.0, 0.01], [-0.02 * (1 + 0.5 * np.cos(p)), 0.99]] for p in phases])
    whole = np.linalg.multi_dot(maps[::-1])
    np.testing.assert_allclose(map_of_turn(maps[::4], 60), whole, rtol=1e-12)


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
