"""The layer of a load that turns with its aircraft, alone and in its loop."""

import warnings

import numpy as np
import pytest
from helpers import difference
from pydrake.systems.analysis import Simulator

from drake_nonstop import load_scenario, make_nonstop
from drake_nonstop.blocks.load_trajectory import PlannedTurn, PlannedTurnConfig
from drake_nonstop.model.system import Model

LAYER = "optimization_layer=!TurnRateOptimizer {speed_bound: 1.8 V_s, max_frequency_rate: 0.1}"
TURN = "load_trajectory=!PlannedTurn {displacement: [5.0, 0.0, 0.0], move_time: 20.0}"
SHAPED = "phase=!ShapedPhase {bandwidth: 4.0}"


def turning_model():
    scenario = load_scenario("aircraft_co_rotating")
    return Model(scenario.system, scenario.pattern, scenario.control_period)


@pytest.mark.slow
def test_in_its_loop_the_load_turns_as_fast_as_the_bound_asks_for():
    """From 0.4 rad/s on, in 5 m/s of wind, to what keeps 1.8 of the stall speed."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loop = make_nonstop(load_scenario("aircraft_co_rotating", [LAYER, TURN, SHAPED]))
    simulator = Simulator(loop)
    simulator.AdvanceTo(6.0)
    context = simulator.get_context()
    bound, (rate, amplitude) = (
        loop.GetOutputPort(name).Eval(context) for name in ("speed_bound", "parameters")
    )
    assert amplitude == 0
    assert rate > 0.41
    outcome, updates, kept, solved, *_ = loop.GetOutputPort("diagnostics").Eval(context)
    assert outcome == 1
    assert kept + solved > 0.9 * updates
    turning = loop.GetOutputPort("load_state").Eval(context)[9]
    assert turning == pytest.approx(rate, rel=0.03)
    shown = loop.GetOutputPort("aircraft_state").Eval(context).reshape(4, -1)
    assert shown[3].min() > bound[0]
    assert shown[0].max() < 0.9 * 1.4


def test_the_planned_turn_has_the_rates_of_its_pose():
    block = PlannedTurn(
        turning_model(), PlannedTurnConfig(displacement=[3.0, 1.0, 0.0], move_time=4.0)
    )
    jerk = 0.2

    def references(time):
        """Of a phase with a constant ξ̈."""
        context = block.CreateDefaultContext()
        context.SetTime(time)
        angle = 0.4 * time + 0.1 * time**2 / 2 + jerk * time**3 / 6
        rates = [0.4 + 0.1 * time + jerk * time**2 / 2, 0.1 + jerk * time, jerk]
        planned = [angle, rates[0], 0.0, rates[1], 0.0, rates[2], 0.0, 0.0]
        block.GetInputPort("planned").FixValue(context, planned)
        names = ("reference", "reference_higher_rates")
        return [block.GetOutputPort(name).Eval(context).copy() for name in names]

    now, higher = references(1.3)
    assert 2 * np.arctan2(now[3], now[0]) == pytest.approx(0.52 + 0.0845 + jerk * 1.3**3 / 6)
    for rate, of in ((slice(10, 13), slice(4, 7)), (slice(13, 16), slice(7, 10))):
        expected = difference(lambda t, of=of: references(t)[0][of], 1.3)
        np.testing.assert_allclose(now[rate], expected, atol=1e-8)
    np.testing.assert_allclose(
        higher[:3], difference(lambda t: references(t)[0][13:16], 1.3), atol=1e-8
    )
