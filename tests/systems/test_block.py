"""A run is freed once nothing refers to it any more."""

import gc
import itertools
import weakref

import pytest
from pydrake.systems.framework import BasicVector, LeafSystem

from drake_nonstop.diagrams.nonstop import BOXES
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.simulation.simulate import simulate
from drake_nonstop.systems.block import BlockType, LeafBlock, release, weakly

SWAPS = [
    [],
    ["phase=PaperPhase", "wrench_controller=PaperWrenchController", "control_period=0"],
    ["load_plant=MultibodyLoadPlant", "carrier_trajectory=MeasuredCarrierTrajectory"],
    ["load_feedback=!NoisyFeedback {delay: 0.02}", "load_disturbance=Wind"],
    ["carrier_dynamics=LoadedCarrierDynamics", "carrier_controller=LoadedCarrierPid"],
    ["carrier_dynamics=IdealCarriers", "load_feedback=DesiredStateFeedback"],
    ["cables=IndividualCables", "force_distribution=BoundedTensionDistribution"],
    ["optimization_layer=ConstantParameters"],
    ["fused_plant=true"],
    *([f"optimization_layer.solver={name}"] for name in ("snopt", "ipopt", "nlopt", "grid")),
]


class PlainWind(LeafSystem):
    """A block as a user writes it, whose callback holds it."""

    def __init__(self, model):
        super().__init__()
        self.DeclareVectorOutputPort("disturbance_wrench", 6, self.calc)

    def calc(self, context, output: BasicVector) -> None:
        output.SetFromVector([0.0] * 6)


def held(run):
    """Weak references to what the run, its diagram and its blocks are."""
    things = [run, run.diagram, *run.diagram.GetSystems()]
    return [weakref.ref(thing) for thing in things]


@pytest.mark.parametrize("overrides", SWAPS, ids=lambda s: ", ".join(s) or "default")
def test_a_run_leaves_nothing_in_memory(overrides):
    run = simulate(load_scenario("line", ["simulation_duration=0.02", *overrides]))
    references = held(run)
    del run
    gc.collect()
    assert [r() for r in references if r() is not None] == []


def test_every_block_is_one_that_is_freed():
    for block in itertools.chain.from_iterable(box.variants for box in BOXES.values()):
        assert isinstance(block, BlockType)


class Stateful(LeafBlock):
    """A block without the rates of its state."""

    def __init__(self):
        super().__init__()
        self.DeclareContinuousState(2)


def test_a_continuous_state_without_rates_is_an_error():
    block = Stateful()
    with pytest.raises((RuntimeError, SystemExit)):
        block.EvalTimeDerivatives(block.CreateDefaultContext())


def test_release_frees_the_rest_beside_a_block_of_the_users():
    run = simulate(load_scenario("line", ["simulation_duration=0.02"]), load_disturbance=PlainWind)
    reference, blocks = weakref.ref(run.diagram), held(run)
    release(run.diagram)
    del run
    gc.collect()
    assert reference() is None
    assert [type(r()) for r in blocks if r() is not None] in ([PlainWind], [])


def test_weakly():
    class Owner:
        def method(self, *arguments):
            return self, arguments

    owner = Owner()
    callback = weakly(owner.method)
    assert callback(1, 2) == (owner, (1, 2))
    reference = weakref.ref(owner)
    del owner
    assert reference() is None
    assert weakly(len) is len
