"""The drawing of a built diagram: an SVG laid out like the paper's control figure.

The boxes are the diagram's subsystems and the wires its connections, so that the drawing
shows what runs. The places of the known boxes, and the paper's symbols of signals, are given in
`diagrams.nonstop`.

Boxes stand in columns and rows with lanes between them. The wires of a signal run along one line
across, a lane between two rows or the line of a port, and along one lane down in front of each
column that they lead to. Of two signals side by side the order is the one with fewer crossings.
"""

import html
import itertools
import math
import re
import textwrap
from collections import defaultdict
from collections.abc import Sequence
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
BOX_WIDTH = 13
INPUT_SPACING = 3
GAP = 2  # between a lane and a box
NAME_SIZE, CLASS_SIZE, LABEL_SIZE = 13, 11, 12  # px
LABEL_LIFT = 4  # px from the wire
LINE_HEIGHT = 1.1  # of the size of a font
LETTER_WIDTH = 0.55  # of the size of a font
NAME_CHARACTERS, CLASS_CHARACTERS, LABEL_CHARACTERS = 15, 22, 13  # in one line

WIRE_COLOUR, UNREAD_COLOUR = "#333", "#999"
STYLE = f"""
text {{ font-family: Helvetica, Arial, sans-serif; text-anchor: middle; fill: #222 }}
.name {{ font-size: {NAME_SIZE}px; font-weight: bold }}
.class {{ font-size: {CLASS_SIZE}px; fill: #555 }}
.wire-label, .unread-label {{ font-size: {LABEL_SIZE}px; font-style: italic }}
.unread-label {{ fill: #777 }}
.index {{ font-size: {LABEL_SIZE - 3}px }}
.wire, .unread {{ fill: none; stroke-width: 1.2; stroke-linejoin: round }}
.wire {{ stroke: {WIRE_COLOUR}; marker-end: url(#wire-arrow) }}
.unread {{ stroke: {UNREAD_COLOUR}; marker-end: url(#unread-arrow) }}
"""
ARROWHEADS = [
    f'<marker id="{kind}-arrow" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8"'
    f' markerHeight="8" markerUnits="userSpaceOnUse" orient="auto">'
    f'<path d="M0,1 L8,4 L0,7 z" fill="{colour}"/></marker>'
    for kind, colour in (("wire", WIRE_COLOUR), ("unread", UNREAD_COLOUR))
]

Node = tuple[int, int]
# Where something is, across or down: the number of its column or row, odd, or of the gap before
# it, even; and the units from the start of that.
Spot = tuple[int, int]
Lines = dict[str, Spot | None]  # where the wires of each signal run across; None: nowhere
Lanes = dict[tuple[int, str], int]  # of each signal, by gap and name


@dataclass
class _Signal:
    """An output port and the wires that leave it, by name "block.port -> block.port"."""

    name: str  # "block.port"
    box: "_Box"
    down: Spot = (0, 0)
    sinks: dict[str, "_Box"] = field(default_factory=dict)

    @cached_property
    def lines(self) -> list[str]:
        """The label, in lines, with the paper's symbol."""
        port = self.name.partition(".")[2]
        *lines, last = textwrap.wrap(
            port.replace("_", " "), LABEL_CHARACTERS, break_long_words=False
        )
        symbol = SYMBOLS.get(port.removeprefix("held_"), "")
        if len(last) + len(symbol) <= LABEL_CHARACTERS + 2:
            return [*lines, f"{last} {symbol}".strip()]
        return [*lines, last, symbol]

    @property
    def label_width(self) -> int:
        """Units along the wire."""
        return math.ceil((LETTER_WIDTH * LABEL_SIZE * max(map(len, self.lines)) + 8) / UNIT)

    @property
    def height(self) -> int:
        """Units from the wire to what is above the label, an even number."""
        lines_above = len(self.lines) - 1
        label = (LABEL_LIFT + (0.75 + lines_above * LINE_HEIGHT) * LABEL_SIZE + 3) / UNIT
        return 2 * math.ceil((int(label) + 1) / 2)


@dataclass
class _Box:
    """A subsystem: its names, its signals and its place on the grid."""

    name: str
    class_name: str
    place: Place
    outputs: list[_Signal] = field(default_factory=list)
    inputs: dict[str, _Signal] = field(default_factory=dict)  # by wire
    sinks: dict[str, Spot] = field(default_factory=dict)  # where these arrive, down
    column: int = 0
    row: int = 0
    top: int = 0  # below the start of its row

    @cached_property
    def texts(self) -> list[tuple[str, str, int]]:
        """The lines of text in the box: style, text, size in px."""
        names = textwrap.wrap(self.name.replace("_", " "), NAME_CHARACTERS)
        words = re.sub("(?<=[a-z])(?=[A-Z])", " ", self.class_name)
        classes = [line.replace(" ", "") for line in textwrap.wrap(words, CLASS_CHARACTERS)]
        styles = (("name", names, NAME_SIZE), ("class", classes, CLASS_SIZE))
        return [(style, line, size) for style, lines, size in styles for line in lines]

    @property
    def height(self) -> int:
        """The height that the texts and the ports on either side need."""
        texts = math.ceil(sum(size for _, _, size in self.texts) * LINE_HEIGHT / UNIT) + 2
        inputs = INPUT_SPACING * len(self.inputs) + 1
        return max(texts, inputs, sum(signal.height for signal in self.outputs) + 3)

    @property
    def middle(self) -> Spot:
        return self.row, self.top + self.height // 2

    def gap(self, way: int) -> int:
        """The gap in front of its outputs (way 1), or of its inputs (-1)."""
        return self.column + way * self.place.flow

    def covers(self, down: Spot) -> bool:
        """Whether that is in its height, or next to it."""
        return (self.row, self.top - 1) <= down <= (self.row, self.top + self.height + 1)


@dataclass
class _Run:
    """A straight part of a signal's wires in a gap: its ends, and where others leave it."""

    name: str
    leaves: list[tuple[Spot, int]]  # at that spot along it, to which side: -1 or 1

    @property
    def ends(self) -> tuple[Spot, Spot]:
        spots = [spot for spot, _ in self.leaves]
        return min(spots), max(spots)

    def meets(self, spot: Spot) -> bool:
        first, last = self.ends
        return first <= spot <= last

    def crossings(self, other: "_Run") -> int:
        """Of the two, with this one before the other."""
        after = sum(side > 0 and other.meets(spot) for spot, side in self.leaves)
        return after + sum(side < 0 and self.meets(spot) for spot, side in other.leaves)


def draw_diagram(diagram: Diagram) -> str:
    """The diagram as the text of a standalone SVG file.

    Each box has its instance name as `data-block`, each wire its connection (see
    `wiring.connections`) as `data-wire`, and each label its output port as `data-signal`.
    """
    boxes = _boxes(diagram)
    _place(boxes)
    across = {signal.name: _line_across(signal, boxes) for box in boxes for signal in box.outputs}
    signals = [signal for box in boxes for signal in box.outputs if signal.sinks]
    rows = _lanes(_runs_across(signals, across))
    across |= {name: (gap, GAP + lane) for (gap, name), lane in rows.items()}
    columns = _lanes(_runs_down(signals, across))
    return _Drawing(boxes, across, rows, columns).svg(diagram.get_name())


def _boxes(diagram: Diagram) -> list[_Box]:
    """The boxes, each where that of its name is, or else the one that makes one of its signals."""
    boxes: dict[str, _Box] = {}
    signals: dict[str, _Signal] = {}
    below = ((row, column) for row in itertools.count(ROWS) for column in range(COLUMNS))
    systems = {system.get_name(): system for system in diagram.GetSystems()}
    taken = {PLACES[name] for name in systems if name in PLACES}
    for name, system in systems.items():
        ports = wiring.output_names(system)
        alike = (box.place for box in BOXES.values() if not box.signals.keys().isdisjoint(ports))
        place = PLACES.get(name) or next((other for other in alike if other not in taken), None)
        if place is None:
            row, column = next(below)
            place = Place(column, row, 1, Kind.ADDITION)
        taken.add(place)
        box = boxes[name] = _Box(name, type(system).__name__, place)
        box.outputs = [_Signal(f"{name}.{port}", box) for port in ports]
        signals.update({signal.name: signal for signal in box.outputs})
    for wire in sorted(wiring.connections(diagram)):
        source, target = wire.split(" -> ")
        box = boxes[target.partition(".")[0]]
        box.inputs[wire] = signals[source]
        signals[source].sinks[wire] = box
    return list(boxes.values())


def _place(boxes: list[_Box]) -> None:
    """Puts the boxes and their ports in columns and rows.

    Ports on the right of boxes are at even heights and those on the left at odd ones, so that
    no two of one gap are at the same: but for those that a straight wire connects.
    """
    columns, rows = ({*places} for places in zip(*(box.place[:2] for box in boxes), strict=True))
    for box in boxes:
        box.column = 1 + 2 * sorted(columns).index(box.place.column)
        box.row = 1 + 2 * sorted(rows).index(box.place.row)
    for row in {box.row for box in boxes}:
        members = [box for box in boxes if box.row == row]
        height = max(box.height for box in members)
        for box in members:
            box.top = (height - box.height) // 2
    for box in boxes:
        _place_outputs(box)
    for box in boxes:
        _place_inputs(box, boxes)


def _bearing(box: _Box, way: int, other: Spot, gap: int) -> float:
    """The angle downwards from a side of a box (see `gap`) to what is at that height and gap."""
    ahead = way * box.place.flow * (gap - box.gap(way))
    return math.atan2(other[0] - box.row + (other[1] - box.middle[1]) / 100, ahead + 1)


def _place_outputs(box: _Box) -> None:
    """Puts outputs that lead upwards above those that lead downwards, and unread ones last."""

    def leads_to(signal: _Signal) -> float:
        sinks = signal.sinks.values()
        bearings = [_bearing(box, 1, sink.middle, sink.gap(-1)) for sink in sinks]
        return sum(bearings) / len(bearings) if bearings else math.inf

    box.outputs.sort(key=leads_to)
    heights = [signal.height for signal in box.outputs]
    row = box.top + (box.height - sum(heights)) // 2
    row += (row + (box.place.flow < 0)) % 2
    for signal in box.outputs:
        row += signal.height
        signal.down = box.row, row


def _place_inputs(box: _Box, boxes: list[_Box]) -> None:
    """Puts inputs from above on top, and those with a straight wire at the height of its source."""

    def comes_from(wire: str) -> tuple[float, str]:
        signal = box.inputs[wire]
        return _bearing(box, -1, signal.down, signal.box.gap(1)), wire

    straight = {w: s.down for w, s in box.inputs.items() if _is_straight(s, box, boxes)}
    start = box.top + 1 + (box.top + (box.place.flow < 0)) % 2
    taken = [row for _, row in straight.values()]
    rows = range(start, box.top + box.height, 2)
    free = [row for row in rows if all(abs(row - other) > 1 for other in taken)]
    wires = sorted(box.inputs.keys() - straight.keys(), key=comes_from)
    above = sum(comes_from(wire)[0] < 0 for wire in wires)
    if straight:
        free = free[:above] + free[len(free) - len(wires) + above :]
    box.sinks = straight | {
        wire: (box.row, free[(2 * k + 1) * len(free) // (2 * len(wires))])
        for k, wire in enumerate(wires)
    }


def _is_straight(signal: _Signal, box: _Box, boxes: list[_Box]) -> bool:
    """Whether a straight wire can connect the signal with the box."""
    row, height = signal.down
    is_beside = row == box.row and box.top < height < box.top + box.height
    flow = box.place.flow
    is_ahead = flow == signal.box.place.flow and flow * (box.gap(-1) - signal.box.gap(1)) >= 0
    return is_beside and is_ahead and _is_clear(signal, box, signal.down, boxes)


def _is_clear(signal: _Signal, box: _Box, down: Spot, boxes: list[_Box]) -> bool:
    """Whether there is no box at that height between the gaps of the signal and of the box."""
    low, high = sorted((signal.box.gap(1), box.gap(-1)))
    return not any(low < other.column < high and other.covers(down) for other in boxes)


def _line_across(signal: _Signal, boxes: list[_Box]) -> Spot | None:
    """Where the wires of a signal run across: its own line, its only sink's, or a gap's.

    None: they stay in one gap.
    """
    far = {w: box for w, box in signal.sinks.items() if box.gap(-1) != signal.box.gap(1)}
    if not far:
        return None
    lines = [signal.down, *(box.sinks[wire] for wire, box in far.items() if len(far) == 1)]
    for line in lines:
        if all(_is_clear(signal, box, line, boxes) for box in far.values()):
            return line
    ends = [signal.box.row, *(box.row for box in far.values())]
    gaps = range(min(ends) - 1, max(ends) + 2, 2)
    return min(gaps, key=lambda gap: sum(abs(gap - end) for end in ends)), 0


def _runs_across(signals: Sequence[_Signal], across: Lines) -> dict[int, list[_Run]]:
    """The parts of wires in the gaps between rows, by gap."""
    runs: dict[int, list[_Run]] = defaultdict(list)
    for signal in signals:
        line = across[signal.name]
        if line is not None and line[0] % 2 == 0:
            ends = [(signal.box.gap(1), signal.box.row)]
            ends += [(box.gap(-1), box.row) for box in signal.sinks.values()]
            leaves = [((gap, 0), 1 if row > line[0] else -1) for gap, row in ends]
            runs[line[0]].append(_Run(signal.name, leaves))
    return runs


def _runs_down(signals: Sequence[_Signal], across: Lines) -> dict[int, list[_Run]]:
    """The parts of wires in the gaps between columns, by gap."""
    runs: dict[int, list[_Run]] = defaultdict(list)
    for signal in signals:
        leaves: dict[int, list[tuple[Spot, int]]] = defaultdict(list)
        leaves[signal.box.gap(1)].append((signal.down, -signal.box.place.flow))
        for wire, box in signal.sinks.items():
            leaves[box.gap(-1)].append((box.sinks[wire], box.place.flow))
        line = across[signal.name]
        for gap, own in leaves.items():
            if line is not None:
                own += [(line, 1 if other > gap else -1) for other in leaves if other != gap]
            run = _Run(signal.name, own)
            if run.ends[0] != run.ends[1]:
                runs[gap].append(run)
    return runs


def _lanes(runs: dict[int, list[_Run]]) -> Lanes:
    """The lane of each run in its gap, by the gap and the signal's name: of few crossings."""
    lanes: Lanes = {}
    for gap, members in runs.items():
        ordered: list[_Run] = []
        for run in members * 2:  # each where it crosses the fewest of the others
            ordered = [other for other in ordered if other is not run]
            costs = [
                sum(other.crossings(run) for other in ordered[:k])
                + sum(run.crossings(other) for other in ordered[k:])
                for k in range(len(ordered) + 1)
            ]
            ordered.insert(costs.index(min(costs)), run)
        placed: list[_Run] = []
        for run in ordered:
            beside = [
                lanes[gap, other.name]
                for other in placed
                if other.meets(run.ends[0]) or run.meets(other.ends[0])
            ]
            lanes[gap, run.name] = 1 + max(beside, default=-1)
            placed.append(run)
    return lanes


class _Drawing:
    """The boxes and wires at their places in px."""

    def __init__(
        self,
        boxes: list[_Box],
        across: Lines,
        rows: Lanes,
        columns: Lanes,
    ):
        self._boxes, self._across, self._columns = boxes, across, columns
        gaps = range(0, 2 + max(box.column for box in boxes), 2)
        self._labels = {gap: _label_room(boxes, gap, 1) for gap in gaps}  # left of the lanes
        widths = {gap: _lane_room(columns, gap) + _label_room(boxes, gap, -1) for gap in gaps}
        widths = {gap: width + self._labels[gap] for gap, width in widths.items()}
        widths |= {box.column: BOX_WIDTH for box in boxes}
        gaps = range(0, 2 + max(box.row for box in boxes), 2)
        heights = {gap: _lane_room(rows, gap) for gap in gaps}
        for box in boxes:
            heights[box.row] = max(box.height, heights.get(box.row, 0))
        self._lefts, self._tops = (
            [*itertools.accumulate((sizes[k] for k in range(len(sizes))), initial=0)]
            for sizes in (widths, heights)
        )

    def _x(self, box: _Box, way: int) -> int:
        """The side of a box with its outputs (way 1), or its inputs (-1), in px."""
        return UNIT * (self._lefts[box.column] + BOX_WIDTH * (way * box.place.flow > 0))

    def _y(self, down: Spot) -> int:
        return UNIT * (self._tops[down[0]] + down[1])

    def _lane(self, gap: int, signal: _Signal, *rows: Spot) -> list[Node]:
        """Nodes on the lane of a signal in a gap, at these heights; none where it has no lane."""
        lane = self._columns.get((gap, signal.name))
        if lane is None:
            return []
        return [
            (UNIT * (self._lefts[gap] + self._labels[gap] + GAP + lane), self._y(r)) for r in rows
        ]

    def _path(self, signal: _Signal, wire: str, sink: _Box) -> list[Node]:
        """The ends and corners of a wire."""
        first, last, line = signal.box.gap(1), sink.gap(-1), self._across[signal.name]
        start, end = signal.down, sink.sinks[wire]
        if line is None or first == last:
            path = self._lane(first, signal, start, end)
        else:
            path = self._lane(first, signal, start, line) + self._lane(last, signal, line, end)
        ends = (self._x(signal.box, 1), self._y(start)), (self._x(sink, -1), self._y(end))
        return [*dict.fromkeys([ends[0], *path, ends[1]])]

    def svg(self, title: str) -> str:
        """The text of the file."""
        width, height = UNIT * self._lefts[-1], UNIT * self._tops[-1]
        size = f'width="{width}" height="{height}"'
        lines = [
            f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {width} {height}">',
            f"<title>{html.escape(title, quote=False)}</title>",
            f"<style>{STYLE}</style>",
            *ARROWHEADS,
            f'<rect {size} fill="white"/>',
        ]
        lines += [line for b in self._boxes for s in b.outputs for line in self._signal_svg(s)]
        lines += [line for box in self._boxes for line in self._box_svg(box)]
        return "\n".join([*lines, "</svg>", ""])

    def _signal_svg(self, signal: _Signal) -> list[str]:
        kind = "wire" if signal.sinks else "unread"
        lines = [f'<g data-signal="{html.escape(signal.name)}">']
        neighbours: dict[Node, set[Node]] = defaultdict(set)
        for wire, sink in signal.sinks.items():
            path = self._path(signal, wire, sink)
            data = " L".join("{},{}".format(*node) for node in path)
            lines.append(f'<path class="wire" data-wire="{html.escape(wire)}" d="M{data}"/>')
            for node, other in pairwise(_nodes(path)):
                neighbours[node].add(other)
                neighbours[other].add(node)
        for (x, y), around in neighbours.items():
            if len(around) > 2:
                lines.append(f'<circle cx="{x}" cy="{y}" r="2.5" fill="{WIRE_COLOUR}"/>')
        x, y = self._x(signal.box, 1), self._y(signal.down)
        end = x + signal.box.place.flow * signal.label_width * UNIT
        if not signal.sinks:
            lines.append(f'<path class="unread" d="M{x},{y} L{end},{y}"/>')
        baseline = y - LABEL_LIFT - (len(signal.lines) - 1) * LINE_HEIGHT * LABEL_SIZE
        for line in signal.lines:
            lines.append(_text_svg(f"{kind}-label", line, (x + end) / 2, baseline))
            baseline += LINE_HEIGHT * LABEL_SIZE
        return [*lines, "</g>"]

    def _box_svg(self, box: _Box) -> list[str]:
        left, top = UNIT * self._lefts[box.column], self._y((box.row, box.top))
        width, height = UNIT * BOX_WIDTH, UNIT * box.height
        fill, border = COLOURS[box.place.kind]
        lines = [
            f'<g data-block="{html.escape(box.name)}">',
            f'<rect x="{left}" y="{top}" width="{width}" height="{height}" rx="5"'
            f' fill="{fill}" stroke="{border}"/>',
        ]
        baseline = top + (height - sum(size for _, _, size in box.texts) * LINE_HEIGHT) / 2
        for kind, text, size in box.texts:
            baseline += LINE_HEIGHT * size
            lines.append(_text_svg(kind, text, left + width / 2, baseline - 0.25 * size))
        return [*lines, "</g>"]


def _lane_room(lanes: Lanes, gap: int) -> int:
    """Units from box to box, without labels."""
    return 2 * GAP + max((lane for (place, _), lane in lanes.items() if place == gap), default=0)


def _label_room(boxes: list[_Box], gap: int, flow: int) -> int:
    """Units for the labels of the outputs that run into a gap this way."""
    signals = (s for b in boxes if b.place.flow == flow and b.gap(1) == gap for s in b.outputs)
    return max((signal.label_width for signal in signals), default=0)


def _nodes(path: list[Node]) -> list[Node]:
    """All nodes of a path, a unit from one another."""
    nodes = path[:1]
    for (x, y), (to_x, to_y) in pairwise(path):
        count = (abs(to_x - x) + abs(to_y - y)) // UNIT
        nodes += [
            (x + (to_x - x) * k // count, y + (to_y - y) * k // count) for k in range(1, count + 1)
        ]
    return nodes


def _text_svg(kind: str, text: str, x: float, y: float) -> str:
    lowered = r'<tspan class="index" dy="3">\1</tspan><tspan dy="-3">\2</tspan>'
    shown = re.sub(r"_(\w+)([^_]*)", lowered, html.escape(text, quote=False))
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}">{shown}</text>'
