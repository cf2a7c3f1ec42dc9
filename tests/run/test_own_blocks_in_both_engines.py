"""Blocks of a user's own fly the same in both engines, or the compiled one names them."""

import numpy as np
import pytest
from drawn_own_blocks import compare
from helpers import nightly_beyond
from pydrake.systems.framework import LeafSystem

from drake_nonstop import ScenarioError, load_scenario
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.systems.compiled_loop import CompiledLoop

# A continuous state that starts by others; a sampled one, of two samples; no multiple; plain.
SHOWN_BY_DAY = [6, 14, 2, 4]


@pytest.mark.parametrize(
    "seed", nightly_beyond(4, "engines", dict.fromkeys([*SHOWN_BY_DAY, *range(112)]))
)
def test_drawn_blocks_fly_the_same_or_are_named(seed):
    difference, told = compare(seed)
    assert difference < 1e-9, told
    assert (told == "") == (seed in (6, 14)) or seed not in SHOWN_BY_DAY
    assert told == "" or told.endswith("the diagram is simulated instead")


class Own(LeafSystem):
    """A layer that is sampled, as it says, with updates of a period and an offset in s."""

    is_sampled = True

    def __init__(self, period, offset):
        super().__init__()
        self.DeclareVectorInputPort("reference", 22)
        self.DeclareStateOutputPort("parameters", self.DeclareDiscreteState([2.0, 1.2]))
        self.DeclarePeriodicDiscreteUpdateEvent(period, offset, self.update)

    def update(self, context, state):
        reference = self.GetInputPort("reference").Eval(context)
        frequency = 2.0 + 0.2 * np.sin(7 * context.get_time()) + reference[10]
        state.set_value([frequency, 1.2 + 0.1 * reference[4]])


def test_a_compiled_loop_of_ones_own_is_refused_with_the_remedy():
    """Without `simulate` nothing flies the diagram instead."""
    scenario = load_scenario("quintic")
    diagram = make_nonstop(
        scenario, at_equilibrium=False, optimization_layer=lambda model: Own(0.01, 0.01)
    )
    with pytest.raises(ScenarioError, match=r"^optimization_layer = Own: it has no equations; a"):
        CompiledLoop(diagram, scenario.simulator_config, 0.01)
