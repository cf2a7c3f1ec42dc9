"""What Drake asks of the controller of aircraft."""

import pytest
from helpers import model
from pydrake.systems.framework import Diagram

from drake_nonstop import ScenarioError, load_scenario, make_nonstop
from drake_nonstop.blocks.fixed_wing_controller import FixedWingController
from drake_nonstop.model.aircraft import AircraftParameters
from drake_nonstop.systems.block import LeafBlock


def leaves(system):
    if not isinstance(system, Diagram):
        return [system]
    return [leaf for part in system.GetSystems() for leaf in leaves(part)]


@pytest.mark.parametrize(("period", "asked"), [(0.0, ["observer"]), (0.04, [])])
def test_only_an_integrated_observer_is_asked_for_rates(period, asked):
    """An override is called at each evaluation of the loop's rates, also where there are none."""
    aircraft = AircraftParameters(model="rascal_110")
    given = model(3, aircraft=aircraft, cable_length=150.0, control_period=period)
    own = [leaf for leaf in leaves(FixedWingController(given)) if isinstance(leaf, LeafBlock)]
    assert len(own) > 1
    plain = LeafBlock.DoCalcTimeDerivatives
    overriding = [leaf for leaf in own if type(leaf).DoCalcTimeDerivatives is not plain]
    assert [leaf.get_name() for leaf in overriding] == asked


@pytest.mark.parametrize(
    ("field", "value"), [("lift_share", 1.01), ("lift_share", 0), ("max_bank", 1.6), ("lead", -1)]
)
def test_a_field_out_of_its_range_is_refused(field, value):
    scenario = load_scenario("aircraft_rest", [f"carrier_controller.{field}={value}"])
    with pytest.raises(ScenarioError, match=rf"^carrier_controller.{field} = {value}"):
        make_nonstop(scenario, at_equilibrium=False)
