"""The drawing of any diagram: all is drawn, wires lead where they should, nothing is covered."""

import re
from functools import cache
from itertools import combinations, pairwise, permutations, product
from pathlib import Path
from xml.etree import ElementTree

import pytest
from helpers import Ports, nightly_beyond
from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_nonstop import connect_by_name, draw_diagram, make_nonstop
from drake_nonstop.scenario.loading import load_scenario, scenario_names

COMMITTED = Path(__file__).parents[2] / "diagrams" / "nonstop.svg"
SVG = "{http://www.w3.org/2000/svg}"
FONT_SIZES = {"name": 13, "class": 11, "wire-label": 12, "unread-label": 12}
Rectangle = tuple[float, float, float, float]  # left, top, right, bottom, px
NAMES = ("quintic", "labels", "extra_blocks", "aircraft_rest_cables", *scenario_names())


def connected(blocks: dict[str, tuple[list[str], list[str]]]) -> Diagram:
    """Blocks with inputs and outputs of these names that do nothing."""
    builder, toys = DiagramBuilder(), {}
    for name, (inputs, outputs) in blocks.items():
        toys[name] = Ports(dict.fromkeys(inputs, 1), dict.fromkeys(outputs, 1))
    connect_by_name(builder, toys)
    diagram = builder.Build()
    diagram.set_name("toys & extras")
    return diagram


def ports_of(system) -> tuple[list[str], list[str]]:
    return (
        [system.get_input_port(k).get_name() for k in range(system.num_input_ports())],
        [system.get_output_port(k).get_name() for k in range(system.num_output_ports())],
    )


def diagram_of(name: str) -> Diagram:
    """That of a scenario, or toys."""
    if name == "labels":  # and a box are in the short ways of some wires
        hidden, signals = [f"hidden_{i}" for i in range(4)], ["a_long_name_of_a_signal", "s"]
        return connected(
            {
                "load_trajectory": ([], ["from_above"]),
                "sample_and_hold": ([], hidden),
                "wrench_controller": ([], signals),
                "optimization_layer": (signals, []),
                "force_distribution": (["from_above", *hidden, *signals], []),
                "my_wind": ([], ["wind"]),  # of one box's signals: one of them stands in its place
                "my_load_wind": ([], ["load_wind"]),
            }
        )
    if name != "extra_blocks":
        return make_nonstop(load_scenario(name))
    systems = make_nonstop(load_scenario("quintic")).GetSystems()
    blocks = {system.get_name(): ports_of(system) for system in systems}
    for inputs, _ in blocks.values():
        inputs[:] = [port for port in inputs if port not in ("speed_bound_command", "plan")]
    blocks["load_plant"] = ["cable_forces", "disturbance_wrench", "gust"], ["load_state"]
    read = ["load_state", "carrier_state", "reference"]
    blocks["wind_estimator"] = read, ["wind_estimate", "wind_speed"]
    blocks["wind <tunnel>"] = ["wind_speed", "phase"], ["gust"]  # the layout does not know it
    return connected(blocks)


class Picture:
    """The boxes, texts and wires of an SVG; a net are the parts of the wires of a signal."""

    def __init__(self, text: str, diagram: Diagram | None = None):
        self.text, self.diagram, root = text, diagram, ElementTree.fromstring(text)
        self.size = float(root.get("width")), float(root.get("height"))
        self.blocks: dict[str, Rectangle] = {}
        self.nets: dict[str, list[Rectangle]] = {}
        self.labels, self.wires = {}, {}
        for group in root.iter(f"{SVG}g"):
            name = group.get("data-block") or group.get("data-signal")
            texts = group.iter(f"{SVG}text")
            self.labels[name] = " ".join("".join(each.itertext()) for each in texts)
            if group.get("data-block"):
                rectangle = group.find(f"{SVG}rect")
                x, y, *size = (float(rectangle.get(k)) for k in ("x", "y", "width", "height"))
                self.blocks[name] = x, y, x + size[0], y + size[1]
                continue
            self.nets[name] = []
            for path in group.iter(f"{SVG}path"):
                found = re.findall(r"[ML]([\d.-]+),([\d.-]+)", path.get("d"))
                points = [(float(x), float(y)) for x, y in found]
                self.nets[name] += [(*map(min, a, b), *map(max, a, b)) for a, b in pairwise(points)]
                if path.get("data-wire"):
                    self.wires[path.get("data-wire")] = points[0], points[-1]
        self.texts = [rectangle_of(text) for text in root.iter(f"{SVG}text")]


def rectangle_of(text: ElementTree.Element) -> Rectangle:
    size, x, y = FONT_SIZES[text.get("class")], float(text.get("x")), float(text.get("y"))
    half = 0.25 * size * len("".join(text.itertext()))
    return x - half, y - 0.72 * size, x + half, y


def overlap(a: Rectangle, b: Rectangle) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def touch(a: Rectangle, b: Rectangle) -> bool:
    """Whether two straight parts share a point other than by crossing inside both."""
    meet = a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]
    crossing = [
        across[0] < down[0] <= down[2] < across[2] and down[1] < across[1] <= across[3] < down[3]
        for across, down in ((a, b), (b, a))
    ]
    return meet and not any(crossing)


@cache
def picture_of(name: str) -> Picture:
    if name == "committed":
        return Picture(COMMITTED.read_text(encoding="utf-8"))
    diagram = diagram_of(name)
    return Picture(draw_diagram(diagram), diagram)


@pytest.fixture(scope="module", params=nightly_beyond(4, "studies", dict.fromkeys(NAMES)))
def picture(request: pytest.FixtureRequest) -> Picture:
    return picture_of(request.param)


def test_every_subsystem_connection_and_signal_is_drawn_and_named(picture: Picture):
    systems = {system.get_name(): system for system in picture.diagram.GetSystems()}
    assert picture.blocks.keys() == systems.keys()
    known = {name.partition(".")[2]: text for name, text in picture_of("committed").labels.items()}
    for name, system in systems.items():
        words = picture.labels[name].replace(" ", "")
        assert words == name.replace("_", "").replace(" ", "") + type(system).__name__
        for port in ports_of(system)[1]:  # the words of its name, and the paper's symbol
            label = picture.labels[f"{name}.{port}"]
            assert label.startswith(port.replace("_", " "))
            assert label == known.get(port, label)
    assert sorted(picture.wires) == sorted(
        f"{source.get_name()}.{source.get_output_port(out).get_name()} -> "
        f"{sink.get_name()}.{sink.get_input_port(into).get_name()}"
        for (sink, into), (source, out) in picture.diagram.connection_map().items()
    )


def test_wires_lead_from_their_source_to_their_target_across_or_down(picture: Picture):
    for wire, ends in picture.wires.items():
        for port, (x, y) in zip(wire.split(" -> "), ends, strict=True):
            left, top, right, bottom = picture.blocks[port.partition(".")[0]]
            assert x in (left, right)
            assert top < y < bottom
    for left, top, right, bottom in (part for net in picture.nets.values() for part in net):
        assert left == right or top == bottom
        assert 0 < left <= right < picture.size[0]
        assert 0 < top <= bottom < picture.size[1]


def test_nets_only_cross_and_nothing_is_covered(picture: Picture):
    boxes = [*picture.blocks.values()]
    for (name, net), (other, parts) in combinations(picture.nets.items(), 2):
        assert not any(touch(*pair) for pair in product(net, parts)), (name, other)
    for name, net in picture.nets.items():
        assert not any(overlap(*pair) for pair in product(net, [*boxes, *picture.texts])), name
    for things in (picture.texts, boxes):
        assert not [pair for pair in combinations(things, 2) if overlap(*pair)]
    for text, box in product(picture.texts, boxes):
        inside = box[0] < text[0] and text[2] < box[2] and box[1] < text[1] and text[3] < box[3]
        assert inside or not overlap(text, box)


def test_blocks_stand_as_in_the_committed_drawing_and_unknown_ones_below(picture: Picture):
    places = picture_of("committed").blocks
    known = picture.blocks.keys() & places.keys()
    for (name, other), side in product(permutations(known, 2), (0, 1)):  # to the left, above
        if places[name][side + 2] < places[other][side]:
            assert picture.blocks[name][side + 2] < picture.blocks[other][side]
    if "wind <tunnel>" in picture.blocks:
        lowest = max(picture.blocks[name][3] for name in known)
        assert picture.blocks["wind <tunnel>"][1] > lowest


def test_the_committed_drawing_is_that_of_the_built_diagram():
    assert picture_of("committed").text == picture_of("quintic").text, (
        "the figure has changed; `drake-nonstop run quintic` draws it anew as "
        "out/quintic/diagram.svg: copy that to diagrams/nonstop.svg"
    )
