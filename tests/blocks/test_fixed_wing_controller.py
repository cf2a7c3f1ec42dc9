"""What Drake asks of the controller of aircraft."""

import numpy as np
import pytest
from helpers import fix, output, sizes_of_ports
from pydrake.systems.analysis import Simulator

from drake_nonstop import load_scenario, make_nonstop


@pytest.mark.slow
@pytest.mark.parametrize("samples", [0, 1, 2, 15, 16])
def test_the_command_that_is_held_is_that_of_the_plan_at_its_own_sample(samples):
    """The observer, whose state steps at the sample, is left out."""
    settings = ["optimization_layer.knot_spacing=0.6", "carrier_controller.observer=0"]
    scenario = load_scenario("aircraft_transfer_rising_wind", settings)
    nonstop = make_nonstop(scenario)
    simulator = Simulator(nonstop)
    simulator.Initialize()
    period = scenario.control_period
    simulator.AdvanceTo((samples > 0) * (period + (samples - 1) * period))  # as Drake rounds it
    simulator.AdvancePendingEvents()
    context = simulator.get_context()
    block = nonstop.GetSubsystemByName("carrier_controller")
    held = output(block, block.GetMyContextFromRoot(context), "aircraft_command")
    now = block.CreateDefaultContext()
    for name in sizes_of_ports(block, "input"):
        signal = name.removeprefix("sampled_").removeprefix("held_")
        if nonstop.HasOutputPort(signal):
            fix(block, now, **{name: output(nonstop, context, signal)})
    np.testing.assert_allclose(held, output(block, now, "aircraft_command"), rtol=1e-5)
