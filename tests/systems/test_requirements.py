"""What blocks of a loop say of each other."""

import pytest
from pydrake.systems.framework import LeafSystem

from drake_nonstop.blocks.load_disturbance import NoDisturbance
from drake_nonstop.diagrams.nonstop import make_nonstop
from drake_nonstop.scenario.schema import Scenario
from drake_nonstop.systems.requirements import LoopBlocks
from drake_nonstop.validation import ScenarioError, ScenarioWarning


class Careful(NoDisturbance):
    """Wants a load of 2 kg, and tells of all cables."""

    def requires(self, loop):
        if loop.simulated.load_mass < 2:
            raise ScenarioError(f"simulated.load_mass = {loop.simulated.load_mass:g}: give 2")
        yield f"cables = {type(loop.get('cables')).__name__}: they are light"


def test_a_block_of_ones_own_tells_what_it_requires():
    with pytest.raises(ScenarioError, match=r"^simulated\.load_mass = 1: give 2$"):
        make_nonstop(Scenario(), load_disturbance=Careful)
    scenario = Scenario()
    scenario.system.load_mass = 2.0
    with pytest.warns(ScenarioWarning, match=r"^cables = Cables: they are light") as told:
        make_nonstop(scenario, at_equilibrium=False, load_disturbance=Careful)
    assert [warning.filename for warning in told] == [__file__]  # the user's line


class Ports(LeafSystem):
    """A block of these inputs and outputs, one of which it may do without."""

    optional_inputs = ("spare",)

    def __init__(self, inputs, outputs):
        super().__init__()
        for name in inputs:
            self.DeclareVectorInputPort(name, 1)
        for name in outputs:
            self.DeclareVectorOutputPort(name, 1, lambda context, output: None)


def test_what_blocks_make_and_need_is_told_by_their_ports():
    maker, reader = Ports((), ("force",)), Ports(("force", "spare"), ())
    maker.requires = lambda loop: None  # what raises only need not return anything
    loop = LoopBlocks({"maker": maker, "reader": reader}, None, None)
    assert loop.maker_of("force") is maker
    assert loop.maker_of("spare") is None
    assert loop.reads("reader", "spare")
    assert not loop.reads("nothing", "force")
    assert loop.needed("reader") == {"force"}
    assert loop.at_start("spare") is None
    assert [*loop.check()] == []
