"""A loop is freed once nothing refers to it any more, and its blocks convert."""

import gc
import math
import weakref

import pytest
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression, Variable
from pydrake.systems.framework import BasicVector, Diagram, LeafSystem, LeafSystem_

from drake_nonstop import ConstantParametersConfig, LeafBlock, load_scenario, make_nonstop, simulate
from drake_nonstop.systems.block import number, of_scalar, release

CONSTANT = "optimization_layer=ConstantParameters"
SWAPS = [  # the first two have most blocks between them
    [],
    [
        *("load_plant=MultibodyLoadPlant", "carrier_trajectory=MeasuredCarrierTrajectory"),
        *("carrier_controller=CarrierPid", "load_feedback=!NoisyFeedback {delay: 0.02}"),
        *("load_disturbance=DisturbanceForce", "wind=GustyWind"),
        *("phase=PaperPhase", "wrench_controller=PaperWrenchController", CONSTANT),
    ],
    ["engine=compiled", CONSTANT],
]


class PlainWind(LeafSystem):
    """A block as a user writes it, whose callback holds it."""

    def __init__(self, model):
        super().__init__()
        self.DeclareVectorOutputPort("disturbance_wrench", 6, self.calc)

    def calc(self, context, output: BasicVector) -> None:
        output.SetFromVector([0.0] * 6)


def references(diagram, *others):
    """Weak references to a diagram, its blocks and other things."""
    return [weakref.ref(thing) for thing in (diagram, *diagram.GetSystems(), *others)]


def left(found):
    """The types of what is still there."""
    gc.collect()
    gc.collect()  # what Drake's systems in C++ held
    return [type(each()) for each in found if each() is not None]


@pytest.mark.parametrize("overrides", SWAPS)
@pytest.mark.slow
def test_a_run_leaves_nothing_in_memory(overrides):
    run = simulate(load_scenario("line", ["simulation_duration=0.02", *overrides]))
    found = references(run.diagram, run)
    del run
    assert left(found) == []


@pytest.mark.parametrize("convert", [Diagram.ToAutoDiffXd, Diagram.ToSymbolic, Diagram.Clone])
def test_a_converted_loop_leaves_nothing_in_memory(convert):
    overrides = ["load_plant=MultibodyLoadPlant", "phase=PaperPhase", CONSTANT]
    converted = convert(make_nonstop(load_scenario("line", overrides), at_equilibrium=False))
    found = references(converted)
    converted.GetOutputPort("phase").Eval(converted.CreateDefaultContext())
    del converted
    assert left(found) == []


def test_release_frees_the_rest_beside_a_block_of_the_users():
    scenario = load_scenario("line", ["simulation_duration=0.02", CONSTANT])
    run = simulate(scenario, load_disturbance=PlainWind)
    found = references(run.diagram, run)
    release(run.diagram)
    del run
    assert left(found) in ([PlainWind], [])


class Scaled(LeafBlock):
    """A block below another one, with a keyword and a static method."""

    def __init__(self, config, *, offset):
        super().__init__()
        self.sum = self.sum_of(config.frequency, offset)
        self.DeclareVectorOutputPort("sum", 1, self.calc)

    @staticmethod
    def sum_of(first, second):
        return first + second

    def calc(self, context, output):
        output.SetFromVector([self.sum])


class ScaledMore(Scaled):
    """Which calls what it is below."""

    def calc(self, context, output):
        super().calc(context, output)
        output.SetFromVector(2 * output.CopyToVector())


def test_a_block_converts_with_its_name_and_its_first_arguments():
    config = ConstantParametersConfig(frequency=3.0)
    block = ScaledMore(config, offset=4.0)
    block.set_name("more")
    config.frequency = 100.0
    for other, scalar in (
        (block.ToAutoDiffXd(), AutoDiffXd),
        (block.ToSymbolic(), Expression),
        (block.Clone(), float),
        (block.ToAutoDiffXd().ToSymbolic().Clone(), Expression),
    ):
        assert (other.get_name(), other.scalar) == ("more", scalar)
        assert isinstance(other, LeafSystem_[scalar])
        value = other.GetOutputPort("sum").Eval(other.CreateDefaultContext())[0]
        assert number(value) == 14.0
    assert of_scalar(of_scalar(ScaledMore, Expression), float) is ScaledMore


class Root(LeafBlock):
    """What Python's own square root makes, which takes no Expression."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorInputPort("square", 1)
        self.DeclareVectorInputPort("other", 1)
        self.DeclareVectorOutputPort("root", 1, self.calc)

    def calc(self, context, output):
        output.SetFromVector([math.sqrt(self.GetInputPort("square").Eval(context)[0])])


def test_a_function_that_takes_floats_only_feeds_everything_through():
    block = Root()
    assert block.HasDirectFeedthrough(0, 0)
    assert block.HasDirectFeedthrough(1, 0)
    symbolic = block.ToSymbolic()
    context = symbolic.CreateDefaultContext()
    for k, name in enumerate("xy"):
        symbolic.get_input_port(k).FixValue(context, [Expression(Variable(name))])
    (unknown,) = symbolic.get_output_port().Eval(context)
    assert {v.get_name() for v in unknown.GetVariables()} == {"x", "y"}
    with pytest.raises(RuntimeError):
        unknown.Evaluate(dict.fromkeys(unknown.GetVariables(), 1.0))
