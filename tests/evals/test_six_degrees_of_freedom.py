"""JSBSim as the judge of the point masses: the shipped formations with six degrees of freedom."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from drake_nonstop import load_scenario, simulate
from drake_nonstop.mechanics.aircraft import drawn_power
from drake_nonstop.mechanics.signals import AircraftState
from drake_nonstop.model.system import aircraft_in

EXAMPLE = Path(__file__).parents[2] / "examples" / "six_degrees_of_freedom.py"
TURNS = {"rest": 23.0, "co-rotating": 32.0}  # s: two turns


def test_rigid_aircraft_begin_as_the_point_masses_do(fleet):
    """Over the first 2 s of the same hold."""
    pytest.importorskip("jsbsim")
    rigid, mass = fleet.run("rigid_aircraft"), fleet.run("aircraft_rest")
    count = len(rigid.time)
    needs = []
    for run in (rigid, mass):
        state = AircraftState.view(run.signal("aircraft_state")[:count])
        power = drawn_power(aircraft_in(run.scenario.system), state.thrust, state.airspeed)
        each = (state.lift, np.abs(state.bank), state.thrust, state.airspeed, power)
        needs.append([np.mean(need) for need in each])
    np.testing.assert_allclose(needs[0], needs[1], rtol=0.02)
    ways = [run.signal("carrier_state")[:count, :12] for run in (rigid, mass)]
    assert np.ptp(ways[0], axis=0).max() > 15  # m
    np.testing.assert_allclose(ways[0], ways[1], rtol=0, atol=0.06)
    loads = [run.signal("load_state")[:count, 4:7] for run in (rigid, mass)]
    np.testing.assert_allclose(loads[0], loads[1], rtol=0, atol=0.03)


@pytest.mark.nightly("flights")
@pytest.mark.parametrize("name", TURNS)
def test_rigid_aircraft_need_what_the_point_masses_need(name):
    """Over the second turn in still air; README has all of a longer flight."""
    pytest.importorskip("jsbsim")
    example = runpy.run_path(str(EXAMPLE))
    scenario, changes = example["FLIGHTS"][name]
    mass, rigid = (
        example["measured"](
            simulate(
                load_scenario(
                    scenario,
                    [*changes, f"simulation_duration={TURNS[name]}", f"carrier_dynamics={plant}"],
                )
            )
        )
        for plant in example["PLANTS"]
    )
    for need in ("lift", "bank", "thrust", "power"):
        assert getattr(rigid, need) == pytest.approx(getattr(mass, need), rel=0.02), need
    assert rigid.largest_error < 0.05
