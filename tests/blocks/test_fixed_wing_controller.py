"""What Drake asks of the controller of aircraft."""

import numpy as np
import pytest
from helpers import model
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram

from drake_nonstop import ScenarioError, load_scenario, make_nonstop
from drake_nonstop.blocks.fixed_wing_controller import FixedWingController
from drake_nonstop.loop.block_events import sample_times
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


@pytest.mark.parametrize("samples", [0, 1, 2, 15, 16])
def test_the_command_that_is_held_is_that_of_the_plan_at_its_own_sample(samples):
    """To the little by which the integral of the wrench changes at a sample, too.

    The observer, which does as well, is left out. With the plan of the sample before a command was
    off by up to 12 N.
    """
    settings = ["optimization_layer.knot_spacing=0.6", "carrier_controller.observer=0"]
    scenario = load_scenario("aircraft_transfer_rising_wind", settings)
    nonstop = make_nonstop(scenario)
    simulator = Simulator(nonstop)
    simulator.Initialize()
    simulator.AdvanceTo(sample_times(samples, scenario.control_period))
    simulator.AdvancePendingEvents()
    context = simulator.get_context()
    block = nonstop.GetSubsystemByName("carrier_controller")
    law = block.GetSubsystemByName("law")
    held, computed = (
        part.GetOutputPort("aircraft_command").Eval(part.GetMyContextFromRoot(context))
        for part in (block, law)
    )
    np.testing.assert_allclose(held, computed, rtol=1e-5)
