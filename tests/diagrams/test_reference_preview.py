"""The abstract signal `reference_preview` in a loop."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem

from drake_nonstop import ReferencePreview, load_scenario, make_nonstop
from drake_nonstop.systems import wiring
from drake_nonstop.systems.block import LeafBlock

CONSTANT = "optimization_layer=ConstantParameters"
AHEAD = 2.0  # s


class Ahead(LeafBlock):
    """Makes the reference that comes in 2 s, where there is a preview."""

    optional_inputs = ("reference_preview",)

    def __init__(self, model):
        super().__init__()
        self._preview = self.DeclareAbstractInputPort("reference_preview", Value[object]())
        self.DeclareVectorOutputPort("ahead", 22, self._calc)

    def _calc(self, context, output):
        output.SetFromVector(self._preview.Eval(context)(context.get_time() + AHEAD))


class OwnTrajectory(LeafSystem):
    """A load at rest, with an own preview or none."""

    def __init__(self, preview=None):
        super().__init__()
        rest = np.eye(22)[0]
        self.DeclareVectorOutputPort("reference", 22, lambda c, output: output.SetFromVector(rest))
        if preview is not None:
            self.DeclareAbstractOutputPort(
                "reference_preview",
                lambda: Value(preview),
                lambda c, output: output.set_value(preview),
            )


@pytest.mark.parametrize("period", [0.0, 0.01])
def test_a_block_reads_it_from_the_trajectory_and_not_held(period):
    scenario = load_scenario("quintic", [CONSTANT, f"control_period={period}"])
    loop = make_nonstop(scenario, extra={"foresight": Ahead})
    wires = wiring.connections(loop)
    assert "load_trajectory.reference_preview -> foresight.reference_preview" in wires
    assert not any("held_reference_preview" in wire for wire in wires)
    simulator = Simulator(loop)
    simulator.AdvanceTo(0.5)
    context = simulator.get_context()
    ahead = loop.GetOutputPort("ahead").Eval(context).copy()
    later = loop.CreateDefaultContext()
    later.SetTime(0.5 + AHEAD)
    np.testing.assert_array_equal(ahead, loop.GetOutputPort("reference").Eval(later))


def at_rest(time):
    return np.eye(22)[0]


def test_it_can_come_from_outside():
    loop = make_nonstop(
        load_scenario("quintic", [CONSTANT]),
        load_trajectory=lambda model: OwnTrajectory(),
        extra={"foresight": Ahead},
        inputs=["reference_preview"],
        at_equilibrium=False,
    )
    assert wiring.input_sizes(loop) == {"reference_preview": None}
    context = loop.CreateDefaultContext()
    loop.GetInputPort("reference_preview").FixValue(context, ReferencePreview(at_rest))
    np.testing.assert_array_equal(loop.GetOutputPort("ahead").Eval(context), at_rest(0))
