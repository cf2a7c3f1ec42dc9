"""The signals of a drawing: their labels, and the routes of their wires over a grid."""

import functools
import heapq
import math
import textwrap
from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

UNIT = 10  # px between neighbouring lanes; lengths are in units unless they say px
SPARE_COLUMNS = 8  # between two boxes, beside the room for labels
SPARE_ROWS = 9
LABEL_SIZE = 12  # px
LABEL_LIFT = 4  # px from the wire
LINE_HEIGHT = 1.1  # of the size of a font
_LABEL_CHARACTERS = 13  # in one line
_NARROW, _WIDE = set("fijlrt I"), set("mwMW")

# Costs of a wire's route, in units of length.
_BEND_COST, _CROSSING_COST, _BRANCH_COST = 5, 9, 2
_PASSES = 3

Node = tuple[int, int]
Step = tuple[int, int]
_STEPS: tuple[Step, ...] = ((1, 0), (0, 1), (-1, 0), (0, -1))
_State = tuple[int, Node, Step]  # cost of a path to a node, and its last step
_Taken = dict[Node, set[Step]]  # nodes of other wires, and the steps to or from these


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
        count = len(textwrap.wrap(words, _LABEL_CHARACTERS))
        width = next(w for w in range(1, 99) if len(textwrap.wrap(words, w)) <= count)
        return textwrap.wrap(words, width, break_long_words=False)

    @property
    def label_width(self) -> int:
        """Lanes along the wire."""
        return math.ceil((max(text_width(line, LABEL_SIZE) for line in self.lines) + 8) / UNIT)

    @property
    def label_height(self) -> int:
        """Lanes above the wire."""
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


def text_width(text: str, size: float) -> float:
    """The approximate width of a text in px."""
    widths = [0.3 if c in _NARROW else 0.85 if c in _WIDE else 0.58 for c in text]
    return size * sum(widths)


def route_all(signals: Sequence[Signal], blocked: set[Node], reserved: dict[Node, str]) -> bool:
    """Routes the wires of all signals, short ones first, in several passes.

    A pass after the first routes each signal around the routes of all others.

    Args:
        signals: which are given their paths.
        blocked: nodes of boxes and labels.
        reserved: nodes that only the signal of that name may use.

    Returns:
        False if a wire has no route.
    """

    def extent(signal: Signal) -> int:
        xs, ys = zip(signal.source, *signal.sinks.values(), strict=True)
        return max(xs) - min(xs) + max(ys) - min(ys)

    router = _Router(signals, blocked, reserved)
    ordered = sorted(signals, key=extent)
    return all(router.route(signal) for _ in range(_PASSES) for signal in ordered)


class _Router:
    """Routes wires over the grid: around boxes and labels, across other wires."""

    def __init__(self, signals: Sequence[Signal], blocked: set[Node], reserved: dict[Node, str]):
        self._signals, self._blocked, self._reserved = signals, blocked, reserved
        xs, ys = zip(*blocked, *reserved, strict=True)
        self._columns = range(min(xs) - SPARE_COLUMNS, max(xs) + SPARE_COLUMNS)
        self._rows = range(min(ys) - SPARE_ROWS, max(ys) + SPARE_ROWS)

    def route(self, signal: Signal) -> bool:
        """Routes all wires of the signal again, the cheapest first; False if one has no route."""
        signal.paths = {}
        others: _Taken = defaultdict(set)
        for path in (path for other in self._signals for path in other.paths.values()):
            for a, b in pairwise(path):
                step = abs(a[0] - b[0]), abs(a[1] - b[1])
                others[a].add(step)
                others[b].add(step)
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
            branchable = set(path) - others.keys() - self._blocked - set(signal.stem[:-1])
            starts += [(_BRANCH_COST, node, step) for node in branchable for step in _STEPS]
        return True

    def _cheapest_path(
        self, name: str, starts: list[_State], goals: Collection[Node], others: _Taken
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
            for turn in _STEPS:
                turns_back = turn == (-step[0], -step[1])
                turns_on_a_wire = turn != step and node in others
                onto = (node[0] + turn[0], node[1] + turn[1])
                if turns_back or turns_on_a_wire or not self._is_free(onto, name):
                    continue
                is_crossing = onto in others
                if is_crossing and others[onto] != {(abs(turn[1]), abs(turn[0]))}:
                    continue
                longer = cost + 1 + _BEND_COST * (turn != step) + _CROSSING_COST * is_crossing
                if longer < costs.get((onto, turn), math.inf):
                    costs[(onto, turn)] = longer
                    came_from[(onto, turn)] = (node, step)
                    heapq.heappush(queue, (longer + distance(onto), longer, onto, turn))
        return []

    def _is_free(self, node: Node, name: str) -> bool:
        if node in self._reserved:
            return self._reserved[node] == name
        on_the_grid = node[0] in self._columns and node[1] in self._rows
        return on_the_grid and node not in self._blocked
