"""The drawing of any diagram: all is drawn, wires lead where they should, nothing is covered."""

import re
from functools import cache
from itertools import combinations, pairwise
from xml.etree import ElementTree

import pytest
from helpers import nightly_beyond
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem

from drake_nonstop.diagrams.nonstop import PLACES, SYMBOLS, make_nonstop
from drake_nonstop.scenario.loading import SCENARIOS as SCENARIO_FILES
from drake_nonstop.scenario.loading import load_scenario, scenario_names
from drake_nonstop.systems import wiring
from drake_nonstop.view.drawing import draw_diagram

SVG = "{http://www.w3.org/2000/svg}"
FONT_SIZES = {"name": 13, "class": 11, "wire-label": 12, "unread-label": 12}
Point = tuple[float, float]


class Toy(LeafSystem):
    """A block with the given ports that does nothing."""

    def __init__(self, inputs: list[str], outputs: list[str]):
        super().__init__()
        for name in inputs:
            self.DeclareVectorInputPort(name, 1)
        for name in outputs:
            self.DeclareVectorOutputPort(
                name, 1, lambda context, output: None, {self.time_ticket()}
            )


def connected(blocks: dict[str, Toy]) -> Diagram:
    builder = DiagramBuilder()
    wiring.connect_by_name(builder, blocks)
    diagram = builder.Build()
    diagram.set_name("toys & extras")
    return diagram


def with_extra_blocks() -> Diagram:
    """Toys with the ports of a loop's blocks, and blocks that the layout does not know."""
    blocks = {
        system.get_name(): Toy(
            [s for s in wiring.input_names(system) if s not in ("speed_bound_command", "plan")],
            wiring.output_names(system),
        )
        for system in make_nonstop(load_scenario("quintic")).GetSystems()
    }
    blocks["load_plant"] = Toy(["cable_forces", "disturbance_wrench", "gust"], ["load_state"])
    read = ["load_state", "carrier_state", "reference"]
    blocks["wind_estimator"] = Toy(read, ["wind_estimate", "wind_speed"])
    blocks["wind <tunnel>"] = Toy(["wind_speed", "phase"], ["gust"])
    return connected(blocks)


def with_labels_in_the_way() -> Diagram:
    """The short ways of some wires would be through labels or behind a box."""
    hidden, signals = [f"hidden_{i}" for i in range(4)], ["a_long_name_of_a_signal", "s"]
    return connected(
        {
            "load_trajectory": Toy([], ["from_above"]),
            "sample_and_hold": Toy([], hidden),
            "wrench_controller": Toy([], signals),
            "optimization_layer": Toy(signals, []),
            "force_distribution": Toy(["from_above", *hidden, *signals], []),
        }
    )


TOYS = {"labels": with_labels_in_the_way, "extra_blocks": with_extra_blocks}
NAMES = ("quintic", *TOYS, "aircraft_rest_cables", *scenario_names())


class Picture:
    """What an SVG shows, in numbers."""

    def __init__(self, diagram: Diagram):
        self.diagram, self.text = diagram, draw_diagram(diagram)
        root = ElementTree.fromstring(self.text)
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
    return Picture(TOYS[name]() if name in TOYS else make_nonstop(load_scenario(name)))


@pytest.fixture(scope="module", params=nightly_beyond(4, "studies", dict.fromkeys(NAMES)))
def picture(request: pytest.FixtureRequest) -> Picture:
    return picture_of(request.param)


def test_every_subsystem_connection_and_signal_is_drawn_and_named(picture: Picture):
    systems = {system.get_name(): system for system in picture.diagram.GetSystems()}
    assert picture.blocks.keys() == systems.keys()
    labels = {}
    for name, system in systems.items():
        expected = name.replace("_", "").replace(" ", "") + type(system).__name__
        assert picture.words[name].replace(" ", "") == expected
        for port in wiring.output_names(system):
            symbol = SYMBOLS.get(port.removeprefix("held_"), "").replace("_", "")
            labels[f"{name}.{port}"] = f"{port.replace('_', ' ')} {symbol}".strip()
    assert sorted(picture.wires) == sorted(wiring.connections(picture.diagram))
    assert picture.labels == labels


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


def test_blocks_stand_as_in_the_figure_and_unknown_ones_below(picture: Picture):
    known = {name: box for name, box in picture.blocks.items() if name in PLACES}
    for (name, box), (other, below) in combinations(known.items(), 2):
        place, place_below = PLACES[name], PLACES[other]
        if place.row < place_below.row:
            assert box[3] < below[1]
        if place.column < place_below.column:
            assert box[2] < below[0]
    for name, box in picture.blocks.items():
        assert name in known or box[1] > max(bottom for _, _, _, bottom in known.values())


def test_the_same_diagram_gives_the_same_text_in_whatever_order_it_is_wired(monkeypatch):
    connections = wiring.connections
    monkeypatch.setattr(wiring, "connections", lambda diagram: connections(diagram)[::-1])
    assert draw_diagram(with_labels_in_the_way()) == picture_of("labels").text


def test_the_committed_drawing_is_that_of_the_built_diagram():
    committed = SCENARIO_FILES.parent / "nonstop.svg"
    assert committed.read_text(encoding="utf-8") == picture_of("quintic").text, (
        "the figure has changed; `drake-nonstop run quintic` draws it anew as "
        "out/quintic/diagram.svg: copy that to diagrams/nonstop.svg"
    )
