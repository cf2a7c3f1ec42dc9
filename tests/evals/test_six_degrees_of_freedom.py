"""JSBSim as the judge of the point masses: the shipped formations with six degrees of freedom."""

import runpy
from pathlib import Path

import pytest

from drake_nonstop import load_scenario, simulate

EXAMPLE = Path(__file__).parents[2] / "examples" / "six_degrees_of_freedom.py"
TURNS = {"rest": 23.0, "co-rotating": 32.0}  # s: two turns


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
