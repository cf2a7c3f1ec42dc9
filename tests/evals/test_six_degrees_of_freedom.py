"""JSBSim as the judge of the point masses: the shipped formations with six degrees of freedom."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from drake_nonstop import load_scenario, make_nonstop, simulate
from drake_nonstop.mechanics.aircraft import drawn_power
from drake_nonstop.mechanics.signals import AircraftState
from drake_nonstop.model.system import aircraft_in

EXAMPLE = Path(__file__).parents[2] / "examples" / "six_degrees_of_freedom"
TURNS = {"rest": 23.0, "co-rotating": 32.0}  # s: two turns


@pytest.fixture(scope="module")
def example():
    pytest.importorskip("jsbsim")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(EXAMPLE)
        yield importlib.import_module("fly")
        for name in ("fly", "jsbsim_carriers"):
            del sys.modules[name]


@pytest.mark.nightly("flights")
def test_rigid_aircraft_begin_as_the_point_masses_do_and_repeat_to_the_bit(example, fleet):
    """Over the first 2 s of the same hold."""
    scenario = load_scenario("aircraft_rest", ["simulation_duration=2"])
    rigid, again = (simulate(scenario, **example.PLANTS["JSBSim"]) for _ in range(2))
    mass, count, needs = fleet.run("aircraft_rest"), len(rigid.time), []
    for run in (rigid, mass):
        state = AircraftState.view(run.signal("aircraft_state")[:count])
        power = drawn_power(aircraft_in(run.scenario.system), state.thrust, state.airspeed)
        each = (state.lift, np.abs(state.bank), state.thrust, state.airspeed, power)
        needs.append([np.mean(need) for need in each])
    np.testing.assert_allclose(*needs, rtol=0.02)
    assert np.ptp(rigid.signal("carrier_state")[:, :12], axis=0).max() > 15  # m
    for name, part, within in (("carrier_state", slice(12), 0.06), ("load_state", [4, 5, 6], 0.03)):
        ways = [run.signal(name)[:count, part] for run in (rigid, mass)]
        np.testing.assert_allclose(*ways, rtol=0, atol=within)
        assert np.any(ways[0] != ways[1])
    for name in ("load_state", "carrier_state", "aircraft_state", "carrier_acceleration"):
        np.testing.assert_array_equal(rigid.signal(name), again.signal(name), name)


def test_between_steps_positions_are_smooth_and_velocities_are_their_rates(example):
    """Whatever is between two steps, central differences of positions are the velocities."""
    plant = example.JsbsimCarriers
    loop = make_nonstop(load_scenario("aircraft_rest"), carrier_dynamics=plant)
    block = loop.GetSubsystemByName("carrier_dynamics")
    context = block.CreateDefaultContext()
    rng = np.random.default_rng(3)
    step, (before, after) = 0.005, rng.normal(size=(2, 52))
    context.SetDiscreteState(np.concatenate([[1.0, 0.1], before, after]))

    def at(share):
        context.SetTime(0.1 + share * step)
        return block.GetOutputPort("carrier_state").Eval(context).copy()

    np.testing.assert_allclose(at(0.0), before[:24], atol=1e-9)
    np.testing.assert_allclose(at(1.0), after[:24], atol=1e-9)
    for share in (0.2, 0.5, 0.9):
        slope = (at(share + 1e-4) - at(share - 1e-4))[:12] / (2e-4 * step)
        np.testing.assert_allclose(slope, at(share)[12:], rtol=1e-6)


@pytest.mark.nightly("flights")
@pytest.mark.parametrize("name", TURNS)
def test_rigid_aircraft_need_what_the_point_masses_need(example, name):
    """Over the second turn in still air; the page has all of a longer flight."""
    scenario, changes = example.FLIGHTS[name]
    changed = load_scenario(scenario, [*changes, f"simulation_duration={TURNS[name]}"])
    mass, rigid = (
        example.measured(simulate(changed, **blocks)) for blocks in example.PLANTS.values()
    )
    for need in ("lift", "bank", "thrust", "power"):
        assert getattr(rigid, need) == pytest.approx(getattr(mass, need), rel=0.02), need
    assert rigid.largest_error < 0.05
