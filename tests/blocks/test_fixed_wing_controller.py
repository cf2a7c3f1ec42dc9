"""What Drake asks of the controller of aircraft."""

import numpy as np
import pytest
from helpers import fix, output
from pydrake.systems.analysis import Simulator

from drake_nonstop import load_scenario, make_nonstop
from drake_nonstop.systems.compiled_flight import sample_times
from drake_nonstop.systems.wiring import input_names


@pytest.mark.slow
@pytest.mark.parametrize("samples", [0, 1, 2, 15, 16])
def test_the_command_that_is_held_is_that_of_the_plan_at_its_own_sample(samples):
    """The observer, whose state steps at the sample, is left out."""
    settings = ["optimization_layer.knot_spacing=0.6", "carrier_controller.observer=0"]
    scenario = load_scenario("aircraft_transfer_rising_wind", settings)
    nonstop = make_nonstop(scenario)
    simulator = Simulator(nonstop)
    simulator.Initialize()
    simulator.AdvanceTo(sample_times(samples, scenario.control_period))
    simulator.AdvancePendingEvents()
    context = simulator.get_context()
    block = nonstop.GetSubsystemByName("carrier_controller")
    own = block.GetMyContextFromRoot(context)
    held = output(block, own, "aircraft_command")
    now = block.CreateDefaultContext()
    for name in input_names(block):
        signal = name.removeprefix("sampled_").removeprefix("held_")
        if nonstop.HasOutputPort(signal):
            fix(block, now, **{name: output(nonstop, context, signal)})
    computed = output(block, now, "aircraft_command")
    np.testing.assert_allclose(held, computed, rtol=1e-5)
