import re
from functools import cache
from itertools import combinations, pairwise
from xml.etree import ElementTree

import pytest
from helpers import nightly_beyond
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem

from drake_nonstop.diagrams.nonstop import PLACES, SIGNALS, SYMBOLS, make_nonstop
from drake_nonstop.scenario.loading import SCENARIOS as SCENARIO_FILES
from drake_nonstop.scenario.loading import load_scenario
from drake_nonstop.systems import wiring
from drake_nonstop.view.drawing import draw_diagram

SVG = "{http://www.w3.org/2000/svg}"
FONT_SIZES = {"name": 13, "class": 11, "wire-label": 12, "unread-label": 12}
SCENARIOS = {
    "sampled": ("quintic", []),
    "cables_with_nodes": ("aircraft_rest_cables", []),
    "continuous": ("quintic", ["control_period=0"]),
    "printed_phase": ("paper_line", []),
    "open_loop": ("static_hold_open_loop", []),
    "no_optimization": ("line_without_optimization", []),
}

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


def connected(blocks: dict[str, Toy], name: str) -> Diagram:
    """The blocks in a diagram of that name."""
    builder = DiagramBuilder()
    wiring.connect_by_name(builder, blocks)
    diagram = builder.Build()
    diagram.set_name(name)
    return diagram


def with_extra_blocks(diagram: Diagram) -> Diagram:
    """Toys with the ports of the diagram's blocks, and blocks that the layout does not know."""
    blocks = {
        system.get_name(): Toy(
            [s for s in wiring.input_names(system) if s not in ("speed_bound_command", "plan")],
            wiring.output_names(system),
        )
        for system in diagram.GetSystems()
    }
    blocks["load_plant"] = Toy(["cable_forces", "disturbance_wrench", "gust"], ["load_state"])
    read = ["load_state", "carrier_state", "reference"]
    blocks["wind_estimator"] = Toy(read, ["wind_estimate", "wind_speed"])
    blocks["wind <tunnel>"] = Toy(["wind_speed", "phase"], ["gust"])
    return connected(blocks, name="toys & extras")


def with_labels_in_the_way() -> Diagram:
    """The short ways of some wires would be through labels or behind a box."""
    hidden = [f"hidden_{i}" for i in range(4)]
    signals = ["a_long_name_of_a_signal", "s"]
    return connected(
        {
            "load_trajectory": Toy([], ["from_above"]),
            "sample_and_hold": Toy([], hidden),
            "wrench_controller": Toy([], signals),
            "optimization_layer": Toy(signals, []),
            "force_distribution": Toy(["from_above", *hidden, *signals], []),
        },
        name="labels",
    )


class Picture:
    """What an SVG shows, in numbers."""

    def __init__(self, diagram: Diagram):
        self.diagram = diagram
        self.text = draw_diagram(diagram)
        root = ElementTree.fromstring(self.text)
        self.size = (float(root.get("width", 0)), float(root.get("height", 0)))
        self.blocks = {
            group.get("data-block", ""): _rectangle(group)
            for group in root.iter(f"{SVG}g")
            if group.get("data-block")
        }
        self.words = {
            group.get("data-block", ""): [text.text for text in group.iter(f"{SVG}text")]
            for group in root.iter(f"{SVG}g")
            if group.get("data-block")
        }
        self.wires: dict[str, list[Point]] = {}
        self.nets: dict[str, list[list[Point]]] = {}
        self.labels: dict[str, str] = {}
        for group in root.iter(f"{SVG}g"):
            signal = group.get("data-signal")
            if signal is None:
                continue
            self.labels[signal] = " ".join(map(_words, group.iter(f"{SVG}text")))
            paths = list(group.iter(f"{SVG}path"))
            self.nets[signal] = [_points(path.get("d", "")) for path in paths]
            for path, points in zip(paths, self.nets[signal], strict=True):
                if path.get("data-wire"):
                    self.wires[path.get("data-wire", "")] = points
        self.texts = [_text_rectangle(text) for text in root.iter(f"{SVG}text")]

    def segments(self, net: str) -> list[tuple[Point, Point]]:
        return [segment for points in self.nets[net] for segment in pairwise(points)]


def _words(text: ElementTree.Element) -> str:
    return "".join(text.itertext())


def _points(data: str) -> list[Point]:
    """The ends and corners of a path."""
    points = [tuple(map(float, text.split(","))) for text in re.findall(r"[ML]([\d.,-]+)", data)]
    lines = zip(points, points[1:], points[2:], strict=False)
    corners = [b for a, b, c in lines if len({a[0], b[0], c[0]}) > 1 < len({a[1], b[1], c[1]})]
    return [points[0], *corners, points[-1]]


def _rectangle(group: ElementTree.Element) -> tuple[float, float, float, float]:
    rect = group.find(f"{SVG}rect")
    assert rect is not None
    x, y, width, height = (float(rect.get(key, 0)) for key in ("x", "y", "width", "height"))
    return x, y, x + width, y + height


def _text_rectangle(text: ElementTree.Element) -> tuple[float, float, float, float]:
    size = FONT_SIZES[text.get("class", "")]
    x, y = float(text.get("x", 0)), float(text.get("y", 0))
    half = 0.25 * size * len(_words(text))
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


PICTURES = nightly_beyond(
    3,
    "studies",
    dict.fromkeys(["sampled", "labels", "cables_with_nodes", "extra_blocks", *SCENARIOS]),
)


@cache
def picture_of(name: str) -> Picture:
    if name == "labels":
        return Picture(with_labels_in_the_way())
    if name == "extra_blocks":
        return Picture(with_extra_blocks(make_nonstop(load_scenario("quintic"))))
    scenario, overrides = SCENARIOS[name]
    return Picture(make_nonstop(load_scenario(scenario, overrides)))


@pytest.fixture(scope="module", params=PICTURES)
def picture(request: pytest.FixtureRequest) -> Picture:
    return picture_of(request.param)


def test_every_subsystem_and_connection_is_drawn(picture: Picture):
    systems = {system.get_name(): system for system in picture.diagram.GetSystems()}
    assert picture.blocks.keys() == systems.keys()
    for name, system in systems.items():
        words = "".join(picture.words[name]).replace(" ", "")
        assert words == name.replace("_", "").replace(" ", "") + type(system).__name__
    assert sorted(picture.wires) == sorted(wiring.connections(picture.diagram))


def test_every_signal_is_named_once(picture: Picture):
    for system in picture.diagram.GetSystems():
        for port in wiring.output_names(system):
            label = picture.labels.pop(f"{system.get_name()}.{port}")
            symbol = SYMBOLS.get(port.removeprefix("held_"), "")
            assert label == f"{port.replace('_', ' ')} {symbol.replace('_', '')}".strip()
    assert not picture.labels


def test_symbols_are_those_of_signals():
    assert set(SYMBOLS) <= set(SIGNALS)
    assert '<tspan class="index" dy="3">d</tspan>' in picture_of("sampled").text


def test_wires_lead_from_their_source_to_their_target(picture: Picture):
    for wire, points in picture.wires.items():
        source, target = wire.split(" -> ")
        left, top, right, bottom = picture.blocks[target.split(".")[0]]
        assert points[-1][0] in (left, right)
        assert top < points[-1][1] < bottom
        others = picture.segments(source)
        for segment in pairwise(points):
            others.remove(segment)
        left, top, right, bottom = picture.blocks[source.split(".")[0]]
        at_source = points[0][0] in (left, right) and top < points[0][1] < bottom
        assert at_source or any(touch((points[0], points[0]), segment) for segment in others)


def test_wires_run_across_or_down_and_inside_the_picture(picture: Picture):
    for net in picture.nets:
        for segment in picture.segments(net):
            left, top, right, bottom = span(segment)
            assert left == right or top == bottom
            assert 0 < left <= right < picture.size[0]
            assert 0 < top <= bottom < picture.size[1]


def test_no_wire_passes_through_a_box(picture: Picture):
    for net in picture.nets:
        for segment in picture.segments(net):
            for box in picture.blocks.values():
                assert not overlap(span(segment), box), (net, segment)


def test_nets_only_cross(picture: Picture):
    for net, other in combinations(picture.nets, 2):
        for segment in picture.segments(net):
            for other_segment in picture.segments(other):
                assert not touch(segment, other_segment), (net, other)


def test_texts_are_clear_of_each_other_and_of_wires(picture: Picture):
    for text, other in combinations(picture.texts, 2):
        assert not overlap(text, other)
    for net in picture.nets:
        for segment in picture.segments(net):
            for text in picture.texts:
                assert not overlap(span(segment), text), (net, segment)


def test_boxes_are_apart_and_texts_inside_or_outside(picture: Picture):
    for box, other in combinations(picture.blocks.values(), 2):
        assert not overlap(box, other)
    for text in picture.texts:
        for box in picture.blocks.values():
            inside = box[0] < text[0] and text[2] < box[2] and box[1] < text[1] and text[3] < box[3]
            assert inside or not overlap(text, box)


def test_unknown_blocks_stand_below_the_known(picture: Picture):
    known = [box for name, box in picture.blocks.items() if name in PLACES]
    for name, box in picture.blocks.items():
        if name not in PLACES:
            assert box[1] > max(bottom for _, _, _, bottom in known)


def test_layout_is_that_of_the_figure():
    blocks = picture_of("sampled").blocks
    main_row = [
        "load_feedback",
        "sample_and_hold",
        "wrench_controller",
        "force_distribution",
        "carrier_trajectory",
    ]
    for name, following in pairwise(main_row):
        assert blocks[name][2] < blocks[following][0]
    for name, below in pairwise(["optimization_layer", "internal_force", "force_distribution"]):
        assert blocks[name][3] < blocks[below][1]
        assert blocks[name][0] == blocks[below][0]


def test_the_same_diagram_gives_the_same_text(monkeypatch: pytest.MonkeyPatch):
    """In whatever order its connections are listed."""
    connections = wiring.connections
    monkeypatch.setattr(wiring, "connections", lambda diagram: connections(diagram)[::-1])
    assert draw_diagram(with_labels_in_the_way()) == picture_of("labels").text


def test_the_committed_drawing_is_that_of_the_built_diagram():
    committed = SCENARIO_FILES.parent / "nonstop.svg"
    drawn = picture_of("sampled").text
    assert committed.read_text(encoding="utf-8") == drawn, (
        "the figure has changed; `drake-nonstop run quintic` draws it anew as "
        "out/quintic/diagram.svg: copy that to diagrams/nonstop.svg"
    )
