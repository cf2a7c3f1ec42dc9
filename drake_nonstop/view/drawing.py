"""The drawing of a built diagram: an SVG laid out like the paper's control figure.

The boxes are the diagram's subsystems and the wires its connections, so that the drawing
shows what runs. The places of the known boxes are given in `diagrams.nonstop`.

Boxes and wires are on a grid, with spare lanes between the boxes. The wires are routed along
the lanes (`wires`), and lanes without a wire are removed.
"""

import functools
import html
import itertools
import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

from pydrake.systems.framework import Diagram

from drake_nonstop.diagrams.nonstop import BOXES, PLACES
from drake_nonstop.loop.box import Kind, Place
from drake_nonstop.systems import wiring
from drake_nonstop.view.wires import (
    LABEL_LIFT,
    LABEL_SIZE,
    LINE_HEIGHT,
    SPARE_COLUMNS,
    SPARE_ROWS,
    UNIT,
    Node,
    Signal,
    route_all,
    text_width,
)

COLUMNS = 1 + max(place.column for place in PLACES.values())
ROWS = 1 + max(place.row for place in PLACES.values())

# Fill and border.
COLOURS = {
    Kind.PLANT: ("#f2f2f2", "#7a7a7a"),
    Kind.TRAJECTORY: ("#f2f2f2", "#7a7a7a"),
    Kind.WRENCH: ("#e4f5e4", "#4f9a4f"),
    Kind.INNER_LOOP: ("#e6e8fc", "#5f68bd"),
    Kind.OPTIMIZATION: ("#fde4e4", "#c05a5a"),
    Kind.ADDITION: ("#ffffff", "#7a7a7a"),
}

BOX_WIDTH = 11
INPUT_SPACING = 2
NAME_SIZE, CLASS_SIZE = 13, 11  # px
BOLD_WIDTH = 1.1  # over that of the same text in regular

WIDEST_GAPS = 8  # times the spare lanes; tried where the wires do not fit

CORNER_RADIUS = 5  # px
WIRE_COLOUR, UNREAD_COLOUR = "#333", "#999"
STYLE = f"""
text {{ font-family: Helvetica, Arial, sans-serif; text-anchor: middle; fill: #222 }}
.name {{ font-size: {NAME_SIZE}px; font-weight: bold }}
.class {{ font-size: {CLASS_SIZE}px; fill: #555 }}
.wire-label, .unread-label {{ font-size: {LABEL_SIZE}px; font-style: italic }}
.unread-label {{ fill: #777 }}
.wire, .unread {{ fill: none; stroke-width: 1.2 }}
.wire {{ stroke: {WIRE_COLOUR}; marker-end: url(#wire-arrow) }}
.unread {{ stroke: {UNREAD_COLOUR}; marker-end: url(#unread-arrow) }}
"""
ARROWHEADS = [
    f'<marker id="{kind}-arrow" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8"'
    f' markerHeight="8" markerUnits="userSpaceOnUse" orient="auto">'
    f'<path d="M0,1 L8,4 L0,7 z" fill="{colour}"/></marker>'
    for kind, colour in (("wire", WIRE_COLOUR), ("unread", UNREAD_COLOUR))
]

Subsystem = tuple[str, str, tuple[str, ...]]  # its name, its class and its output ports
Pixel = Callable[[Node], Node]  # where a node is, in px


@dataclass
class _Box:
    """A subsystem: its names, its signals and its place on the grid."""

    name: str
    class_name: str
    place: Place
    outputs: list[Signal]
    inputs: dict[str, Signal] = field(default_factory=dict)  # by wire
    left: int = 0
    top: int = 0

    @cached_property
    def texts(self) -> list[tuple[str, str, int]]:
        """The lines of text in the box: style, text, size in px."""
        names = _wrapped(self.name.split("_"), " ", BOLD_WIDTH * NAME_SIZE)
        classes = _wrapped(re.findall("[A-Z]+[^A-Z]*|[^A-Z]+", self.class_name), "", CLASS_SIZE)
        styles = (("name", names, NAME_SIZE), ("class", classes, CLASS_SIZE))
        return [(style, line, size) for style, lines, size in styles for line in lines]

    @property
    def height(self) -> int:
        """The height that the texts and the ports on either side need."""
        texts = math.ceil(sum(size for _, _, size in self.texts) * LINE_HEIGHT / UNIT) + 2
        inputs = INPUT_SPACING * (len(self.inputs) + 1) + 2
        outputs = sum(signal.label_height + 1 for signal in self.outputs[1:]) + 4
        return max(texts, inputs, outputs)

    @property
    def middle(self) -> int:
        return self.top + self.height // 2

    @property
    def sides(self) -> tuple[int, int]:
        """The columns of the edges with the inputs and with the outputs."""
        left, right = self.left, self.left + BOX_WIDTH
        return (left, right) if self.place.flow > 0 else (right, left)

    @property
    def nodes(self) -> Iterable[Node]:
        """The nodes of the box, with one around it."""
        columns = range(self.left - 1, self.left + BOX_WIDTH + 2)
        return itertools.product(columns, range(self.top - 1, self.top + self.height + 2))


def draw_diagram(diagram: Diagram) -> str:
    """The diagram as the text of a standalone SVG file.

    Each box has its instance name as `data-block`, each wire its connection (see
    `wiring.connections`) as `data-wire`, and each label its output port as `data-signal`.

    Raises:
        RuntimeError: there is no room for all wires.
    """
    subsystems = tuple(
        (system.get_name(), type(system).__name__, tuple(wiring.output_names(system)))
        for system in diagram.GetSystems()
    )
    return _drawn(diagram.get_name(), subsystems, tuple(sorted(wiring.connections(diagram))))


@functools.lru_cache(maxsize=32)  # most runs of a process have the same diagram
def _drawn(title: str, subsystems: tuple[Subsystem, ...], wires: tuple[str, ...]) -> str:
    boxes = _boxes(subsystems, wires)
    for scale in range(1, WIDEST_GAPS + 1):
        _place(boxes, scale)
        if _route(boxes):
            return _svg(title, boxes)
    raise RuntimeError(f"{title} cannot be drawn: its wires do not fit into the gaps between boxes")


def _boxes(subsystems: tuple[Subsystem, ...], wires: tuple[str, ...]) -> list[_Box]:
    """The boxes, each where that of its name is, or else the one that makes one of its signals."""
    boxes: dict[str, _Box] = {}
    signals: dict[str, Signal] = {}
    below = ((row, column) for row in itertools.count(ROWS) for column in range(COLUMNS))
    taken = {PLACES[name] for name, _, _ in subsystems if name in PLACES}
    for name, class_name, output_names in subsystems:
        alike = (b.place for b in BOXES.values() if not b.signals.keys().isdisjoint(output_names))
        place = PLACES.get(name) or next((other for other in alike if other not in taken), None)
        if place is None:
            row, column = next(below)
            place = Place(column, row, 1, Kind.ADDITION)
        taken.add(place)
        outputs = [Signal(f"{name}.{port}", place.flow) for port in output_names]
        signals.update({signal.name: signal for signal in outputs})
        boxes[name] = _Box(name, class_name, place, outputs)
    for wire in wires:
        source, target = wire.split(" -> ")
        boxes[target.partition(".")[0]].inputs[wire] = signals[source]
        signals[source].sinks[wire] = (0, 0)
    return list(boxes.values())


def _place(boxes: list[_Box], scale: int) -> None:
    """Puts the boxes and their ports on the grid."""
    right_edge = label_room = bottom_edge = 0
    for column in sorted({box.place.column for box in boxes}):
        members = [box for box in boxes if box.place.column == column]
        room = max(label_room, _label_room(members, -1))
        for box in members:
            box.left = right_edge + room + scale * SPARE_COLUMNS
        right_edge = members[0].left + BOX_WIDTH
        label_room = _label_room(members, 1)
    for row in sorted({box.place.row for box in boxes}):
        members = [box for box in boxes if box.place.row == row]
        height = max(box.height for box in members)
        for box in members:
            box.top = bottom_edge + scale * SPARE_ROWS + (height - box.height) // 2
        bottom_edge += scale * SPARE_ROWS + height
    for place in (_place_outputs, _place_inputs):
        for box in boxes:
            place(box, boxes)


def _label_room(boxes: list[_Box], flow: int) -> int:
    signals = [signal for box in boxes if box.place.flow == flow for signal in box.outputs]
    return max((signal.label_width for signal in signals), default=0)


def _place_outputs(box: _Box, boxes: list[_Box]) -> None:
    """Puts outputs that lead upwards above those that lead downwards, and unread ones last."""

    def bearing(signal: Signal) -> float:
        readers = [other for other in boxes for wire in other.inputs if wire in signal.sinks]
        ahead = [box.place.flow * (reader.sides[0] - box.sides[1]) for reader in readers]
        down = [reader.middle - box.middle for reader in readers]
        return sum(map(math.atan2, down, ahead)) / len(readers) if readers else math.inf

    box.outputs.sort(key=bearing)
    heights = [signal.label_height + 1 for signal in box.outputs[1:]]
    rows = itertools.accumulate([box.middle - sum(heights) // 2, *heights])
    for signal, row in zip(box.outputs, rows, strict=False):
        signal.source = (box.sides[1], row)


def _place_inputs(box: _Box, boxes: list[_Box]) -> None:
    """Puts inputs from above on top, and those with a straight wire at the height of its source."""
    low, high = box.top + 1, box.top + box.height - 1

    def comes_from(signal: Signal) -> float:
        x, y = signal.source
        ahead = box.place.flow * (box.sides[0] - x)
        if ahead > 0 and low <= y <= high and not _is_straight(signal, box, boxes):
            return math.copysign(math.pi / 2, y - box.middle + INPUT_SPACING)
        return math.atan2(y - box.middle - 0.5, ahead)

    wires = sorted(box.inputs, key=lambda wire: comes_from(box.inputs[wire]))
    straight = {
        i: box.inputs[wire].source[1]
        for i, wire in enumerate(wires)
        if _is_straight(box.inputs[wire], box, boxes)
    }
    heights: list[int] = []
    for i in range(len(wires)):
        y = box.top + round(box.height * (i + 1) / (len(wires) + 1))
        for k, straight_y in straight.items():
            bound = straight_y + INPUT_SPACING * (i - k)
            y = max(y, bound) if k <= i else min(y, bound)
        y = straight.get(i, y)
        heights.append(max(y, heights[-1] + INPUT_SPACING) if heights else max(y, low))
    for wire, y in zip(reversed(wires), reversed(heights), strict=True):
        y = min(y, high)
        high = y - INPUT_SPACING
        box.inputs[wire].sinks[wire] = (box.sides[0], y)


def _is_straight(signal: Signal, box: _Box, boxes: list[_Box]) -> bool:
    """Whether a straight wire can connect the signal with the box."""
    x, y = signal.source
    between = range(*sorted((x, box.sides[0])))
    is_ahead = box.place.flow * (box.sides[0] - x) > 0 and box.top < y < box.top + box.height
    others = (other for other in boxes if other is not box and other.left in between)
    return is_ahead and not any(other.top <= y <= other.top + other.height for other in others)


def _route(boxes: list[_Box]) -> bool:
    """Routes the wires around boxes and labels; False if one has no route."""
    blocked = {node for box in boxes for node in box.nodes}
    reserved: dict[Node, str] = {}
    signals = [signal for box in boxes for signal in box.outputs]
    for signal in signals:
        blocked.update(signal.label_nodes)
        reserved.update(dict.fromkeys(signal.stem, signal.name))
    for box in boxes:
        for wire, signal in box.inputs.items():
            x, y = signal.sinks[wire]
            reserved.update({(x - box.place.flow * i, y): signal.name for i in range(3)})
    return route_all(signals, blocked, reserved)


def _positions(boxes: list[_Box]) -> tuple[dict[int, int], dict[int, int]]:
    """Positions of the lanes in px, without the gaps that no box, label or wire needs."""
    runs_down = {node for box in boxes for node in box.nodes}
    for signal in (signal for box in boxes for signal in box.outputs):
        runs_down.update(signal.stem, signal.label_nodes)
    runs_across = {(y, x) for x, y in runs_down}
    for path in (path for b in boxes for s in b.outputs for path in s.paths.values()):
        for (x, y), (next_x, next_y) in pairwise(path):
            if x == next_x:
                runs_down.update([(x, y), (x, next_y)])
            else:
                runs_across.update([(y, x), (y, next_x)])
    return _squeezed(runs_down), _squeezed(runs_across)


def _squeezed(nodes: set[Node]) -> dict[int, int]:
    """Positions of the lanes in px, each as close to the lanes before it as its nodes allow."""
    places = defaultdict(list)
    for lane, place in nodes:
        places[lane].append(place)
    filled: dict[int, int] = defaultdict(int)
    positions = {}
    for lane in sorted(places):
        positions[lane] = UNIT + max(filled[place] for place in places[lane])
        filled.update(dict.fromkeys(places[lane], positions[lane]))
    return positions


def _svg(title: str, boxes: list[_Box]) -> str:
    columns, rows = _positions(boxes)
    width, height = (max(lanes.values()) + UNIT for lanes in (columns, rows))

    def pixel(node: Node) -> Node:
        return columns[node[0]], rows[node[1]]

    size = f'width="{width}" height="{height}"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {width} {height}">',
        f"<title>{html.escape(title, quote=False)}</title>",
        f"<style>{STYLE}</style>",
        *ARROWHEADS,
        f'<rect {size} fill="white"/>',
    ]
    lines += [line for b in boxes for s in b.outputs for line in _signal_svg(s, pixel)]
    lines += [line for box in boxes for line in _box_svg(box, pixel)]
    return "\n".join([*lines, "</svg>", ""])


def _signal_svg(signal: Signal, pixel: Pixel) -> list[str]:
    kind = "wire" if signal.paths else "unread"
    lines = [f'<g data-signal="{html.escape(signal.name)}">']
    neighbours: dict[Node, set[Node]] = defaultdict(set)
    for wire, path in signal.paths.items():
        data = _path_data(path, pixel)
        lines.append(f'<path class="wire" data-wire="{html.escape(wire)}" d="{data}"/>')
        for node, other in (*pairwise(path), *pairwise(path[::-1])):
            neighbours[node].add(other)
    if not signal.paths:
        lines.append(f'<path class="unread" d="{_path_data(signal.stem, pixel)}"/>')
    for node, around in neighbours.items():
        if len(around) > 2:
            x, y = pixel(node)
            lines.append(f'<circle cx="{x}" cy="{y}" r="2.5" fill="{WIRE_COLOUR}"/>')
    x, y = pixel(signal.source)
    middle = x + signal.flow * signal.label_width * UNIT / 2
    baseline = y - LABEL_LIFT - (len(signal.lines) - 1) * LINE_HEIGHT * LABEL_SIZE
    for line in signal.lines:
        lines.append(_text_svg(f"{kind}-label", line, middle, baseline))
        baseline += LINE_HEIGHT * LABEL_SIZE
    return [*lines, "</g>"]


def _box_svg(box: _Box, pixel: Pixel) -> list[str]:
    left, top = pixel((box.left, box.top))
    right, bottom = pixel((box.left + BOX_WIDTH, box.top + box.height))
    fill, border = COLOURS[box.place.kind]
    lines = [
        f'<g data-block="{html.escape(box.name)}">',
        f'<rect x="{left}" y="{top}" width="{right - left}" height="{bottom - top}" rx="5"'
        f' fill="{fill}" stroke="{border}"/>',
    ]
    baseline = (top + bottom - sum(size for _, _, size in box.texts) * LINE_HEIGHT) / 2
    for kind, text, size in box.texts:
        baseline += LINE_HEIGHT * size
        lines.append(_text_svg(kind, text, (left + right) / 2, baseline - 0.25 * size))
    return [*lines, "</g>"]


def _text_svg(kind: str, text: str, x: float, y: float) -> str:
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}">{html.escape(text, quote=False)}</text>'


def _path_data(path: list[Node], pixel: Pixel) -> str:
    """A line along the path, with its corners rounded."""
    triples = zip(path, path[1:], path[2:], strict=False)
    corners = [node for a, node, b in triples if a[0] != b[0] and a[1] != b[1]]
    points = [pixel(node) for node in (path[0], *corners, path[-1])]
    data = "M{},{}".format(*points[0])
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        start, end = _towards(corner, before), _towards(corner, after)
        data += " L{},{} Q{},{} {},{}".format(*start, *corner, *end)
    return data + " L{},{}".format(*points[-1])


def _towards(corner: Node, point: Node) -> Node:
    """The point towards another one at which a corner's rounding ends."""
    dx, dy = point[0] - corner[0], point[1] - corner[1]
    length = abs(dx) + abs(dy)
    radius = min(CORNER_RADIUS, length // 2)
    return corner[0] + radius * dx // length, corner[1] + radius * dy // length


def _wrapped(words: list[str], joint: str, size: float) -> list[str]:
    """The words in lines that fit into a box."""
    lines = [words[0]]
    for word in words[1:]:
        longer = lines[-1] + joint + word
        fits = text_width(longer, size) <= BOX_WIDTH * UNIT - 10
        lines[-1:] = [longer] if fits else [lines[-1], word]
    return lines
