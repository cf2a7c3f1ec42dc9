"""The drawing of a built diagram: an SVG laid out like the paper's control figure.

The boxes are the diagram's subsystems and the wires its connections, so that the drawing
shows what runs. The places of the known boxes are given in `diagrams.nonstop`.

Boxes and wires are on a grid, with spare lanes between the boxes. The wires are routed along
the lanes, and lanes without a wire are removed.
"""

import functools
import heapq
import math
import re
import textwrap
from collections import defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from xml.sax.saxutils import escape, quoteattr

from pydrake.systems.framework import Diagram

from drake_nonstop.diagrams.nonstop import BOXES, PLACES
from drake_nonstop.loop.box import Kind, Place
from drake_nonstop.systems import wiring

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

UNIT = 10  # px between neighbouring lanes; lengths are in units unless they say px
BOX_WIDTH = 11
INPUT_SPACING = 2
SPARE_COLUMNS = 8  # between two boxes, beside the room for labels
SPARE_ROWS = 9
NAME_SIZE, CLASS_SIZE, LABEL_SIZE = 13, 11, 12  # px
LINE_HEIGHT = 1.1  # of the size of a font
BOLD_WIDTH = 1.1  # over that of the same text in regular
NARROW, WIDE = set("fijlrt I"), set("mwMW")
LABEL_LIFT = 4  # px from the wire
LABEL_CHARACTERS = 13  # in one line

# Costs of a wire's route, in units of length.
BEND_COST, CROSSING_COST, BRANCH_COST = 5, 9, 2
ROUTING_PASSES = 3
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
Node = tuple[int, int]
Step = tuple[int, int]
State = tuple[int, Node, Step]  # cost of a path to a node, and its last step
Positions = tuple[dict[int, int], dict[int, int]]  # of columns and of rows, in px
STEPS: tuple[Step, ...] = ((1, 0), (0, 1), (-1, 0), (0, -1))


@dataclass
class Signal:
    """An output port and the wires that leave it, by name "block.port -> block.port"."""

    name: str  # "block.port"
    flow: int
    source: Node = (0, 0)
    sinks: dict[str, Node] = field(default_factory=dict)
    paths: dict[str, list[Node]] = field(default_factory=dict)  # each from the trunk to its sink

    @cached_property
    def lines(self) -> list[str]:
        """The label, in lines of about the same length."""
        words = self.name.partition(".")[2].replace("_", " ")
        count = len(textwrap.wrap(words, LABEL_CHARACTERS))
        width = next(w for w in range(1, 99) if len(textwrap.wrap(words, w)) <= count)
        return textwrap.wrap(words, width, break_long_words=False)

    @property
    def label_width(self) -> int:
        """The width of the label along the wire."""
        return math.ceil((max(_text_width(line, LABEL_SIZE) for line in self.lines) + 8) / UNIT)

    @property
    def label_height(self) -> int:
        """The height of the label above the wire."""
        lines_above = len(self.lines) - 1
        return int((LABEL_LIFT + (0.75 + lines_above * LINE_HEIGHT) * LABEL_SIZE + 3) / UNIT)

    @property
    def stem(self) -> list[Node]:
        """The start of the wires, straight below the label."""
        x, y = self.source
        return [(x + self.flow * i, y) for i in range(self.label_width + 1)]

    @property
    def label_nodes(self) -> list[Node]:
        """The nodes that the label covers."""
        heights = range(1, self.label_height + 1)
        return [(x, y - height) for x, y in self.stem[1:-1] for height in heights]


@dataclass
class Box:
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
        return [("name", line, NAME_SIZE) for line in names] + [
            ("class", line, CLASS_SIZE) for line in classes
        ]

    @property
    def height(self) -> int:
        """The height that the texts and the ports on either side need."""
        texts = math.ceil(sum(size for _, _, size in self.texts) * LINE_HEIGHT / UNIT) + 2
        inputs = INPUT_SPACING * (len(self.inputs) + 1) + 2
        outputs = sum(signal.label_height + 1 for signal in self.outputs[1:]) + 4
        return max(texts, inputs, outputs)

    @property
    def middle(self) -> int:
        """The row in the middle of the box."""
        return self.top + self.height // 2

    @property
    def input_side(self) -> int:
        """The column of the edge with the inputs."""
        return self.left if self.place.flow > 0 else self.left + BOX_WIDTH

    @property
    def output_side(self) -> int:
        """The column of the edge with the outputs."""
        return self.left + BOX_WIDTH if self.place.flow > 0 else self.left

    def nodes(self, margin: int) -> Iterable[Node]:
        """The nodes of the box and of a margin around it."""
        for x in range(self.left - margin, self.left + BOX_WIDTH + margin + 1):
            for y in range(self.top - margin, self.top + self.height + margin + 1):
                yield x, y


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


def _boxes(subsystems: tuple[Subsystem, ...], wires: tuple[str, ...]) -> list[Box]:
    boxes: dict[str, Box] = {}
    signals: dict[str, Signal] = {}
    unknown_boxes = 0
    taken = {PLACES[name] for name, _, _ in subsystems if name in PLACES}
    for name, class_name, output_names in subsystems:
        place = _place_of(name, output_names, taken)
        if place is None:
            row, column = divmod(unknown_boxes, COLUMNS)
            place = Place(column, ROWS + row, 1, Kind.ADDITION)
            unknown_boxes += 1
        taken.add(place)
        outputs = [Signal(f"{name}.{port}", place.flow) for port in output_names]
        signals.update({signal.name: signal for signal in outputs})
        boxes[name] = Box(name, class_name, place, outputs)
    for wire in wires:
        source, target = wire.split(" -> ")
        boxes[target.partition(".")[0]].inputs[wire] = signals[source]
        signals[source].sinks[wire] = (0, 0)
    return list(boxes.values())


def _place_of(name: str, output_names: tuple[str, ...], taken: set[Place]) -> Place | None:
    """The place of the box of that name, or of the one that makes one of these signals."""
    if name in PLACES:
        return PLACES[name]
    boxes = (box for box in BOXES.values() if not box.signals.keys().isdisjoint(output_names))
    return next((box.place for box in boxes if box.place not in taken), None)


def _place(boxes: list[Box], scale: int) -> None:
    """Puts the boxes and their ports on the grid."""
    right_edge = 0
    label_room = 0
    for column in sorted({box.place.column for box in boxes}):
        members = [box for box in boxes if box.place.column == column]
        room = max(label_room, _label_room(members, -1))
        for box in members:
            box.left = right_edge + room + scale * SPARE_COLUMNS
        right_edge = members[0].left + BOX_WIDTH
        label_room = _label_room(members, 1)
    bottom_edge = 0
    for row in sorted({box.place.row for box in boxes}):
        members = [box for box in boxes if box.place.row == row]
        height = max(box.height for box in members)
        for box in members:
            box.top = bottom_edge + scale * SPARE_ROWS + (height - box.height) // 2
        bottom_edge += scale * SPARE_ROWS + height
    for box in boxes:
        _place_outputs(box, boxes)
    for box in boxes:
        _place_inputs(box, boxes)


def _label_room(boxes: list[Box], flow: int) -> int:
    signals = [signal for box in boxes if box.place.flow == flow for signal in box.outputs]
    return max((signal.label_width for signal in signals), default=0)


def _place_outputs(box: Box, boxes: list[Box]) -> None:
    """Puts outputs that lead upwards above those that lead downwards, and unread ones last."""

    def bearing(signal: Signal) -> float:
        bearings = [
            math.atan2(
                reader.middle - box.middle, box.place.flow * (reader.input_side - box.output_side)
            )
            for reader in boxes
            for wire in reader.inputs
            if wire in signal.sinks
        ]
        return sum(bearings) / len(bearings) if bearings else math.inf

    box.outputs.sort(key=bearing)
    y = box.middle - sum(signal.label_height + 1 for signal in box.outputs[1:]) // 2
    for i, signal in enumerate(box.outputs):
        if i > 0:
            y += signal.label_height + 1
        signal.source = (box.output_side, y)


def _place_inputs(box: Box, boxes: list[Box]) -> None:
    """Puts inputs from above on top, and those with a straight wire at the height of its source."""
    low, high = box.top + 1, box.top + box.height - 1

    def comes_from(signal: Signal) -> float:
        x, y = signal.source
        ahead = box.place.flow * (box.input_side - x)
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
        box.inputs[wire].sinks[wire] = (box.input_side, y)


def _is_straight(signal: Signal, box: Box, boxes: list[Box]) -> bool:
    """Whether a straight wire can connect the signal with the box."""
    x, y = signal.source
    between = range(*sorted((x, box.input_side)))
    return (
        box.place.flow * (box.input_side - x) > 0
        and box.top < y < box.top + box.height
        and not any(
            other.left in between and other.top <= y <= other.top + other.height
            for other in boxes
            if other is not box
        )
    )


class _Router:
    """Routes the wires over the grid: around boxes and labels, across other wires."""

    def __init__(self, boxes: list[Box]):
        self._blocked: set[Node] = set()
        self._reserved: dict[Node, str] = {}
        self._axes: dict[Node, dict[str, str]] = defaultdict(dict)  # by node and signal
        for box in boxes:
            self._blocked.update(box.nodes(margin=1))
            for wire, signal in box.inputs.items():
                x, y = signal.sinks[wire]
                for i in range(3):
                    self._reserved[(x - box.place.flow * i, y)] = signal.name
            for signal in box.outputs:
                self._blocked.update(signal.label_nodes)
                self._reserved.update(dict.fromkeys(signal.stem, signal.name))
        xs, ys = zip(*self._blocked, *self._reserved, strict=True)
        self._columns = range(min(xs) - SPARE_COLUMNS, max(xs) + SPARE_COLUMNS)
        self._rows = range(min(ys) - SPARE_ROWS, max(ys) + SPARE_ROWS)

    def route(self, signal: Signal) -> bool:
        """Routes all wires of the signal again, the cheapest first; False if one has no route."""
        for axes in self._axes.values():
            axes.pop(signal.name, None)
        others = {node: "".join(axes.values()) for node, axes in self._axes.items() if axes}
        signal.paths = {}
        starts = [(0, signal.stem[-1], (signal.flow, 0))]
        goals = {sink: wire for wire, sink in signal.sinks.items()}
        while goals:
            path = self._cheapest_path(signal.name, starts, goals, others)
            if not path:
                return False
            if not signal.paths:
                path = signal.stem[:-1] + path
                starts = []
            signal.paths[goals.pop(path[-1])] = path
            self._occupy(path, signal.name)
            branchable = set(path) - others.keys() - self._blocked - set(signal.stem[:-1])
            starts += [(BRANCH_COST, node, step) for node in branchable for step in STEPS]
        return True

    def _occupy(self, path: list[Node], name: str) -> None:
        for (x, y), (next_x, next_y) in pairwise(path):
            axis = "h" if y == next_y else "v"
            for node in ((x, y), (next_x, next_y)):
                known = self._axes[node].get(name, axis)
                self._axes[node][name] = axis if known == axis else "hv"

    def _cheapest_path(
        self, name: str, starts: list[State], goals: Collection[Node], others: dict[Node, str]
    ) -> list[Node]:
        """The cheapest path by the A* algorithm; empty if there is none."""

        @functools.cache
        def distance(node: Node) -> int:
            return min(abs(node[0] - x) + abs(node[1] - y) for x, y in goals)

        queue = [(cost + distance(node), cost, node, step) for cost, node, step in starts]
        heapq.heapify(queue)
        costs = {(node, step): cost for cost, node, step in starts}
        came_from: dict[tuple[Node, Step], tuple[Node, Step]] = {}
        while queue:
            _, cost, node, step = heapq.heappop(queue)
            if node in goals:
                path = [node]
                while (node, step) in came_from:
                    node, step = came_from[(node, step)]
                    path.append(node)
                return path[::-1]
            if cost > costs[(node, step)]:
                continue
            for turn in STEPS:
                turns_back = turn == (-step[0], -step[1])
                turns_on_a_wire = turn != step and node in others
                following = (node[0] + turn[0], node[1] + turn[1])
                if turns_back or turns_on_a_wire or not self._is_free(following, name):
                    continue
                crossed = others.get(following, "")
                if crossed and crossed != ("v" if turn[1] == 0 else "h"):
                    continue
                new_cost = cost + 1 + BEND_COST * (turn != step) + CROSSING_COST * bool(crossed)
                if new_cost < costs.get((following, turn), math.inf):
                    costs[(following, turn)] = new_cost
                    came_from[(following, turn)] = (node, step)
                    heapq.heappush(
                        queue, (new_cost + distance(following), new_cost, following, turn)
                    )
        return []

    def _is_free(self, node: Node, name: str) -> bool:
        if node in self._reserved:
            return self._reserved[node] == name
        on_the_grid = node[0] in self._columns and node[1] in self._rows
        return on_the_grid and node not in self._blocked


def _route(boxes: list[Box]) -> bool:
    """Routes all signals, short ones first, in several passes; False if one has no route.

    A pass after the first routes each signal around the routes of all others.
    """

    def extent(signal: Signal) -> int:
        xs, ys = zip(signal.source, *signal.sinks.values(), strict=True)
        return max(xs) - min(xs) + max(ys) - min(ys)

    router = _Router(boxes)
    signals = sorted((signal for box in boxes for signal in box.outputs), key=extent)
    return all(router.route(signal) for _ in range(ROUTING_PASSES) for signal in signals)


def _positions(boxes: list[Box]) -> Positions:
    """Positions of the lanes in px, without the gaps that no box, label or wire needs."""
    signals = [signal for box in boxes for signal in box.outputs]
    solid = {node for box in boxes for node in box.nodes(margin=1)}
    for signal in signals:
        solid.update(signal.stem, signal.label_nodes)
    runs_down, runs_across = set(solid), {(y, x) for x, y in solid}
    for signal in signals:
        for path in signal.paths.values():
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


def _svg(title: str, boxes: list[Box]) -> str:
    position = _positions(boxes)
    width, height = (max(lanes.values()) + UNIT for lanes in position)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}"'
        f' viewBox="0 0 {width} {height}">',
        f"<title>{escape(title)}</title>",
        f"<style>{STYLE}</style>",
        *ARROWHEADS,
        f'<rect width="{width}" height="{height}" fill="white"/>',
    ]
    for box in boxes:
        for signal in box.outputs:
            lines += _signal_svg(signal, position)
    for box in boxes:
        lines += _box_svg(box, position)
    return "\n".join([*lines, "</svg>", ""])


def _signal_svg(signal: Signal, position: Positions) -> list[str]:
    kind = "wire" if signal.paths else "unread"
    lines = [f"<g data-signal={quoteattr(signal.name)}>"]
    neighbours: dict[Node, set[Node]] = defaultdict(set)
    for wire, path in signal.paths.items():
        data = _path_data(path, position)
        lines.append(f'<path class="wire" data-wire={quoteattr(wire)} d="{data}"/>')
        for node, following in pairwise(path):
            neighbours[node].add(following)
            neighbours[following].add(node)
    if not signal.paths:
        lines.append(f'<path class="unread" d="{_path_data(signal.stem, position)}"/>')
    for node, around in neighbours.items():
        if len(around) > 2:
            x, y = _pixel(node, position)
            lines.append(f'<circle cx="{x}" cy="{y}" r="2.5" fill="{WIRE_COLOUR}"/>')
    x, y = _pixel(signal.source, position)
    middle = x + signal.flow * signal.label_width * UNIT / 2
    baseline = y - LABEL_LIFT - (len(signal.lines) - 1) * LINE_HEIGHT * LABEL_SIZE
    for line in signal.lines:
        lines.append(_text_svg(f"{kind}-label", line, middle, baseline))
        baseline += LINE_HEIGHT * LABEL_SIZE
    return [*lines, "</g>"]


def _box_svg(box: Box, position: Positions) -> list[str]:
    left, top = _pixel((box.left, box.top), position)
    right, bottom = _pixel((box.left + BOX_WIDTH, box.top + box.height), position)
    fill, border = COLOURS[box.place.kind]
    lines = [
        f"<g data-block={quoteattr(box.name)}>",
        f'<rect x="{left}" y="{top}" width="{right - left}" height="{bottom - top}" rx="5"'
        f' fill="{fill}" stroke="{border}"/>',
    ]
    baseline = (top + bottom - sum(size for _, _, size in box.texts) * LINE_HEIGHT) / 2
    for kind, text, size in box.texts:
        baseline += LINE_HEIGHT * size
        lines.append(_text_svg(kind, text, (left + right) / 2, baseline - 0.25 * size))
    return [*lines, "</g>"]


def _text_svg(kind: str, text: str, x: float, y: float) -> str:
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}">{escape(text)}</text>'


def _path_data(path: list[Node], position: Positions) -> str:
    """A line along the path, with its corners rounded."""
    corners = [
        node
        for before, node, after in zip(path, path[1:], path[2:], strict=False)
        if before[0] != after[0] and before[1] != after[1]
    ]
    points = [_pixel(node, position) for node in (path[0], *corners, path[-1])]
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


def _pixel(node: Node, position: Positions) -> Node:
    return position[0][node[0]], position[1][node[1]]


def _wrapped(words: list[str], joint: str, size: float) -> list[str]:
    """The words in lines that fit into a box."""
    lines = [words[0]]
    for word in words[1:]:
        longer = lines[-1] + joint + word
        if _text_width(longer, size) > BOX_WIDTH * UNIT - 10:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def _text_width(text: str, size: float) -> float:
    """The approximate width of a text in px."""
    widths = [0.3 if c in NARROW else 0.85 if c in WIDE else 0.58 for c in text]
    return size * sum(widths)
