"""The drawing of a built diagram: an SVG laid out like the paper's control figure.

The boxes are the diagram's subsystems and the wires its connections, so that the drawing
shows what runs. The places of the known boxes, and the paper's symbols of signals, are given in
`diagrams.nonstop`.

Boxes stand in columns and rows with lanes between them. The A* algorithm routes each wire along the
lanes; those without a wire are removed.
"""

import functools
import heapq
import html
import itertools
import math
import re
import textwrap
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

from pydrake.systems.framework import Diagram

from drake_nonstop.diagrams.nonstop import BOXES, PLACES, SYMBOLS
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
BOX_WIDTH = 12
INPUT_SPACING = 2
NAME_SIZE, CLASS_SIZE, LABEL_SIZE = 13, 11, 12  # px
BOLD_WIDTH = 1.25  # over that of the same text in regular
LABEL_LIFT = 4  # px from the wire
LINE_HEIGHT = 1.1  # of the size of a font
LABEL_CHARACTERS = 13  # in one line
NARROW, WIDE = set("fijlrt I,"), set("mwMW")
FREE_LANES = 3  # in front of an input, where no other wire turns
MOST_TRIES = 8
LANES = 8  # between boxes, of which those without a wire are removed
BEND_COST, CROSSING_COST, BRANCH_COST = 5, 9, 2  # units of length

CORNER_RADIUS = 5  # px
WIRE_COLOUR, UNREAD_COLOUR = "#333", "#999"
STYLE = f"""
text {{ font-family: Helvetica, Arial, sans-serif; text-anchor: middle; fill: #222 }}
.name {{ font-size: {NAME_SIZE}px; font-weight: bold }}
.class {{ font-size: {CLASS_SIZE}px; fill: #555 }}
.wire-label, .unread-label {{ font-size: {LABEL_SIZE}px; font-style: italic }}
.unread-label {{ fill: #777 }}
.index {{ font-size: {LABEL_SIZE - 3}px }}
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
Pixel = Callable[[Node], Node]  # where a node is, in px
ACROSS, DOWN = 0, 1


@dataclass
class _Signal:
    """An output port and the wires that leave it, by name "block.port -> block.port"."""

    name: str  # "block.port"
    flow: int
    source: Node = (0, 0)
    sinks: dict[str, Node] = field(default_factory=dict)
    paths: dict[str, list[Node]] = field(default_factory=dict)  # each from the trunk to its sink

    @cached_property
    def lines(self) -> list[str]:
        """The label, in lines of about the same length, and the paper's symbol."""
        port = self.name.partition(".")[2]
        words = port.replace("_", " ")
        count = len(textwrap.wrap(words, LABEL_CHARACTERS))
        width = next(w for w in range(1, 99) if len(textwrap.wrap(words, w)) <= count)
        lines = textwrap.wrap(words, width, break_long_words=False)
        symbol = SYMBOLS.get(port.removeprefix("held_"))
        if symbol is None:
            return lines
        if len(lines[-1]) + len(symbol) <= LABEL_CHARACTERS + 2:
            return [*lines[:-1], f"{lines[-1]} {symbol}"]
        return [*lines, symbol]

    @property
    def label_width(self) -> int:
        """Units along the wire."""
        return math.ceil((max(text_width(line, LABEL_SIZE) for line in self.lines) + 8) / UNIT)

    @property
    def label_height(self) -> int:
        """Units above the wire."""
        lines_above = len(self.lines) - 1
        return int((LABEL_LIFT + (0.75 + lines_above * LINE_HEIGHT) * LABEL_SIZE + 3) / UNIT)


@dataclass
class _Box:
    """A subsystem: its names, its signals and its place on the grid."""

    name: str
    class_name: str
    place: Place
    outputs: list[_Signal]
    inputs: dict[str, _Signal] = field(default_factory=dict)  # by wire
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
        outputs = [signal.label_height + 1 for signal in self.outputs]
        return max(texts, inputs, sum(outputs) + max(outputs, default=0))

    @property
    def middle(self) -> int:
        return self.top + self.height // 2

    @property
    def sides(self) -> tuple[int, int]:
        """The columns of the edges with the inputs and with the outputs."""
        left, right = self.left, self.left + BOX_WIDTH
        return (left, right) if self.place.flow > 0 else (right, left)


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
    urgent: list[str] = []  # signals that had no way, which are routed before all others
    while True:
        grid = _place(boxes, LANES + 2 * len(urgent))
        stuck = grid.route(urgent)
        if stuck is None:
            return _svg(title, boxes, *grid.pixels())
        urgent.insert(0, stuck)
        if urgent.count(stuck) > MOST_TRIES:
            raise RuntimeError(f"{stuck} of {title} cannot be drawn: it has no way between boxes")


def _boxes(subsystems: tuple[Subsystem, ...], wires: tuple[str, ...]) -> list[_Box]:
    """The boxes, each where that of its name is, or else the one that makes one of its signals."""
    boxes: dict[str, _Box] = {}
    signals: dict[str, _Signal] = {}
    below = ((row, column) for row in itertools.count(ROWS) for column in range(COLUMNS))
    taken = {PLACES[name] for name, _, _ in subsystems if name in PLACES}
    for name, class_name, output_names in subsystems:
        alike = (b.place for b in BOXES.values() if not b.signals.keys().isdisjoint(output_names))
        place = PLACES.get(name) or next((other for other in alike if other not in taken), None)
        if place is None:
            row, column = next(below)
            place = Place(column, row, 1, Kind.ADDITION)
        taken.add(place)
        outputs = [_Signal(f"{name}.{port}", place.flow) for port in output_names]
        signals.update({signal.name: signal for signal in outputs})
        boxes[name] = _Box(name, class_name, place, outputs)
    for wire in wires:
        source, target = wire.split(" -> ")
        boxes[target.partition(".")[0]].inputs[wire] = signals[source]
        signals[source].sinks[wire] = (0, 0)
    return list(boxes.values())


def _place(boxes: list[_Box], lanes: int) -> "_Grid":
    """Puts the boxes and their ports in columns and rows with that many lanes between them."""
    across, down = _Axis(lanes), _Axis(lanes)
    for column in sorted({box.place.column for box in boxes}):
        members = [box for box in boxes if box.place.column == column]
        rooms = [_label_room(members, flow) for flow in (-1, 1)]
        for box in members:
            box.left = across.end + rooms[0]
        across.add([rooms[0], BOX_WIDTH, rooms[1]])
    for row in sorted({box.place.row for box in boxes}):
        members = [box for box in boxes if box.place.row == row]
        height = max(box.height for box in members)
        for box in members:
            box.top = down.end + (height - box.height) // 2
        down.add([1] * height)
    for place in (_place_outputs, _place_inputs):
        for box in boxes:
            place(box, boxes)
    return _Grid(boxes, across, down)


class _Axis:
    """Positions across or down: the edges of what stands there, and the lanes between."""

    def __init__(self, lanes: int) -> None:
        self._lanes = lanes
        self.positions: list[int] = []
        self.parts: dict[int, int] = {}  # from edge to edge
        self.end = 0
        self.add([])

    def add(self, lengths: Sequence[int]) -> None:
        """Adds what has parts of these lengths at the end, and lanes behind it."""
        edges = [*dict.fromkeys(itertools.accumulate(lengths, initial=self.end))]
        self.parts |= dict(pairwise(edges))
        self.positions += [*edges, *range(edges[-1] + 1, edges[-1] + 1 + self._lanes)]
        self.end = edges[-1] + 1 + self._lanes

    @property
    def lanes(self) -> set[int]:
        """The positions that are no edges."""
        return {*self.positions} - {*self.parts, *self.parts.values()}

    def pixels(self, used: set[int]) -> dict[int, int]:
        """The positions in px, without the lanes that are not used."""
        lanes = self.lanes
        kept = [place for place in self.positions if place in used or place not in lanes]
        pixels = {kept[0]: UNIT}
        for before, place in pairwise(kept):
            is_part = self.parts.get(before) == place
            is_empty = lanes.isdisjoint({before, place})  # there is no wire between two boxes
            length = place - before if is_part else 3 if is_empty else 1
            pixels[place] = pixels[before] + UNIT * length
        return pixels


class _Grid:
    """Routes wires along the lanes: around boxes and labels, across other wires."""

    def __init__(self, boxes: list[_Box], across: _Axis, down: _Axis):
        self._across, self._down = across, down
        self._lanes = across.lanes
        self._signals = [signal for box in boxes for signal in box.outputs]
        across_at: dict[Node, str] = {}  # the signal that may run across there; "": none
        for box in boxes:
            labels = [signal.source[1] - signal.label_height for signal in box.outputs]
            rows = range(min([box.top, *labels]) - 1, box.top + box.height + 2)
            edges = box.left, box.left + BOX_WIDTH
            across_at |= dict.fromkeys(itertools.product(edges, rows), "")
        stems = [(self._stem(each.source, each.flow), each) for each in self._signals]
        for box in boxes:
            for wire, signal in box.inputs.items():
                stems.append((self._stem(signal.sinks[wire], -box.place.flow, FREE_LANES), signal))
        for stem, signal in stems:
            across_at |= dict.fromkeys(stem, signal.name)
        # By direction, the signal that alone may run so at a node.
        self._owners: tuple[dict[Node, str], dict[Node, str]] = (across_at, {})
        rows_used = down.lanes | {stem[0][1] for stem, _ in stems}
        self._next = [_neighbours(across.positions), _neighbours(sorted(rows_used))]

    def _stem(self, port: Node, flow: int, lanes: int = 1) -> list[Node]:
        """The nodes from a port to the lane in front of it, or to one of the next ones."""
        places = self._across.positions[::flow]
        stem = [(place, port[1]) for place in places[places.index(port[0]) :]]
        return stem[: lanes + next(k for k, node in enumerate(stem) if node[0] in self._lanes)]

    def route(self, urgent: Sequence[str]) -> str | None:
        """Routes the wires of all signals around those that are there: urgent and short ones first.

        Returns:
            The name of a signal that has no way, if there is one.
        """

        def order(signal: _Signal) -> tuple[int, int]:
            far = max((_far(signal.source, sink) for sink in signal.sinks.values()), default=0)
            return (urgent.index(signal.name) if signal.name in urgent else len(urgent)), far

        for signal in sorted(self._signals, key=order):
            signal.paths = {}
            stem = self._stem(signal.source, signal.flow)
            starts = [(0, stem[-1], ACROSS)]
            for wire, sink in sorted(signal.sinks.items(), key=lambda w: _far(w[1], signal.source)):
                path = self._cheapest_path(signal.name, starts, sink)
                if not path:
                    return signal.name
                if not signal.paths:
                    path, starts = stem[:-1] + path, []
                signal.paths[wire] = path
                lanes = [node for node in path if node[0] in self._lanes]
                starts += [(BRANCH_COST, node, turn) for node in lanes for turn in (ACROSS, DOWN)]
                for a, b in pairwise(path):
                    self._owners[_direction(a, b)].update({a: signal.name, b: signal.name})
        return None

    def _cheapest_path(
        self,
        name: str,
        starts: list[tuple[int, Node, int]],
        sink: Node,
    ) -> list[Node]:
        """The cheapest path by the A* algorithm; empty: there is none.

        A state is a node and the direction of the wire there.
        """
        owners = self._owners
        queue = [(cost + _far(node, sink), cost, node, turn) for cost, node, turn in starts]
        heapq.heapify(queue)
        costs = {(node, turn): cost for cost, node, turn in starts}
        came_from: dict[tuple[Node, int], tuple[Node, int]] = {}
        while queue:
            _, cost, node, turn = heapq.heappop(queue)
            state = node, turn
            if node == sink:
                path = [node]
                while state in came_from:
                    state = came_from[state]
                    path.append(state[0])
                return [*dict.fromkeys(reversed(path))]
            if cost > costs[state]:
                continue
            for direction in (ACROSS, DOWN):
                longer = cost
                if direction != turn:
                    if owners[direction].get(node, name) != name:
                        continue  # no turns on another wire
                    longer += BEND_COST
                if direction == DOWN and node[0] not in self._lanes:
                    continue
                for place in self._next[direction][node[direction]]:
                    onto = (place, node[1]) if direction == ACROSS else (node[0], place)
                    if owners[direction].get(onto, name) != name:
                        continue
                    crossed = owners[1 - direction].get(onto, name) != name
                    further = longer + _far(node, onto) + CROSSING_COST * crossed
                    if further < costs.get((onto, direction), math.inf):
                        costs[onto, direction] = further
                        came_from[onto, direction] = state
                        heapq.heappush(
                            queue, (further + _far(onto, sink), further, onto, direction)
                        )
        return []

    def pixels(self) -> tuple[dict[int, int], dict[int, int]]:
        """Columns and rows in px, without the lanes that no wire runs along."""
        used: tuple[set[int], set[int]] = set(), set()
        for path in (path for signal in self._signals for path in signal.paths.values()):
            for a, b in pairwise(path):
                direction = _direction(a, b)
                used[1 - direction].add(a[1 - direction])
        return self._across.pixels(used[ACROSS]), self._down.pixels(used[DOWN])


def _neighbours(places: list[int]) -> dict[int, list[int]]:
    """Of each place the one before and the one after it."""
    found: dict[int, list[int]] = {place: [] for place in places}
    for before, after in pairwise(places):
        found[before].append(after)
        found[after].append(before)
    return found


def _direction(a: Node, b: Node) -> int:
    return ACROSS if a[1] == b[1] else DOWN


def _far(a: Node, b: Node) -> int:
    return abs(a[0] - b[0]) + abs(a[1] - b[1])


def _label_room(boxes: list[_Box], flow: int) -> int:
    signals = [signal for box in boxes if box.place.flow == flow for signal in box.outputs]
    return max((signal.label_width for signal in signals), default=0)


def _place_outputs(box: _Box, boxes: list[_Box]) -> None:
    """Puts outputs that lead upwards above those that lead downwards, and unread ones last."""

    def bearing(signal: _Signal) -> float:
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
    straight = {wire for wire, signal in box.inputs.items() if _is_straight(signal, box, boxes)}

    def comes_from(wire: str) -> float:
        x, y = box.inputs[wire].source
        ahead = box.place.flow * (box.sides[0] - x)
        if ahead > 0 and low <= y <= high and wire not in straight:
            return math.copysign(math.pi / 2, y - box.middle + INPUT_SPACING)
        return math.atan2(y - box.middle - 0.5, ahead)

    wires = sorted(box.inputs, key=comes_from)
    fixed = {i: box.inputs[wire].source[1] for i, wire in enumerate(wires) if wire in straight}
    heights: list[int] = []
    for i in range(len(wires)):
        y = box.top + round(box.height * (i + 1) / (len(wires) + 1))
        for k, height in fixed.items():
            bound = height + INPUT_SPACING * (i - k)
            y = max(y, bound) if k <= i else min(y, bound)
        y = fixed.get(i, y)
        heights.append(max(y, heights[-1] + INPUT_SPACING if heights else low))
    for wire, y in zip(reversed(wires), reversed(heights), strict=True):
        y = min(y, high)
        high = y - INPUT_SPACING
        box.inputs[wire].sinks[wire] = (box.sides[0], y)


def _is_straight(signal: _Signal, box: _Box, boxes: list[_Box]) -> bool:
    """Whether a straight wire can connect the signal with the box."""
    x, y = signal.source
    between = range(*sorted((x, box.sides[0])))
    is_ahead = box.place.flow * (box.sides[0] - x) > 0 and box.top < y < box.top + box.height
    others = (other for other in boxes if other is not box and other.left in between)
    return is_ahead and not any(other.top <= y <= other.top + other.height for other in others)


def _svg(title: str, boxes: list[_Box], columns: dict[int, int], rows: dict[int, int]) -> str:
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


def _signal_svg(signal: _Signal, pixel: Pixel) -> list[str]:
    kind = "wire" if signal.paths else "unread"
    lines = [f'<g data-signal="{html.escape(signal.name)}">']
    neighbours: dict[Node, set[Node]] = defaultdict(set)
    for wire, path in signal.paths.items():
        data = _path_data(path, pixel)
        lines.append(f'<path class="wire" data-wire="{html.escape(wire)}" d="{data}"/>')
        for node, other in (*pairwise(path), *pairwise(path[::-1])):
            neighbours[node].add(other)
    for node, around in neighbours.items():
        if len(around) > 2:
            dot = 'cx="{}" cy="{}"'.format(*pixel(node))
            lines.append(f'<circle {dot} r="2.5" fill="{WIRE_COLOUR}"/>')
    x, y = pixel(signal.source)
    end = x + signal.flow * signal.label_width * UNIT
    if not signal.paths:
        lines.append(f'<path class="unread" d="M{x},{y} L{end},{y}"/>')
    baseline = y - LABEL_LIFT - (len(signal.lines) - 1) * LINE_HEIGHT * LABEL_SIZE
    for line in signal.lines:
        lines.append(_text_svg(f"{kind}-label", line, (x + end) / 2, baseline))
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
    lowered = r'<tspan class="index" dy="3">\1</tspan><tspan dy="-3">\2</tspan>'
    shown = re.sub(r"_(\w+)([^_]*)", lowered, html.escape(text, quote=False))
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}">{shown}</text>'


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


def text_width(text: str, size: float) -> float:
    """The approximate width of a text in px."""
    widths = [0.3 if c in NARROW else 0.85 if c in WIDE else 0.58 for c in text]
    return size * sum(widths)
