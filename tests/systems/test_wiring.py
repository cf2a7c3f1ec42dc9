import numpy as np
import pytest
from helpers import Ports
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from drake_nonstop.systems import wiring
from drake_nonstop.systems.wiring import connect_by_name, connections, loop_in, optional_inputs
from drake_nonstop.validation import ScenarioError


class Box(LeafSystem):
    """Each output (2,) is the sum of all inputs (2,) plus its number, or a constant."""

    def __init__(self, inputs=(), outputs=(), size=2):
        super().__init__()
        for name in inputs:
            self.DeclareVectorInputPort(name, size)
        for i, name in enumerate(outputs):
            self.DeclareVectorOutputPort(
                name, size, lambda context, value, i=i: value.SetFromVector(self._sum(context) + i)
            )

    def _sum(self, context):
        ports = [self.get_input_port(i) for i in range(self.num_input_ports())]
        return sum((port.Eval(context) for port in ports), np.ones(2))


def wires(blocks, inputs=()):
    return ["{}.{} -> {}.{}".format(*wire) for wire in wiring.wires(blocks, inputs)]


def connect(blocks, **options):
    builder = DiagramBuilder()
    connect_by_name(builder, blocks, **options)
    return builder.Build()


def figure():
    return {
        "source": Box([], ["force", "pose"]),
        "controller": Box(["force", "pose"], ["command"]),
        "plant": Box(["command", "force"], ["state"]),
    }


FIGURE_WIRES = [
    "source.force -> controller.force",
    "source.pose -> controller.pose",
    "controller.command -> plant.command",
    "source.force -> plant.force",
]


def test_wires_follow_from_the_names_and_every_signal_is_exported_with_its_value():
    assert wires(figure()) == FIGURE_WIRES
    blocks = figure() | {"mode": Ports({}, {"mode": None}), "display": Ports({"mode": None}, {})}
    diagram = connect(blocks)
    assert {*connections(diagram)} == {*FIGURE_WIRES, "mode.mode -> display.mode"}
    assert [block.get_name() for block in diagram.GetSystems()] == [*blocks]
    assert diagram.num_input_ports() == 0
    context = diagram.CreateDefaultContext()
    expected = {"force": 1, "pose": 2, "command": 1 + 1 + 2, "state": 1 + 4 + 1}
    assert diagram.num_output_ports() == len(expected) + 1
    for name, value in expected.items():
        np.testing.assert_array_equal(diagram.GetOutputPort(name).Eval(context), [value, value])


class Sail(Box):
    """A box whose input `wind` may be left unconnected."""

    optional_inputs = ("wind",)


def test_optional_input_is_connected_only_where_there_is_such_a_signal():
    blocks = {"plant": Sail(["command", "wind"], ["state"]), "source": Box([], ["command"])}
    assert wires(blocks) == ["source.command -> plant.command"]
    assert "inputs.wind -> plant.wind" in wires(blocks, ["wind"])
    assert "weather.wind -> plant.wind" in wires(blocks | {"weather": Box([], ["wind"])})
    kite = Box(["wind"], ["pull"])  # to which it is not optional
    with pytest.raises(ScenarioError, match=r"kite = Box .* wind \(2\): it is not among"):
        wires(blocks | {"kite": kite})


def test_input_of_a_diagram_is_optional_where_it_leads_to_optional_ones_only():
    both = {"sail": Sail(["wind"], ["pull"]), "other": Sail(["wind"], ["push"])}
    assert optional_inputs(connect(both, inputs=["wind"])) == {"wind"}
    one = {"sail": Sail(["wind"], ["pull"]), "kite": Box(["wind"], ["push"])}
    assert optional_inputs(connect(one, inputs=["wind"])) == set()
    assert optional_inputs(Box(["wind"], ["pull"])) == set()


def test_a_diagram_whose_signals_are_made_elsewhere_too_is_not_the_one_that_counts():
    for is_exported in (False, True):
        builder = DiagramBuilder()
        inner = builder.AddSystem(connect({"source": Box([], ["force", "pose"])}))
        other = builder.AddSystem(Box([], ["pose"] * is_exported))
        if is_exported:
            builder.ExportOutput(other.GetOutputPort("pose"), "pose")
        diagram = builder.Build()
        expected = diagram if is_exported else inner
        assert loop_in(diagram, ["force", "pose"]) is expected


@pytest.mark.parametrize(
    ("blocks", "told", "remedy"),
    [
        ({"plant": Box(["comand"])}, "plant = Box with input comand (2)", "rename the port"),
        ({"second": Box([], ["pose"])}, "second.pose = output: source", "rename one of the two"),
        ({"plant": Box(["command"], size=3)}, "input command (3): controller makes", "resize"),
        ({"kite": Sail(["force"], size=3)}, "Sail with input force (3): source", "resize"),
        ({"display": Ports({"force": None}, {})}, "display = Ports with input force (abs", "resi"),
        ({"a:b": Box()}, "blocks = a:b", "a text without colons and dots"),
        ({"a": Box}, "blocks.a = ", "give a LeafSystem or Diagram"),
    ],
)
def test_what_cannot_be_wired_is_named_with_the_remedy(blocks, told, remedy):
    with pytest.raises(ScenarioError) as error:
        connect(figure() | blocks)
    assert told in str(error.value)
    assert remedy in str(error.value).partition(told)[2]
    assert "\n" not in str(error.value)
