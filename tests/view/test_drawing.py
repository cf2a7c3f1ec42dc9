"""The drawing of any diagram: all is drawn, wires lead where they should, nothing is covered."""

import re
from functools import cache
from itertools import combinations, pairwise
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
Point = tuple[float, float]


def connected(blocks: dict[str, tuple[list[str], list[str]]]) -> Diagram:
    """Blocks with inputs and outputs of these names that do nothing."""
    builder = DiagramBuilder()
    toys = {
        name: Ports(*(dict.fromkeys(each, 1) for each in ports)) for name, ports in blocks.items()
    }
    connect_by_name(builder, toys)
    diagram = builder.Build()
    diagram.set_name("toys & extras")
    return diagram


def ports_of(system) -> tuple[list[str], list[str]]:
    return (
        [system.get_input_port(k).get_name() for k in range(system.num_input_ports())],
        [system.get_output_port(k).get_name() for k in range(system.num_output_ports())],
    )


def with_extra_blocks() -> Diagram:
    """Toys with the ports of a loop's blocks, and blocks that the layout does not know."""
    blocks = {}
    for system in make_nonstop(load_scenario("quintic")).GetSystems():
        inputs, outputs = ports_of(system)
        inputs = [name for name in inputs if name not in ("speed_bound_command", "plan")]
        blocks[system.get_name()] = inputs, outputs
    blocks["load_plant"] = ["cable_forces", "disturbance_wrench", "gust"], ["load_state"]
    read = ["load_state", "carrier_state", "reference"]
    blocks["wind_estimator"] = read, ["wind_estimate", "wind_speed"]
    blocks["wind <tunnel>"] = ["wind_speed", "phase"], ["gust"]
    return connected(blocks)


def with_labels_in_the_way() -> Diagram:
    """The short ways of some wires would be through labels or behind a box."""
    hidden, signals = [f"hidden_{i}" for i in range(4)], ["a_long_name_of_a_signal", "s"]
    return connected(
        {
            "load_trajectory": ([], ["from_above"]),
            "sample_and_hold": ([], hidden),
            "wrench_controller": ([], signals),
            "optimization_layer": (signals, []),
            "force_distribution": (["from_above", *hidden, *signals], []),
        }
    )


TOYS = {"labels": with_labels_in_the_way, "extra_blocks": with_extra_blocks}
NAMES = ("quintic", *TOYS, "aircraft_rest_cables", *scenario_names())


class Picture:
    """What an SVG shows, in numbers."""

    def __init__(self, text: str, diagram: Diagram | None = None):
        self.diagram, self.text = diagram, text
        root = ElementTree.fromstring(text)
        groups = [*root.iter(f"{SVG}g")]
        blocks = {group.get("data-block"): group for group in groups if group.get("data-block")}
        signals = {group.get("data-signal"): group for group in groups if group.get("data-signal")}
        self.size = (float(root.get("width")), float(root.get("height")))
        self.blocks = {name: _rectangle(group.find(f"{SVG}rect")) for name, group in blocks.items()}
        self.words = {name: _words(group) for name, group in blocks.items()}
        self.labels = {
            name: " ".join(map(_words, group.iter(f"{SVG}text"))) for name, group in signals.items()
        }
        paths = {name: [*group.iter(f"{SVG}path")] for name, group in signals.items()}
        self.nets = {
            name: [segment for path in found for segment in pairwise(_points(path))]
            for name, found in paths.items()
        }
        found = [path for each in paths.values() for path in each if path.get("data-wire")]
        self.wires = {path.get("data-wire"): _points(path) for path in found}
        self.texts = [_text_rectangle(text) for text in root.iter(f"{SVG}text")]


def _words(element: ElementTree.Element) -> str:
    return "".join("".join(text.itertext()) for text in element.iter(f"{SVG}text"))


def _points(path: ElementTree.Element) -> list[Point]:
    """The ends and corners of a path."""
    found = re.findall(r"[ML]([\d.,-]+)", path.get("d"))
    points = [tuple(map(float, text.split(","))) for text in found]
    lines = zip(points, points[1:], points[2:], strict=False)
    corners = [b for a, b, c in lines if len({a[0], b[0], c[0]}) > 1 < len({a[1], b[1], c[1]})]
    return [points[0], *corners, points[-1]]


def _rectangle(rect: ElementTree.Element) -> tuple[float, float, float, float]:
    x, y, width, height = (float(rect.get(key)) for key in ("x", "y", "width", "height"))
    return x, y, x + width, y + height


def _text_rectangle(text: ElementTree.Element) -> tuple[float, float, float, float]:
    size = FONT_SIZES[text.get("class")]
    x, y = float(text.get("x")), float(text.get("y"))
    half = 0.25 * size * len("".join(text.itertext()))
    return x - half, y - 0.72 * size, x + half, y


def overlap(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def span(segment: tuple[Point, Point]) -> tuple[float, float, float, float]:
    (x1, y1), (x2, y2) = segment
    return min(x1, x2), min(y1, y2), max(x1, x2), max(y1, y2)


def touch(a: tuple[Point, Point], b: tuple[Point, Point]) -> bool:
    """Whether two segments share a point other than by crossing inside both."""
    a, b = span(a), span(b)
    if not (a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]):
        return False
    across = [s for s in (a, b) if s[1] == s[3]]
    down = [s for s in (a, b) if s[1] != s[3]]
    if len(across) != 1:
        return True
    (left, y, right, _), (x, top, _, bottom) = across[0], down[0]
    return not (left < x < right and top < y < bottom)


@cache
def picture_of(name: str) -> Picture:
    diagram = TOYS[name]() if name in TOYS else make_nonstop(load_scenario(name))
    return Picture(draw_diagram(diagram), diagram)


@cache
def committed() -> Picture:
    return Picture(COMMITTED.read_text(encoding="utf-8"))


@pytest.fixture(scope="module", params=nightly_beyond(4, "studies", dict.fromkeys(NAMES)))
def picture(request: pytest.FixtureRequest) -> Picture:
    return picture_of(request.param)


def test_every_subsystem_connection_and_signal_is_drawn_and_named(picture: Picture):
    systems = {system.get_name(): system for system in picture.diagram.GetSystems()}
    assert picture.blocks.keys() == systems.keys()
    for name, system in systems.items():
        expected = name.replace("_", "").replace(" ", "") + type(system).__name__
        assert picture.words[name].replace(" ", "") == expected
    signals = {f"{name}.{port}" for name, each in systems.items() for port in ports_of(each)[1]}
    assert picture.labels.keys() == signals
    symbols = {name.partition(".")[2]: label for name, label in committed().labels.items()}
    for name, label in picture.labels.items():  # the words of its name, and the paper's symbol
        port = name.partition(".")[2]
        assert label.startswith(port.replace("_", " "))
        assert label == symbols.get(port, label)
    wires = picture.diagram.connection_map().items()
    assert sorted(picture.wires) == sorted(
        f"{source.get_name()}.{source.get_output_port(out).get_name()} -> "
        f"{sink.get_name()}.{sink.get_input_port(into).get_name()}"
        for (sink, into), (source, out) in wires
    )


def test_wires_lead_from_their_source_to_their_target_across_or_down(picture: Picture):
    for wire, points in picture.wires.items():
        for (port, _), (x, y) in zip(
            (name.split(".") for name in wire.split(" -> ")), (points[0], points[-1]), strict=True
        ):
            left, top, right, bottom = picture.blocks[port]
            assert x in (left, right)
            assert top < y < bottom
    for segment in (segment for net in picture.nets.values() for segment in net):
        left, top, right, bottom = span(segment)
        assert left == right or top == bottom
        assert 0 < left <= right < picture.size[0]
        assert 0 < top <= bottom < picture.size[1]


def test_nets_only_cross(picture: Picture):
    for net, other in combinations(picture.nets, 2):
        for segment in picture.nets[net]:
            for other_segment in picture.nets[other]:
                assert not touch(segment, other_segment), (net, other)


def test_nothing_is_covered(picture: Picture):
    for net, segments in picture.nets.items():
        for segment in segments:
            for covered in (*picture.blocks.values(), *picture.texts):
                assert not overlap(span(segment), covered), (net, segment)
    for things in (picture.texts, picture.blocks.values()):
        assert not [pair for pair in combinations(things, 2) if overlap(*pair)]
    for text in picture.texts:
        for box in picture.blocks.values():
            inside = box[0] < text[0] and text[2] < box[2] and box[1] < text[1] and text[3] < box[3]
            assert inside or not overlap(text, box)


def test_blocks_stand_as_in_the_committed_drawing_and_unknown_ones_below(picture: Picture):
    places = committed().blocks
    known = picture.blocks.keys() & places.keys()
    for name, other in combinations(known, 2):
        for near, far in ((0, 2), (1, 3)):  # to the left of, or above
            for first, second in ((name, other), (other, name)):
                if places[first][far] < places[second][near]:
                    assert picture.blocks[first][far] < picture.blocks[second][near]
    if picture.diagram.get_name() == "toys & extras":
        lowest = max(picture.blocks[name][3] for name in known)
        assert all(picture.blocks[name][1] > lowest for name in picture.blocks.keys() - known)


def test_the_committed_drawing_is_that_of_the_built_diagram():
    assert committed().text == picture_of("quintic").text, (
        "the figure has changed; `drake-nonstop run quintic` draws it anew as "
        "out/quintic/diagram.svg: copy that to diagrams/nonstop.svg"
    )
